"""Sparse linear systems K x = b inside compiled programs: one interface, three direct solvers behind it.

`Pardiso` (oneMKL, x86-64), `KLU` (SuiteSparse, every platform) and `Dense` (LAPACK or the device's own LU).
The matrix is CSR with a fixed, structurally symmetric `SparsityPattern`; its values need not be symmetric.

    handle = solver.prepare(pattern)                              # once, on the host: symbolic analysis
    x, factorization = solver.factor_and_solve(handle, values, b) # LU and substitution, one native call
    x = solver.solve(handle, factorization, values, b)            # substitution only, with the kept LU
    x = linear_solve(solver, handle, values, b)                   # x with jvp and vjp, keeping no LU

Pass `handle` into compiled functions as an argument: XLA may spend seconds on index arrays
that are constants.

**Kept factorizations.** Pardiso and KLU keep the LU in native memory, one slot a handle, and overwrite it in
place. A factorization in JAX is a scalar that names the slot and orders a `solve` after the `factor` it came
from, so it may be the carry of a loop, cross a `lax.cond` and outlive a time step. Two rules follow: a new
`factor` on a handle ends the life of the factorization before it, and a kept factorization cannot be mapped
over matrices by `jax.vmap` (a clear error). `linear_solve` has a slot of its own and disturbs no kept one.
Why in place: pardiso_mkl_jax also offers `factor`, which names an LU by a hash of its matrix. The hash costs
0.31 / 0.56 / 2.5 / 9.5 ms at 384 / 726 / 3168 / 12150 unknowns where factor and solve together cost
0.24 / 0.68 / 4.9 / 37 ms, and it retires the analysis it started from, so that every further call of a
compiled program would analyse again (30 to 120 ms).

**Singular matrices** do not raise in Pardiso (it perturbs the pivot) or Dense: x comes back huge or not
finite, and |K x - b|/|b| is then far above round-off. KLU raises out of the compiled program when it
meets a pivot that is exactly zero. Values that are not finite give an x that is not finite, with all three.
"""

import abc
import concurrent.futures
import functools
import importlib
import importlib.util
import os
import platform
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt64

from jaxshell.assembly.sparsity import SparsityPattern
from jaxshell.numerics.checks import index_array, require_float64


class Handle(eqx.Module):
    """A prepared pattern: index arrays (as int32) and the native solver's names for its analyses."""

    indptr: Int[Array, " n1"]
    indices: Int[Array, " m"]
    rows: Int[Array, " m"]
    native: tuple[UInt64[Array, ""], ...]

    @property
    def size(self) -> int:
        return self.indptr.shape[0] - 1


class LinearSolver(eqx.Module):
    """What every solver offers. Instances hold nothing but static choices."""

    def prepare(self, pattern: SparsityPattern) -> Handle:
        """Order and analyse `pattern`, on the host, also while a program is being traced.

        Done once for each solver and pattern and remembered for the life of the process. Raises RuntimeError
        when float64 is off and ImportError when the solver's package cannot be imported.
        """
        require_float64()
        axes = jax.sharding.get_abstract_mesh().manual_axes
        if not axes:
            return _prepare(self, pattern, 0)
        # Under jax.shard_map devices run at the same time, so each needs native memory of its own.
        handles = [_prepare(self, pattern, device) for device in range(jax.lax.axis_size(axes))]
        here = jax.lax.axis_index(axes)
        names = zip(*(handle.native for handle in handles), strict=True)
        return eqx.tree_at(lambda h: h.native, handles[0], tuple(jnp.stack(name)[here] for name in names))

    @abc.abstractmethod
    def _analyse(self, pattern: SparsityPattern, device: int) -> tuple[Array, ...]:
        """The native names for `Handle.native`, others for every device."""

    @abc.abstractmethod
    def initial_factorization(self, handle: Handle) -> Any:
        """A factorization of the right structure for a loop's first carry. Not to be solved with."""

    @abc.abstractmethod
    def factor_and_solve(
        self, handle: Handle, values: Float[Array, " m"], rhs: Float[Array, " n"], transpose: bool = False
    ) -> tuple[Float[Array, " n"], Any]:
        """Factor the matrix and solve with it (or with its transpose): (x, factorization).

        The factorization is of the matrix itself in either case. `x` may be mapped over values and rhs.
        """

    def factor(self, handle: Handle, values: Float[Array, " m"]) -> Any:
        """Factor alone. Costs a substitution too, of zeros: prefer `factor_and_solve` with a rhs in hand."""
        return self.factor_and_solve(handle, values, jnp.zeros(handle.size, values.dtype))[1]

    @abc.abstractmethod
    def solve(
        self,
        handle: Handle,
        factorization: Any,
        values: Float[Array, " m"],
        rhs: Float[Array, " n"],
        transpose: bool = False,
    ) -> Float[Array, " n"]:
        """Substitution with a kept factorization. May be mapped over rhs.

        values: a matrix near the factored one. Pardiso factors it should the kept LU have been evicted (it
        keeps the eight used last in the process, environment variable PARDISO_MKL_JAX_FACTOR_CACHE).
        """

    @abc.abstractmethod
    def _solve_once(
        self, handle: Handle, values: Float[Array, " m"], rhs: Float[Array, " n"], transpose: bool
    ) -> Float[Array, " n"]:
        """Factor, solve and keep nothing, without touching a kept factorization."""


