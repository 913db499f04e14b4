"""Eigenvalue problems: natural frequencies about a given state, and linear buckling factors.

    K φ = ω² M φ            K = K_Stat at the state, eq. (85): with the geometric stiffness of its stresses
    K φ = -Λ K_σ φ          K at the stress-free shape, K_σ the geometric stiffness of the linear stresses

M is the consistent mass of the paper's kinetic energy, eq. (34), linear in translations and directors:
½∫ ρh |v|² + (ρh³/12)|ṫ|² dA. Turning about the director (drilling) has no inertia, so M is singular; the
solver, SciPy's shift-invert Lanczos (ARPACK), needs no inverse of it.

Both are solved in units in which no number depends on the user's. `jaxshell.solvers.eigenpairs` has the derivatives
of eigenvalues and modes.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse
from jaxtyping import Array, Float
from scipy.linalg import eigh

from jaxshell.analyses import spinning
from jaxshell.analyses.eigen import DENSE, Inverse, indefinite, lanczos, on_host, power_of_two, shift_invert
from jaxshell.analyses.statics import proportional
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.prepared import elimination_of
from jaxshell.assembly.sparsity import SparsityPattern
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import Tables, analyse
from jaxshell.elements import corotational, cubic_inertia
from jaxshell.elements.inertia import mass_matrix
from jaxshell.model.mechanisms import check_supported, connected_parts
from jaxshell.model.scene import Scene
from jaxshell.numerics import rotations
from jaxshell.numerics.checks import check_choice, require_float64
from jaxshell.numerics.compiled import compiled_once
from jaxshell.results.eigenmodes import Eigenmodes, load_eigenmodes, save_eigenmodes
from jaxshell.results.head import BUCKLING, MODES
from jaxshell.results.solution import Solution
from jaxshell.solvers.eigenpairs import Pencil, eigenvalues, eigenvectors, quadratic, symmetric
from jaxshell.solvers.iteration import Linear
from jaxshell.solvers.linear_solver import default_solver, scaled

_RIGID = 1e-3
"""A free shell's motion below this part of the lowest bending frequency scale is a rigid-body motion."""
_ROUND_OFF = 1e-12
"""An energy below this part of its terms is noise."""


class Modes(eqx.Module):
    """Natural frequencies and modes, lowest first."""

    frequencies: Float[Array, " c"]
    """[1/time, Hz where time is in seconds]; negative where ω² is: the state is unstable."""
    shapes: Float[Array, "c n 6"]
    """Nodal displacements and spins, mass-normalised: φᵀ M φ = 1. Their derivatives are NaN where another frequency is
    equal."""
    quarter: Float[Array, "c n 6"] | None = None
    """Of a scene whose axes spin: what is added to the shapes a quarter of a period later, φ cos ωt - (·) sin ωt."""
    growth: Float[Array, " c"] | None = None
    """Of such a scene, [1/time]: amplitudes go with exp(growth · t); zero where the state is stable."""

    def save(self, path, scene: Scene) -> None:
        """Write the modes and the scene that they are of; `jaxshell plot` draws the file.

        A file that holds a finished run is replaced. Raises ValueError where it holds something else; OSError where
        nothing can be written.
        """
        save_eigenmodes(Eigenmodes(MODES, scene, self.frequencies, self.shapes), path)

    @classmethod
    def load(cls, path) -> tuple["Modes", Scene]:
        """The modes of a file that `save` or `jaxshell run` wrote, and their scene.

        Raises FileNotFoundError; ValueError for a file that is not ours, damaged, or that holds something else.
        """
        found = load_eigenmodes(path, MODES)
        return cls(found.values, found.shapes), found.scene


class BucklingModes(eqx.Module):
    """Linear buckling factors and modes, lowest first."""

    load_factors: Float[Array, " c"]
    """Multiples of the scene's loads; infinite where fewer exist than were asked for."""
    shapes: Float[Array, "c n 6"]
    """Nodal displacements and spins, the largest displacement 1. Their derivatives are NaN where another factor is
    equal."""

    def save(self, path, scene: Scene) -> None:
        """As `Modes.save`."""
        save_eigenmodes(Eigenmodes(BUCKLING, scene, self.load_factors, self.shapes), path)

    @classmethod
    def load(cls, path) -> tuple["BucklingModes", Scene]:
        """As `Modes.load`."""
        found = load_eigenmodes(path, BUCKLING)
        return cls(found.values, found.shapes), found.scene


