"""Budgets of momentum of Bathe's composite method and central differences, and moments where a balance stands at
the end of the step.

Random loads on the shells of `marching.py`. Bathe's two balances stand at the middle and at the end of a step; the
impulse of a free flight is their sum. At the end of a step of his method and of Newmark's, forces and moments of loads,
reactions and inertia are in balance. Central differences kick twice a step, so that impulses and their moments are
known exactly.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from marching import CLOSED, NEWTON, STEPS, TIME_STEPS, N, resultant, shells, sizes
from properties import PROFILE, powers

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.elements.inertia import Spins
from jaxshell.methods import seven_point
from jaxshell.methods.method import Solvers
from jaxshell.methods.turning import turning
from jaxshell.numerics.rotations import skew
from jaxshell.solvers.iteration import Linear

ROUND_OFF = 1e-13
"""Of the sum of the sizes of what is in balance."""


class Look(NamedTuple):
    """What is looked at of every state; axes over states first."""

    x: np.ndarray
    momenta: np.ndarray
    """(6,) linear, and angular about the origin."""
    loads: np.ndarray
    """(n, 6) all loads, by the scene's histories."""
    halfway: np.ndarray
    """(n, 6) dead loads half a step later."""
    own: tuple
    """What one method keeps besides."""


@eqx.filter_jit
def states_of(scene, method, dt, tables, handle, own):
    """`STEPS` steps: a `Look` at each of their STEPS + 1 states; what the steps' balances leave, and how they ended."""
    model = Model.build(scene, tables)
    solvers = Solvers(NEWTON, Linear(js.Dense(), handle), "closed_form")
    first = method.start(model, scene, 0.0)

    def look(state):
        observed = method.observe(model, state)
        loads = model.external_load(state.x, state.R, state.time)
        momenta = jnp.concatenate([observed.linear, observed.angular])
        return Look(state.x, momenta, loads, model.dead_load(state.time + 0.5 * dt), own(model, state))

    def step(carry, _):
        state, info, memory = method.step(model, carry[0], dt, solvers, carry[1])
        return (state, memory), (look(state), method.unbalanced(model, carry[0], state, dt), info.result)

    memory = solvers.linear.memory(NEWTON, turning(model, first.R)) if method.uses_matrix else None
    _, (looks, left, result) = jax.lax.scan(step, (first, memory), None, length=STEPS)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), look(first), looks), left, result


def looked_at(scene, method, dt, own) -> tuple[Look, np.ndarray]:
    """The states, and (STEPS, n, 6) what the balances leave."""
    tables, pattern = analyse(structure_of(scene))
    handle = js.Dense().prepare(pattern)
    looks, left, result = jax.tree.map(np.asarray, states_of(scene, method, jnp.asarray(dt), tables, handle, own))
    assert np.all(result == 0)
    return looks, left


# --- Bathe ------------------------------------------------------------------------------------------------


@st.composite
def flights(draw):
    """A free shell under dead loads."""
    held = draw(shells())
    force, moment, gravity, _ = held.loads
    return js.Scene(held.mesh, held.section, (), (force, moment, gravity), held.initial)


def nothing(model, state):
    return ()


@pytest.mark.slow
@settings(PROFILE, max_examples=15)
@given(flights(), TIME_STEPS)
def test_bathe_in_free_flight_gains_the_impulse_of_three_loads(scene, dt):
    """ΔL = Δt (F_n + F_n+½ + F_n+1)/3: the trapezoidal rule to the middle, then v_1 from 3 v_1 - 4 v_½ + v_0 = Δt a_1."""
    found, _ = looked_at(scene, js.Bathe(), dt, nothing)
    L = found.momenta[:, :3]
    for k in range(STEPS):
        forces = (found.loads[k] + found.halfway[k] + found.loads[k + 1]) / 3.0
        error = np.abs(L[k + 1] - L[k] - dt * forces[:, :3].sum(axis=0)).max()
        scale = np.abs(L[k : k + 2]).sum() + dt * sizes(forces, found.x[k])[0]
        assert error <= ROUND_OFF * scale  # internal forces sum to zero, however far Newton went


