"""Properties of whole runs under random loads: budgets of momentum and energy, numbering of nodes and triangles.

Every budget counts the supports' reactions, which are what a step's balance leaves at the held degrees of freedom. The budgets
are each method's own sums over its steps, so that they close to the round-off of Newton's solution and not to the order
of the method. Bathe's method and central differences: test_properties_budgets.py.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from marching import (
    CLOSED,
    EVERY,
    FLAT,
    STEPS,
    TIME_STEPS,
    March,
    N,
    march,
    reactions,
    resultant,
    shells,
    sizes,
    steps_of,
)
from properties import EPS, PROFILE, numbers
from scipy.spatial.transform import Rotation

import jaxshell as js
from jaxshell import scenes
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse

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
    "hht": numbers(-1.0 / 3.0, 0.0).map(lambda alpha: js.HHT(jnp.asarray(alpha))),
}
OTHERS = ("generalized_alpha", "hht", "newmark")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.evidence) if name in OTHERS else name for name in FAMILY],
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
        loads = found.dead + found.pressure[:, None, None] * np.concatenate([found.normals[:1, 0], found.normals[:, 2]])
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
