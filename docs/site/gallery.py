"""The pictures of the manual's gallery, from the examples themselves.

    python docs/site/gallery.py                      # all of them, which takes its time
    python docs/site/gallery.py snap_through 03_benchmarks

An example runs as it stands, and its picture is drawn from the names that it leaves behind; a notebook's is one of
those that it holds. Writes docs/pictures/gallery/NAME.png, 800 pixels wide.
"""

import argparse
import base64
import io
import json
import os
import runpy
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.collections import PolyCollection  # noqa: E402
from matplotlib.colors import Normalize  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from PIL import Image  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.plotting.style import BLUE, STYLE, VERMILLION  # noqa: E402

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "pictures" / "gallery"
WIDTH = 800
"""Pixels."""


def panels(title: str, columns: int = 2, height: float = 3.0, **options):
    figure = Figure(figsize=(6.7, height), layout="constrained")
    figure.suptitle(title, fontsize=9.5)
    return figure, figure.subplots(1, columns, **options)


def surface(panel, nodes, triangles, values, label: str, unit: str, cmap="viridis", azimuth=-60.0) -> None:
    """A shell in orthographic projection, true to scale, with a triad and a bar of a length; `nodes` in `unit`.

    Seen from `azimuth` [degrees], counted from +x, and from above.
    """
    azimuth, elevation = np.radians(azimuth), np.radians(25.0)
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    view = np.stack([right, np.cross(towards, right), towards], axis=1)
    corners, seen = nodes[triangles], (nodes @ view)[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scale = Normalize(values.min(), values.max())
    colours = matplotlib.colormaps[cmap](scale(values))
    colours[:, :3] *= 0.72 + 0.28 * np.abs(normals @ np.array([0.31, -0.61, 0.73]))[:, None]
    order = np.argsort(seen[:, :, 2].mean(axis=1))  # the farthest first
    faces = PolyCollection(list(seen[order, :, :2]), facecolors=colours[order], edgecolors="0.3", linewidths=0.15)
    panel.add_collection(faces)
    low, high = seen[:, :, :2].min((0, 1)), seen[:, :, :2].max((0, 1))
    size = (high - low).max()
    origin = np.array([low[0] - 0.02 * size, low[1] - 0.22 * size])
    for axis, letter in enumerate("xyz"):
        tip = origin + 0.13 * size * view[axis, :2]
        panel.annotate(
            "", tip, origin, arrowprops={"arrowstyle": "-|>", "lw": 0.8, "color": "0.2", "shrinkA": 0, "shrinkB": 0}
        )
        panel.text(*(origin + 0.17 * size * view[axis, :2]), letter, ha="center", va="center", fontsize=8)
    length = max(step * 10.0**power for step in (1, 2, 5) for power in range(-4, 4) if step * 10.0**power < 0.35 * size)
    panel.plot([high[0] - length, high[0]], [origin[1]] * 2, color="black", lw=1.5, solid_capstyle="butt")
    panel.text(high[0] - length / 2, origin[1] - 0.03 * size, f"{length:g} {unit}", ha="center", va="top")
    panel.set(xlim=(low[0] - 0.12 * size, high[0] + 0.05 * size), ylim=(low[1] - 0.34 * size, high[1] + 0.05 * size))
    panel.set_aspect("equal")
    panel.set_axis_off()
    bar = panel.figure.colorbar(matplotlib.cm.ScalarMappable(scale, cmap), ax=panel, shrink=0.75, pad=0.02)
    bar.set_label(label)
    bar.outline.set_visible(False)


def delay_buckling(e) -> Figure:
    figure, (left, right) = panels("Opened cap under a ring of forces, EnergyMomentum, Δt = 25 ms")
    for h, label in ((np.ones(e.rings), "uniform"), (np.asarray(e.h), "best")):
        scene = e.eqx.tree_at(lambda scene: scene.section.thickness, e.cap, 0.4 * h[e.ring])
        run = js.simulate(scene, js.EnergyMomentum(), dt=0.025, t_end=5.0, save_every=200)
        left.plot(run.times, run.watched["A"], label=label)
        right.step(np.arange(e.rings + 1), 0.4 * np.append(h, h[-1]), where="post", label=label)
    left.axhline(-5.0, color="0.6", lw=0.8)
    left.set(xlabel="t in s", ylabel="deflection of A in m", title="-5 m counts as buckled")
    right.set(xlabel="ring, from the bottom", ylabel="thickness in m", title=f"{e.first:.3f} s → {e.time:.3f} s")
    left.legend()
    return figure


def identify_load_and_thickness(e) -> Figure:
    figure, (left, right) = panels("Clamped cap, EnergyMomentum, Δt = 2 µs: what was measured, and what it says")
    times = 1e6 * np.linspace(0.0, 1.2e-4, e.measured.shape[1])
    fitted = np.asarray(e.displacements(e.theta))
    for k, (name, colour) in enumerate(zip(e.points, (BLUE, VERMILLION, "#009E73"), strict=True)):
        left.plot(times, e.measured[k], ".", color=colour, ms=3)
        left.plot(times, fitted[k], color=colour, label=name)
    left.set(xlabel="t in µs", ylabel="displacement in mm", title="dots measured, lines identified")
    left.legend()
    t = 1e6 * np.asarray(e.sample_times)
    right.plot(t, 100 * np.asarray(e.truth[:5]), "k--", label="true")
    right.errorbar(t, 100 * np.asarray(e.theta[:5]), 300 * np.asarray(e.deviation[:5]), fmt="o", capsize=3, ms=4,
                   label="identified, ± 3 standard deviations")  # fmt: skip
    right.set(xlabel="t in µs", ylabel="force at the apex in N", ylim=(0, 125),
              title=f"thickness {0.4 * float(e.theta[5]):.4f} mm, true {0.4 * float(e.truth[5]):.4f} mm")  # fmt: skip
    right.legend()
    return figure


def quarter_map(panel, nodes, triangles, values, label, **options) -> None:
    """Values of the elements of a quarter, seen from above, the other quarters by symmetry; [mm]."""
    for sx in (1, -1):
        for sy in (1, -1):
            drawn = panel.tripcolor(1e3 * sx * nodes[:, 0], 1e3 * sy * nodes[:, 1], triangles, facecolors=values,
                                    edgecolors="face", linewidth=0.2, **options)  # fmt: skip
    panel.set_aspect("equal")
    panel.grid(False)
    panel.set(xlabel="x in mm", ylabel="y in mm")
    panel.figure.colorbar(drawn, ax=panel, label=label)


def optimise_thickness(e) -> Figure:
    figure, (left, right) = panels("Clamped cap under 90 N at its apex, EMC, Δt = 2 µs: same mass, lower peak")
    quarter_map(left, e.nodes, e.triangles, 1e3 * np.asarray(e.best), "thickness in mm", cmap="viridis")
    for h, label in ((np.full(e.cap.mesh.n_elements, e.uniform), "uniform"), (e.best, "best")):
        w = np.asarray(e.deflection(h))
        right.plot(np.linspace(0, 160, w.size), w, label=label)
    right.set(xlabel="t in µs", ylabel="deflection of the apex in mm")
    right.legend()
    return figure


def ply_angles(e) -> Figure:
    figure, (left, right) = panels("Carbon arch [θ1/-θ1/θ2/-θ2]s, pressed through at its crown: SLSQP")
    tried = np.array(list(e.seen))
    force, index = np.array([value for value, _ in e.seen.values()]).T
    left.plot(100 * force, "o-", ms=3.5)
    left.set(xlabel="evaluation", ylabel="largest force before it snaps in N")
    twin = right.twinx()
    right.plot(tried[:, 0], "o-", ms=3.5, label="θ1")
    right.plot(tried[:, 1], "s--", ms=3.5, color=VERMILLION, label="θ2")
    twin.plot(index, "k:", label="Tsai-Wu")
    twin.axhline(e.limit, color="0.6", lw=0.8)
    twin.grid(False)
    right.set(xlabel="evaluation", ylabel="angles in degrees")
    twin.set_ylabel("Tsai-Wu index (limit 0.7)")
    right.legend(loc="center left")
    return figure


def uncertainty(e) -> Figure:
    figure, panel = panels("Clamped cap after 60 µs, EMC, Δt = 3 µs: scatter of thickness (2 %) and load (3 %)", 1)
    sample = np.asarray(e.sampled)
    panel.hist(sample, 30, density=True, color="0.8", label="400 runs in one program")
    w = np.linspace(sample.min(), sample.max(), 200)
    bell = np.exp(-0.5 * ((w - float(e.mean)) / e.linear) ** 2) / (e.linear * np.sqrt(2 * np.pi))
    panel.plot(w, bell, color=VERMILLION, label="one gradient")
    panel.set(xlabel="deflection of the apex in mm", ylabel="density in 1/mm")
    panel.legend()
    return figure


def snap_through(e) -> Figure:
    figure, panel = panels("Hinged roof, 6.35 mm thick, arc length: load against the deflection of its centre", 1, 3.4)
    load = 3e3 * e.factor
    panel.plot(e.centre, np.where(e.stable, load, np.nan), color=BLUE, label="stable")
    panel.plot(e.centre, np.where(e.stable, np.nan, load), "--", color=VERMILLION, label="unstable")
    panel.plot([12.892, 15.778], [0.1953 * 3e3, -0.1288 * 3e3], "k+", ms=9, label="limit points, Sze, Liu & Lo 2004")
    panel.set(xlabel="deflection in mm", ylabel="force in N")
    panel.legend()
    return figure


def closed_shell(e) -> Figure:
    figure, (left, right) = panels("Free sphere under a sudden pressure, EnergyMomentum, Δt = T/40")
    frame = int(np.argmax(e.swing))
    u = np.asarray(e.run.displacements)[frame]
    radial = 1e3 * np.einsum("ni,ni->n", u, e.nodes) / e.radius
    time = 1e3 * float(e.run.frame_times[frame])
    surface(left, e.nodes + 300 * u, e.triangles, radial[e.triangles].mean(1), "radial displacement in mm", "m")
    left.set_title(f"t = {time:.2f} ms, 300 times enlarged")
    t = np.asarray(e.run.times)
    right.plot(1e3 * t, 1e3 * e.swing, label="mean of the nodes")
    right.plot(1e3 * t, 1e3 * e.w_s * (1 - np.cos(e.omega * t)), "k:", label="membrane theory")
    right.set(xlabel="t in ms", ylabel="swing of the radius in mm", ylim=(-0.02, 0.36))
    right.legend(loc="upper right")
    return figure


def tape_spring(e) -> Figure:
    figure = Figure(figsize=(6.7, 4.8), layout="constrained")
    figure.suptitle("Steel tape, 120 × 21 × 0.1 mm: folded by arc length, and let go", fontsize=9.5)
    places = figure.subplot_mosaic([["path", "fold"], ["free", "free"]], height_ratios=[1.4, 1.0])
    left, right, below = (places[name] for name in ("path", "fold", "free"))
    closer = left.inset_axes((0.4, 0.27, 0.57, 0.32))
    for panel in (left, closer):
        panel.plot(e.angle, np.where(e.stable, 1e3 * e.moment, np.nan), ".-", ms=3, color=BLUE, label="stable")
        panel.plot(e.angle, np.where(e.stable, np.nan, 1e3 * e.moment), "--", color=VERMILLION, label="unstable")
        panel.axhline(1e3 * e.classic, color="black", lw=0.8, ls=":", label="(1 + ν) D α")
        panel.axhline(1e3 * e.fold.fun, color="black", lw=0.8, ls="-.", label="with free edges")
    left.set(xlabel="angle between the ends in degrees", ylabel="moment in mN m", ylim=(-15, 480))
    closer.set(xlim=(10, 122), ylim=(25, 42))
    closer.tick_params(labelsize=7)
    left.legend(loc="upper right", ncols=2, fontsize=7)
    nodes, triangles = np.asarray(e.tape.mesh.nodes)[:-2], e.tape.mesh.triangles
    shape = nodes + np.asarray(e.path.displacements)[-1, :-2]
    surface(right, 1e3 * shape, triangles, 1e3 * shape[triangles, 2].mean(1), "height in mm", "mm")
    right.set_title(f"folded by {e.angle[-1]:.0f}°")
    crown = np.flatnonzero(np.abs(nodes[:, 1]) < 1e-9)
    for frame in range(0, len(e.run.frame_times), 3):
        x = 1e3 * (nodes + np.asarray(e.run.displacements)[frame, :-2])[crown]
        below.plot(x[:, 0], x[:, 2], label=f"{1e3 * float(e.run.frame_times[frame]):.0f} ms")
    below.set(
        xlabel="x in mm", ylabel="z in mm", title="crown after the right end is let go, EnergyMomentum, Δt = 50 µs"
    )
    below.set_aspect("equal")
    below.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    return figure


def shaken_plate(run) -> Figure:
    figure, (left, right) = panels("Plate with a mass at its tip on a shaken base, EnergyMomentum, Δt = 1 ms")
    time, tip, base = (1e3 * np.asarray(values) for values in (run.times, run.watched["tip"], run.watched["base"]))
    left.plot(time, tip, label="tip")
    left.plot(time, base, "--", color=VERMILLION, label="base")
    left.set(xlabel="t in ms", ylabel="displacement in space in mm")
    left.legend()
    right.plot(time, tip - base)
    right.set(xlabel="t in ms", ylabel="tip against base in mm")
    return figure


def shape_gradient(e) -> Figure:
    figure, (left, right) = panels(f"Clamped panel 0.4 × 0.4 m: lowest frequency {e.first:.1f} → {e.found:.1f} Hz")
    place = (1e3 * e.side * e.x, 1e3 * e.side * e.y, e.triangles)
    for panel, values, label in (
        (left, np.asarray(e.slope) / 1e3, "gradient at the start in Hz/mm"),
        (right, 1e3 * np.asarray(e.z), "heights at the end in mm"),
    ):
        field = np.zeros(e.x.size)
        field[e.inner] = values
        largest = np.abs(field).max()
        drawn = panel.tripcolor(*place, field, shading="gouraud", cmap="RdBu_r", vmin=-largest, vmax=largest)
        panel.set_aspect("equal")
        panel.grid(False)
        panel.set(xlabel="x in mm", ylabel="y in mm")
        figure.colorbar(drawn, ax=panel, label=label)
    return figure


def stiffened_panel(e) -> Figure:
    figure, both = panels("Stiffened panel from gmsh, clamped at x = 0: two of its modes")
    nodes = np.asarray(e.mesh.nodes)
    for panel, mode in zip(both, (0, e.bending), strict=True):
        u = np.asarray(e.modes.shapes)[mode, :, :3]
        u = 0.06 * u / np.abs(u).max()
        size = np.linalg.norm(u, axis=1) / 0.06
        surface(panel, nodes + u, e.mesh.triangles, size[e.mesh.triangles].mean(1), "motion, of the largest", "m")
        panel.set_title(f"{float(e.modes.frequencies[mode]):.1f} Hz")
    return figure


def laminate_panel(e) -> Figure:
    time = f"{1e3 * float(e.run.frame_times[e.frame]):.0f} ms"
    figure, both = panels(f"Laminate panel of panel.inp in a gust, EnergyMomentum, Δt = 0.5 ms: at t = {time}")
    u, triangles = np.asarray(e.run.displacements)[e.frame], e.panel.mesh.triangles
    shape = np.asarray(e.panel.mesh.nodes) + u
    surface(both[0], shape, triangles, 1e3 * u[triangles, 2].mean(1), "deflection in mm", "m", azimuth=-120.0)
    surface(both[1], shape, triangles, e.index, "Tsai-Wu index, worst ply", "m", "magma_r", azimuth=-120.0)
    return figure


def sweep(e) -> Figure:
    figure, all_three = panels(
        "Clamped cap, latin hypercube of 64 runs, EMC, Δt = 4 µs, first 0.2 ms", 3, 2.6, sharey=True
    )
    names = {"h": "thickness", "E": "Young's modulus", "f": "load"}
    for panel, (name, values) in zip(all_three, e.found.parameters.items(), strict=True):
        panel.plot(values, 1e3 * e.found.minimum["apex"], ".", ms=4)
        beta = dict(zip(e.sensitivities.parameters, e.sensitivities.values["apex min"], strict=True))[name]
        panel.set(xlabel=f"relative {names[name]}", title=f"β = {beta:+.2f}")
    all_three[0].set_ylabel("lowest place of the apex in mm")
    return figure


def spun_blade(e) -> Figure:
    figure, panel = panels("Campbell diagram of a blade on a hub, 16 × 2 cells beside the beam (dashed)", 1, 3.6)
    fine = np.linspace(0.0, e.speeds[-1], 61)
    beams = np.array([e.beams(speed) for speed in fine])
    for turns in range(1, 7):
        panel.plot(fine, turns * fine / (2 * np.pi), color="0.8", lw=0.8, zorder=0)
        at = min(e.speeds[-1], 2 * np.pi * 82.0 / turns)
        panel.annotate(
            f"{turns}/rev", (at, turns * at / (2 * np.pi)), color="0.45", fontsize=7, ha="right", va="bottom"
        )
    names = ("flapping, first", "lead and lag, first", "flapping, second")
    for k, (name, colour) in enumerate(zip(names, (BLUE, VERMILLION, "#009E73"), strict=True)):
        panel.plot(fine, beams[:, k] / (2 * np.pi), "--", color=colour, lw=1.0)
        panel.plot(e.speeds, e.found[:, k] / (2 * np.pi), "o", color=colour, ms=4, label=name)
    panel.set(xlabel="speed of the hub in rad/s", ylabel="frequency in Hz", xlim=(0, None), ylim=(0, 85))
    panel.legend(loc="upper left")
    return figure


def unfolding_panel(e) -> Figure:
    figure, (left, right) = panels("Panel that unfolds by spring hinges, EnergyMomentum, Δt = 5 ms")
    nodes, n = np.asarray(e.panel.mesh.nodes), e.plate
    edge = np.concatenate([k * n + np.flatnonzero(nodes[:n, 1] == 0.0) for k in range(3)])
    body = e.panel.connectors[0]
    times = (0.0, 0.25, 0.5, 0.75, 1.0, 4.0)
    for shade, time in zip(np.linspace(0.0, 0.85, len(times)), times, strict=True):
        frame = int(np.argmin(np.abs(np.asarray(e.run.frame_times) - time)))
        x = nodes + np.asarray(e.run.displacements)[frame]
        colour = matplotlib.colormaps["viridis"](shade)
        left.plot(*x[[body.master, body.followers[0]]][:, [0, 2]].T, color=colour, lw=3.0, solid_capstyle="butt")
        left.plot(*x[edge][:, [0, 2]].T, color=colour, lw=1.4, label=f"{time:g} s")
    left.set(xlabel="x in m", ylabel="z in m", title="thick: the satellite", aspect="equal")
    left.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.4))
    t, energy = np.asarray(e.run.times), e.run.energy
    for name, values, style in (
        ("springs and strains", energy.strain, "-"), ("kinetic", energy.kinetic, "-"),
        ("taken by friction", energy.dissipated, "-"), ("sum", energy.total + energy.dissipated, "k:"),
    ):  # fmt: skip
        right.plot(t, values, style, label=name)
    right.set(xlabel="t in s", ylabel="energy in J")
    right.legend()
    return figure


