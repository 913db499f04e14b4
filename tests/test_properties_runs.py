"""Properties of whole runs under random loads: budgets of momentum and energy, numbering of nodes and triangles.

Every budget counts the supports' reactions, which are what a step's balance leaves at the held freedoms. A small
curved shell of eight triangles is held at one node and moved at another; loads are forces and moments on every node,
a follower pressure and gravity, each with its own history. The budgets are each method's own sums over its steps, so
that they close to the round-off of Newton's solution and not to the order of the method.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from properties import EPS, PROFILE, numbers, powers, vectors
from scipy.spatial.transform import Rotation

import jaxshell as js
from jaxshell import generators, scenes
from jaxshell.assembly import analyse
from jaxshell.elements.corotational import internal_force
from jaxshell.methods.base import Observation, Solvers
from jaxshell.model import Model, pressure_force, structure_of
from jaxshell.newton import Linear

CLOSED = 1e-10
"""Of the sum of the sizes of what is in balance, besides what Newton leaves at the free freedoms."""
STEPS = 6
NEWTON = js.Newton(tolerance=1e-13, max_iterations=100)
"""Random velocities of neighbouring nodes are no smooth motion; a few such starts take some thirty iterations."""
FLAT = generators.rectangle(0.6, 0.4, (2, 2))
N = FLAT.n_nodes
EVERY = np.arange(N)


@st.composite
def histories(draw, first=None):
    values = [draw(numbers(-1.0, 1.0)) for _ in range(3)]
    return js.History([0.0, 0.02, 0.05], values if first is None else [first, *values[1:]])


@st.composite
def shells(draw):
    """A scene: random heights of the nodes, section, start, loads and motion of a support."""
    nodes = np.asarray(FLAT.nodes) + [0.0, 0.0, 0.05] * draw(vectors(N))
    section = js.Section(0.02 * draw(powers(-0.3, 0.3)), 1e6, draw(numbers(0.0, 0.45)), 1000.0)
    supports = (
        js.Support([0], ("ux", "uy", "uz", "ry")),
        js.Support([2], ("uy", "uz"), 0.02 * draw(vectors(None))[:2], draw(histories(0.0))),
    )
    loads = (
        js.NodalForce(EVERY, 10.0 * draw(vectors(N)), draw(histories())),
        js.NodalMoment(EVERY, 0.02 * draw(vectors(N)), draw(histories())),
        js.Gravity(10.0 * draw(vectors(None)), draw(histories())),
        js.Pressure(100.0 * draw(numbers(-1.0, 1.0)), draw(histories())),
    )
    initial = js.Initial(draw(vectors(N, 0.5)), draw(vectors(N, 2.0)))
    return js.Scene(js.Mesh(nodes, FLAT.triangles), section, supports, loads, initial)


TIME_STEPS = powers(-3.0, -2.0)


class March(NamedTuple):
    """`STEPS` steps: k + 1 states, k steps."""

    observed: Observation
    x: jax.Array
    R: jax.Array
    dead: jax.Array
    """(k + 1, n, 6) loads with a fixed direction."""
    pressure: jax.Array
    """(k + 1,), the same on every triangle."""
    normals: jax.Array
    """(k, 3, n, 6) nodal forces of a unit pressure at the start, in the middle and at the end of a step."""
    residual: jax.Array
    """(k, n, 6) what the steps' balances leave."""
    strength: jax.Array
    """(k,) Σ over elements of |internal force| |position| + |moment| at the end of a step: with the machine's ε, what
    the rounding of positions and rotations costs in energy."""
    acceleration: jax.Array
    """(3,) rate of the linear momentum at the start; zero for a method without accelerations."""
    result: jax.Array


