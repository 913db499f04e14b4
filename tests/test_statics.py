"""Load steps, cutback, arc length, reactions, mechanisms, and the static derivative."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from balance import imbalance
from linear import displacements

import jaxshell as js
from jaxshell import scenes
from jaxshell.analyses.statics import LoadFactor, proportional
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.methods.static import Static
from jaxshell.model import generators

BALANCE = 1e-9


def strip(loads=(), supports=(), **section):
    """A cantilever of 4 × 1 cells along x, clamped at x = 0, ten thicknesses wide."""
    mesh = generators.rectangle(4.0, 1.0, (4, 1))
    values = {"thickness": 0.1, "young_modulus": 1e6, "poisson_ratio": 0.2, "density": 1.0} | section
    return js.Scene(mesh, js.Section(**values), (js.clamped([0, 1]), *supports), loads, watch={"tip": (9, "uz")})


TIP = js.NodalForce([8, 9], [0.0, 0.0, 2.0])


def arc(scene, factors):
    """Tip of a cantilever of length 12 under a moment, EI = 100: exact."""
    curvature = np.asarray(factors) * 50 * np.pi / 3 / 100
    return np.sin(12 * curvature) / curvature - 12, (1 - np.cos(12 * curvature)) / curvature


@pytest.mark.parametrize("divisions", [(40, 1), pytest.param((40, 2), marks=pytest.mark.evidence)])
def test_end_moment_rolls_a_full_circle(divisions):
    """In the ten load steps that are asked for, none of them cut."""
    solution = js.solve_static(scenes.cantilever_end_moment(divisions), np.arange(1, 11) / 10)
    u, w = arc(solution.scene, solution.times[1:])
    assert np.asarray(solution.watched["tip u"][1:]) == pytest.approx(u, abs=0.005 * 12)
    assert np.asarray(solution.watched["tip w"][1:]) == pytest.approx(w, abs=0.005 * 12)
    assert np.asarray(solution.iterations).max() <= 10
    assert imbalance(solution) < BALANCE
    # The strain energy of a beam under a moment, ½ M²L/EI, is also the work done on it.
    energy = 0.5 * (50 * np.pi / 3) ** 2 * 12 / 100
    assert float(solution.energy.strain[-1]) == pytest.approx(energy, rel=1e-3)
    assert float(solution.energy.external_work[-1]) == pytest.approx(energy, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("divisions", [(8, 1), pytest.param((40, 1), marks=pytest.mark.evidence)])
def test_end_shear(divisions):
    """Sze, Liu & Lo 2004, table 1; at 8×1, the mesh that docs/validation.md names, too."""
    solution = js.solve_static(scenes.cantilever_end_shear(divisions), [0.25, 0.5, 0.75, 1.0])
    assert np.asarray(solution.watched["tip u"][1:]) == pytest.approx([-0.563, -1.604, -2.541, -3.286], rel=0.01)
    assert np.asarray(solution.watched["tip w"][1:]) == pytest.approx([3.015, 4.933, 6.031, 6.698], rel=0.01)
    assert imbalance(solution) < BALANCE


def test_small_loads_are_linear_and_a_file_keeps_the_run(tmp_path):
    scene = strip((TIP,))
    solution = js.solve_static(scene, [1e-5, -1e-5], output=tmp_path / "strip.h5")
    loads = np.zeros((10, 6))
    loads[[8, 9], 2] = 2.0
    expected = displacements(scene.mesh, scene.section, scene.held_dofs, loads)[9, 2]
    assert np.asarray(solution.watched["tip"]) == pytest.approx(1e-5 * expected * np.array([0, 1, -1]), rel=1e-5)
    loaded = js.Solution.load(tmp_path / "strip.h5")
    assert np.array_equal(loaded.times, [0, 1e-5, -1e-5])
    assert np.asarray(js.reactions(loaded)) == pytest.approx(np.asarray(js.reactions(solution)), abs=1e-12)


def test_cutback_and_what_is_kept_of_a_run_that_fails():
    scene = strip((TIP,))
    cut = js.solve_static(scene, [3000.0])
    assert np.array_equal(cut.times, [0, 3000])
    assert int(cut.iterations[-1]) > js.Newton().max_iterations
    assert imbalance(cut) < BALANCE
    with pytest.raises(js.SimulationError, match="followed to load factor") as error:
        js.solve_static(scene, [0.5, 1e12])
    kept = error.value.solution
    assert float(kept.times[1]) == 0.5 and kept.result != js.RESULTS.successful
    assert np.isfinite(np.asarray(kept.displacements)).all()
    with pytest.warns(UserWarning, match="unstable"):
        part = js.solve_static(scene, [0.5, 1e6], throw=False, save_every=5)
    assert 3000 < float(part.times[-1]) < 1e6 and part.result != js.RESULTS.successful
    assert np.array_equal(part.frame_times, np.asarray(part.times)[[0, 2]])  # where it ended is kept


@pytest.mark.slow
def test_prescribed_displacement_needs_the_reaction_that_gives_it():
    pushed = js.solve_static(strip((js.NodalForce([9], [0.0, 0.0, 50.0]),)))
    target = float(pushed.watched["tip"][-1])
    held = js.Support([9], "uz", displacement=target, history=js.History.ramp(7.0))
    moved = js.solve_static(strip(supports=(held,)))
    assert float(moved.watched["tip"][-1]) == pytest.approx(target)
    assert float(js.reactions(moved)[-1, 9, 2]) == pytest.approx(50.0, rel=1e-8)
    assert np.asarray(moved.displacements[-1]) == pytest.approx(np.asarray(pushed.displacements[-1]), abs=1e-8)
    assert imbalance(moved) < BALANCE
    # The support does the work that the shell stores, to the trapezoidal rule of ten steps.
    assert float(moved.energy.external_work[-1]) == pytest.approx(float(moved.energy.strain[-1]), rel=0.05)


def test_tangent_of_a_mixed_iteration_is_that_of_autodiff():
    scene = proportional(strip((js.Pressure(15.0),)))
    tables, _ = analyse(structure_of(scene))
    method, rng = Static(), np.random.default_rng(3)
    u, last = 0.1 * jnp.asarray(rng.standard_normal((2, 10, 6)))

    @eqx.filter_jit
    def matrices(scene, u, last, tangent):
        model = Model.build(scene, tables)
        state = method.start(model, scene, 0.0)
        return method.mixed_matrices(model, state, method.begin(model, state, 1.0), u, last, tangent)

    exact = matrices(scene, u, last, "autodiff")
    assert np.asarray(matrices(scene, u, last, "closed_form")) == pytest.approx(
        np.asarray(exact), abs=1e-12 * float(jnp.abs(exact).max())
    )
    # The predicted stresses matter, and at convergence, where u and last agree, they are the actual ones.
    assert float(jnp.abs(exact - matrices(scene, u, u, "autodiff")).max()) > 1e-3 * float(jnp.abs(exact).max())


@pytest.mark.slow
def test_follower_pressure_with_both_tangents():
    scene = strip((js.Pressure(15.0), js.Gravity([0.0, 0.0, -1.0])))
    solution, other = (js.solve_static(scene, [0.5, 1.0], tangent=t) for t in ("closed_form", "autodiff"))
    assert np.asarray(other.displacements) == pytest.approx(np.asarray(solution.displacements), abs=1e-9)
    assert np.array_equal(other.iterations, solution.iterations)
    assert imbalance(solution) < BALANCE
    assert float(solution.watched["tip"][-1]) > 1.0


@pytest.mark.slow
def test_static_gradient():
    """Through the implicit function theorem, against central differences."""
    scene = strip((TIP,))

    def tip(values):
        changed = eqx.tree_at(
            lambda s: (s.section.thickness, s.loads[0].force), scene, (values[0], values[1] * TIP.force)
        )
        return js.solve_static(changed, [5.0, 10.0]).watched["tip"][-1]

    at, step = jnp.array([0.1, 1.0]), 1e-5
    expected = [(tip(at + d) - tip(at - d)) / (2 * step) for d in step * jnp.eye(2)]
    assert np.asarray(jax.grad(tip)(at)) == pytest.approx(np.asarray(expected), rel=1e-6)


@pytest.mark.parametrize(
    ("supports", "named"),
    [
        ((), "translation along (1, 0, 0)"),
        ((js.pinned([0, 1]),), "rotation about the axis (0, 1, 0) through (0, 0.5, 0)"),
        ((js.Support([0, 1, 8], ("uz",)),), "rotation about the axis (0, 0, 1)"),
        ((js.Support([0], ("ux", "uy", "uz", "ry", "rz")),), "rotation about the axis (1, 0, 0) through"),
        ((js.symmetry([0, 1], "x"), js.Support([9], "uz")), "translation along (0, 1, 0)"),
    ],
)
def test_a_mechanism_is_named(supports, named):
    mesh = generators.rectangle(4.0, 1.0, (4, 1))
    scene = js.Scene(mesh, js.Section(0.1, 1e6, 0.2, 1.0), supports, (TIP,))
    with pytest.raises(ValueError) as error:
        js.solve_static(scene)
    assert named in str(error.value)


def test_a_loose_part_is_named():
    nodes = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0]]
    mesh = js.Mesh(nodes, [[0, 1, 2], [3, 4, 5]])
    with pytest.raises(ValueError, match="the part of the shell with node 3"):
        js.solve_static(js.Scene(mesh, js.Section(0.1, 1.0, 0.3, 1.0), (js.clamped([0, 1]),)))


@pytest.mark.wrong_types
@pytest.mark.parametrize("factors", [[], [0.0], [0.5, 0.5], [np.nan], [[1.0]]])
def test_bad_load_factors_are_refused(factors):
    with pytest.raises(ValueError, match="load_factors"):
        js.solve_static(strip((TIP,)), factors)


def test_reactions_of_a_run_in_time_are_refused():
    from synthetic import synthetic_solution

    with pytest.raises(ValueError, match="EMC"):
        js.reactions(synthetic_solution(strip((TIP,))))


def test_the_load_factor_is_its_own_history():
    assert float(LoadFactor()(-3.5)) == -3.5


# Sze, Liu & Lo 2004, tables 8a and 8d: load factor and deflection of the centre.
THICK = [
    (0.3473, 3.087),
    (0.6381, 7.057),
    (0.7421, 11.293),
    (0.6182, 14.188),
    (0.4442, 15.676),
    (0.2717, 17.094),
    (0.1729, 19.852),
    (0.2950, 22.875),
    (0.5826, 25.940),
    (0.9643, 28.663),
]
THIN = [
    (0.1182, 5.271),
    (0.1953, 12.892),
    (0.1671, 15.501),
    (0.0504, 16.915),
    (-0.0312, 16.697),
    (-0.0861, 14.767),
    (-0.1247, 14.862),
    (-0.1288, 15.778),
    (-0.1055, 19.817),
    (0.0626, 26.565),
    (0.4898, 33.388),
]


@pytest.mark.parametrize(
    ("thickness", "reference", "divisions"),
    [
        pytest.param(12.7, THICK, (8, 8), marks=pytest.mark.slow),
        pytest.param(6.35, THIN, (8, 8), marks=pytest.mark.slow),
        pytest.param(12.7, THICK, (24, 24), marks=pytest.mark.evidence),
        pytest.param(6.35, THIN, (24, 24), marks=pytest.mark.evidence),
    ],
)
def test_roof_through_its_limit_points(thickness, reference, divisions):
    """The reference's points lie on the path: within 2 % of the largest load and deflection in them, or 1 %."""
    path = js.solve_arc_length(scenes.hinged_roof(divisions, thickness), 0.5, steps=150)
    assert abs(float(path.times[-1])) >= 1
    scale = np.max(np.abs(reference), axis=0)
    points = np.stack([np.asarray(path.times), -np.asarray(path.watched["centre"])], 1) / scale
    fine = np.concatenate(
        [a + (b - a) * np.linspace(0, 1, 50)[:, None] for a, b in zip(points[:-1], points[1:], strict=True)]
    )
    distance = [np.linalg.norm(fine - np.array(point) / scale, axis=1).min() for point in reference]
    assert max(distance) < (0.02 if divisions == (8, 8) else 0.01)
    assert np.diff(path.times).min() < 0
    assert imbalance(path) < BALANCE


