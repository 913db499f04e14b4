"""Second derivatives of every analysis against differences of first ones, their symmetry, and Hessian-vector products."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js

NODES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.5, 0.0], [0.0, 0.5, 0.1]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
NEWTON = js.Newton(tolerance=1e-13, reuse=False)
QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
"""Programs that run a few times only: half the time goes into their optimisation."""
AT = np.zeros(4)


def scene(p, loads, moving=False) -> js.Scene:
    """README's two triangles, with a bent corner; p: relative changes of thickness, modulus and length, and another."""
    supports = [js.clamped([0, 3])]
    if moving:
        supports.append(js.Support([2], ("uy",), displacement=0.02 * (1 + p[3]), history=js.History.ramp(1.0)))
    mesh = js.Mesh(NODES * (1 + jnp.array([p[2], 0.0, 0.0])), TRIANGLES)
    return js.Scene(mesh, js.Section(0.02 * (1 + p[0]), 1e6 * (1 + p[1]), 0.3, 1000.0), supports, loads, watch=WATCH)


WATCH = {"tip": (2, "uz")}


def bent(p, moving=False):
    """Tip of the shell under a force, a pressure that follows it, and with a support that moves."""
    loads = (js.EdgeForce([[1, 2]], [0, 0, 0.5]), js.Pressure(0.3 * (1 + p[1])))
    factors = jnp.array([0.5, 1.0]) * (1 + 0.3 * p[3])
    run = js.solve_static(scene(p, loads, moving), factors, newton=NEWTON, throw=False)
    return run.watched["tip"][-1]


def moved(p, method):
    """Tip after a few steps; p[3] is the step's size."""
    loads = (js.EdgeForce([[1, 2]], [0, 0, 5.0], js.History.ramp(1.0)), js.Pressure(0.3))
    dt = (2e-4 if isinstance(method, js.CentralDifference) else 0.05) * (1 + p[3]) * jnp.ones(3)
    return js.simulate(scene(p, loads), method, dt=dt, newton=NEWTON, throw=False).watched["tip"][-1]


def frequency(p):
    return js.natural_frequencies(scene(p, ()), 2).frequencies[1]


def factor(p):
    push = (js.EdgeForce([[1, 2]], jnp.array([-1.0, 0.0, 0.1 * p[3]])), js.Pressure(0.3))
    return js.linear_buckling(scene(p, push), 1).load_factors[0]


def check(function, tolerance=1e-5, step=1e-2):
    """The Hessian is that of differences of gradients, symmetric, and what Hessian-vector products give."""

    def all_of(p, v):
        gradient = jax.grad(function)
        return gradient(p), jax.vmap(lambda e: jax.jvp(gradient, (p,), (e,))[1])(v)

    program = jax.jit(all_of, compiler_options=QUICK)

    def differences(h):
        steps = h * np.eye(AT.size)
        return np.stack([np.asarray(program(AT + s, steps)[0] - program(AT - s, steps)[0]) / (2 * h) for s in steps])

    hessian = np.asarray(program(AT, np.eye(AT.size))[1])
    expected = (4 * differences(0.5 * step) - differences(step)) / 3
    size = np.abs(expected).max()
    assert size > 0
    assert np.abs(hessian - expected).max() < tolerance * size
    assert np.abs(hessian - hessian.T).max() < 1e-9 * size
    direction = np.array([[0.3, -0.7, 0.2, 0.5]] * AT.size)
    assert np.asarray(program(AT, direction)[1][0]) == pytest.approx(hessian @ direction[0], abs=1e-9 * size)


@pytest.mark.slow
def test_statics():
    check(bent, step=5e-4)  # it bends by much: the fourth derivatives are large


@pytest.mark.evidence
def test_statics_with_a_moving_support():
    check(lambda p: bent(p, moving=True), step=5e-4)


@pytest.mark.slow
def test_frequencies():
    check(frequency)


@pytest.mark.slow
def test_buckling():
    check(factor)


METHODS = [
    pytest.param(js.GeneralizedEnergyMomentum(), marks=pytest.mark.slow),
    *(
        pytest.param(m, marks=pytest.mark.evidence)
        for m in (js.EnergyMomentum(), js.Newmark(), js.Bathe(), js.CentralDifference())
    ),
]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_motion(method):
    check(lambda p: moved(p, method))


def test_modes_have_derivatives():
    """Against differences, and NaN where the plate's symmetry makes two frequencies equal."""

    def shape(p):
        return js.natural_frequencies(scene(p, ()), 2).shapes[1, 1:3].ravel()

    p, along = AT, np.array([0.3, -0.5, 0.2, 0.0])
    _, change = jax.jvp(shape, (p,), (along,))
    difference = [(shape(p + h * along) - shape(p - h * along)) / (2 * h) for h in (1e-3, 2e-3)]
    expected = np.asarray((4 * difference[0] - difference[1]) / 3)
    assert np.asarray(change) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_equal_frequencies_have_no_second_derivative():
    """Two shells alike that nothing connects: every frequency is there twice."""
    nodes, triangles = np.concatenate([NODES, NODES + [0.0, 3.0, 0.0]]), np.concatenate([TRIANGLES, TRIANGLES + 4])

    def lowest(p):
        section = js.Section(0.02 * (1 + p), 1e6, 0.3, 1000.0)
        pair = js.Scene(js.Mesh(nodes, triangles), section, (js.clamped([0, 3, 4, 7]),))
        return js.natural_frequencies(pair, 1)

    assert np.isfinite(jax.grad(lambda p: lowest(p).frequencies[0])(0.0))
    assert np.all(np.isnan(jax.jacfwd(lambda p: lowest(p).shapes)(0.0)[0, 1]))
    with pytest.raises(Exception, match="equal to another"):
        jax.block_until_ready(jax.grad(jax.grad(lambda p: lowest(p).frequencies[0]))(0.0))