@eqx.filter_jit
def steps_of(scene, method, dt, tables, handle) -> March:
    model = Model.build(scene, tables)
    solvers = Solvers(NEWTON, Linear(js.Dense(), handle), "closed_form")
    first = method.start(model, scene, 0.0)

    def state_of(state):
        return method.observe(model, state), state.x, state.R, model.dead_load(state.time), model.pressure(state.time)[0]

    def unit_pressure(x):
        return model.assemble_vector(jax.vmap(pressure_force, (0, None))(model.gather(x), 1.0))

    def step(carry, _):
        state, memory = carry
        new, info, memory = method.step(model, state, dt, solvers, memory)
        residual = method.balance(model, state, method.begin(model, state, dt), dt * new.rates[0]).residual
        normals = jnp.stack([unit_pressure(x) for x in (state.x, 0.5 * (state.x + new.x), new.x)])
        f = jnp.abs(jax.vmap(internal_force)(model.gather(new.x), model.gather(new.R), model.elements))
        strength = jnp.sum(f.reshape(-1, 2, 3) * jnp.array([jnp.max(jnp.abs(new.x)), 1.0])[:, None])
        return (new, memory), (state_of(new), normals, residual, strength, info.result)

    _, (states, normals, residual, strength, result) = jax.lax.scan(
        step, (first, solvers.linear.memory(NEWTON)), None, length=STEPS
    )
    states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), state_of(first), states)
    rate = jnp.zeros(3)
    if hasattr(first, "a"):
        rate = method.observe(model, eqx.tree_at(lambda s: s.v, first, first.a)).linear
    return March(*states, normals, residual, strength, rate, result)


def march(scene, method, dt) -> March:
    """The steps of a scene, on the host; every example must converge."""
    tables, pattern = analyse(structure_of(scene))
    # Numbers as arrays: traced, so that one program serves every example.
    method = jax.tree.map(jnp.asarray, method)
    found = jax.tree.map(np.asarray, steps_of(scene, method, jnp.asarray(dt), tables, js.Dense().prepare(pattern)))
    assert np.all(found.result == 0)
    return found


def reactions(scene, found: March):
    """(k, n, 6) each: the residuals at the held freedoms, and at the free ones, which Newton leaves."""
    held = np.zeros(6 * N)
    held[scene.held_dofs] = 1.0
    carried = held.reshape(N, 6) * found.residual
    return carried, np.abs(found.residual - carried)


def resultant(forces, x):
    """(6,): sum of nodal forces, and of their moments about the origin."""
    return np.concatenate([forces[:, :3].sum(axis=0), (np.cross(x, forces[:, :3]) + forces[:, 3:]).sum(axis=0)])


def sizes(forces, x):
    """(2,): sums of the sizes of forces and of moments, what a resultant cancels from."""
    size = np.abs(forces[:, :3]).sum()
    return np.array([size, size * np.abs(x).max() + np.abs(forces[:, 3:]).sum()])


# --- EnergyMomentum ---------------------------------------------------------------------------------------


def cayley_vectors(R0, R1):
    turned = Rotation.from_matrix(R1 @ np.swapaxes(R0, 1, 2)).as_rotvec()
    half = 0.5 * np.linalg.norm(turned, axis=1, keepdims=True)
    return turned * np.where(half > 1e-8, np.tan(half) / np.where(half > 1e-8, half, 1.0), 1.0)


