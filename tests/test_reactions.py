"""Reactions of runs in time, `simulate(..., reactions=True)`: in balance with loads and momentum for every method.

Random scenes under every method, moments included: test_properties_runs.py and test_properties_budgets.py.
"""

import jax
import numpy as np
import pytest

import jaxshell as js
from jaxshell.model import generators

NEWTON = js.Newton(tolerance=1e-13)
BALANCE = 1e-9
METHODS = {
    "EMC": js.GeneralizedEnergyMomentum(),
    "EDMC": js.GeneralizedEnergyMomentum(0.8, 0.05),
    "energy_momentum": js.EnergyMomentum(),
    "newmark": js.Newmark(),
    "hht": js.HHT(-0.1),
    "generalized_alpha": js.GeneralizedAlpha(0.6),
    "central_difference": js.CentralDifference(),
}
RAMP = js.History.ramp(0.02)
PARTS = np.linspace(0.0, 1.0, 21)
SMOOTH = js.History(0.02 * PARTS, PARTS**2 * (3.0 - 2.0 * PARTS))
"""A lift with a jump of velocity would leave the trapezoidal rule with reactions that alternate for ever."""


def shell(pull=1.0, young_modulus=1e6) -> js.Scene:
    """A strip held at one edge, whose other supports lift it there; all at rest and without load at the start."""
    mesh = generators.rectangle(1.0, 0.4, (3, 1))
    supports = (
        js.Support([0, 1], ("ux", "uy", "rx", "ry", "rz")),
        js.Support([0, 1], ("uz",), 0.01, SMOOTH),
    )
    loads = (
        js.NodalForce([7], pull * np.array([0.2, 0.5, 2.0]), RAMP),
        js.NodalMoment([6], [0.05, 0.02, 0.01], RAMP),
        js.Gravity([0.0, 1.0, -5.0], RAMP),
    )
    return js.Scene(mesh, js.Section(0.02, young_modulus, 0.3, 1000.0), supports, loads, watch={"tip": (7, "uz")})


def applied(scene, times):
    """(k, n, 6) nodal forces and moments of all loads."""
    mass = np.asarray(scene.section.density * scene.section.thickness) * np.ones(scene.mesh.n_elements)
    nodal = [np.asarray(load.nodal(scene.mesh.nodes, scene.mesh.triangles, mass)) for load in scene.loads]
    values = [np.asarray(jax.vmap(load.history)(times)) for load in scene.loads]
    return sum(value[:, None, None] * pattern for value, pattern in zip(values, nodal, strict=True))


def run(method, count=50, scene=None, **options):
    dt = 1e-4 if isinstance(method, js.CentralDifference) else 1e-3
    options = {"newton": NEWTON, "linear_solver": js.Dense(), "reactions": True} | options
    return js.simulate(shell() if scene is None else scene, method, dt=dt, t_end=count * dt, **options)


OTHERS = ("EDMC", "hht", "generalized_alpha")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.evidence) if name in OTHERS else name for name in METHODS]
)
def test_loads_and_reactions_give_the_momentum(name):
    """The rate of the linear momentum, by the method's own formulas of acceleration and velocity, to 1e-9."""
    method = METHODS[name]
    solution = run(method)
    carried, loads = np.asarray(js.reactions(solution)), applied(solution.scene, solution.times)
    dt, L = float(solution.times[1]), np.asarray(solution.momentum.linear)
    gamma = alpha_m = alpha_f = 0.5  # of a balance of means
    if name not in ("energy_momentum", "central_difference"):
        _, gamma, alpha_m, alpha_f, _ = (float(number) for number in method.factors(dt))
    held = solution.scene.held_dofs
    assert np.isnan(carried[0].reshape(-1)[held]).all()
    assert not np.delete(carried.reshape(-1, carried[0].size), held, axis=1).any()
    rate, size = np.zeros(3), 0.0
    for k in range(len(L) - 1):
        forces = (1.0 - alpha_f) * loads[k + 1] + alpha_f * loads[k] + carried[k + 1]
        new = (forces[:, :3].sum(axis=0) - alpha_m * rate) / (1.0 - alpha_m)
        expected = L[k] + dt * ((1.0 - gamma) * rate + gamma * new)
        rate, size = new, max(size, np.abs(forces[:, :3]).sum())
        assert np.abs(L[k + 1] - expected).max() <= BALANCE * dt * size
    assert np.abs(L).max() > 1e-3 * dt * len(L) * size