SCENES = ("dropped_tray",)
"""Scenes of the library that the gallery shows as the command line runs them."""


def of_scene(path: Path) -> Figure:
    """Of a run from the command line, of a scene file or a scene's name: its shapes, or what is drawn of it here."""
    from jaxshell.command.cli import main

    assert main(["run", str(path), "--quiet", "--no-plots"]) == 0
    run = js.Solution.load(f"{path.stem}.h5")
    if path.stem in globals():
        return globals()[path.stem](run)
    return js.plotting.figures({f"{path.name}": run})["shapes"]


def of_notebook(path: Path) -> Image.Image:
    """The largest picture among its outputs."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    outputs = [output.get("data", {}) for cell in cells for output in cell.get("outputs", ())]
    return Image.open(io.BytesIO(max((base64.b64decode(d["image/png"]) for d in outputs if "image/png" in d), key=len)))


def picture_of(path: Path) -> Image.Image:
    """An example's picture; of those without a function here the one that they write."""
    if path.suffix == ".ipynb":
        return of_notebook(path)
    if path.suffix == ".toml" or path.name in SCENES:
        figure = of_scene(path)
    else:
        names = SimpleNamespace(**runpy.run_path(str(path)))
        draw = globals().get(path.stem)
        if draw is None:
            return Image.open(f"{path.stem}.png")
        figure = draw(names)
    page = io.BytesIO()
    figure.savefig(page, dpi=2 * WIDTH / figure.get_figwidth())
    return Image.open(page)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    paths = [*ROOT.glob("examples/*.py"), *ROOT.glob("examples/*.toml"), *ROOT.glob("notebooks/*.ipynb")]
    found = {path.stem: path for path in (*sorted(paths), *map(Path, SCENES))}
    parser.add_argument("names", nargs="*", choices=[[], *found], help="which; all by default")
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in parser.parse_args().names or found:
        with tempfile.TemporaryDirectory() as folder, matplotlib.rc_context(STYLE):
            os.chdir(folder)
            image = picture_of(found[name]).convert("RGB")
            os.chdir(ROOT)
        small = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
        # A palette: a quarter of the size, and nobody sees it.
        small.quantize(256, dither=Image.Dither.NONE).save(PICTURES / f"{name}.png", optimize=True)
        print(f"{name}: {(PICTURES / f'{name}.png').stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    sys.exit(main())
