"""Properties of one element at any state of any triangle: gradients, objectivity, self-balance, which edge is first.

Tolerances are rounding bounds of the state at hand (see `bounds`): each number carries some hundred roundings, and
the local frame multiplies one of a coordinate by the largest coordinate over the triangle's smallest altitude.
"""

from typing import NamedTuple

import isotropic
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import EPS, PROFILE, altitude_of, cases, numbers, powers, rigid_motions, triangles, vectors
from scipy.spatial.transform import Rotation

import jaxshell as js
from jaxshell.elements import corotational, director_inertia, energy_momentum
from jaxshell.elements.director_inertia import DirectorMotion
from jaxshell.elements.inertia import PointStart, StepFactors
from jaxshell.methods import seven_point
from jaxshell.numerics import rotations

ROUNDINGS = 100
ZERO = jnp.zeros(18)


def move(x, R, dq):
    """The state after displacements and spins dq (18,)."""
    dq = dq.reshape(3, 2, 3)
    return x + dq[:, 0], jax.vmap(rotations.exp)(dq[:, 1]) @ R


def energy(x, R, element):
    return corotational.strain_energy(corotational.kinematics(x, R, element).deformations, element)


def bounds(x, R, element):
    """What the force and the tangent are sums of, all terms positive: |Λ|ᵀ|K̂|(|e| + e⁰) and |Λ|ᵀ|K̂||Λ| + geometric.

    e⁰ is what a deformation is the difference of: lengths of the triangle, and angles of 1 rad.
    """
    kin = corotational.kinematics(x, R, element)
    Lambda = jnp.abs(corotational.gradient_to_global(corotational.deformation_gradient(kin), kin))
    K = jnp.abs(jax.scipy.linalg.block_diag(element.K_membrane, element.K_bending))
    size = jnp.max(jnp.abs(kin.coordinates)) + jnp.max(jnp.abs(element.coordinates))
    e = jnp.abs(kin.deformations) + jnp.concatenate([jnp.full(3, size), jnp.ones(9)])
    force, G = Lambda.T @ K @ e, jnp.abs(corotational.gradient_to_global(corotational.frame_spin(kin), kin))
    moments = jnp.pad(force.reshape(3, 2, 3)[:, 1], ((0, 0), (3, 0))).reshape(18)
    turned = jnp.sum(force.reshape(6, 3), axis=1, keepdims=True) * jnp.ones((6, 3))
    geometric = turned.reshape(18, 1) * jnp.sum(G, axis=0)
    return force, Lambda.T @ K @ Lambda + geometric + geometric.T + jnp.diag(moments), e, Lambda, K


class Derivatives(NamedTuple):
    energy: jax.Array
    force: jax.Array
    gradient: jax.Array
    tangent: jax.Array
    jacobian: jax.Array
    force_bound: jax.Array
    tangent_bound: jax.Array


@jax.jit
def derivatives(x, R, element):
    def force(dq):
        return corotational.internal_force(*move(x, R, dq), element)

    force_bound, tangent_bound, *_ = bounds(x, R, element)
    return Derivatives(
        energy(x, R, element),
        force(ZERO),
        jax.grad(lambda dq: energy(*move(x, R, dq), element))(ZERO),
        corotational.tangent_stiffness(x, R, element),
        jax.jacfwd(force)(ZERO),
        force_bound,
        tangent_bound,
    )


def forces_and_moments(vector):
    """Largest entry of each, (2,)."""
    return np.abs(np.asarray(vector)).reshape(3, 2, 3).max(axis=(0, 2))


def blocks(matrix):
    """Largest entry of forces and moments by displacements and rotations, (2, 2)."""
    return np.abs(np.asarray(matrix)).reshape(3, 2, 3, 3, 2, 3).max(axis=(0, 2, 3, 5))


def assert_round_off(error, bound, condition, largest=forces_and_moments):
    assert np.all(largest(error) <= ROUNDINGS * EPS * condition * largest(bound))