@settings(PROFILE, max_examples=25)
@given(shells(), TIME_STEPS, st.one_of(st.just(0.0), numbers(0.0, 0.5)))
def test_budgets_of_energy_momentum(scene, dt, dissipation):
    """ΔL = ΣF Δt, ΔJ = Σ(x_m × F + M) Δt and ΔE = W - D in every step, by mid-point loads and reactions."""
    found = march(scene, js.EnergyMomentum(jnp.asarray(dissipation)), dt)
    momenta = np.concatenate([found.observed.linear, found.observed.angular], axis=1)
    energy = found.observed.kinetic + found.observed.strain
    carried, left = reactions(scene, found)
    # The mean of a constant pressure's normal over the straight path of the nodes, by Simpson's rule, exact.
    follower = np.einsum("s,ksnf->knf", [1 / 6, 4 / 6, 1 / 6], found.normals)
    for k in range(STEPS):
        middle = 0.5 * (found.x[k] + found.x[k + 1])
        pressure = 0.5 * (found.pressure[k] + found.pressure[k + 1])
        forces = 0.5 * (found.dead[k] + found.dead[k + 1]) + pressure * follower[k] + carried[k]
        rate = (momenta[k + 1] - momenta[k]) / dt
        # Accelerating masses are in balance with the internal forces too: Newton's residual scales with both.
        scale = sizes(forces, middle) + _inertial_sizes(found, k, dt)
        error = np.abs(rate - resultant(forces, middle)).reshape(2, 3).max(axis=1)
        assert np.all(error <= CLOSED * scale + sizes(left[k], middle))

        increments = np.concatenate([found.x[k + 1] - found.x[k], cayley_vectors(found.R[k], found.R[k + 1])], axis=1)
        work = np.sum(forces * increments)
        dissipated = found.observed.dissipated[k + 1] - found.observed.dissipated[k]
        assert dissipated >= 0.0 and (dissipated > 0.0 or dissipation < 1e-12)
        scale = energy[k] + energy[k + 1] + np.abs(forces * increments).sum()
        rounding = 100 * EPS * (found.strength[k] + found.strength[max(k - 1, 0)])
        error = abs(energy[k + 1] - energy[k] + dissipated - work)
        assert error <= CLOSED * scale + rounding + np.sum(left[k] * np.abs(increments))
        recorded = found.observed.external_work[k + 1] - found.observed.external_work[k]
        assert abs(recorded - work) <= CLOSED * scale


def _inertial_sizes(found: March, k, dt):
    """(2,) sizes of momenta over the step size, of which a rate of change is the difference."""
    linear, angular = (np.abs(v[k : k + 2]).sum() / dt for v in (found.observed.linear, found.observed.angular))
    return np.array([linear, linear * np.abs(found.x[k]).max() + angular])


# --- Newmark and its relatives ----------------------------------------------------------------------------

FAMILY = {
    "generalized_energy_momentum": st.builds(
        js.GeneralizedEnergyMomentum, numbers(0.0, 1.0).map(jnp.asarray), numbers(0.0, 0.5).map(jnp.asarray)
    ),
    "newmark": numbers(0.5, 1.0).map(lambda gamma: js.Newmark(jnp.asarray(0.25 * (gamma + 0.5) ** 2), gamma)),
    "generalized_alpha": numbers(0.0, 1.0).map(lambda rho: js.GeneralizedAlpha(jnp.asarray(rho))),
}


@pytest.mark.parametrize(
    "name",
    ["generalized_energy_momentum", "newmark", pytest.param("generalized_alpha", marks=pytest.mark.slow)],
)
def test_linear_momentum_is_the_impulse_by_newmarks_formulas(name):
    """M of the whole shell obeys the scalar scheme: its rate A = L̇ from ΣF at t_{n+1-αf}, and ΔL = Δt(γ A₁ + (1-γ)A₀).

    With ρ∞ = 1 and for the trapezoidal rule this is the impulse of the mean force of each step.
    """

    @settings(PROFILE, max_examples=25)
    @given(shells(), TIME_STEPS, FAMILY[name])
    def budget(scene, dt, method):
        found = march(scene, method, dt)
        _, gamma, alpha_m, alpha_f, _ = (float(number) for number in method.factors(dt))
        rate, (carried, left) = found.acceleration, reactions(scene, found)
        loads = found.dead + found.pressure[:, None, None] * np.concatenate(
            [found.normals[:1, 0], found.normals[:, 2]]
        )
        size, total = np.abs(rate).sum(), 0.0
        for k in range(STEPS):
            forces = (1.0 - alpha_f) * loads[k + 1] + alpha_f * loads[k] + carried[k]
            new = (forces[:, :3].sum(axis=0) - alpha_m * rate) / (1.0 - alpha_m)
            expected = found.observed.linear[k] + dt * ((1.0 - gamma) * rate + gamma * new)
            rate = new
            # An error of one step's rate comes back in all later ones, ever smaller: |αm/(1-αm)| <= 1.
            size += np.abs(forces[:, :3]).sum() / (1.0 - alpha_m) + np.abs(found.observed.linear[k]).sum() / dt
            total += left[k, :, :3].sum() / (1.0 - alpha_m)
            assert np.abs(found.observed.linear[k + 1] - expected).max() <= dt * (CLOSED * size + total)

    budget()