@functools.cache
def _prepare(solver: LinearSolver, pattern: SparsityPattern, device: int) -> Handle:
    with jax.ensure_compile_time_eval():
        return Handle(
            *(index_array(a) for a in (pattern.indptr.array, pattern.indices.array, pattern.rows)),
            native=solver._analyse(pattern, device),
        )


def _dominant_values(pattern: SparsityPattern) -> np.ndarray:
    """A well-conditioned matrix on `pattern`, for analyses that must see one: pivots stay on the diagonal."""
    return np.where(pattern.rows == pattern.indices.array, 2.0 * pattern.size, 1.0)


class Pardiso(LinearSolver):
    """oneMKL Pardiso through pardiso_mkl_jax, for x86-64. ImportError if that is not installed.

    Real, structurally symmetric; no scaling, matching or iterative refinement. MKL takes a thread for each core
    of the process, up to four, unless MKL_NUM_THREADS is set in the environment before the first `prepare`.
    """

    def __check_init__(self):
        _require_package("pardiso_mkl_jax", "Pardiso", "pip install pardiso-mkl-jax mkl")

    def _analyse(self, pattern, device):
        # Two analyses a device, told apart by their values: for kept factorizations, and for `_solve_once`.
        indptr, indices = (index_array(a.array) for a in (pattern.indptr, pattern.indices))
        values = _dominant_values(pattern)
        analyse = functools.partial(_pardiso().analyze, **_pardiso_options())
        return tuple(analyse(indptr, indices, jax.device_put((2 * device + k) * values))[0].id for k in (1, 2))

    def initial_factorization(self, handle):
        return handle.native[0]

    def factor_and_solve(self, handle, values, rhs, transpose=False):
        _check_values(handle, values)
        call = _mappable(_pardiso_call, "factor_and_solve_stateful", transpose)
        x, witness = call(handle.native[0], handle, values, rhs[None])
        # `witness` (why the analysis was rebuilt; 0 for "it was not") is never negative, which XLA cannot
        # know: so the name depends on the call, and whatever takes the name runs after the call.
        return x[0], jnp.where(witness < 0, jnp.zeros_like(handle.native[0]), handle.native[0])

    def solve(self, handle, factorization, values, rhs, transpose=False):
        _check_values(handle, values)
        return _mappable(_pardiso_call, "solve_stateful", transpose)(factorization, handle, values, rhs[None])[0][0]

    def _solve_once(self, handle, values, rhs, transpose):
        _check_values(handle, values)
        call = _mappable(_pardiso_call, "factor_and_solve_stateful", transpose)
        return call(handle.native[1], handle, values, rhs[None])[0][0]


