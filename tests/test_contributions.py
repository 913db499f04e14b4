"""What follows the motion: places in the sparse matrix, tangents with every method, and what it does to the energy."""

import itertools
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.methods.base import _problem
from jaxshell.methods.bathe import ThreePointBackward
from jaxshell.methods.method import Solvers
from jaxshell.methods.static import Static
from jaxshell.model import generators
from jaxshell.model.contribution import Contribution
from jaxshell.model.loads import Load
from jaxshell.numerics.frozen import Frozen
from jaxshell.results.diagnostics import momentum_scales
from jaxshell.solvers.iteration import Linear

NEWTON = js.Newton(tolerance=1e-13)
METHODS = {
    "EMC": js.GeneralizedEnergyMomentum(0.8, 0.1),
    "exact": js.EnergyMomentum(),
    "generalised alpha": js.GeneralizedAlpha(0.6),
    "Bathe's second half": ThreePointBackward(),
    "statics": Static(),
}


class Pull(Load, Contribution):
    """Two nodes far apart pull at each other with a constant force: a contribution between nodes of no element."""

    kind: ClassVar[str] = "pull"
    value: ClassVar[str] = "tension"

    nodes: Frozen = eqx.field(static=True)
    tension: jax.Array
    history: js.History

    def groups(self, triangles):
        return Frozen(self.nodes.array[None])

    def data(self, surface):
        return self.tension[None]

    def force(self, data, place):
        along = place.x[1] - place.x[0]
        force = data * self.history(place.time) * along / jnp.linalg.norm(along)
        return jnp.stack([jnp.concatenate([f, jnp.zeros(3)]) for f in (force, -force)])


RAMP = js.History([0.0, 1.0, 2.0], [0.5, 2.0, 1.0])


def strip(*loads, supports=True) -> js.Scene:
    mesh = generators.rectangle(1.0, 0.5, (3, 2))
    edge = mesh.nodes_where(lambda x: x[0] < 1e-9)
    held = [js.clamped(edge[:2]), js.Support(edge[2:], ("uz", "rx"))] if supports else []
    return js.Scene(mesh, js.Section(0.02, 1e6, 0.3, 1000.0), held, loads, watch={"tip": (11, "uz")})


def everything():
    return (
        js.Pressure(3.0, RAMP),
        js.NormalForce([4, 11], [0.7, -0.2], RAMP),
        Pull(Frozen([3, 11]), jnp.array(2.0), RAMP),
        js.FollowerEdgeForce([[8, 11], [10, 11]], [0.4, -0.3, 0.5], RAMP),
        js.HydrostaticPressure(20.0, js.History([0.0, 2.0], [0.8, 0.5]), RAMP, elements=[3, 6, 9], up=[2.0, 0.3, 1.0]),
    )


def state_of(method, model, scene, random):
    """A state far from rest, with increments of a step from it."""
    state = method.start(model, scene, 0.1)
    turned = jnp.asarray(Rotation.from_rotvec(0.3 * random(model.x0.shape[0], 3)).as_matrix())
    if isinstance(method, Static):
        return eqx.tree_at(lambda s: (s.d, s.R), state, (jnp.asarray(0.05 * random(*model.x0.shape)), turned))
    moved = model.x0 + 0.05 * random(*model.x0.shape)
    return eqx.tree_at(lambda s: (s.x, s.R), state, (moved, turned))


@pytest.mark.parametrize(
    "name",
    [name if name in ("statics", "exact") else pytest.param(name, marks=pytest.mark.evidence) for name in METHODS],
)
def test_tangent_is_the_derivative_of_the_balance(name):
    """Closed form and `jax.jacfwd` of each contribution against `jax.jacfwd` of the whole step's residual."""
    method, scene, rng = METHODS[name], strip(*everything()), np.random.default_rng(7)
    tables, pattern = analyse(structure_of(scene))
    solver = js.Dense()
    handle = solver.prepare(pattern)
    random = lambda *shape: rng.normal(size=shape)  # noqa: E731
    model = eqx.filter_jit(Model.build)(scene, tables)
    state = state_of(method, model, scene, random)
    scale = np.where(np.asarray(tables.free) % 6 >= 3, 0.2, 0.03)
    free = jnp.asarray(scale * random(tables.free.size))

    @eqx.filter_jit
    def compute(model, state, free, tangent):
        solvers = Solvers(js.Newton(), Linear(solver, handle), tangent)
        dt = jnp.array(0.05)
        held = model.held_increment(state.time, dt, method.size_of_turn)
        problem = _problem(method, model, state, method.begin(model, state, dt), held, solvers)
        return jax.jacfwd(lambda free: problem.free(problem.balance(free).residual))(free), problem.matrix(free, free)

    n = pattern.size
    turns = np.asarray(tables.free) % 6 >= 3
    for tangent in ("closed_form", "autodiff"):
        expected, values = compute(model, state, free, tangent)
        found = csr_matrix((np.asarray(values), pattern.indices.array, pattern.indptr.array), (n, n)).toarray()
        error = np.abs(found - np.asarray(expected))
        for rows, columns in itertools.product((turns, ~turns), repeat=2):
            block = np.ix_(rows, columns)
            assert error[block].max() < 1e-11 * np.abs(np.asarray(expected)[block]).max()