# --- gradients --------------------------------------------------------------------------------------------


@PROFILE
@given(cases())
def test_force_is_the_gradient_and_tangent_the_derivative(case):
    found = derivatives(case.x, case.R, case.element)
    assert_round_off(found.force - found.gradient, found.force_bound, case.condition)
    assert_round_off(found.tangent - found.jacobian, found.tangent_bound, case.condition, blocks)


@PROFILE
@given(cases())
def test_tangent_is_symmetric_but_for_half_the_moments(case):
    """K - Kᵀ = -diag(~m_a): all that the spins, which are no coordinates of SO(3), leave of a second derivative.

    In any element with an energy S, whatever its formulas: ∂_j ∂_i S along spins differs from ∂_i ∂_j S by the
    commutator [e_i, e_j] = e_i × e_j. Without nodal moments, as in equilibrium under forces, nothing is left.
    """
    found = derivatives(case.x, case.R, case.element)
    expected = np.zeros((18, 18))
    for node, moment in enumerate(np.asarray(found.force).reshape(3, 2, 3)[:, 1]):
        at = slice(6 * node + 3, 6 * node + 6)
        expected[at, at] = -np.cross(np.eye(3), moment)
    K = np.asarray(found.tangent)
    assert_round_off(K - K.T - expected, found.tangent_bound, case.condition, blocks)


@jax.jit
def along(x, R, direction, step, element):
    """Central differences of energy and force along `direction` (18,), what they should be, and their scales."""

    def at(t):
        state = move(x, R, t * direction)
        return energy(*state, element), corotational.internal_force(*state, element)

    (S1, f1), (S0, f0) = at(step), at(-step)
    force = corotational.internal_force(x, R, element)
    _, _, e, Lambda, K = bounds(x, R, element)
    change = Lambda @ jnp.abs(direction)
    e = jnp.abs(corotational.kinematics(x, R, element).deformations) + change
    exact = force @ direction, corotational.tangent_stiffness(x, R, element) @ direction
    return ((S1 - S0) / (2 * step), (f1 - f0) / (2 * step)), exact, (change @ K @ e, Lambda.T @ K @ e)


@PROFILE
@given(cases(), vectors(6))
def test_finite_differences(case, direction):
    """Along any direction of 1 rad and one altitude: at a step of 1e-5 the third derivative costs about 1e-10."""
    direction = direction.reshape(3, 2, 3) * np.array([case.altitude, 1.0])[:, None]
    found, exact, scale = along(case.x, case.R, jnp.asarray(direction.reshape(18)), 1e-5, case.element)
    rounding = ROUNDINGS * EPS / 1e-5 * case.condition
    tolerance = 1e-7 + rounding
    assert abs(found[0] - exact[0]) <= tolerance * scale[0]
    error = forces_and_moments(found[1] - exact[1])
    assert np.all(error <= tolerance * forces_and_moments(scale[1]))


# --- rigid motions and balance ----------------------------------------------------------------------------


@PROFILE
@given(cases(), rigid_motions())
def test_objectivity(case, motion):
    """f(Qx + c, QR) = Q f, K = Q K Qᵀ, the same energy."""
    size = float(np.ptp(np.asarray(case.x), axis=0).max())
    motion = motion._replace(c=size * motion.c)
    x, R = motion.points(case.x), motion.matrices(case.R)
    condition = float(np.abs(x).max()) / case.altitude + case.condition
    still, moved = derivatives(case.x, case.R, case.element), derivatives(x, R, case.element)
    Q = np.kron(np.eye(6), motion.Q)
    assert_round_off(moved.force - Q @ still.force, still.force_bound, condition)
    assert_round_off(moved.tangent - Q @ still.tangent @ Q.T, still.tangent_bound, condition, blocks)
    # An energy's rounding is the force's on the deformation's own rounding.
    work = np.abs(still.force).reshape(3, 2, 3).sum(axis=(0, 2)) @ [float(np.abs(x).max()), condition]
    assert abs(moved.energy - still.energy) <= ROUNDINGS * EPS * (work + condition * float(still.energy))


