"""Kernels by LLVM: one element's function over all of them, beside `jax.vmap` and beside whole runs of XLA's."""

import ctypes
import dataclasses
import importlib
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from strip import STRIP  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.numerics.kernels import each, machine  # noqa: E402
from jaxshell.numerics.rotations import exp, log  # noqa: E402

EACH = importlib.import_module("jaxshell.numerics.kernels.each")
WIDTH = machine.this_machine().width


def values(*shape, seed=0):
    return np.random.default_rng(seed).uniform(0.5, 1.5, shape)


def by_kernel(function, *arguments, in_axes=0):
    """The results under `jax.jit`; there is to be a kernel in the program."""
    with js.kernels("llvm"):
        program = jax.jit(each(function, in_axes)).lower(*arguments)
        assert "jaxshell_" in program.as_text()
        return program.compile()(*arguments)


def agree(found, expected, rtol=1e-14):
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.shape == other.shape
        np.testing.assert_allclose(one, other, rtol=rtol, atol=rtol)


OPERATIONS = {
    "sums": lambda a, b: a + b - (-a) + 0.0 - (0.0 - b) + (1.0 - a),
    "products": lambda a, b: (
        (1.0 * a) * (b * -1.0) * (0.0 + a) / (b / 4.0) / 3.0 * jnp.array([0.0, 1.0, 2.0]) + 0.0 / a
    ),
    "powers": lambda a, b: (a**0, a**1, a**5, b**-3, jnp.square(a)),
    "functions": lambda a, b: (jnp.sqrt(a), jnp.abs(a - 1.0), jnp.sin(9 * a), jnp.cos(-9 * b), jnp.sqrt(4.0) * a),
    "extremes": lambda a, b: (jnp.maximum(a, b), jnp.minimum(a, 1.0), jnp.maximum(2.0, jnp.float64(3.0)) * a),
    "choices": lambda a, b: (
        jnp.where((a < b) & ~(a <= 0.9) | (b > 1.4), a, 2.0),
        jnp.where((a >= b) == (a == a), 1.0, b),
        jnp.where(a != b, (a > 1.0).astype(float), (a > 1.0).astype(int) + 0.5),
        jnp.where(jnp.array([True, False, True]), a, a),
    ),
    "matrices": lambda a, b: (
        jnp.outer(a, b) @ jnp.diag(a) @ b,
        jnp.einsum("ik,kjl->lij", jnp.outer(a, b), jnp.arange(18.0).reshape(3, 3, 2)),
        jax.vmap(jnp.matmul)(jnp.stack([jnp.outer(a, a), jnp.outer(b, a)]), jnp.stack([a, b])),
        jnp.dot(a, b),
    ),
    "places": lambda a, b: (
        jnp.concatenate([a[::-1], b[1:], jnp.stack([a[0], b[2]])]).reshape(7)[1:6:2],
        jnp.pad(a, (2, 1)) + jnp.pad(b, (0, 1), constant_values=2.0)[jnp.array([3, 0, 1, 2, 2, 3])],
        jnp.array_split(jnp.tile(a, 2), 3)[1] * jnp.expand_dims(b, 1),
        jax.lax.pad(a, 1.0, [(-1, 2, 1)]),
        jnp.broadcast_to(a[:, None], (3, 2)).T.sum(0),
        jnp.where(jnp.arange(3) == 1, a, b),
        jnp.zeros((0, 2)),
    ),
    "rotations": lambda a, b: (exp(a) @ exp(-2 * b), log(exp(a)), jax.jacfwd(lambda v: exp(v)[0])(b)),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_are_those_of_vmap(name):
    function, a, b = OPERATIONS[name], values(2 * WIDTH + 3, 3), values(2 * WIDTH + 3, 3, seed=1)
    agree(by_kernel(function, a, b), jax.vmap(function)(a, b))


@pytest.mark.parametrize("name", OPERATIONS)
def test_derivatives_are_those_of_vmap(name):
    function, a, b = OPERATIONS[name], values(WIDTH + 1, 3), values(WIDTH + 1, 3, seed=1)

    def derivatives(over):
        def total(a, b):
            return sum(jnp.sum(jnp.sin(k + f)) for k, f in enumerate(jax.tree.leaves(over(function)(a, b))))

        def all_of(a, b):
            reverse = jax.grad(total, (0, 1))
            return reverse(a, b), jax.jvp(total, (a, b), (b, a)), jax.jvp(reverse, (a, b), (b, a))[1]

        return jax.jit(all_of)(a, b)

    with js.kernels("llvm"):
        found = derivatives(each)
    agree(found, derivatives(jax.vmap), rtol=1e-12)


@pytest.mark.parametrize("count", [WIDTH, WIDTH + 1, 2 * WIDTH - 1, 3 * WIDTH])
def test_every_element_is_read_and_written_where_it_is(count):
    for size in range(1, 2 * WIDTH + 2):
        a = np.arange(count * size, dtype=float).reshape(count, size)
        np.testing.assert_array_equal(by_kernel(lambda v: 2.0 * v[::-1], a), 2.0 * a[:, ::-1])


def test_what_all_share_is_summed_in_its_derivative():
    a, s, n = values(WIDTH + 3, 4), jnp.asarray(1.7), jnp.asarray(3)

    def total(over):
        return lambda a, s: jnp.sum(
            over(lambda a, s, n, two: two * s * n * jnp.sin(s * a), (0, None, None, None))(a, s, n, 2)
        )

    with js.kernels("llvm"):
        found = jax.jit(jax.value_and_grad(total(each), (0, 1)))(a, s)
    agree(found, jax.value_and_grad(total(jax.vmap), (0, 1))(a, s))


def test_traced_values_may_be_closed_over():
    a = values(WIDTH + 3, 3)

    def total(over):
        return lambda s: jnp.sum(over(lambda v: jnp.sin(s * v))(a * s))

    with js.kernels("llvm"):
        found = jax.jit(jax.value_and_grad(total(each)))(1.3)
    agree(found, jax.value_and_grad(total(jax.vmap))(1.3))


@pytest.mark.parametrize("axes", [(0, None), (1, 0), (None, 2), (2, 1)])
def test_members_of_a_batch_are_more_elements(axes):
    shapes = {0: (5, WIDTH + 2, 3), 1: (WIDTH + 2, 5, 3), 2: (WIDTH + 2, 3, 5), None: (WIDTH + 2, 3)}
    a, b = (values(*shapes[axis], seed=k) for k, axis in enumerate(axes))

    def function(over):
        return jax.vmap(lambda a, b: over(lambda a, b, s: jnp.outer(a, s * b), (0, 0, None))(a, b, a[0, 0]), axes)

    with js.kernels("llvm"):
        found = jax.jit(function(each))(a, b)
    agree(found, function(jax.vmap)(a, b))


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        (jnp.cumsum, [values(WIDTH, 3)]),  # no straight-line form here
        (lambda a, k: a[k], [values(WIDTH, 3), np.arange(WIDTH) % 3]),  # a place for each element
        (lambda a: a > 1.0, [values(WIDTH, 3)]),  # no floats
        (lambda a: a[jnp.array([5, 3, 1]) // jnp.array([3, 2, 1])], [values(WIDTH, 3)]),  # whole numbers
        (lambda a: a[(jnp.arange(3) & 1) + (~jnp.arange(3) & 1)], [values(WIDTH, 3)]),  # bits
        (lambda a: a.astype(jnp.float32).astype(float), [values(WIDTH, 3)]),  # digits cut off
        (lambda a: 2.0 * a, [values(WIDTH - 1, 3)]),  # less than a vector
    ],
)
def test_what_has_no_kernel_stays_with_xla(function, arguments):
    with js.kernels("llvm"):
        program = jax.jit(each(function)).lower(*arguments)
        assert "jaxshell_" not in program.as_text()
        agree(program.compile()(*arguments), jax.vmap(function)(*arguments))
        agree(each(function)(*arguments), jax.vmap(function)(*arguments))  # without a program


def test_what_all_share_is_little():
    a, s = values(WIDTH, 3), values(65)
    with js.kernels("llvm"):
        text = jax.jit(each(lambda a, s: a * jnp.sum(s), (0, None))).lower(a, s).as_text()
    assert "jaxshell_" not in text


def test_a_number_that_is_not_finite_shows():
    a = values(WIDTH + 1, 3)
    a[2, 1] = np.nan
    found = by_kernel(lambda v: exp(v), a)
    assert np.isfinite(found[:2]).all() and not np.isfinite(found[2]).any() and np.isfinite(found[3:]).all()


def test_programs_are_compiled_for_the_kernels_that_are_chosen():
    a = values(WIDTH, 3)
    program = jax.jit(each(lambda v: jnp.sin(v)))
    texts = [program.lower(a).as_text()]
    with js.kernels("llvm"):
        texts.append(program.lower(a).as_text())
        with js.kernels("xla"):
            texts.append(program.lower(a).as_text())
    assert ["jaxshell_" in text for text in texts] == [False, True, False]


def test_another_name_is_refused_and_llvmlite_is_asked_for(monkeypatch):
    with pytest.raises(ValueError, match="kernels must be one of xla, llvm"):
        js.kernels("gcc")
    machine.this_machine.cache_clear()
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    with pytest.raises(ImportError, match="pip install llvmlite"):
        js.kernels("llvm")
    with js.kernels("xla"):
        pass


def test_calls_of_another_version_are_refused(monkeypatch, tmp_path):
    machine._version_of_calls.cache_clear()
    (tmp_path / "xla/ffi/api").mkdir(parents=True)
    (tmp_path / "xla/ffi/api/c_api.h").write_text("#define XLA_FFI_API_MAJOR 1\n#define XLA_FFI_API_MINOR 0\n")
    monkeypatch.setattr(jax.ffi, "include_dir", lambda: str(tmp_path))
    with pytest.raises(RuntimeError, match="version 0, but this jaxlib has version 1"):
        js.kernels("llvm")


def test_machine_code_is_kept_with_compiled_programs(tmp_path, monkeypatch):
    this, written = machine.this_machine(), []
    text = "define i64 @seven() {\n ret i64 7\n}"
    before, write = jax.config.values["jax_compilation_cache_dir"], machine._write
    monkeypatch.setattr(machine, "_write", lambda *of: written.append(of) or write(*of))

    def called():
        engine = machine._loaded(this, "seven", text)
        return ctypes.CFUNCTYPE(ctypes.c_int64)(engine.get_function_address("seven"))()

    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    try:
        assert called() == 7 and len(written) == 1
        assert called() == 7 and len(written) == 1
        path = tmp_path / "seven.o"
        content = path.read_bytes()
        for damaged in (content[:-8], content[:50] + b"\1" + content[51:], b""):
            path.write_bytes(damaged)
            assert called() == 7 and path.read_bytes() == content
        jax.config.update("jax_compilation_cache_dir", str(tmp_path / "none"))
        assert called() == 7 and len(written) == 4
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


# --- whole runs ------------------------------------------------------------------------------------------------


def both(run, monkeypatch):
    """What a run gives by XLA's kernels and by LLVM's, of which there are some, and no function without one."""
    made = []

    def kernel_of(*of):
        made.append(of)
        return machine.kernel_of(*of)  # Unsupported ends the test

    def refused(*_, **__):
        raise AssertionError("a function of elements has no kernel")

    monkeypatch.setattr(EACH, "kernel_of", kernel_of)
    monkeypatch.setattr(EACH, "_by_xla", refused)
    plain = run()
    with js.kernels("llvm"):
        found = run()
    assert made
    return plain, found


def same(plain, found, size, tolerance=1e-11):
    """Displacements, rotations and energies, within a fraction of their size."""
    assert bool(found.result == js.RESULTS.successful) and len(found.times) == len(plain.times)
    np.testing.assert_allclose(found.displacements, plain.displacements, rtol=0, atol=tolerance * size)
    np.testing.assert_allclose(found.rotations, plain.rotations, rtol=0, atol=tolerance)
    largest = np.abs(plain.energy.kinetic + plain.energy.strain).max()
    for name in ("kinetic", "strain", "external_work", "dissipated"):
        one, other = getattr(found.energy, name), getattr(plain.energy, name)
        np.testing.assert_allclose(one, other, rtol=0, atol=tolerance * largest)
    np.testing.assert_array_equal(found.iterations, plain.iterations)


def opened_cap(shape="flat", damped=False):
    scene = js.with_shape(js.scenes.opened_cap((6, 3)), shape)
    return dataclasses.replace(scene, damping=js.RayleighDamping(0.1, 1e-4)) if damped else scene


RUNS = {
    "EMC": (js.GeneralizedEnergyMomentum(), {}),
    "exact": (js.EnergyMomentum(), {}),
    "EDMC, damped, curved": (
        js.GeneralizedEnergyMomentum(spectral_radius=0.8, dissipation=0.1),
        {"shape": "curved", "damped": True},
    ),
    "exact, dissipating, damped, cubic, relaxed": (
        js.EnergyMomentum(0.05, inertia="cubic"),
        {"shape": "relaxed", "damped": True},
    ),
    "EMC, traditional inertia": (js.GeneralizedEnergyMomentum(inertia="traditional"), {}),
    "generalized α": (js.GeneralizedAlpha(), {}),
    "Bathe": (js.Bathe(), {}),
}
QUICK = ("exact",)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow) for n in RUNS])
def test_runs_are_those_of_xla(name, monkeypatch):
    method, kind = RUNS[name]
    scene = opened_cap(**kind)
    same(*both(lambda: js.simulate(scene, method, dt=0.02, t_end=0.3), monkeypatch), size=10.0)