def natural_frequencies(
    scene: Scene,
    count: int = 10,
    about: Solution | None = None,
    *,
    rigid_modes: bool = True,
    inertia: str = "linear",
) -> Modes:
    """Lowest natural frequencies [Hz] and their modes, small vibrations about a given state.

    Arguments:
        scene: the shell; its loads matter only as follower pressure (stiffness of the load), and `Centrifugal`, which
            says that the axes spin: see below. Differentiable in its floats, for frequencies that no other frequency
            equals.
        count: how many. About an unstable state those whose squares are nearest zero: growing motions that are
            faster need a larger count to be found.
        about: a solution, about whose last frame the shell vibrates, with its stresses; static or dynamic. None
            is the state at the start, with the scene's initial displacements and rotations.
        rigid_modes: whether motions as a rigid body, of frequency 0, are reported; six for a free shell.
        inertia: "linear" or "cubic", as of `EnergyMomentum`: the latter is nearer by far on coarse meshes
            (docs/accuracy.md). Axes that spin have "linear" only.

    In axes that spin (a `Centrifugal` load) gyroscopic forces couple motions that are a quarter of a period apart:
    frequencies are those of the complex pairs, seen from these axes, and differentiate once; `Modes.quarter` and
    `Modes.growth` say more of them. Take `about` from `solve_static` of the same scene: the load factor f spins with √f
    times the load's `spin`.

    Raises ValueError for a count out of range, RuntimeError when the iteration does not converge.
    """
    require_float64()
    check_choice("inertia", inertia, ("linear", "cubic"))
    if scene.spins and inertia != "linear":
        raise ValueError('Frequencies in axes that spin (a Centrifugal load) have inertia="linear" only.')
    tables, pattern = analyse(structure_of(scene))
    _check_count(count, pattern.size + 2 * bool(scene.spins))
    state = _initial_state(scene) if about is None else (about.frame(-1).displacements, about.frame(-1).rotations)
    time = jnp.zeros(()) if about is None else about.times[-1]
    if about is not None and about.analysis == "static":
        scene = proportional(scene)
    *values, units, soft, shift = _vibration_matrices(scene, tables, state, time, about is not None, inertia == "cubic")
    K, M = (_posed(pattern, units, v) for v in values)
    if scene.spins:
        return _spinning(scene, tables, pattern, state, time, count, (K, M, units, shift))
    spare = 0 if rigid_modes else 6 * connected_parts(scene.mesh.triangles, scene.mesh.n_nodes)[0]

    def solve(K, M, shift):
        # ω² as a multiple of a power of two near `shift`: ARPACK's tolerances are absolute.
        size, unit = power_of_two(np.abs(K).max()), power_of_two(shift)
        shift = float(shift) / unit
        asked = min(count + spare, pattern.size - 1)
        values, vectors = shift_invert(_sparse(pattern, K / size), _sparse(pattern, M * (unit / size)), -shift, asked)
        kept = slice(None)
        if not rigid_modes:
            kept = np.flatnonzero(np.abs(values) > _RIGID**2 * shift)
        values, vectors = values[kept][:count], vectors[:, kept][:, :count]
        return np.pad(vectors.T, ((0, count - len(values)), (0, 0)), constant_values=np.nan)

    vectors = _normalised(pattern, M, on_host(solve, (count, pattern.size), K, M, shift))
    rigid = _are_rigid(pattern, K, vectors, shift)
    pencil = Pencil(K, M, pattern, soft)
    omega_sq = eigenvalues(pencil, vectors, ~rigid)
    still = rigid | (omega_sq == 0)
    safe = jnp.where(still, 1.0, jnp.abs(omega_sq))
    frequencies = jnp.where(still, 0.0, jnp.sign(omega_sq) * jnp.sqrt(safe)) / (2 * jnp.pi)
    return Modes(frequencies, _nodal(scene, tables, state[1], units * eigenvectors(pencil, vectors)))


