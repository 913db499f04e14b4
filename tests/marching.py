"""Random scenes of a small shell, and a few steps of a method on them, for the budgets of `test_properties_*.py`.

A small curved shell of eight triangles is held at one node and moved at another; loads are forces and moments on every
node, a follower pressure and gravity, each with its own history. Sections, loads, motions and step sizes are traced:
one compiled program serves every example.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st
from properties import numbers, powers, vectors

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.elements.corotational import internal_force
from jaxshell.methods.method import Observation, Solvers
from jaxshell.methods.turning import turning
from jaxshell.model import generators
from jaxshell.model.loads.pressure import pressure_force
from jaxshell.solvers.iteration import Linear

CLOSED = 1e-10
"""Of the sum of the sizes of what is in balance, besides what Newton leaves at the free degrees of freedom."""
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

    def pressure_at(time):
        """On every element alike."""
        (acting,) = model.contributions
        return acting.contribution.history(time) * acting.data[0]

    def state_of(state):
        return (
            method.observe(model, state),
            state.x,
            state.R,
            model.dead_load(state.time),
            pressure_at(state.time),
        )

    def unit_pressure(x):
        return model.assemble_vector(jax.vmap(pressure_force, (0, None))(model.gather(x), 1.0).reshape(-1, 18))

    def step(carry, _):
        state, memory = carry
        new, info, memory = method.step(model, state, dt, solvers, memory)
        residual = method.unbalanced(model, state, new, dt)
        normals = jnp.stack([unit_pressure(x) for x in (state.x, 0.5 * (state.x + new.x), new.x)])
        f = jnp.abs(jax.vmap(internal_force)(model.gather(new.x), model.gather(new.R), model.elements))
        strength = jnp.sum(f.reshape(-1, 2, 3) * jnp.array([jnp.max(jnp.abs(new.x)), 1.0])[:, None])
        return (new, memory), (state_of(new), normals, residual, strength, info.result)

    _, (states, normals, residual, strength, result) = jax.lax.scan(
        step, (first, solvers.linear.memory(NEWTON, turning(model, first.R))), None, length=STEPS
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
    """(k, n, 6) each: the residuals at the held degrees of freedom, and at the free ones, which Newton leaves."""
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
