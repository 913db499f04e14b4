"""A small shell on which every kind of parameter acts, and checks of derivatives that several tests share."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js

STEPS, DT = 6, 4e-6


def parameters() -> dict:
    """Relative changes of every differentiable quantity, all zero; shapes are those of the quantities."""
    return {
        "thickness": jnp.zeros(8),
        "young_modulus": jnp.zeros(()),
        "poisson_ratio": jnp.zeros(()),
        "density": jnp.zeros(8),
        "nodes": jnp.zeros((9, 3)),
        "force": jnp.zeros(()),
        "history": jnp.zeros(3),
        "pressure": jnp.zeros(8),
        "velocities": jnp.zeros((9, 3)),
        "support": jnp.zeros(()),
        "support_history": jnp.zeros(2),
        "dt": jnp.zeros(STEPS),
    }


@functools.cache
def _cap():
    with jax.ensure_compile_time_eval():
        mesh = js.scenes.spherical_cap(2).mesh
        return np.asarray(mesh.nodes), mesh.triangles


def shell(p: dict, load=1.0, motion=1.0) -> js.Scene:
    """A quarter of a cap under a force, a follower pressure, a moving rim, with initial velocities.

    `p` holds some of `parameters()`; the others change nothing. `load` scales all loads; `motion` the motion of the
    rim and the initial velocities. Both may be traced; with zeros the shell is at rest.
    """
    p = {**parameters(), **p}
    nodes, triangles = _cap()
    rim = np.flatnonzero(nodes[:, 2] < nodes[:, 2].min() + 1e-9)
    # No kink at the end of a step or of half a step: there the derivative by the step sizes jumps.
    history = js.History([0.0, 3e-6, 1.1e-5], jnp.array([0.2, 1.0, 0.7]) * (1 + p["history"]))
    moves = js.History([0.0, 2.7e-5], jnp.array([0.0, 1.0]) + p["support_history"] * jnp.array([0.0, 1.0]))
    rng = np.random.default_rng(1)
    velocities = motion * (20 * rng.standard_normal((9, 3)) + 20 * p["velocities"])
    return js.Scene(
        js.Mesh(nodes + 0.01 * p["nodes"], triangles),
        js.Section(
            4e-4 * (1 + p["thickness"]),
            68.94e9 * (1 + p["young_modulus"]),
            0.3 * (1 + p["poisson_ratio"]),
            2618.0 * (1 + p["density"]),
        ),
        (
            js.symmetry(np.flatnonzero(np.abs(nodes[:, 1]) < 1e-12), "y"),
            js.symmetry(np.flatnonzero(np.abs(nodes[:, 0]) < 1e-12), "x"),
            js.Support(rim, ("uz",), displacement=2e-4 * motion * (1 + p["support"]), history=moves),
        ),
        (
            js.NodalForce([0], load * (1 + p["force"]) * jnp.array([0.0, 0.0, -200.0]), history),
            js.Pressure(load * -1e5 * (1 + p["pressure"])),
        ),
        initial=js.Initial(velocities=velocities),
        watch={"apex": (0, "uz"), "speed": (0, "vz"), "inner": (4, "ux")},
    )


def measure(solution: js.Solution) -> jax.Array:
    """One number of order one in which positions, rotations, velocities and energies of a run all matter."""
    rng = np.random.default_rng(2)
    last = -1
    terms = [
        1e3 * jnp.sum(jnp.asarray(rng.standard_normal((9, 3))) * solution.displacements[last]),
        jnp.sum(jnp.asarray(rng.standard_normal((9, 3, 3))) * solution.rotations[last]),
        1e-2 * jnp.sum(jnp.asarray(rng.standard_normal((9, 3))) * solution.velocities[last]),
        1e3 * jnp.sum(solution.watched["apex"] ** 2) / solution.watched["apex"].size,
        jnp.mean(solution.energy.kinetic + 2 * solution.energy.strain + 3 * solution.energy.external_work),
        jnp.sum(solution.momentum.linear[last] * jnp.array([1.0, 2.0, 3.0])),
    ]
    return sum(terms)


def directions(p: dict) -> dict:
    """For every parameter, a random direction in it alone: leaves with a leading axis over the parameters."""
    rng = np.random.default_rng(3)
    return {
        name: jnp.stack(
            [jnp.asarray(rng.standard_normal(np.shape(v)) if other == name else np.zeros(np.shape(v))) for other in p]
        )
        for name, v in p.items()
    }


def products(gradient: dict, directions: dict) -> dict[str, float]:
    """⟨gradient, direction⟩ for each parameter."""
    return {
        name: float(sum(np.sum(gradient[k] * directions[k][i]) for k in gradient)) for i, name in enumerate(directions)
    }


def check_derivatives(value_and_gradient, push: Callable | None, p: dict) -> None:
    """Adjoint against forward mode to 1e-10 and against central differences to 1e-6, each parameter apart.

    value_and_gradient(p) → (value, gradient); push(p, direction) → the directional derivative by forward mode, None
    where differences alone are to be compared.
    """
    along = directions(p)
    _, gradient = value_and_gradient(p)
    back = products(gradient, along)
    for i, name in enumerate(p):
        one = {k: v[i] for k, v in along.items()}
        if push is not None:
            assert back[name] == pytest.approx(float(push(p, one)), rel=1e-10), name
        assert difference_error(lambda p: value_and_gradient(p)[0], p, one, back[name]) < 1e-6, name


def check_slope(measure: Callable, start, change) -> None:
    """Adjoint against forward mode to 1e-10 and against central differences to 1e-6, along one change of an array."""
    _, forward = jax.jvp(measure, (start,), (change,))
    assert float(jnp.sum(jax.grad(measure)(start) * change)) == pytest.approx(float(forward), rel=1e-10)
    h = 1e-5
    difference = (measure(start + h * change) - measure(start - h * change)) / (2 * h)
    assert float(difference) == pytest.approx(float(forward), rel=1e-6)


def difference_error(
    f, p: dict, direction: dict, exact: float, steps=(1e-3, 3e-3, 3e-4, 1e-2, 1e-4), enough=1e-6
) -> float:
    """Relative error of `exact` against fourth-order central differences at the first step size of those given at
    which it is below `enough`, or else the smallest."""

    def at(s):
        return float(f(jax.tree.map(lambda a, d: a + s * d, p, direction)))

    errors = []
    for s in steps:
        slope = (8 * (at(s) - at(-s)) - (at(2 * s) - at(-2 * s))) / (12 * s)
        errors.append(abs(slope - exact) / max(abs(exact), 1e-30))
        if errors[-1] < enough:
            break
    return min(errors)