@pytest.mark.parametrize("damped", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_explicit_runs_are_those_of_xla(damped, monkeypatch):
    scene, method = opened_cap(damped=damped), js.CentralDifference()
    same(*both(lambda: js.simulate(scene, method, dt=5e-4, t_end=0.3, save_every=200), monkeypatch), size=10.0)


@pytest.mark.slow
def test_equilibria_are_those_of_xla(monkeypatch):
    roof = js.scenes.hinged_roof((4, 4))
    same(*both(lambda: js.solve_static(roof, [0.1, 0.2, 0.3]), monkeypatch), size=254.0)


@pytest.mark.slow
def test_tangents_by_differentiation_too(monkeypatch):
    run = both(
        lambda: js.simulate(opened_cap(), js.EnergyMomentum(), dt=0.02, t_end=0.1, tangent="autodiff"), monkeypatch
    )
    same(*run, size=10.0)


@pytest.mark.slow
def test_energy_is_conserved_as_by_xla():
    """A free plate that flies and bends: energy less the work of its loads."""
    scene = js.scenes.free_plate((12, 2))
    with js.kernels("llvm"):
        run = js.simulate(scene, js.EnergyMomentum(), dt=1e-3, t_end=0.2, newton=js.Newton(1e-12), save_every=200)
    assert run.stats["kernels"] == "llvm"
    loaded = np.asarray(run.energy.kinetic + run.energy.strain - run.energy.external_work)
    assert np.abs(loaded - loaded[0]).max() < 1e-10 * np.asarray(run.energy.kinetic).max()


@pytest.mark.parametrize(
    ("method", "dt", "steps"),
    [
        (js.CentralDifference(), 5e-4, 200),
        pytest.param(js.GeneralizedEnergyMomentum(), 0.02, 5, marks=pytest.mark.slow),
        pytest.param(js.EnergyMomentum(), 0.02, 5, marks=pytest.mark.slow),
    ],
)
def test_gradients_are_those_of_forward_mode_and_differences(method, dt, steps):
    scene = js.scenes.opened_cap((4, 2))
    along = values(scene.mesh.n_elements)

    def tip(thickness, dt):
        varied = eqx.tree_at(lambda s: s.section.thickness, scene, thickness)
        run = js.simulate(varied, method, dt=dt * jnp.ones(steps), newton=js.Newton(1e-13), throw=False)
        return run.watched["A"][-1]

    at = 0.4 * np.ones(scene.mesh.n_elements), dt
    with js.kernels("llvm"):
        program = jax.jit(tip)
        by_thickness, by_dt = jax.jit(jax.grad(tip, (0, 1)))(*at)
        forward = jax.jit(lambda *v: jax.jvp(tip, v, (along, 0.1 * dt))[1])(*at)
        near = [(at[0] + sign * 1e-4 * along, at[1] * (1 + sign * 1e-5)) for sign in (1, -1)]
        difference = (program(*near[0]) - program(*near[1])) / 2e-4
    reverse = by_thickness @ along + 0.1 * dt * by_dt
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)
    np.testing.assert_allclose(reverse, difference, rtol=1e-6)