class KLU(LinearSolver):
    """SuiteSparse KLU through klujax, on CPUs of every kind. ImportError if that is not installed.

    Kept factorizations are refactored in place with pivots on the diagonal; `linear_solve` pivots anew. An
    exactly singular matrix raises out of the compiled program.
    """

    def __check_init__(self):
        _require_package("klujax", "KLU", "pip install klujax")

    def _analyse(self, pattern, device):
        klujax = _klujax()
        rows, columns = (index_array(a) for a in (pattern.rows, pattern.indices.array))
        symbolic = klujax.analyze(rows, columns, pattern.size)
        numeric = klujax.factor(rows, columns, jnp.asarray(_dominant_values(pattern)), symbolic)
        _native_objects.append((symbolic, numeric))
        return jnp.asarray(symbolic.raw, jnp.uint64), jnp.asarray(numeric.as_list()[0], jnp.uint64)

    def initial_factorization(self, handle):
        return handle.native[1]

    # The primitives are bound directly: klujax's functions sort the indices anew in every call, which at
    # 12150 unknowns takes 130 ms of 400. Shapes: values (1, m), rhs (1, n, number of right-hand sides).
    def factor_and_solve(self, handle, values, rhs, transpose=False):
        _check_values(handle, values)
        x, numeric = _mappable(_klu_call, "refactor_and_solve", False)(handle.native, handle, values, rhs[None])
        if transpose:
            x = _mappable(_klu_call, "solve_with_numeric", True)(
                (handle.native[0], numeric), handle, values, rhs[None]
            )[0]
        return x[0], numeric

    def solve(self, handle, factorization, values, rhs, transpose=False):
        _check_values(handle, values)
        names = handle.native[0], factorization
        return _mappable(_klu_call, "solve_with_numeric", transpose)(names, handle, values, rhs[None])[0][0]

    def _solve_once(self, handle, values, rhs, transpose):
        _check_values(handle, values)
        return _mappable(_klu_call, "solve_with_symbol", transpose)(handle.native, handle, values, rhs[None])[0][0]


class Dense(LinearSolver):
    """A dense LU: works on any device and under every transformation, and costs n^3. For small systems.

    Slower than Pardiso already at 24 unknowns on a CPU core (0.06 against 0.02 ms; 343 against 4.9 at 3168).
    """

    def _analyse(self, pattern, device):
        return ()

    def initial_factorization(self, handle):
        n = handle.size
        return jnp.zeros((n, n), jnp.float64), jnp.zeros(n, jnp.int32)

    def factor_and_solve(self, handle, values, rhs, transpose=False):
        factorization = self.factor(handle, values)
        return self.solve(handle, factorization, values, rhs, transpose), factorization

    def factor(self, handle, values):
        _check_values(handle, values)
        matrix = jnp.zeros((handle.size, handle.size), values.dtype)
        return jax.scipy.linalg.lu_factor(matrix.at[handle.rows, handle.indices].set(values))

    def solve(self, handle, factorization, values, rhs, transpose=False):
        return jax.scipy.linalg.lu_solve(factorization, rhs, trans=int(transpose))

    def _solve_once(self, handle, values, rhs, transpose):
        return self.factor_and_solve(handle, values, rhs, transpose)[0]


def default_solver() -> LinearSolver:
    """Pardiso on x86-64 if installed, else KLU if installed, else Dense. Dense where JAX runs on no CPU."""
    if jax.default_backend() != "cpu":
        return Dense()
    candidates = [Pardiso, KLU] if platform.machine().lower() in ("x86_64", "amd64") else [KLU]
    for solver in candidates:
        try:
            return solver()
        except ImportError:
            pass
    return Dense()


def multiply(handle: Handle, values: Float[Array, " m"], x: Float[Array, " n"]) -> Float[Array, " n"]:
    """K x."""
    return jax.ops.segment_sum(
        values * x[handle.indices], handle.rows, num_segments=handle.size, indices_are_sorted=True
    )


def scaled(values: Float[Array, " m"], rows, columns, units: Float[Array, " n"]) -> Float[Array, " m"]:
    """S K S for the diagonal S of `units`: exact where they are powers of two."""
    return units[rows] * values * units[columns]


def linear_solve(
    solver: LinearSolver, handle: Handle, values: Float[Array, " m"], rhs: Float[Array, " n"]
) -> Float[Array, " n"]:
    """K⁻¹ b, differentiable in `values` and `rhs` (jvp and vjp, any order), also under jit and vmap.

    Every derivative factors once more (the transposed system with the same matrix in reverse mode).
    """
    return jax.lax.custom_linear_solve(
        lambda x: multiply(handle, values, x),
        rhs,
        solve=lambda _, b: solver._solve_once(handle, values, b, False),
        transpose_solve=lambda _, b: solver._solve_once(handle, values, b, True),
    )