def limit_points(factors):
    """The load factors at which a path turns."""
    change = np.diff(factors)
    return factors[1:-1][change[:-1] * change[1:] < 0]


@pytest.mark.parametrize("arc_length", [pytest.param(4.0, marks=pytest.mark.evidence)])
def test_a_path_that_turns_back_sharply_is_not_followed_back(arc_length):
    """The pinched cylinder on 16×16 snaps back three times on the way to its full load; on the part that it came
    from it would unload to zero and below."""
    path = js.solve_arc_length(scenes.pinched_cylinder((16, 16)), arc_length, steps=300)
    factors = np.asarray(path.times)
    assert factors[-1] >= 1
    # As followed with an arc length of 0.125.
    expected = np.array([0.0578, 0.3127, 0.0525, 0.5880, 0.1463])
    np.testing.assert_allclose(limit_points(factors)[-5:], expected, atol=0.01)
    assert imbalance(path) < BALANCE


@pytest.mark.slow
def test_an_arc_length_is_found_where_none_is_given():
    """The thin roof's limit loads, 0.1953 and -0.1288 in the reference, found without one."""
    path = js.solve_arc_length(scenes.hinged_roof((8, 8), 6.35))
    factors = np.asarray(path.times)
    assert factors[-1] >= 1
    np.testing.assert_allclose(limit_points(factors), [0.1953, -0.1288], rtol=0.02)


@pytest.mark.wrong_types
def test_bad_arc_lengths_are_refused():
    with pytest.raises(ValueError, match="arc_length must be positive"):
        js.solve_arc_length(strip((TIP,)), -1.0)
    with pytest.raises(ValueError, match="steps"):
        js.solve_arc_length(strip((TIP,)), 1.0, steps=0)
    with pytest.raises(ValueError, match="Nothing loads or moves the shell: there is no path to follow"):
        js.solve_arc_length(strip())
    with pytest.raises(ValueError, match="cannot be traced"):
        jax.grad(lambda s: js.solve_arc_length(strip((TIP,)), s).watched["tip"][-1])(0.1)
