"""What a step costs on the way back, part by part: `python benchmarks/way_back.py`.

One core; every part done many times within one compiled program, as in `limits.py`. Reverse mode solves each step's
transposed system with the step's own matrix, and takes the derivatives of its balance and of all else that it computes:
none of it depends on how few factorizations the run needed. Writes the table of docs/gradients.md.
"""

import functools
import itertools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import limits  # (beside this script) takes one core before anything is computed
from gradients import best, deflection
from pages import fill, table

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.solvers.linear_solver import default_solver

PAGE = Path(__file__).parent.parent / "docs" / "gradients.md"
STEPS = 100


def parts(scene, method) -> dict[str, float]:
    """Seconds of each part, on the scene's first step."""
    tables, pattern = analyse(structure_of(scene))
    solver, dt = default_solver(), scene.defaults.dt
    handle, model = solver.prepare(pattern), Model.build(scene, tables)
    state = method.start(model, scene, 0.0)
    u = limits.increments(model)

    def around(model, state, u):
        begun = method.begin(model, state, dt)
        state = method.finish(model, state, dt, u, method.motion(state, u), begun)
        return state, method.observe(model, state)

    def balance(model, state, u):
        begun = method.begin(model, state, dt)
        return model.free(method.balance(model, state, begun, u).residual)

    def tangent(model, state, u):
        return method.tangent(model, state, method.begin(model, state, dt), u, None, "closed_form")

    def back(function):
        """Its transposed derivative, by what it finds: by thickness, coordinates and loads, state and increments."""

        def transposed(*given):
            found, pull = eqx.filter_vjp(function, *given)
            return pull(found)

        return transposed

    values = jax.jit(tangent)(model, state, u)
    found = {
        "begin, end and record": limits.part(around, model, state, u),
        "derivative of the three": limits.part(back(around), model, state, u),
        "derivative of the balance": limits.part(back(balance), model, state, u),
        "tangent, assembled": limits.part(tangent, model, state, u),
        "factorization, substitution": limits.part(solver.factor_and_solve, handle, values, jnp.ones(handle.size)),
    }
    return {label: seconds for label, (_, seconds, _) in found.items()}


def whole(scene, method) -> tuple[float, float]:
    """Seconds a step of a plain run, and of value and gradient by every element's thickness."""
    dt = scene.defaults.dt
    value = deflection(scene, method, dt, STEPS)
    both = jax.jit(jax.value_and_grad(value), compiler_options=js.COMPILER_OPTIONS)
    thickness = jnp.full(scene.mesh.n_elements, scene.section.thickness)

    def plain():
        return js.simulate(scene, method, dt=dt, t_end=STEPS * dt, save_every=STEPS)

    (_, run, _), (_, gradient, _) = best(plain, functools.partial(both, thickness), repeat=5)
    return run / STEPS, gradient / STEPS


def main() -> None:
    scene, rows = js.scenes.opened_cap(), []
    labels: list[str] = []
    for kernels, (name, method) in itertools.product(("xla", "llvm"), limits.METHODS.items()):
        with js.kernels(kernels):
            plain, both = whole(scene, method)
            found = parts(scene, method)
        labels, seconds = list(found), (plain, both, *found.values())
        rows.append([name, kernels, *(f"{1e3 * s:.2f}" for s in seconds), f"{both / plain:.2f}"])
        print(rows[-1], flush=True)
    header = ["method", "kernels", "plain run", "value and gradient", *labels, "ratio"]
    text = (
        f"Opened cap of {scene.mesh.n_elements} elements, {STEPS} steps; ms a step, one core.\n\n{table(header, rows)}"
    )
    print(text)
    fill(PAGE, {"way_back": text})


if __name__ == "__main__":
    main()
