"""Section forces, stresses, failure, smoothing and mass properties against closed forms and hand calculations."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.command.report import describe_run
from jaxshell.files.scene_file import read_scene_file
from jaxshell.model import generators
from jaxshell.numerics.rotations import exp
from jaxshell.plotting import figures
from jaxshell.results.stresses import gauge_field, largest_von_mises

CARBON = js.Orthotropic(140.0, 10.0, 0.3, 5.0, 1.6e-9, 1e-6, 3e-5)
ANGLES, PLY, OFFSET = (0.0, 45.0, 90.0, -30.0), 0.05, 0.02
STRIP = generators.rectangle(2.0, 1.0, (4, 2))
STRENGTHS = {"X_t": 1.5, "X_c": 1.2, "Y_t": 0.05, "Y_c": 0.2, "S": 0.07}


def distorted(divisions, length, width, amount=0.25) -> js.Mesh:
    mesh = generators.rectangle(length, width, divisions)
    x = np.array(mesh.nodes)
    inner = np.setdiff1d(np.arange(len(x)), mesh.boundary_edges())
    cell = np.array([length, width]) / divisions
    x[inner, :2] += amount * cell * np.random.default_rng(3).uniform(-1, 1, (len(inner), 2))
    return js.Mesh(x, mesh.triangles)


def classical(angles, ply, offset):
    """[A B; B D], and of every ply (z, Q in the laminate's axes, stresses to the ply's axes): Jones 1999, in NumPy."""
    E1, E2, nu, G = 140.0, 10.0, 0.3, 5.0
    q = 1 / (1 - nu**2 * E2 / E1)
    Q = np.array([[E1 * q, nu * E2 * q, 0], [nu * E2 * q, E2 * q, 0], [0, 0, G]])
    matrix, plies, reuter = np.zeros((6, 6)), [], np.diag([1.0, 1.0, 2.0])
    for k, angle in enumerate(angles):
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        T = np.array([[c * c, s * s, 2 * c * s], [s * s, c * c, -2 * c * s], [-c * s, c * s, c * c - s * s]])
        turned = np.linalg.inv(T) @ Q @ reuter @ T @ np.linalg.inv(reuter)
        low = (k - 0.5 * len(angles)) * ply + offset
        high = low + ply
        A, B, D = ((high**p - low**p) / p * turned for p in (1, 2, 3))
        matrix += np.block([[A, B], [B, D]])
        plies.append((np.array([low, high]), turned, T))
    return matrix, plies


def close(found, wanted, tolerance):
    found = np.asarray(found)
    assert np.abs(found - wanted).max() <= tolerance * np.abs(wanted).max(), np.abs(found - wanted).max()


def carbon(angles=ANGLES, offset=OFFSET, ply=PLY) -> js.Laminate:
    return js.Laminate([js.Ply(CARBON, ply, angle) for angle in angles], offset=offset)


# --- constant states ----------------------------------------------------------------------------------------


def constant_motion(mesh, strain, curvature):
    """Linear displacements and rotation vectors of a flat sheet with a constant strain and curvature."""
    x, y = np.asarray(mesh.nodes)[:, :2].T
    w = -0.5 * (curvature[0] * x**2 + curvature[1] * y**2 + curvature[2] * x * y)
    d = np.stack([strain[0] * x + 0.5 * strain[2] * y, strain[1] * y + 0.5 * strain[2] * x, w], 1)
    across = -(curvature[1] * y + 0.5 * curvature[2] * x), curvature[0] * x + 0.5 * curvature[2] * y
    return d, np.stack([*across, 0 * x], 1)


def test_constant_states_are_exact():
    """On a distorted mesh: N, M, strains and ply stresses, linear in small motions, to 1e-10."""
    mesh = distorted((4, 3), 1.0, 0.8)
    strain, curvature = np.array([1.0, -2.0, 3.0]), np.array([1.5, 2.0, -3.0])
    d, theta = constant_motion(mesh, strain, curvature)
    matrix, plies = classical(ANGLES, PLY, OFFSET)
    iso = js.Section(0.1, 200.0, 0.3, 7.8e-9)
    C = 200.0 / 0.91 * np.array([[1, 0.3, 0], [0.3, 1, 0], [0, 0, 0.35]])
    flat = np.block([[0.1 * C, np.zeros((3, 3))], [np.zeros((3, 3)), 0.1**3 / 12 * C]])

    for section, stiffness in ((iso, flat), (carbon(), matrix)):
        scene, tops = js.Scene(mesh, section), () if section is iso else (0, 1, 3)

        def state(size, scene=scene, tops=tops):
            moved = scene, size * d, jax.vmap(exp)(size * theta)
            forces = js.section_forces_of(*moved, axes=[1.0, 0, 0])
            strains = js.section_strains_of(*moved, axes=[1.0, 0, 0])
            return forces, strains, [js.stresses_of(*moved, at=(k, "top"), axes="ply") for k in tops]

        forces, strains, inner = jax.jvp(state, (0.0,), (1.0,))[1]
        wanted = stiffness @ np.concatenate([strain, curvature])
        close(strains.strain, strain, 1e-10)
        close(strains.curvature, curvature, 1e-10)
        close(forces.N, wanted[:3], 1e-10)
        close(forces.M, wanted[3:], 1e-10)
        for k, stress in zip(tops, inner, strict=True):
            (_, high), Q, T = plies[k]
            close(stress, T @ Q @ (strain + high * curvature), 1e-10)


# --- statics: one laminate strip, one program ----------------------------------------------------------------


def strip(angles=ANGLES, ply=PLY, history=None, watch=None) -> js.Scene:
    """A short cantilever of four plies, pulled and bent at its tip, in part heated."""
    loads = [
        js.NodalForce([12, 13, 14], [2e-3, 1e-3, 2e-3]),
        js.Thermal(np.linspace(20.0, 60.0, STRIP.n_elements), 10.0, history),
    ]
    return js.Scene(STRIP, carbon(angles, ply=ply), [js.clamped([0, 1, 2])], loads, watch=watch)


WATCH = {
    "N": (3, "Nxy"),
    "M": (5, "Myy material"),
    "mises": (6, "von mises top"),
    "shear": (7, "sxy bottom material"),
    "fibre": (2, "s11 ply 1 top"),
    "least": (2, "smin middle"),
    "tip": (10, "uz"),
}


@pytest.fixture(scope="module")
def bent() -> js.Solution:
    return js.solve_static(strip(watch=WATCH), [0.5, 1.0])


@pytest.mark.slow
def test_what_is_watched_is_what_frames_give(bent):
    def at(values, element):
        return np.asarray(values)[:, element]

    frames, only = [0, 1, 2], {"mean": True}
    forces = js.section_forces(bent, frames, at="mean")
    wanted = {
        "N": at(forces.N, 3)[:, 2],
        "M": at(js.section_forces(bent, frames, at="mean", axes="material").M, 5)[:, 1],
        "mises": at(js.von_mises(js.stresses(bent, frames, "top", **only)), 6),
        "shear": at(js.stresses(bent, frames, "bottom", axes="material", **only), 7)[:, 2],
        "fibre": at(js.stresses(bent, frames, (1, "top"), axes="ply", **only), 2)[:, 0],
        "least": at(js.principal(js.stresses(bent, frames, "middle", **only)).values, 2)[:, 1],
    }
    for label, values in wanted.items():
        assert values[-1] != 0
        close(bent.watched[label], values, 1e-12)


def test_energies_of_elements_sum_up(bent):
    energies = js.strain_energies(bent, [1, 2])
    assert energies.shape == (2, 16) and np.all(np.asarray(energies) > 0)
    close(np.sum(energies, axis=1), bent.energy.strain[1:], 1e-12)


@pytest.mark.slow
def test_axes_are_axes_of_one_tensor(bent):
    """Element axes, a direction, a cylinder and space: the same invariants; strains and forces do the same work."""
    own, turned = (js.section_forces(bent, at="mean", axes=axes) for axes in ("element", [1.0, 2.0, 0.5]))
    space = js.section_forces(bent, at="mean", axes="global")
    close(js.principal(own.M).values, js.principal(turned.M).values, 1e-12)
    three = np.linalg.eigvalsh(np.asarray(space.M))
    two = np.sort(np.concatenate([js.principal(own.M).values, np.zeros((16, 1))], axis=1), axis=1)
    close(three, two, 1e-12)
    work = []
    for axes in ("element", js.Cylindrical([0.0, 1.0, 0.0], [-3.0, 0.0, 5.0], "circumference")):
        forces, strains = js.section_forces(bent, axes=axes), js.section_strains(bent, axes=axes, elastic=True)
        work.append(np.sum(np.asarray(forces.N * strains.strain + forces.M * strains.curvature), axis=2).mean(axis=1))
    close(work[0], work[1], 1e-12)
    x = np.asarray(bent.scene.mesh.nodes)[bent.scene.mesh.triangles]
    areas = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    close(0.5 * work[0] * areas, np.asarray(js.strain_energies(bent)), 1e-10)


def test_plies_bear_the_section_forces(bent):
    """N = Σ h σ(middle of the ply): stresses are linear in each, thermal ones included."""
    total = sum(PLY * np.asarray(js.stresses(bent, at=k)) for k in range(4))
    close(total, np.asarray(js.section_forces(bent).N), 1e-10)


def test_failure_by_hand(bent):
    stress = np.asarray(js.stresses(bent, at=(2, "top"), axes="ply"))
    s1, s2, t = np.moveaxis(stress, -1, 0)
    X = np.where(s1 >= 0, 1.5, 1.2)
    Y = np.where(s2 >= 0, 0.05, 0.2)
    by_hand = {
        "tsai-wu": (1 / 1.5 - 1 / 1.2) * s1
        + (1 / 0.05 - 1 / 0.2) * s2
        + s1**2 / 1.8
        + s2**2 / 0.01
        + (t / 0.07) ** 2
        - s1 * s2 / np.sqrt(1.8 * 0.01),
        "tsai-hill": (s1**2 - s1 * s2) / X**2 + (s2 / Y) ** 2 + (t / 0.07) ** 2,
        "max-stress": np.max([np.abs(s1) / X, np.abs(s2) / Y, np.abs(t) / 0.07], axis=0),
        "von-mises": np.sqrt(s1**2 - s1 * s2 + s2**2 + 3 * t**2) / 0.3,
    }
    E1, E2, nu, G = 140.0, 10.0, 0.3, 5.0
    strain = np.stack([(s1 - nu * s2) / E1, s2 / E2 - nu * s1 / E1, t / G])
    limits = [np.where(strain[0] >= 0, 1.5, 1.2), np.where(strain[1] >= 0, 0.05, 0.2), 0.07]
    by_hand["max-strain"] = np.max(np.abs(strain) / np.stack(np.broadcast_arrays(*limits)), axis=0)
    for criterion, values in by_hand.items():
        found = js.failure_index(bent, criterion, {**STRENGTHS, "yield": 0.3}, reduce="all")
        assert found.shape == (16, 4, 2, 3)
        close(found[:, 2, 1], values, 1e-10)
    close(js.failure_index(bent, criterion, {**STRENGTHS, "yield": 0.3}), np.max(found, axis=(1, 2, 3)), 1e-15)
    each = [js.Strengths(yield_stress=0.3 * (k + 1)) for k in range(4)]
    one = js.failure_index(bent, "von-mises", each[0], reduce="all")
    close(js.failure_index(bent, "von-mises", each, reduce="all"), one / np.arange(1.0, 5.0)[:, None, None], 1e-14)


@pytest.mark.slow
def test_gradients_of_a_failure_limit():
    """KS of Tsai-Wu through solve_static, by a ply's angle, its thickness and strengths."""

    def limit(p):
        scene = strip((0.0, p[0], 90.0, -30.0), p[1])
        index = js.failure_index(
            js.solve_static(scene, [1.0]), "tsai-wu", {**STRENGTHS, "X_t": p[2], "S": p[3]}, reduce="all"
        )
        return js.ks(index, 20.0)

    start = jnp.array([45.0, PLY, 1.5, 0.07])
    along = start * jnp.array([1.0, 0.3, -0.2, 0.5])
    both = jax.jit(lambda p: (*jax.value_and_grad(limit)(p), jax.jvp(limit, (p,), (along,))[1]))
    _, adjoint, forward = both(start)
    assert np.all(np.abs(adjoint * start) > 1e-3)
    assert float(forward) == pytest.approx(float(adjoint @ along), rel=1e-10)
    step = 1e-4
    for k, size in enumerate(start):
        up, down, twice_up, twice_down = (both(start.at[k].add(n * step * size))[0] for n in (1, -1, 2, -2))
        difference = (8 * (up - down) - (twice_up - twice_down)) / (12 * step * size)
        assert float(difference) == pytest.approx(float(adjoint[k]), rel=1e-6)


