"""Stable and unstable equilibria, where stability is lost, and the way to the stable branch."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from scipy.special import ellipk

import jaxshell as js
from jaxshell.analyses import modal, stability
from jaxshell.analyses.statics import proportional
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.model import generators

OVER = 1.884
"""Load of the column over its buckling load: the tip turns by about 120 degrees."""


def column(cells=10):
    """A cantilever of length 1 along x, compressed at its free end by OVER times its buckling load π²EI/4."""
    length, width, thickness, young = 1.0, 0.05, 0.01, 1e9
    mesh = generators.rectangle(length, width, (cells, 1))
    load = OVER * np.pi**2 / 4 * young * width * thickness**3 / 12
    x = np.asarray(mesh.nodes)
    base, tip = np.flatnonzero(x[:, 0] < 1e-9), np.flatnonzero(x[:, 0] > length - 1e-9)
    section = js.Section(thickness, young, 0.0, 1.0)
    forces = js.NodalForce(tip, [-load / tip.size, 0.0, 0.0])
    return js.Scene(mesh, section, (js.clamped(base),), (forces,), watch={"side": (int(tip[0]), "uz")})


def elastica(over):
    """Side displacement of a cantilever of length 1 whose end load is `over` times the buckling load: K(k) = π/2 √over,
    and 2k/(π/2 √over), by S. Timoshenko & J. Gere, Theory of Elastic Stability (1961), section 2.7."""
    k_sq = scipy.optimize.brentq(lambda m: ellipk(m) - np.pi / 2 * np.sqrt(over), 1e-12, 1 - 1e-12)
    return 2 * np.sqrt(k_sq) / (np.pi / 2 * np.sqrt(over))


def quotients(solution, frame):
    """All μ of an equilibrium by a dense solver."""
    scene = proportional(solution.scene)
    tables, pattern = analyse(structure_of(scene))
    model = Model.build(scene, tables)
    place = solution.displacements[frame], solution.rotations[frame]
    x, R = model.gather((model.x0 + place[0], place[1]))
    element = modal.corotational.tangent_stiffness
    K = np.zeros((pattern.size, pattern.size))
    K[pattern.rows, pattern.indices.array] = np.asarray(model.assemble_matrix(jax.vmap(element)(x, R, model.elements)))
    state = stability.StaticState(jnp.zeros(()), *place, jnp.zeros_like(place[0]), jnp.zeros(()))
    K_0 = np.asarray(jax.vmap(stability._material_product(model, state))(jnp.eye(pattern.size)))
    return scipy.linalg.eigh(0.5 * (K + K.T), 0.5 * (K_0 + K_0.T), eigvals_only=True)


def test_elastica_of_the_tables():
    assert elastica(1.884) == pytest.approx(0.803, abs=1e-3)
    assert elastica(1.015) == pytest.approx(0.220, abs=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver", [js.Pardiso, *(pytest.param(s, marks=pytest.mark.evidence) for s in (js.KLU, js.Dense))]
)
def test_straight_column_says_where_it_lost_its_stability(solver):
    """A column of 10 cells buckles 0.2 % above Euler's load; on the way there is no other sign of it."""
    factors = [0.25, 0.5, 0.75, 1.0]
    with pytest.warns(UserWarning, match=r'load factor 0\.53.*branch="follow"'):
        solution = js.solve_static(column(), factors, linear_solver=solver())
    assert solution.stable.tolist() == [True, True, True, False, False]
    assert solution.stats["stability_lost"] == (pytest.approx(1 / OVER, rel=3e-3),)
    assert float(jnp.abs(solution.watched["side"]).max()) < 1e-6
    for frame, stable in enumerate(solution.stable.tolist()):
        assert (quotients(solution, frame)[0] > 0) == stable


@pytest.mark.evidence
def test_followed_column_is_the_elastica():
    solution = js.solve_static(column(), [0.5, 0.75, 1.0], branch="follow")
    assert all(solution.stable)
    assert solution.stats["branched"] == (pytest.approx(1 / OVER, rel=3e-3),)
    side = np.asarray(solution.watched["side"])
    assert abs(side[1]) < 1e-6
    # Ten cells: half a per cent. The sign is that of the rule: the first large displacement is positive.
    assert side[2:] == pytest.approx([elastica(0.75 * OVER), elastica(OVER)], rel=5e-3)
    assert quotients(solution, -1)[0] > 0


def test_branch_is_named_and_not_traced():
    def pushed(force):
        return eqx.tree_at(lambda scene: scene.loads[0].force, column(), jnp.array([force, 0.0, 0.0]))

    with pytest.raises(ValueError, match="branch must be"):
        js.solve_static(column(), branch="left")
    with pytest.raises(ValueError, match="cannot be traced"):
        jax.grad(lambda force: js.solve_static(pushed(force), branch="follow").watched["side"][-1])(-1.0)


def plate(cells=6, over=1.5):
    """A simply supported square of side 1, compressed along x by `over` times its buckling strain; its sides may slide."""
    thickness, young, nu = 0.01, 1e7, 0.3
    mesh = generators.rectangle(1.0, 1.0, (cells, cells))
    x = np.asarray(mesh.nodes)
    rim = np.flatnonzero((np.abs(x[:, :2] - 0.5) > 0.5 - 1e-9).any(axis=1))
    left, right = (np.flatnonzero(np.abs(x[:, 0] - side) < 1e-9) for side in (0.0, 1.0))
    strain = over * 4 * np.pi**2 * thickness**2 / 12 / (1 - nu**2)
    press = js.Support(right, "ux", displacement=-strain, history=js.History.ramp(1.0))
    supports = js.Support(rim, "uz"), js.Support(left, "ux"), js.Support([0], "uy"), press
    middle = int(np.argmin(np.hypot(*(x[:, :2] - 0.5).T)))
    return js.Scene(mesh, js.Section(thickness, young, nu, 1.0), supports, watch={"w": (middle, "uz")})


@pytest.mark.evidence
def test_plate_buckles_into_its_half_wave():
    """At k = 4 of the square plate, to what 6 cells give; and to a deflection of the thickness's size."""
    solution = js.solve_static(plate(), [0.5, 1.0], branch="follow")
    assert all(solution.stable)
    assert solution.stats["branched"] == (pytest.approx(1 / 1.5, rel=0.05),)
    assert 0.5 < float(solution.watched["w"][-1]) / 0.01 < 2.0