def rates_of_momenta(model, state):
    """(6,) from the accelerations: ẋ = v, v̇ = a, Ṙ = R ~Ω."""
    spins = state.spins
    turning = Spins(
        jnp.einsum("mpij,mpjk->mpik", spins.R, jax.vmap(jax.vmap(skew))(spins.Omega)),
        spins.Omega_dot,
        jnp.zeros_like(spins.Omega_dot),
    )
    motion, change = (state.x, state.v, spins), (state.v, state.a, turning)
    _, (_, *rates) = jax.jvp(lambda *motion: seven_point.kinetic_and_momenta(model, *motion), motion, change)
    return jnp.concatenate(rates)


@pytest.mark.slow
@pytest.mark.parametrize("method", [js.Bathe(), js.Newmark()], ids=["bathe", "newmark"])
def test_forces_and_moments_are_in_balance_at_the_end_of_each_step(method):
    """Rates of linear and angular momentum are the resultants of loads and reactions there."""

    @settings(PROFILE, max_examples=15)
    @given(shells(), TIME_STEPS)
    def balance(scene, dt):
        found, left = looked_at(scene, method, dt, rates_of_momenta)
        held = np.isin(np.arange(6 * N), scene.held_dofs).reshape(N, 6)
        for k in range(1, STEPS + 1):
            forces = found.loads[k] + np.where(held, left[k - 1], 0.0)
            error = np.abs(found.own[k] - resultant(forces, found.x[k])).reshape(2, 3).max(axis=1)
            scale = sizes(forces, found.x[k])
            assert np.all(error <= CLOSED * scale)

    balance()


# --- central differences ----------------------------------------------------------------------------------


def kicks(model, state):
    """Internal forces, masses and rates of the nodes, and where supports hold them."""
    place = jnp.zeros(6 * N).at[model.tables.held].set(model.held_displacement(state.time))
    return model.internal_force(state.x, state.R, state.time), state.mass, state.rates, place.reshape(N, 6)


@settings(PROFILE, max_examples=25)
@given(shells(), powers(-5.0, -4.0))
def test_central_differences_gain_the_impulses_of_loads_and_reactions(scene, dt):
    """ΔL and ΔJ are half a step's forces at both its ends; the reactions are what the held nodes' motion asks for,
    and free nodes ask for none."""
    found, mean = looked_at(scene, js.CentralDifference(), dt, kicks)
    internal, (mass, *_), rates, place = found.own
    held = np.isin(np.arange(6 * N), scene.held_dofs).reshape(N, 6)
    for k in range(STEPS):
        impulses = [0.5 * dt * found.loads[j] for j in (k, k + 1)]
        # Velocities in the middle of the step: a held freedom has its support's, a free one those that its kick gives.
        middle = rates[k] + (impulses[0] - 0.5 * dt * internal[k]) / mass
        middle = np.where(held, (place[k + 1] - place[k]) / dt, middle)
        carried = [
            mass * (middle - rates[k]) - impulses[0] + 0.5 * dt * internal[k],
            mass * (rates[k + 1] - middle) - impulses[1] + 0.5 * dt * internal[k + 1],
        ]
        # A support's velocity is a difference of displacements: their own last bits are those of mass × place / Δt.
        carrying = np.abs(carried).max() + np.where(held, mass * np.abs(place[k : k + 2]) / dt, 0.0).max()
        assert np.abs(sum(carried) - dt * mean[k]).max() <= ROUND_OFF * carrying
        scale, gained = 0.0, 0.0
        for j, impulse, reaction in zip((k, k + 1), impulses, carried, strict=True):
            x = found.x[j]
            gained = gained + resultant(impulse + np.where(held, reaction, 0.0), x)
            scale = scale + sizes(impulse, x) + sizes(0.5 * dt * internal[j], x) + sizes(mass * rates[j], x)
        error = np.abs(found.momenta[k + 1] - found.momenta[k] - gained).reshape(2, 3).max(axis=1)
        left = np.abs(np.where(held, 0.0, carried[1])).reshape(N, 2, 3).max(axis=(0, 2))
        assert np.all(error <= ROUND_OFF * scale) and np.all(left <= ROUND_OFF * scale)
        drift = found.x[k + 1] - found.x[k] - dt * middle[:, :3]
        assert np.abs(drift).max() <= ROUND_OFF * np.abs(found.x[k]).max()
