"""The figures of docs/validation.md: statics, limit loads and frequencies beside published ones.

    python benchmarks/validation.py                        # all tables (some ten minutes), into the page
    python benchmarks/validation.py end_moment plates      # some of them

Tables go between the page's markers `<!-- NAME -->` and `<!-- end NAME -->`, and to the screen. The references are
Sze, Liu & Lo 2004 (tables of load factor and displacement) unless a title says otherwise.
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import jax
import numpy as np

import jaxshell as js
from benchmarks.pages import table, write
from jaxshell import scenes
from jaxshell.model import generators
from jaxshell.model.grids import chain, grid
from jaxshell.model.supports import ALL

jax.config.update("jax_enable_x64", True)

PAGE = Path(__file__).parent.parent / "docs" / "validation.md"


def titled(title, header, rows) -> str:
    """A table under its title; numbers to four digits."""
    cells = [[cell if isinstance(cell, str) else f"{cell:.4f}" for cell in row] for row in rows]
    return f"**{title}**\n\n{table(header, cells)}"


def cells_of(mesh) -> str:
    return "×".join(map(str, mesh))


def against_reference(name, scene_of, meshes, reference, factors, arc_length=None) -> str:
    """`reference` {watch: {load factor: value}}; `factors` are the load steps.

    Where load control ends at a limit point the path is followed with `arc_length`; there "∩" marks what it gives.
    """
    rows = []
    for mesh in meshes:
        scene = scene_of(mesh)
        run, path = js.solve_static(scene, factors, throw=False), None
        if run.message:
            print(f"{name}, {cells_of(mesh)}: {run.message}")
            path = js.solve_arc_length(scene, arc_length, steps=600)
        for label, values in reference.items():
            for factor, value in values.items():
                at = np.flatnonzero(np.isclose(np.asarray(run.times), factor))
                answer = float(run.watched[label][at[0]]) if at.size else at_last(scene, path, factor, label)
                mark = "" if at.size else " ∩"
                rows.append([cells_of(mesh), label, f"{factor:.4f}{mark}", answer, value, f"{answer / value - 1:+.2%}"])
    return titled(name, ["mesh", "point", "load factor", "found", "reference", "difference"], rows)


def at_last(scene, path, factor, label) -> float:
    """A watched displacement where the path passes a load factor for the last time: equilibrium at that factor,
    found from the end of the step that passes it."""
    step = 1 + int(
        np.flatnonzero((np.asarray(path.times)[:-1] - factor) * (np.asarray(path.times)[1:] - factor) <= 0)[-1]
    )
    start = js.Initial(displacements=path.displacements[step], rotations=path.rotations[step])
    there = dataclasses.replace(scene, initial=start)
    return float(js.solve_static(there, [factor]).watched[label][-1])


def tenths(*more):
    return np.unique(np.round([*np.arange(1, 11) / 10, *more], 6))


def end_moment() -> str:
    curvature = 12 * np.array([0.25, 0.5, 0.75]) * 50 * np.pi / 3 / 100
    exact_u, exact_w = 12 * np.sin(curvature) / curvature - 12, 12 * (1 - np.cos(curvature)) / curvature
    factors = (0.25, 0.5, 0.75)
    reference = {
        "tip u": dict(zip(factors, exact_u, strict=True)) | {1.0: -12.0},
        "tip w": dict(zip(factors, exact_w, strict=True)),
    }
    meshes = [(10, 1), (20, 1), (40, 1), (40, 2)]
    text = against_reference(
        "cantilever, end moment (exact)", scenes.cantilever_end_moment, meshes, reference, tenths(0.25, 0.75)
    )
    run = js.solve_static(scenes.cantilever_end_moment((40, 1)))
    return (
        f"{text}\n\n40×1, ten steps: iterations {np.asarray(run.iterations)[1:].tolist()}, "
        f"tip misses the clamped end by {abs(float(run.watched['tip u'][-1]) + 12) / 12:.1e} (u) "
        f"and {abs(float(run.watched['tip w'][-1])) / 12:.1e} (w) of the length."
    )


def end_shear() -> str:
    reference = {"tip u": {0.5: -1.604, 1.0: -3.286}, "tip w": {0.5: 4.933, 1.0: 6.698}}
    return against_reference(
        "cantilever, end shear", scenes.cantilever_end_shear, [(8, 1), (16, 1), (32, 1)], reference, tenths()
    )


def slit_annular_plate() -> str:
    reference = {"A": {0.1: 4.277, 0.5: 10.468, 1.0: 13.891}, "B": {0.1: 5.876, 0.5: 13.768, 1.0: 17.528}}
    meshes = [(6, 30), (6, 60), (10, 80)]
    return against_reference("slit annular plate", scenes.slit_annular_plate, meshes, reference, tenths())


def cylinder_pull_out() -> str:
    reference = {
        "A": {0.1: 1.707, 0.5: 2.473, 1.0: 2.768},
        "B": {0.1: -2.217, 0.5: -3.653, 1.0: -4.551},
        "C": {0.1: -2.293, 0.5: -3.718, 1.0: -3.269},
    }
    meshes = [(8, 12), (16, 24), (24, 36)]
    return against_reference(
        "pull-out of an open cylinder", scenes.cylinder_pull_out, meshes, reference, np.arange(1, 41) / 40, 0.05
    )


def pinched_cylinder() -> str:
    reference = {
        "A": {0.05: -9.561, 0.1: -23.164, 0.5: -73.790, 1.0: -83.102},
        "B": {0.1: -2.391, 0.5: 25.381, 1.0: 34.272},
    }
    meshes = [(16, 16), (24, 24), (40, 40)]
    return against_reference("pinched cylinder", scenes.pinched_cylinder, meshes, reference, np.arange(1, 41) / 40, 1.0)


def pinched_semi_cylinder() -> str:
    reference = {"A": {0.1: -16.100, 0.3: -66.410, 0.5: -132.653, 1.0: -171.505}}
    meshes = [(16, 16), (24, 24), (32, 32), (40, 40)]
    return against_reference(
        "pinched semi-cylinder", scenes.pinched_semi_cylinder, meshes, reference, np.arange(1, 41) / 40
    )


def hemisphere() -> str:
    reference = {  # quarter model; the same manual has -3.16, -4.20, -5.76 and 2.29, 2.79, 3.37 of its triangle STRI3
        "inward": {0.4: -3.23, 0.6: -4.30, 1.0: -5.83},
        "outward": {0.4: 2.32, 0.6: 2.81, 1.0: 3.40},
    }
    meshes = [(8, 8), (16, 16), (24, 24), (32, 32)]
    title = "hemisphere with a hole (S8R5 of the current Abaqus Benchmarks manual)"
    return against_reference(title, scenes.hemisphere, meshes, reference, tenths())


def twisted_beam() -> str:
    rows = []
    for load, exact in (("in-plane", 5.424e-3), ("out-of-plane", 1.754e-3)):
        for mesh in ((6, 1), (12, 2), (24, 4), (48, 8)):
            run = js.solve_static(scenes.twisted_beam(mesh, load), [1.0])
            found = float(run.watched["tip"][-1])
            rows.append([load, cells_of(mesh), f"{found:.4e}", f"{exact:.4e}", f"{found / exact - 1:+.2%}"])
    return titled("twisted beam (MacNeal & Harder 1985)", ["load", "mesh", "found", "reference", "difference"], rows)


def hinged_roof() -> str:
    limits = {12.7: [(0.7421, 11.293), (0.1729, 19.852)], 6.35: [(0.1953, 12.892), (-0.1288, 15.778)]}
    tables = []
    for thickness, reference in limits.items():
        rows = []
        for mesh in ((8, 8), (16, 16), (24, 24)):
            path = js.solve_arc_length(scenes.hinged_roof(mesh, thickness), 0.25, steps=300)
            factors, centre = np.asarray(path.times), -np.asarray(path.watched["centre"])
            inside = np.arange(1, len(factors) - 1)
            turning = inside[(np.diff(factors)[:-1] * np.diff(factors)[1:]) < 0]
            for point, at in zip(reference, turning, strict=False):
                fit = np.polyfit([-1.0, 0.0, 1.0], factors[at - 1 : at + 2], 2)
                value = np.polyval(fit, -fit[1] / (2 * fit[0]))
                rows.append([cells_of(mesh), value, point[0], f"{value / point[0] - 1:+.2%}", centre[at], point[1]])
        header = ["mesh", "limit load", "reference", "difference", "deflection", "reference"]
        tables.append(titled(f"hinged roof, h = {thickness}: limit loads by arc length", header, rows))
    return "\n\n".join(tables)


def plates() -> str:
    h, young_modulus, nu, density = 0.005, 1e7, 0.3, 2.0
    unit = np.sqrt(young_modulus * h**3 / (12 * (1 - nu**2)) / (density * h)) / (2 * np.pi)
    tables = []
    for name, held, exact in (
        ("clamped (Leissa 1973)", ALL, [35.992, 73.413, 73.413, 108.27]),
        ("free (Hurlebaus et al. 2001)", None, [13.468, 19.596, 24.270, 34.801, 34.801]),
    ):
        rows = []
        for n in (8, 16, 24, 40):
            mesh = generators.rectangle(1.0, 1.0, (n, n))
            edge = mesh.nodes_where(lambda x: np.max(np.abs(x[:2] - 0.5), axis=0) > 0.5 - 1e-9)
            supports = () if held is None else (js.Support(edge, held),)
            scene = js.Scene(mesh, js.Section(h, young_modulus, nu, density), supports)
            found = np.asarray(js.natural_frequencies(scene, len(exact), rigid_modes=False).frequencies) / unit
            rows.append([f"{n}×{n}", *found])
            rows.append(["", *(f"{f / e - 1:+.2%}" for f, e in zip(found, exact, strict=True))])
        rows.append(["reference", *exact])
        header = ["mesh", *(f"mode {k + 1}" for k in range(len(exact)))]
        tables.append(titled(f"square plate, {name}: ω a² (ρh/D)^½", header, rows))
    return "\n\n".join(tables)


def raasch_hook() -> str:
    """A strip of two arcs, sheared across at its free end, which bends and twists it. Thickness over radius is 1/7, and
    bricks shear where a Kirchhoff shell does not."""

    def hook(along, across):
        first, second = np.radians(np.linspace(0, 60, along + 1)), np.radians(np.linspace(60, -90, 3 * along + 1))
        small = 14 * np.stack([1 - np.cos(first), np.sin(first)], 1)
        turned = np.stack([np.cos(second), -np.sin(second)], 1)  # about the other side: the curvature changes its sign
        line = np.concatenate([small[:-1], small[-1] + 46 * (turned - turned[0])])
        index, z = grid(np.arange(len(line)), np.linspace(0, 20, across + 1))
        mesh = js.Mesh(np.column_stack([line[index], z]), js.structured_triangles(len(line) - 1, across))
        tip = mesh.n_nodes - across - 1 + np.arange(across + 1)
        load = js.EdgeForce(chain(tip), [0.0, 0.0, 0.05e-3])  # a thousandth, for the linear answer
        held = [js.clamped(np.arange(across + 1))]
        return js.Scene(mesh, js.Section(2.0, 3300.0, 0.35, 1.0), held, [load], watch={"tip": (int(tip[0]), "uz")})

    rows = []
    for mesh in ((6, 4), (12, 8), (24, 16), (48, 32)):
        found = 1e3 * float(js.solve_static(hook(*mesh), [1.0]).watched["tip"][-1])
        rows.append([f"{4 * mesh[0]}×{mesh[1]}", f"{found:.3f}", "5.022", f"{found / 5.022 - 1:+.1%}"])
    header = ["mesh", "tip, in", "bricks of 20 nodes", "difference"]
    return titled("Raasch's hook (R 14 and 46 in, h 2 in, E 3300 psi, ν 0.35, 0.05 lb/in)", header, rows)


def t_junction() -> str:
    """A cantilever of T section, flange and web of shells that share the nodes of the junction, as a beam."""
    length, side, h, young_modulus = 2.0, 0.2, 0.01, 70e9

    def tee(along, deep):
        flange = generators.rectangle(length, side, (along, 2 * deep))
        x, z = grid(np.linspace(0, length, along + 1), np.linspace(0, -side, deep + 1))
        web = np.stack([x, 0 * x + 0.5 * side, z], 1)
        nodes = np.concatenate([flange.nodes, web])
        triangles = np.concatenate([flange.triangles, js.structured_triangles(along, deep) + flange.n_nodes])
        mesh = js.Mesh.merged(nodes, triangles, 1e-6)
        root = mesh.nodes_where(lambda x: x[0] < 1e-9)
        tip = mesh.nodes_where(lambda x: (abs(x[0] - length) < 1e-9) & (abs(x[1] - 0.5 * side) < 1e-9))
        tip = tip[np.argsort(np.asarray(mesh.nodes)[tip, 2])]  # of the web, from below
        load = js.EdgeForce(chain(tip), [0.0, 0.0, 1.0 / side])
        section = js.Section(h, young_modulus, 0.0, 2700.0)
        return js.Scene(mesh, section, [js.clamped(root)], [load], watch={"tip": (int(tip[0]), "uz")})

    centre = 0.25 * side  # of the section, below the flange
    inertia = side * h * centre**2 + side * h**3 / 12 + h * side**3 / 12 + side * h * (0.5 * side - centre) ** 2
    beam = length**3 / (3 * young_modulus * inertia) + length / (0.5 * young_modulus * side * h)
    rows = []
    for mesh in ((10, 2), (20, 2), (40, 4), (80, 8)):
        found = float(js.solve_static(tee(*mesh), [1.0]).watched["tip"][-1])
        rows.append([cells_of(mesh), f"{found:.4e}", f"{beam:.4e}", f"{found / beam - 1:+.2%}"])
    header = ["mesh of the web", "tip under 1 N", "beam, with the web's shear", "difference"]
    return titled("cantilever of T section, 2 m, 0.2 × 0.2 × 0.01 m", header, rows)


def first_edge() -> str:
    """Each triangle's nodes in the three cyclic orders: the spread of an answer over them, and over the meshes."""

    def sheared(mesh):
        """A square held in its plane at x = 0 and moved by 1 along y at x = 1, the load factor being the mean shear."""
        square = generators.rectangle(1.0, 1.0, mesh)
        x = np.asarray(square.nodes)[:, 0]
        ends = {0.0: np.flatnonzero(x < 1e-9), 1.0: np.flatnonzero(x > 1 - 1e-9)}
        supports = [
            js.Support(nodes, ("ux", "uy"), displacement=[0.0, moved], history=js.History.ramp(1.0))
            for moved, nodes in ends.items()
        ]
        flat = js.Support(np.arange(x.size), ("uz", "rx", "ry"))
        return js.Scene(square, js.Section(0.05, 1.0, 0.3, 1.0), (*supports, flat))

    def watched(label):
        return lambda run: float(run.watched[label][-1])

    def energy(run):
        return float(run.energy.strain[-1])

    def short(value):
        return f"{value:.1e}".replace("e-0", "e-")

    # Name, scene, meshes, load factors, answer and its unit.
    squares = [(4, 4), (8, 8), (16, 16), (32, 32)]
    fifths = np.arange(1, 6) / 5
    problems = [
        ("twisted beam at 400 times its load (tip)", scenes.twisted_beam, [(6, 1), (12, 2), (24, 4)], [200.0, 400.0],
         watched("tip"), 1.0),
        ("slit annular plate (B)", scenes.slit_annular_plate, [(3, 15), (6, 30), (12, 60)], tenths(), watched("B"), 1.0),
        ("hemisphere (inward)", scenes.hemisphere, [(8, 8), (16, 16), (32, 32)], fifths, watched("inward"), 1.0),
        ("square sheared in its plane by 0.02 (energy, 1e-6)", sheared, squares, [0.02], energy, 1e-6),
        ("the same by 0.2 (energy, 1e-4)", sheared, squares, [0.1, 0.2], energy, 1e-4),
    ]  # fmt: skip
    rows = []
    for name, scene_of, meshes, factors, answer, unit in problems:
        last = None
        for mesh in meshes:
            scene, found = scene_of(mesh), []
            for shift in range(3):
                turned = js.Mesh(scene.mesh.nodes, np.roll(scene.mesh.triangles, -shift, axis=1), coincident="allow")
                watch = {label: (node, component) for label, node, component in scene.watch}
                run = js.solve_static(
                    js.Scene(turned, scene.section, scene.supports, scene.loads, watch=watch), factors
                )
                found.append(answer(run))
            change = "" if last is None else short(abs(found[0] - last) / abs(found[0]))
            answers = ", ".join(f"{value / unit:#.6g}" for value in found)
            rows.append([name, cells_of(mesh), answers, short(np.ptp(found) / abs(found[0])), change])
            name, last = "", found[0]
    return table(["problem", "mesh", "answers by edge first, second, third", "spread", "from coarser mesh"], rows)


TABLES = {
    study.__name__: study
    for study in (
        end_moment, end_shear, slit_annular_plate, cylinder_pull_out, pinched_cylinder, pinched_semi_cylinder,
        hemisphere, twisted_beam, hinged_roof, plates, raasch_hook, t_junction, first_edge,
    )
}  # fmt: skip


def main() -> None:
    write(__doc__, PAGE, TABLES)


if __name__ == "__main__":
    main()