@pytest.mark.slow
def test_a_run_that_comes_to_rest_has_the_reactions_of_statics():
    """Node by node; steps that grow to many periods, which ρ∞ = 0 damps in one. Balance at the end of the step."""
    scene = shell(young_modulus=1e9)
    still = js.solve_static(scene)
    steps = np.geomspace(1e-3, 10.0, 100)
    slow = js.simulate(scene, js.GeneralizedAlpha(0.0), dt=steps, save_every=100, newton=NEWTON, reactions=True)
    expected, found = np.asarray(js.reactions(still))[-1], np.asarray(js.reactions(slow))[-1]
    assert np.asarray(slow.displacements[-1]) == pytest.approx(np.asarray(still.displacements[-1]), abs=1e-8)
    assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_recording_changes_nothing_and_is_kept(tmp_path):
    """The motion is that of a run without; a file and a restart go on with it."""
    method, file = METHODS["energy_momentum"], tmp_path / "run.h5"
    whole = run(method, output=file)
    plain = run(method, reactions=False)
    np.testing.assert_allclose(whole.displacements, plain.displacements, atol=1e-12)
    assert whole.stats["method"] == plain.stats["method"] and plain.reaction is None
    carried = np.asarray(js.reactions(whole))
    assert np.array_equal(js.reactions(js.Solution.load(file)), carried, equal_nan=True)
    whole.save(file)
    assert np.array_equal(js.reactions(js.Solution.load(file)), carried, equal_nan=True)
    rest = run(method, count=25, restart=run(method, count=25))
    np.testing.assert_allclose(js.reactions(rest), carried[25:], atol=1e-8 * np.nanmax(np.abs(carried)))


@pytest.mark.slow
def test_a_run_without_them_says_so():
    plain = run(METHODS["energy_momentum"], reactions=False)
    with pytest.raises(ValueError, match=r"reactions=True.*EnergyMomentum"):
        js.reactions(plain)


@pytest.mark.slow
def test_a_run_without_them_can_go_on_with_them():
    """They are not known at the start, and from the first step on those of a run that recorded them all along."""
    plain = run(METHODS["energy_momentum"], count=25, reactions=False)
    rest, whole = run(METHODS["energy_momentum"], count=25, restart=plain), run(METHODS["energy_momentum"])
    held = rest.scene.held_dofs
    assert np.isnan(np.asarray(js.reactions(rest))[0].reshape(-1)[held]).all()
    expected = np.asarray(js.reactions(whole))[26:]
    np.testing.assert_allclose(js.reactions(rest)[1:], expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.slow
def test_gradient_of_a_reaction():
    """Of the lifted edge's force in z at the end, by the pull at the tip."""

    def carried(pull):
        solution = run(METHODS["EMC"], count=10, scene=shell(pull), save_every=10)
        return js.reactions(solution)[-1, :2, 2].sum()

    step = 1e-4
    difference = float(carried(1.0 + step) - carried(1.0 - step)) / (2.0 * step)
    assert float(jax.grad(carried)(1.0)) == pytest.approx(difference, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["EMC", "energy_momentum", "newmark"])
def test_clamped_cap_in_balance(name):
    """The paper's cap through its first half swing: clamped edge, force at the apex. Moments where the method's
    equations have them in balance; prints what the default tolerance leaves."""
    scene = js.scenes.spherical_cap()
    for tolerance in (None, 1e-13):
        newton = js.Newton() if tolerance is None else js.Newton(tolerance=tolerance)
        solution = js.simulate(
            scene, METHODS[name], dt=scene.defaults.dt, t_end=50 * scene.defaults.dt, newton=newton, reactions=True
        )
        carried, loads = np.asarray(js.reactions(solution))[1:], applied(scene, solution.times)
        forces, x = 0.5 * (loads[1:] + loads[:-1]) + carried, np.asarray(scene.mesh.nodes + solution.displacements)
        if name == "newmark":  # at the ends of the steps, and the first one's start is not known
            forces = 0.5 * (loads[2:] + loads[1:-1]) + 0.5 * (carried[1:] + carried[:-1])
        steps, dt = len(forces), float(solution.times[1])
        given = np.diff(np.asarray(solution.momentum.linear), axis=0)[-steps:] / dt
        size = np.abs(forces[:, :, :3]).sum(axis=(1, 2))
        left = np.abs(forces[:, :, :3].sum(axis=1) - given).max(axis=1) / size
        if name == "energy_momentum":
            middle = 0.5 * (x[1:] + x[:-1])
            moments = (np.cross(middle, forces[:, :, :3]) + forces[:, :, 3:]).sum(axis=1)
            given = np.diff(np.asarray(solution.momentum.angular), axis=0) / dt
            size = size * np.abs(x).max() + np.abs(forces[:, :, 3:]).sum(axis=(1, 2))
            left = np.maximum(left, np.abs(moments - given).max(axis=1) / size)
        print(f"{name}, tolerance {newton.tolerance:g}: out of balance by {left.max():.1e}")
    assert left.max() <= BALANCE