def _spinning(scene: Scene, tables: Tables, pattern: SparsityPattern, state, time, count: int, posed) -> Modes:
    """The modes of a scene whose axes spin."""
    K, M, units, shift = posed
    with jax.ensure_compile_time_eval():
        rows, columns = jnp.asarray(pattern.rows), jnp.asarray(pattern.indices.array)
    G = scaled(_gyroscopic(scene, tables, state, time), rows, columns, units)

    def solve(K, G, M, shift):
        # λ as a multiple of √unit, so that all entries are near 1.
        size, unit = power_of_two(np.abs(K).max()), power_of_two(shift)
        K, G, M = (_sparse(pattern, v) for v in (K / size, G * (np.sqrt(unit) / size), M * (unit / size)))
        found = spinning.pairs(K, G, M, count)
        found[:, 2, :2] *= np.sqrt(unit)
        return found

    found = on_host(solve, (count, 3, pattern.size), K, G, M, shift)
    real, imaginary, growth = found[:, 0], found[:, 1], found[:, 2, 0]
    norm = quadratic(pattern, jax.lax.stop_gradient(M), real) + quadratic(pattern, jax.lax.stop_gradient(M), imaginary)
    real, imaginary = (part / jnp.sqrt(norm)[:, None] for part in (real, imaginary))
    stable = growth == 0
    omega = jnp.where(stable, spinning.frequencies(pattern, K, G, M, real, imaginary), found[:, 2, 1])
    first, second = (_nodal(scene, tables, state[1], units * part) for part in (real, imaginary))
    return Modes(omega / (2 * jnp.pi), first, second, growth)


@compiled_once
def _gyroscopic(scene: Scene, tables: Tables, state, time):
    """Values of the gyroscopic matrix over the free degrees of freedom."""
    model = Model.build(scene, tables)
    still = jnp.broadcast_to(jnp.eye(3), (model.x0.shape[0], 3, 3))
    return spinning.gyroscopic(model, scene, model.whole(state[1], still), time)


def linear_buckling(scene: Scene, count: int = 5) -> BucklingModes:
    """Lowest multiples of the scene's loads at which the linear stresses make the stiffness singular.

    The loads, initial strains and prescribed displacements act at their full value, whatever their histories, and
    prescribed rotations as if they were small; supports with a prescribed acceleration hold what they accelerate. K_σ
    holds the geometric stiffness of the linear solution and the stiffness of follower pressure. Good where the shell
    deforms little before it buckles; else follow the path with `solve_arc_length`. Only positive factors are
    sought: turn the loads round for the others. Differentiable like `natural_frequencies`.

    Raises ValueError for a mechanism and for a count out of range.
    """
    require_float64()
    check_supported(scene)
    tables, pattern = analyse(structure_of(scene))
    _check_count(count, pattern.size)
    handle = default_solver().prepare(pattern)
    *values, units, soft = _buckling_matrices(proportional(scene), tables, handle)
    K, K_sigma = (_posed(pattern, units, v) for v in values)

    def solve(K, K_sigma):
        sizes = (power_of_two(np.abs(values).max()) for values in (K, K_sigma))
        K, K_sigma = (_sparse(pattern, v / size) for v, size in zip((K, K_sigma), sizes, strict=True))
        if tables.multipliers:  # K has no definite sign
            return indefinite(K, K_sigma, count)
        if pattern.size <= DENSE:
            _, vectors = eigh(-K_sigma.toarray(), K.toarray())
            return vectors.T[::-1][:count]
        _, vectors = lanczos(-K_sigma, k=count, M=K, Minv=Inverse(K), which="LA")
        return vectors.T[::-1]

    vectors = _normalised(pattern, K, on_host(solve, (count, pattern.size), K, K_sigma))
    positive = quadratic(pattern, jax.lax.stop_gradient(K_sigma), vectors) < 0
    pencil = Pencil(-K_sigma, K, pattern, soft)
    reciprocal = eigenvalues(pencil, vectors, positive)
    factors = jnp.where(positive, 1.0 / jnp.where(positive, reciprocal, 1.0), jnp.inf)
    shapes = _nodal(scene, tables, _initial_state(scene)[1], units * eigenvectors(pencil, vectors))
    return BucklingModes(factors, shapes / jnp.max(jnp.abs(shapes[:, :, :3]), axis=(1, 2), keepdims=True))