@pytest.mark.slow
def test_free_expansion_is_free_of_stress():
    """A heated panel, held like a statically determinate body."""
    mesh = generators.cylinder(1.0, 1.0, (3, 4), angle=100.0)
    held = [js.Support([0], ["ux", "uy", "uz"]), js.Support([15], ["uy", "uz"]), js.Support([4], "uy")]
    E, expansion, heat = 200.0, 1.2e-5, 100.0
    scene = js.Scene(mesh, js.Section(0.02, E, 0.3, 1e-9, expansion), held, [js.Thermal(heat)])
    run = js.solve_static(scene, [1.0])
    scale = E * expansion * heat
    for at in ("top", "bottom"):
        assert np.abs(js.stresses(run, at=at)).max() < 1e-12 * scale
    assert np.abs(js.section_forces(run).N).max() < 1e-12 * scale * 0.02
    close(js.section_strains(run).strain, np.array([1.0, 1.0, 0.0]) * expansion * heat, 1e-12)


# --- spheres and cylinders under pressure --------------------------------------------------------------------


@pytest.mark.slow
def test_cylinder_and_sphere_under_pressure():
    """pR/t around a cylinder whose ends are held along its axis, ν pR/t along it; pR/2t in a sphere."""
    R, h, p, nu = 2.0, 0.02, 1e-4, 0.3
    section = js.Section(h, 200.0, nu, 1e-9)
    tube = generators.cylinder(R, 1.0, (2, 12), angle=90.0)
    ends = tube.nodes_where(lambda x: (x[0] < 1e-9) | (x[0] > 1 - 1e-9))
    sides = [js.symmetry(tube.nodes_where(lambda x, a=a: abs(x[a]) < 1e-9), "xyz"[a]) for a in (1, 2)]
    run = js.solve_static(js.Scene(tube, section, [js.symmetry(ends, "x"), *sides], [js.Pressure(p)]), [1.0])
    axial, hoop, _ = np.moveaxis(np.asarray(js.stresses(run, at="middle", axes=[1.0, 0, 0], mean=True)), -1, 0)
    inside = ~np.isin(tube.triangles, sides[0].nodes.array).any(1) & ~np.isin(tube.triangles, sides[1].nodes.array).any(
        1
    )
    assert inside.sum() == 40
    assert np.mean(hoop) == pytest.approx(p * R / h, rel=0.005)  # right triangles share out the pressure unevenly
    close(hoop[inside], p * R / h, 0.06)
    assert np.mean(axial) == pytest.approx(nu * p * R / h, rel=0.005)

    ball = generators.spherical_cap(R, 90.0, (5,))
    rim = ball.nodes_where(lambda x: abs(x[2]) < 1e-9)
    apex, side = ball.nearest_node([0, 0, R]), ball.nearest_node([R, 0, 0])
    held = [js.symmetry(rim, "z"), js.Support([apex], ["ux", "uy"]), js.Support([side], "uy")]
    run = js.solve_static(js.Scene(ball, section, held, [js.Pressure(p)]), [1.0])
    values = np.asarray(js.principal(js.stresses(run, at="middle", mean=True)).values)
    x = np.asarray(ball.nodes)[ball.triangles]
    areas = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    assert areas @ values.mean(1) / areas.sum() == pytest.approx(p * R / (2 * h), rel=0.03)