def resultants(force, x):
    """(2, 3): resultant force, and moment about the first node."""
    force = np.asarray(force).reshape(3, 2, 3)
    moment = np.cross(np.asarray(x - x[0]), force[:, 0]) + force[:, 1]
    return np.stack([force[:, 0].sum(axis=0), moment.sum(axis=0)])


@PROFILE
@given(cases())
def test_internal_forces_have_no_resultant_and_no_moment(case):
    found = derivatives(case.x, case.R, case.element)
    force = np.abs(found.force).reshape(3, 2, 3)
    arm = float(np.ptp(np.asarray(case.x), axis=0).max())
    scale = force[:, 0].sum(), force[:, 0].sum() * arm + force[:, 1].sum()
    error = np.abs(resultants(found.force, case.x)).max(axis=1)
    assert np.all(error <= ROUNDINGS * EPS * case.condition * np.array(scale))


# --- the exactly conserving element -----------------------------------------------------------------------


class Step(NamedTuple):
    """A step of one element under EnergyMomentum: forces and what they should do."""

    elastic: jax.Array
    inertial: jax.Array
    gained: jax.Array
    scale: jax.Array
    deformations: jax.Array
    d_metric: jax.Array
    force_bound: jax.Array
    correction_bound: jax.Array
    """The rounding of c Δπ in units of EPS: Δe is what two deformations leave, c that over |Δπ|², which may be small."""


@jax.jit
def conserving_step(x, R, u, motion: DirectorMotion, dissipation, dt, element):
    end = jax.vmap(js.EnergyMomentum().node_motion)(u, x, R)
    start = energy_momentum.StepStart(energy_momentum.edges_of(x), corotational.kinematics(x, R, element))
    state = energy_momentum.evaluate(start, end.x, end.R, u, element, dissipation)
    e0, e1 = start.kin.deformations, state.kin.deformations
    S = corotational.strain_energy
    gained = S(e1, element) - S(e0, element) + 2 * dissipation * S(e1 - e0, element)
    motion = motion._replace(director=R @ element.frame[2])
    inertial = director_inertia.forces(u, motion, element, dt)
    bound, _, e, *_ = bounds(x, R, element)
    bound = bound + bounds(end.x, end.R, element)[0]
    scale = S(e1, element) + S(e0, element)
    elastic = energy_momentum.elastic_forces(state)
    w_metric, w = 1.0 / (2.0 * element.area) ** 2, 1.0 / (2.0 * element.area)
    turned_back = jnp.einsum("kba,kib->kia", state.A, state.turned)
    change = energy_momentum.elastic_forces(state._replace(s=w_metric * state.d_metric, p=w * turned_back))
    correction = state.per_norm * jnp.sum(jnp.abs(state.f) * e) * jnp.abs(change)
    return Step(elastic, inertial, gained, scale, e1, state.d_metric, bound, correction)


@st.composite
def steps(draw):
    """A case with increments of up to 0.2 altitudes and 0.5 rad, in any size down to nothing, and a director motion."""
    case = draw(cases())
    size = draw(st.one_of(st.just(1.0), powers(-12.0, 0.0)))
    u = size * np.concatenate([0.2 * case.altitude * draw(vectors(3)), 0.5 * draw(vectors(3))], axis=1)
    rates = DirectorMotion(
        jnp.asarray(case.altitude * draw(vectors(3))), jnp.zeros((3, 3)), jnp.asarray(draw(vectors(3)))
    )
    return case, jnp.asarray(u), rates, draw(numbers(0.0, 0.5))


