"""The dynamic benchmarks: what each scene states, and runs that end with the momentum that the loads gave."""

import numpy as np
import pytest

import jaxshell as js
from jaxshell import scenes

FLYING = [scenes.flying_cylinder((2, 16)), scenes.l_shaped_plate(2), scenes.spinning_plate(3)]


def impulse(scene):
    """∫ of the loads' resultant force over time."""
    total = np.zeros(3)
    for load in scene.loads:
        force = np.asarray(load.nodal(scene.mesh.nodes, scene.mesh.triangles, None))[:, :3].sum(axis=0)
        total += force * np.trapezoid(np.asarray(load.history.values), np.asarray(load.history.times))
    return total


def test_geometry():
    panel = scenes.snapping_panel((4, 8))
    nodes = np.asarray(panel.mesh.nodes)
    assert np.hypot(nodes[:, 1], nodes[:, 2]) == pytest.approx(5.0)
    assert np.ptp(nodes, axis=0) == pytest.approx([5.0, 5.0, 5 * (1 - np.sqrt(0.75))])
    assert nodes[panel.watch[0][1]] == pytest.approx([2.5, 0, 5])
    assert len(panel.held_dofs) == 3 * 2 * 5
    load = np.asarray(panel.loads[0].nodal(panel.mesh.nodes, panel.mesh.triangles, None))
    assert load.sum(axis=0) == pytest.approx([0, 0, -5e7 * 5.0, 0, 0, 0])
    assert nodes[np.flatnonzero(load[:, 2])] == pytest.approx(np.array([[x, 0, 5] for x in np.linspace(0, 5, 5)]))
    fold = scenes.l_shaped_plate(2)
    assert np.ptp(np.asarray(fold.mesh.nodes), axis=0) == pytest.approx([0.6, 0.2, 0.6])
    assert [nodes.tolist() for nodes in np.asarray(fold.mesh.nodes)[[w[1] for w in fold.watch]]] == [
        pytest.approx([0, 0, 0.6]), pytest.approx([0.6, 0, 0])
    ]  # fmt: skip
    with pytest.raises(ValueError, match="even"):
        scenes.snapping_panel((3, 8))
    with pytest.raises(ValueError, match="multiple of 4"):
        scenes.flying_cylinder((2, 10))


@pytest.mark.slow
def test_spinning_plate_keeps_its_spin():
    scene = FLYING[2]
    dt, newton = scene.defaults.dt, js.Newton(tolerance=1e-12)
    run = js.simulate(scene, js.EnergyMomentum(), dt=dt, t_end=20 * dt, newton=newton)
    angular, total = np.asarray(run.momentum.angular), np.asarray(run.energy.total)
    # A thin square plate of mass m = 3.375 kg and side a = 0.5 m, director inertia included: m a²/12 about
    # its tangents, m a²/6 about its normal (the rotary inertia m h²/12 about the tangents only).
    mass, side, h = 2700 * 0.005 * 0.25, 0.5, 0.005
    expected = np.array([0.0, 20.0 * mass * (side**2 + h**2) / 12, 60.0 * mass * side**2 / 6])
    assert angular[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert angular == pytest.approx(np.broadcast_to(expected, angular.shape), rel=1e-9, abs=1e-8)
    assert total == pytest.approx(np.full(total.shape, 0.5 * expected @ [0, 20, 60]), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("scene", FLYING[:2], ids=lambda scene: scene.name)
def test_shells_in_free_flight_keep_what_their_loads_gave(scene):
    end = max(float(load.history.times[-1]) for load in scene.loads)
    dt = scene.defaults.dt
    run = js.simulate(scene, js.EnergyMomentum(), dt=dt, t_end=3 * end, newton=js.Newton(tolerance=1e-12))
    assert np.asarray(run.momentum.linear[-1]) == pytest.approx(impulse(scene), rel=1e-6, abs=1e-9)
    after = np.asarray(run.times) > end * (1 + 1e-9)
    for values in (run.momentum.angular, run.energy.total):
        values = np.asarray(values)[after]
        assert np.abs(values - values[0]).max() <= 1e-8 * np.abs(values).max()
    assert float(run.energy.total[-1]) == pytest.approx(float(run.energy.external_work[-1]), rel=1e-8)


@pytest.mark.slow
def test_panel_snaps_through():
    """With the load at its full value the centre ends beyond the mirror image of the panel's crown."""
    scene = scenes.snapping_panel((8, 16))
    run = js.simulate(scene, js.EnergyMomentum(dissipation=0.02), dt=1e-3, t_end=0.3, save_every=10)
    rise = 5 * (1 - np.sqrt(0.75))
    assert float(run.watched["centre"].min()) < -2 * rise