# --- in every step, in files, in pictures ----------------------------------------------------------------------


FILE = """
name = "watched"
units = "SI"
[mesh]
generator = "rectangle"
length = 2.0
width = 1.0
divisions = [4, 2]
[section]
thickness = 0.05
young_modulus = 2e9
poisson_ratio = 0.3
density = 1000.0
[[supports]]
plane = { x = 0.0 }
hold = "clamped"
[[loads]]
kind = "force"
nearest = [2, 1, 0]
force = [0, 0, 100.0]
[watch]
root = { nearest = [0.1, 0.4, 0.0], component = "Mxx" }
stress = { element = 3, component = "von mises top" }
tip = { nearest = [2, 1, 0], component = "uz" }
"""


def test_a_scene_file_watches_stresses(tmp_path):
    (tmp_path / "scene.toml").write_text(FILE)
    scene, _ = read_scene_file(tmp_path / "scene.toml")
    assert scene.watch[0][1:] == (1, "Mxx") and scene.watch[1][1:] == (3, "von mises top")
    path = tmp_path / "run.h5"
    run = js.simulate(scene, js.CentralDifference(), dt=1e-5, t_end=3e-5, output=path)
    close(run.watched["stress"][-1], js.von_mises(js.stresses(run, mean=True))[3], 1e-9)
    close(run.watched["root"], np.asarray(js.section_forces(run, [0, 1, 2, 3], at="mean").M)[:, 1, 0], 1e-9)
    back = js.Solution.load(path)
    assert back.scene.watch == scene.watch
    np.testing.assert_array_equal(back.watched["root"], run.watched["root"])
    largest = largest_von_mises(run)
    both = [np.asarray(js.von_mises(js.stresses(run, at=at, mean=True))) for at in ("top", "bottom")]
    assert largest.value == pytest.approx(np.max(both), rel=1e-12)
    assert f"{largest.value:.6g}, element {largest.element}, {largest.face}" in describe_run("run", run, path)
    drawn = figures(back, ["von mises top", "Myy"])
    assert {"stress", "moment", "displacement", "von_mises_top", "Myy"} <= set(drawn) and "membrane_force" not in drawn
    assert any(axes.get_ylabel() == "Von Mises stress, top in Pa" for axes in drawn["von_mises_top"].axes)
    assert drawn["moment"].axes[0].get_ylabel() == "root, $M_{xx}$ in N"