def test_pattern_holds_what_no_element_connects():
    plain, pulled = (analyse(structure_of(scene)) for scene in (strip(), strip(everything()[2])))
    assert pulled[1].indices.array.size > plain[1].indices.array.size and pulled[0].own is not None
    # On nodes, and on the elements' own, nothing is added and nothing is summed apart.
    assert analyse(structure_of(strip(*everything()[:2])))[0].own is None
    assert analyse(structure_of(strip(everything()[0])))[1] is plain[1]


def test_energy_changes_by_their_work():
    """`EnergyMomentum`: K + S - W to the round-off of its sums, at a step of a third of the first bending period."""
    scene = strip(*everything())
    solution = js.simulate(scene, js.EnergyMomentum(), dt=0.02, t_end=1.0, save_every=50, newton=NEWTON)
    energy = solution.energy
    balance = np.asarray(energy.total - energy.external_work)
    print(f"largest change of K + S - W: {np.ptp(balance):.1e} of {np.max(energy.total):.3g}")
    assert np.ptp(balance) < 1e-12 * np.max(energy.total)
    assert np.max(energy.total) > 1e-3


@pytest.mark.slow
def test_what_acts_between_two_nodes_keeps_the_linear_momentum():
    """The pull has no resultant: a free strip that it folds keeps its momentum, against √(2 M K)."""
    scene = strip(everything()[2], supports=False)
    solution = js.simulate(scene, js.EnergyMomentum(), dt=0.01, t_end=0.5, save_every=50, newton=NEWTON)
    size, _ = momentum_scales(solution)
    assert size > 1e-3
    assert np.abs(solution.momentum.linear).max() < 1e-10 * size


def test_normal_force_turns_with_the_shell():
    """A rigid strip turned by 90° about y: the force on +z acts along +x."""
    scene = strip(js.NormalForce([4], 2.0))
    model = eqx.filter_jit(Model.build)(scene, analyse(structure_of(scene))[0])
    turn = Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).as_matrix()
    R = jnp.broadcast_to(turn, (model.x0.shape[0], 3, 3))
    found = np.asarray(model.following_load(model.x0 @ turn.T, R, 0.0))
    expected = np.zeros_like(found)
    expected[4, 0] = 2.0
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.slow
def test_normal_force_in_statics_against_a_dead_force():
    """Small: the same as the dead force. Large, it stays at right angles to the tip and does not hang down."""
    tip = [3, 7, 11]
    small = js.solve_static(strip_long(js.NormalForce(tip, 1e-6)), [1.0])
    dead = js.solve_static(strip_long(js.NodalForce(tip, [0.0, 0.0, 1e-6])), [1.0])
    np.testing.assert_allclose(small.displacements[-1], dead.displacements[-1], rtol=1e-4, atol=1e-12)
    large = js.solve_static(strip_long(js.NormalForce(tip, 2e-2)))
    carried, loads = np.asarray(js.reactions(large))[-1], np.asarray(large.rotations[-1])[tip] @ [0.0, 0.0, 2e-2]
    np.testing.assert_allclose(carried[:, :3].sum(axis=0), -loads.sum(axis=0), atol=1e-9 * 6e-2)
    assert abs(loads[0, 0]) > 0.3 * 2e-2


def strip_long(*loads) -> js.Scene:
    mesh = generators.rectangle(1.0, 0.2, (3, 2))
    mesh = js.Mesh(mesh.nodes, mesh.triangles)
    edge = mesh.nodes_where(lambda x: x[0] < 1e-9)
    return js.Scene(mesh, js.Section(0.01, 1e6, 0.0, 1000.0), [js.clamped(edge)], loads)


@pytest.mark.slow
def test_gradient_by_a_normal_force():
    """Adjoint against forward mode, and against differences."""

    def tip(magnitude):
        scene = strip(js.NormalForce([11], magnitude), js.Pressure(1.0))
        return js.simulate(scene, js.EnergyMomentum(), dt=0.02, t_end=0.2, newton=NEWTON).watched["tip"][-1]

    forward, reverse = jax.jvp(tip, (0.5,), (1.0,))[1], jax.grad(tip)(0.5)
    assert float(reverse) == pytest.approx(float(forward), rel=1e-10)
    difference = (float(tip(0.5 + 1e-4)) - float(tip(0.5 - 1e-4))) / 2e-4
    assert float(reverse) == pytest.approx(difference, rel=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: js.NormalForce([0], float("nan")), "normal force must be finite"),
        (lambda: js.NormalForce([0, 1], [1.0, 2.0, 3.0]), "magnitude must be one value or 2"),
        (lambda: strip(js.NormalForce([99], 1.0)), "load 0 names node 99"),
        (lambda: strip(js.Pressure([1.0, 2.0])), "load 0: pressure must be one value or 12"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()