@PROFILE
@given(steps())
def test_energy_momentum_forces_do_the_work_of_the_energy_in_balance(step):
    """Dπᵀs·(Δx, θ) = ΔS + ξ ΔeᵀK̂Δe; no resultant, and no moment about the mid-point, at any step."""
    case, u, rates, dissipation = step
    found = conserving_step(case.x, case.R, u, rates, dissipation, 0.1, case.element)
    force, moved = np.abs(found.elastic).reshape(3, 2, 3), np.abs(u).reshape(3, 2, 3)
    # A rounding of a force acts over the step, one of a deformation in the energies.
    rounding = (forces_and_moments(found.force_bound) * moved.max(axis=(0, 2))).sum()
    rounding += force.sum(axis=(0, 2)) @ [case.altitude, 1.0] + float(found.scale)
    error = abs(float(found.elastic @ u.reshape(18)) - float(found.gained))
    assert error <= ROUNDINGS * EPS * case.condition * rounding
    arm = float(np.ptp(np.asarray(case.x), axis=0).max())
    scale = np.array([force[:, 0].sum(), force[:, 0].sum() * arm + force[:, 1].sum()])
    error = np.abs(resultants(found.elastic, case.x + 0.5 * u[:, :3])).max(axis=1)
    assert np.all(error <= ROUNDINGS * EPS * case.condition * scale)


@PROFILE
@given(steps(), rigid_motions())
def test_energy_momentum_is_objective(step, motion):
    """The step of the turned element is the turned step: same deformations and invariants, forces turned."""
    case, u, rates, dissipation = step
    size = float(np.ptp(np.asarray(case.x), axis=0).max())
    motion = motion._replace(c=size * motion.c)
    still = conserving_step(case.x, case.R, u, rates, dissipation, 0.1, case.element)
    turned_u = motion.turn(np.asarray(u).reshape(3, 2, 3)).reshape(3, 6)
    turned_rates = DirectorMotion(*(motion.turn(v) for v in rates))
    x = motion.points(case.x)
    moved = conserving_step(x, motion.matrices(case.R), turned_u, turned_rates, dissipation, 0.1, case.element)
    condition = float(np.abs(x).max()) / case.altitude + case.condition
    Q = np.kron(np.eye(6), motion.Q)
    bound = still.force_bound + still.correction_bound
    assert_round_off(moved.elastic - Q @ still.elastic, bound, condition)
    assert np.all(
        forces_and_moments(moved.inertial - Q @ still.inertial)
        <= ROUNDINGS * EPS * condition * forces_and_moments(still.inertial)
    )
    error = np.abs(moved.deformations - still.deformations)
    assert np.all(error <= ROUNDINGS * EPS * condition * np.array([size] * 3 + [1.0] * 9))
    assert np.abs(moved.d_metric - still.d_metric).max() <= ROUNDINGS * EPS * condition * size**2


@jax.jit
def seven_point_forces(increment, theta, v, a, points, element, factors):
    return seven_point.inertial_forces(increment, theta, v, a, points, element, factors)


@PROFILE
@given(cases(), vectors(12), vectors(21), numbers(0.0, 1.0))
def test_seven_point_inertia_is_objective(case, nodal, at_points, rho):
    """f_iner of eqs. (40), (88) turns with the step, for every spectral radius ρ∞."""
    factors = StepFactors(*js.GeneralizedEnergyMomentum(rho).factors(0.1))
    increment, theta, v, a = (jnp.asarray(k) for k in nodal.reshape(4, 3, 3))
    director, rate, acceleration = (jnp.asarray(k) for k in at_points.reshape(3, 7, 3))
    director = jnp.broadcast_to(case.element.frame[2], (7, 3)) + 0.0 * director
    points = PointStart(director, rate, acceleration)
    motion = Rotation.from_rotvec([1.0, -2.0, 0.5])
    Q = jnp.asarray(motion.as_matrix())
    still = seven_point_forces(increment, theta, v, a, points, case.element, factors)
    turned = jax.tree.map(lambda k: k @ Q.T, (increment, theta, v, a, points))
    moved = seven_point_forces(*turned, case.element, factors)
    expected = still.reshape(6, 3) @ Q.T
    # Newmark's formulas take differences of Δx/(βΔt²), v/(βΔt), a: entries of up to 4/Δt² = 400.
    mass = float(case.element.area * case.element.mass_per_area)
    rotary = float(case.element.area * case.element.rotary_inertia)
    error = forces_and_moments(moved - expected.reshape(18))
    assert np.all(error <= ROUNDINGS * EPS / (float(factors.beta) * 0.1**2) * np.array([mass, rotary]))