def test_the_command_line_and_result_files_say_which(tmp_path):
    scene = tmp_path / "strip.toml"
    scene.write_text(STRIP)
    for arguments in ([scene, "--kernels", "llvm"], [tmp_path / "strip.h5"]):
        assert main(["run", *map(str, arguments), "--t-end", "0.02", "--no-plots", "--output", str(tmp_path)]) == 0
    for name in ("strip", "strip_rerun"):
        assert js.Solution.load(tmp_path / f"{name}.h5").stats["kernels"] == "llvm"
    one, other = (js.Solution.load(tmp_path / f"{name}.h5").displacements for name in ("strip", "strip_rerun"))
    np.testing.assert_array_equal(one, other)


def test_a_sweep_is_computed_by_the_kernels_that_are_chosen(monkeypatch):
    made = []
    monkeypatch.setattr(EACH, "kernel_of", lambda *of: made.append(of) or machine.kernel_of(*of))
    scene = js.scenes.opened_cap((6, 3))
    where = lambda s: s.section.thickness  # noqa: E731

    def tips():
        vary = {"thickness": (where, [0.3, 0.4, 0.5])}
        return js.sweep(scene, vary, method=js.CentralDifference(), dt=2e-4, t_end=0.02).watched["A"]

    plain = tips()
    assert not made
    with js.kernels("llvm"):
        found = tips()
    assert made
    np.testing.assert_allclose(found, plain, rtol=0, atol=1e-11)