# --- numbering --------------------------------------------------------------------------------------------


def renumbered(scene, nodes, triangles):
    """The scene with node i called nodes[i], and its triangles in the order `triangles`."""
    back = np.argsort(nodes)
    force, moment, *others = scene.loads
    loads = (
        js.NodalForce(EVERY, np.asarray(force.force)[back], force.history),
        js.NodalMoment(EVERY, np.asarray(moment.moment)[back], moment.history),
        *others,
    )
    supports = [js.Support(nodes[s.nodes.array], s.dofs, s.displacement, s.history) for s in scene.supports]
    initial = js.Initial(*(np.asarray(v)[back] for v in (scene.initial.velocities, scene.initial.angular_velocities)))
    mesh = js.Mesh(np.asarray(scene.mesh.nodes)[back], nodes[scene.mesh.triangles[triangles]])
    return js.Scene(mesh, scene.section, supports, loads, initial)


@settings(PROFILE, max_examples=25)
@given(shells(), st.permutations([0, 1, *range(3, N)]), st.permutations(range(FLAT.n_elements)))
def test_numbering_of_nodes_and_triangles_does_not_matter(scene, nodes, triangles):
    """Positions to 1e-9 of the shell's size and rotations to 1e-9 rad.

    The connectivity reaches a compiled program through the tables alone, so that one program serves every numbering;
    only the node of the moving support is named in its text, and keeps its number 2.
    """
    nodes = np.array([*nodes[:2], 2, *nodes[2:]])
    other = renumbered(scene, nodes, np.array(triangles))
    tables, pattern = analyse(structure_of(other))
    same_text = jax.tree.unflatten(jax.tree.structure(scene), jax.tree.leaves(other))
    method, dt = js.EnergyMomentum(jnp.asarray(0.0)), 0.005
    plain = march(scene, method, dt)
    found = steps_of(same_text, method, jnp.asarray(dt), tables, js.Dense().prepare(pattern))
    assert np.abs(np.asarray(found.x)[:, nodes] - plain.x).max() <= 1e-9 * np.ptp(plain.x[0], axis=0).max()
    assert np.abs(np.asarray(found.R)[:, nodes] - plain.R).max() <= 1e-9


@pytest.mark.slow
def test_which_edge_is_first_converges_away():
    """Tip of the twisted beam at 400 times its load (a sixth of its length), first edge by first edge: the spread of
    three answers falls faster than the second order of the mesh and is small beside the mesh's own error."""
    found = []
    for divisions in ((6, 1), (12, 2)):
        beam = scenes.twisted_beam(divisions)
        tips = []
        for shift in range(3):
            mesh = js.Mesh(beam.mesh.nodes, np.roll(beam.mesh.triangles, -shift, axis=1))
            rolled = js.Scene(mesh, beam.section, beam.supports, beam.loads, watch={"tip": beam.watch[0][1:]})
            tips.append(float(js.solve_static(rolled, [200.0, 400.0]).watched["tip"][-1]))
        found.append(np.array(tips))
    coarse, fine = (np.ptp(tips) for tips in found)
    assert 0 < fine < 0.25 * coarse
    assert coarse < 0.1 * abs(found[0][0] - found[1][0])