# --- bad input -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda run: js.section_forces(run, 3), "frame must be the number of a frame, 0 to 2"),
        (lambda run: js.section_forces(run, at="middle"), "at must be one of points, mean"),
        (lambda run: js.section_forces(run, axes="local"), "axes must be one of element, material, global"),
        (lambda run: js.section_forces(run, axes=[0.0, 0, 1]), r"direction \[0.0, 0.0, 1.0\] is normal to element 0"),
        (lambda run: js.stresses(run, at=4), "there is no ply 4 in element 0"),
        (lambda run: js.stresses(run, at="inside"), "at must be .*but it is 'inside'"),
        (lambda run: js.stresses(run, elements=[16]), "elements names 16"),
        (lambda run: gauge_field(run, "Mzz"), "'Mzz' names no stress and no section force"),
        (lambda run: js.failure_index(run, "tsai", STRENGTHS), "criterion must be one of tsai-wu"),
        (
            lambda run: js.failure_index(run, "tsai-wu", {"X_t": 1.0}),
            "strengths lacks X_c, which the criterion tsai-wu",
        ),
        (lambda run: js.failure_index(run, "tsai-wu", {"Xt": 1.0}), "strengths has the unknown name 'Xt'"),
        (lambda run: js.failure_index(run, "tsai-wu", [STRENGTHS]), "or 4, one for each, but they are 1"),
        (lambda run: js.failure_index(run), "needs strengths with X_t"),
        (lambda _: js.Strengths(S=-1.0), "S must be positive"),
        (lambda _: js.ks([1.0], 0.0), "sharpness must be positive"),
        (lambda _: js.von_mises([1.0, 2.0]), r"stress must have shape \(..., 3\)"),
        (lambda run: js.nodal(run.scene, [1.0]), r"values must have shape \(16, 3\)"),
        (lambda _: strip(watch={"a": (16, "Mxx")}), "watch 'a' names element 16, but the mesh has elements 0 to 15"),
        (lambda _: strip(watch={"a": (1, "s11 ply 7")}), "watch 'a': there is no ply 7 in element 1"),
        (lambda _: strip(watch={"a": (1, "sigma")}), "watch 'a' names 'sigma'; choose out of"),
        (
            lambda run: js.stresses(dataclasses.replace(run, scene=js.Scene(STRIP, GENERAL))),
            "the section has no layers, and so no stresses",
        ),
        (
            lambda run: js.section_forces(dataclasses.replace(run, scene=js.Scene(STRIP, PLAIN)), axes="material"),
            "needs a section with a direction",
        ),
    ],
)
def test_bad_input_is_named(bent, call, message):
    with pytest.raises(ValueError, match=message):
        call(bent)


GENERAL, PLAIN = js.GeneralSection(np.eye(3), None, np.eye(3), 1.0), js.Section(0.1, 1.0, 0.3, 1.0)