def _initial_state(scene: Scene):
    """Displacements and rotations at the start."""
    n = scene.mesh.n_nodes
    still = jnp.zeros((n, 3)), jnp.broadcast_to(jnp.eye(3), (n, 3, 3))
    if scene.initial is None:
        return still
    given = scene.initial.displacements, scene.initial.rotations
    return tuple(default if value is None else value for value, default in zip(given, still, strict=True))


# --- matrices ---------------------------------------------------------------------------------------------


@compiled_once
def _vibration_matrices(scene: Scene, tables: Tables, state, time, loaded: bool, bends_mass: bool):
    """Values of K and M over the free degrees of freedom, their units, the zeros of multipliers, and a scale of ω²
    below the bending frequencies.

    `loaded` says that the loads hold the state in balance: then rigid bodies and joints carry forces.
    """
    model = Model.build(scene, tables, bends_mass)
    n = model.x0.shape[0]
    still = jnp.zeros((n, 3)), jnp.broadcast_to(jnp.eye(3), (n, 3, 3))
    placed = model.x0 + model.whole(state[0], still[0]), model.whole(state[1], still[1])
    x, R = model.gather(placed)
    K = jax.vmap(corotational.tangent_stiffness)(x, R, model.elements_at((1.0, time)))
    following = model.following_stiffness(*placed, time)
    M = jax.vmap(cubic_inertia.mass_matrix if bends_mass else mass_matrix)(R, model.elements)
    forces = None
    if model.elimination is not None and loaded:
        forces = model.internal_force(*placed, time) - model.external_load(*placed, time)
    if model.constraints:
        x = model.multipliers_at(*placed, time) if loaded else placed[0]
        following = following + [(a, a.constraint_stiffness(x, placed[1], time)) for a in model.constraints]
        if forces is not None:
            own = (model.sum_over_nodes(a, a.balanced(a.places(x, placed[1], time))) for a in model.constraints)
            forces = forces - sum(own, jnp.zeros_like(forces))
    K = model.matrix_at(placed[1], K, following, forces)
    lumps = [] if model.lumps is None else [(model.lumps, model.lumps.matrices(placed[1]))]
    return K, model.matrix_at(placed[1], M, lumps), model.units, model.soft, model.frequency_scale


@compiled_once
def _buckling_matrices(scene: Scene, tables: Tables, handle):
    """Values of K and K_σ over the free degrees of freedom, K_σ for load factor 1, their units, and the zeros of
    multipliers."""
    model = Model.build(scene, tables)
    n = model.x0.shape[0]
    at_rest = model.x0, jnp.broadcast_to(jnp.eye(3), (n, 3, 3))
    x, R = model.gather(at_rest)
    matrices = jax.vmap(corotational.tangent_stiffness)(x, R, model.elements)
    held = model.held_displacement(1.0)
    if model.turns:  # as small rotations
        _, held = jax.jvp(lambda t: model.held_increment(jnp.zeros(()), t), (jnp.zeros(()),), (jnp.ones(()),))
    moved = model.spread(jnp.zeros(model.tables.free.shape), held, at_rest[1])
    internal = model.assemble_vector(jnp.einsum("mij,mj->mi", matrices, model.gather(moved).reshape(-1, 18)))
    loads = model.external_load(*at_rest, 1.0)
    elements = model.elements_at((1.0, 1.0))
    if model.rests or model.elastic:
        loads = loads - model.internal_force(*at_rest, 1.0)
    joints = [(a, a.constraint_stiffness(*at_rest, 1.0)) for a in model.constraints]
    K = model.matrix_at(at_rest[1], matrices, [*model.stiffness_of(model.elastic, *at_rest, 1.0), *joints])
    load = model.free(model.collected(loads - internal, at_rest[1]))
    free = Linear(default_solver(), handle).posed(model).solve_once(K, load)
    nodal = model.spread(free, held, at_rest[1])
    u = model.gather(nodal)

    def stress_stiffness(x, R, u, element):
        kin = corotational.kinematics(x, R, element)
        local = jnp.einsum("ij,akj->aki", kin.frame, u.reshape(3, 2, 3)).reshape(18)
        deformations = corotational.deformation_gradient(kin) @ local
        if element.rest is not None:
            deformations = deformations.at[:12].add(-element.rest)
        f = corotational.stresses(deformations, element)
        return corotational.stiffness(kin, f, element, None, material=0.0)

    K_sigma = jax.vmap(stress_stiffness)(x, R, u, elements)
    external = tuple(a for a in model.contributions if a.is_plain)
    others = model.stiffness_of(external, *at_rest, 1.0) + _stressed(model, at_rest, nodal)
    # The followers' forces grow with the loads.
    forces = None
    if model.elimination is not None:
        forces = model.assemble_vector(jnp.einsum("mij,mj->mi", matrices, u.reshape(-1, 18))) - loads
    if model.constraints:
        x = model.x0.at[model.tables.nodes :].add(nodal[model.tables.nodes :, :3])
        for acting, at_first in joints:
            others.append((acting, acting.constraint_stiffness(x, at_rest[1], 1.0) - at_first))
            if forces is not None:
                forces = forces - model.sum_over_nodes(acting, acting.balanced(acting.places(x, at_rest[1], 1.0)))
    return K, model.matrix_at(at_rest[1], K_sigma, others, forces), model.units, model.soft


