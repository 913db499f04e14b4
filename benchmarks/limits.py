"""What an iteration is made of, and how far its parts are from the limit: `python benchmarks/limits.py`.

One core. Every part is a program of its own, compiled as jaxshell's are: the residual and the tangent of all elements,
their assembly ("scatter"), factorization and substitution. The limit is what one core gives in a product of
large matrices (dgemm). Flops of the elements are XLA's count, those of the factorization 2 Σ_k |L_k| |U_k| of SciPy's
SuperLU with a minimum degree ordering, since Pardiso's own count cannot be read through its JAX interface. Writes
the table of docs/performance.md.
"""

import os

os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false"

import time  # noqa: E402
from pathlib import Path  # noqa: E402

import equinox as eqx  # noqa: E402
import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from pages import fill, table  # noqa: E402  (beside this script)
from scipy.sparse import csc_matrix  # noqa: E402
from scipy.sparse.linalg import splu  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.assembly.discretised import Model  # noqa: E402
from jaxshell.assembly.structure import structure_of  # noqa: E402
from jaxshell.assembly.tables import analyse  # noqa: E402
from jaxshell.numerics.compiled import COMPILER_OPTIONS  # noqa: E402
from jaxshell.numerics.kernels import each  # noqa: E402
from jaxshell.solvers.linear_solver import default_solver  # noqa: E402

PAGE = Path(__file__).parent.parent / "docs" / "performance.md"
SCENES = {"cap": js.scenes.spherical_cap, "plate": js.scenes.free_plate, "opened cap": js.scenes.opened_cap}
REPEATS = 20
METHODS = {"EMC": js.GeneralizedEnergyMomentum(), "exact": js.EnergyMomentum()}


def best(function, *arguments, rounds=60):
    """(result, seconds of the quickest of many calls)."""
    result, seconds = jax.block_until_ready(function(*arguments)), np.inf
    for _ in range(rounds):
        begun = time.perf_counter()
        result = jax.block_until_ready(function(*arguments))
        seconds = min(seconds, time.perf_counter() - begun)
    return result, seconds


def part(function, *arguments):
    """(result, seconds, flops by XLA's count) of one compiled part, done many times within one program as in a run."""
    once = jax.jit(function).lower(*arguments).compile(compiler_options=COMPILER_OPTIONS)
    result = once(*arguments)

    def repeated(result, arguments):
        def again(k, _):
            # Something of the loop in the arguments, too small to change them: else XLA would do it once, before.
            tiny = 1e-300 * k
            return function(*jax.tree.map(lambda a: a + tiny if eqx.is_inexact_array(a) else a, arguments))

        return jax.lax.fori_loop(0, REPEATS, again, result)

    compiled = jax.jit(repeated).lower(result, arguments).compile(compiler_options=COMPILER_OPTIONS)
    _, seconds = best(compiled, result, arguments)
    return result, seconds / REPEATS, (once.cost_analysis() or {}).get("flops", float("nan"))


def dgemm_rate(size=1500) -> float:
    """Flops a second of one core in a product of large matrices."""
    A = np.random.default_rng(0).normal(size=(size, size))
    return 2.0 * size**3 / best(np.matmul, A, A, rounds=10)[1]


def factorization_flops(pattern, values) -> float:
    """2 Σ_k |L_k| |U_k| over the columns of L and the rows of U below and beside the pivots."""
    matrix = csc_matrix((values, (pattern.rows, pattern.indices.array)), shape=(pattern.size, pattern.size))
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    below = np.bincount(lu.L.tocoo().col, minlength=pattern.size) - 1.0
    beside = np.bincount(lu.U.tocoo().row, minlength=pattern.size) - 1.0
    return 2.0 * float(below @ beside)


def increments(model):
    """Some increments of a step (n, 6)."""
    size = np.array([1e-4 * float(model.size)] * 3 + [1e-3] * 3)
    return jnp.asarray(np.random.default_rng(0).normal(size=(model.x0.shape[0], 6)) * size)


def measure(scene, method, rate):
    """Cells of one row."""
    tables, pattern = analyse(structure_of(scene))
    model = Model.build(scene, tables)
    state, dt, m = method.start(model, scene, 0.0), scene.defaults.dt, scene.mesh.n_elements
    begun = method.begin(model, state, dt)
    data, step = begun.data, begun.step
    u = increments(model)
    corners = model.gather(method.motion(state, u)), model.gather(u)

    def elements(function):
        return lambda motion, u, data: each(function, in_axes=(0, 0, 0, None))(motion, u, data, step)

    forces, residual, residual_flops = part(elements(method.element_forces), *corners, data)
    matrices, tangent, tangent_flops = part(elements(method.element_tangent), *corners, data)
    with js.kernels("llvm"):
        _, residual_llvm, _ = part(elements(method.element_forces), *corners, data)
        _, tangent_llvm, _ = part(elements(method.element_tangent), *corners, data)
    _, vector, _ = part(lambda model, f: model.free(model.assemble_vector(f)), model, forces.elastic)
    values, scatter, _ = part(lambda model, K: model.assemble_matrix(K), model, matrices)
    solver = default_solver()
    handle = solver.prepare(pattern)
    rhs = jnp.ones(pattern.size)
    (_, kept), factor, _ = part(solver.factor_and_solve, handle, values, rhs)
    _, solve, _ = part(solver.solve, handle, kept, values, rhs)
    flops = factorization_flops(pattern, np.asarray(values))
    own, again = residual + vector + tangent + scatter + factor, residual + vector + solve
    return [
        *(f"{1e6 * seconds / m:.2f}" for seconds in (residual, residual_llvm, tangent, tangent_llvm)),
        f"{1e3 * factor:.2f}",
        f"{1e3 * solve:.2f}",
        f"{100 * (vector + scatter) / own:.0f} %, {100 * vector / again:.0f} %",
        *(f"{100 * count / seconds / rate:.0f} %"
          for count, seconds in ((residual_flops, residual), (residual_flops, residual_llvm),
                                 (tangent_flops, tangent), (tangent_flops, tangent_llvm), (flops, factor))),
    ]  # fmt: skip


def main() -> None:
    rate = dgemm_rate()
    header = [
        "scene, method", "residual, µs/element", "by LLVM", "tangent, µs/element", "by LLVM", "factor and solve, ms",
        "substitution, ms",
        "assembly in an iteration with its own factorization, with a kept one",
        "residual of dgemm", "by LLVM", "tangent of dgemm", "by LLVM", "factorization of dgemm",
    ]  # fmt: skip
    rows = []
    for scene in SCENES:
        for name, method in METHODS.items():
            rows.append([f"{scene}, {name}", *measure(SCENES[scene](), method, rate)])
            print(rows[-1], flush=True)
    text = f"One core; its dgemm gives {rate / 1e9:.0f} GFlop/s.\n\n{table(header, rows)}"
    print(text)
    fill(PAGE, {"limits": text})


if __name__ == "__main__":
    main()