@functools.cache
def _mappable(native: Callable, operation: str, transpose: bool):
    """A native call (names, handle, values (m,), rhs (k, n)) -> (x (k, n), witness) with a rule for vmap.

    Right-hand sides become one call with more of them, matrices a loop in the compiled program.
    """
    call = jax.custom_batching.custom_vmap(functools.partial(native, operation, transpose))

    @call.def_vmap
    def rule(axis_size, batched, names, handle, values, rhs):
        names_batched, handle_batched, values_batched, rhs_batched = batched
        kept = operation in ("solve_stateful", "solve_with_numeric")
        if any(jax.tree.leaves((names_batched, handle_batched))) or (kept and values_batched):
            raise NotImplementedError(
                "a factorization kept by Pardiso or KLU cannot be mapped over matrices by jax.vmap: there is"
                " one at a time. Use factor_and_solve or linear_solve inside vmap, or the Dense() solver."
            )
        if values_batched:
            rhs = rhs if rhs_batched else jnp.broadcast_to(rhs, (axis_size, *rhs.shape))
            return jax.lax.map(lambda pair: call(names, handle, *pair), (values, rhs)), (True, True)
        x, witness = call(names, handle, values, rhs.reshape(-1, rhs.shape[-1]))
        return (x.reshape(rhs.shape), witness), (rhs_batched, False)

    return call


def _pardiso_call(operation, transpose, name, handle, values, rhs):
    primitive = _pardiso()
    token = primitive.FactorizationToken(name, jnp.zeros((), jnp.int32))
    x, _, rebuild_reason = getattr(primitive, operation)(
        token, handle.indptr, handle.indices, values, rhs, transpose=transpose, **_pardiso_options()
    )
    return x, rebuild_reason


def _klu_call(operation, transpose, names, handle, values, rhs):
    primitive = getattr(_klujax(), ("t" if transpose else "") + operation + "_f64")
    symbolic, numeric = names
    matrix, b = (handle.rows, handle.indices, values[None]), rhs.T[None]
    if operation == "refactor_and_solve":
        x, numerics = primitive.bind(*matrix, b, symbolic, numeric[None])
        return x[0].T, numerics[0]
    if operation == "solve_with_numeric":
        return primitive.bind(symbolic, numeric[None], b)[0].T, numeric
    return primitive.bind(*matrix, b, symbolic)[0].T, numeric


# KLU's analyses and factors, which klujax frees with these objects: kept while any program may name them.
_native_objects: list[Any] = []


@functools.cache
def _pardiso():
    # Set before MKL starts and never changed: Pardiso crashes when analysis and factorization see different
    # counts. Factor and solve, 1 and 2 threads on 2 cores: 0.52, 0.51 ms (661 unknowns), 1.7, 0.95 (1441),
    # 4.5, 2.5 (3120), 53, 28 (15913), 322, 183 (60601). More than four: not measured. A thread that waits for
    # MKL's next call keeps its core from XLA's loops: 100 µs, not MKL's 200 ms, or runs take up to 1.6 times longer.
    os.environ.setdefault("KMP_BLOCKTIME", "100us")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    os.environ.setdefault("MKL_NUM_THREADS", str(min(cores, 4)))
    return importlib.import_module("pardiso_mkl_jax.primitive")


@functools.cache
def _pardiso_options() -> dict[str, Any]:
    option = importlib.import_module("pardiso_mkl_jax").PardisoOption
    off = (option.MAX_ITERATIVE_REFINEMENT_STEPS, option.SCALING, option.WEIGHTED_MATCHING)
    # The two-level factorization: quicker on several threads, and unlike the classical one the same to the
    # last bit in every run.
    options = (*((int(o), 0) for o in off), (int(option.PARALLEL_FACTORIZATION_CONTROL), 1))
    matrix_type = importlib.import_module("pardiso_mkl_jax").MatrixType.REAL_STRUCTURALLY_SYMMETRIC
    return {"matrix_type": matrix_type, "options": options}


@functools.cache
def _klujax():
    # klujax sets two global options when it is imported; both get their old values back. In a thread of its
    # own, since only there the global value shows: here a `with jax.enable_x64(True):` may hide it.
    def load():
        before = {name: jax.config.values[name] for name in ("jax_enable_x64", "jax_platform_name")}
        try:
            return importlib.import_module("klujax")
        finally:
            for name, value in before.items():
                jax.config.update(name, value)

    with concurrent.futures.ThreadPoolExecutor(1) as thread:
        return thread.submit(load).result()


def _require_package(module: str, solver: str, install: str) -> None:
    if importlib.util.find_spec(module) is None:
        raise ImportError(
            f"{solver}() needs the package {module}, which is not installed: run `{install}`, or choose"
            " another solver (default_solver() names one that is installed; Dense() needs no package)"
        )


def _check_values(handle: Handle, values: Array) -> None:
    if values.shape != handle.indices.shape or values.dtype != jnp.float64:
        raise ValueError(
            f"the matrix needs {handle.indices.shape[0]} float64 values, one for each entry of the pattern,"
            f" not {values.dtype} of shape {values.shape}"
        )