def _stressed(model: Model, at_rest, nodal: Float[Array, "n 6"]):
    """What the linear solution `nodal` adds to the stiffness of elastic contributions, as of a spring it tightens."""

    def along(acting):
        def stiffness(part):
            turned = jax.vmap(rotations.exp)(part * nodal[:, 3:]) @ at_rest[1]
            return -acting.stiffness(acting.places(at_rest[0] + part * nodal[:, :3], turned, 1.0))

        return jax.jvp(stiffness, (jnp.zeros(()),), (jnp.ones(()),))[1]

    return [(acting, along(acting)) for acting in model.elastic]


# --- vectors ----------------------------------------------------------------------------------------------


def _posed(pattern: SparsityPattern, units, values) -> Float[Array, " m"]:
    """The symmetric part (K_Stat is symmetric where the state is in equilibrium), in the units of the unknowns."""
    with jax.ensure_compile_time_eval():
        rows, columns = jnp.asarray(pattern.rows), jnp.asarray(pattern.indices.array)
    return scaled(symmetric(pattern, values), rows, columns, units)


def _sparse(pattern: SparsityPattern, values: np.ndarray) -> Any:  # SciPy's types say array or matrix
    size = pattern.size
    return sparse.csr_matrix((values, pattern.indices.array, pattern.indptr.array), (size, size)).tocsc()


def _normalised(pattern: SparsityPattern, values, vectors) -> Float[Array, "c nf"]:
    """Vectors with φᵀ B φ = 1 for the matrix B of these values; constants for derivatives."""
    return vectors / jnp.sqrt(quadratic(pattern, jax.lax.stop_gradient(values), vectors))[:, None]


def _are_rigid(pattern: SparsityPattern, K, vectors, shift):
    """Which mass-normalised vectors move the shell without deforming it: no energy but round-off."""
    K, shift = jax.lax.stop_gradient((K, shift))
    energy = jnp.abs(quadratic(pattern, K, vectors))
    terms = quadratic(pattern, jnp.abs(K), jnp.abs(vectors))
    return (energy < _ROUND_OFF * terms) & (energy < _RIGID**2 * shift)


def _nodal(scene: Scene, tables: Tables, R, vectors) -> Float[Array, "c n 6"]:
    held = jnp.zeros((vectors.shape[0], tables.held.shape[0]))
    nodal = jnp.concatenate([vectors, held], axis=1)[:, tables.place].reshape(vectors.shape[0], -1, 6)
    nodal = nodal[:, : scene.mesh.n_nodes]
    elimination = elimination_of(scene, tables)
    if elimination is None:
        return nodal
    return jax.vmap(lambda nodal: elimination.nodal(nodal, R, lambda theta: jnp.eye(3)))(nodal)


def _check_count(count, size: int) -> None:
    if not isinstance(count, int | np.integer) or not 1 <= count < size - 1:
        raise ValueError(f"count must be a whole number from 1 to {size - 2}, but it is {count!r}.")