# --- which edge is 1-2 ------------------------------------------------------------------------------------


@jax.jit
def stiffness_at_rest(x0, values, Q):
    """(3, 18, 18): the tangent of the turned, stress-free element in one order of nodes, each edge being 1-2."""

    def one(shift):
        turned = jnp.roll(x0, -shift, axis=0)
        R = jnp.broadcast_to(Q, (3, 3, 3))
        K = corotational.tangent_stiffness(turned @ Q.T, R, isotropic.element(turned, *values))
        return jnp.roll(K.reshape(3, 6, 3, 6), (shift, shift), (0, 2)).reshape(18, 18)

    return jnp.stack([one(shift) for shift in range(3)])


@PROFILE
@given(triangles(), powers(-2.0, -0.5), numbers(-0.5, 0.5), rigid_motions())
def test_linear_stiffness_knows_no_first_edge(x0, slenderness, nu, motion):
    x0 = x0 - x0.mean(axis=0)
    longest = np.ptp(x0, axis=0).max()
    values = tuple(jnp.asarray(v) for v in (slenderness * longest, 1.0, nu, 1.0))
    K = np.asarray(stiffness_at_rest(jnp.asarray(x0), values, jnp.asarray(motion.Q)))
    # The plane elements divide by the area, and so by the aspect ratio, up to twice more than the frame does.
    condition = (longest / altitude_of(x0) + 1.0) ** 3
    for other in K[1:]:
        assert np.all(blocks(other - K[0]) <= ROUNDINGS * EPS * condition * blocks(K[0]))


def test_energies_of_the_three_numberings_part_with_the_third_power_of_the_strain():
    """The frame follows edge 1-2, which turns against the others' frames by an angle φ of the order of the strain.

    A turn of the frame is a rigid one to first order, at which K̂ gives nothing: e changes by O(φ strain), and the
    energy, O(strain²), by O(strain³). Root mean squares over 64 random states of one triangle; the slopes are those
    between strains of about 1e-2 and 1e-3, at which the next power adds about a per cent.
    """
    rng = np.random.default_rng(1)
    x0 = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, 0.0], [0.4, 0.7, 0.3]])
    displacements, turns = rng.normal(size=(2, 64, 3, 3))
    values = tuple(jnp.asarray(v) for v in (0.1, 1.0, 0.3, 1.0))

    @jax.jit
    def energies(size):
        def three(d, turn):
            nodal = jnp.asarray(x0), x0 + size * d, jax.vmap(rotations.exp)(size * turn)
            orders = [[jnp.roll(a, -shift, axis=0) for a in nodal] for shift in range(3)]
            return jnp.stack([energy(x, R, isotropic.element(at_rest, *values)) for at_rest, x, R in orders])

        return jax.vmap(three, out_axes=1)(displacements, turns)

    found = [np.asarray(energies(size)) for size in (1e-2, 1e-3)]
    total = [np.sqrt(np.mean(S**2)) for S in found]
    spread = [np.sqrt(np.mean((S[1:] - S[0]) ** 2)) for S in found]
    assert np.log10(total[0] / total[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log10(spread[0] / spread[1]) == pytest.approx(3.0, abs=0.1)
    assert spread[0] < 0.1 * total[0]
