"""Contact in every kind of analysis and method, and its derivatives: the longer runs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.model import generators

pytestmark = pytest.mark.slow

H, RHO = 2e-3, 2700.0
SECTION = js.Section(thickness=H, young_modulus=70e9, poisson_ratio=0.3, density=RHO)
MESH = generators.rectangle(0.2, 0.1, (2, 1))
MASS = 0.2 * 0.1 * H * RHO
FORCES = {f"f{axis}": ("obstacle", f"f{axis}") for axis in "xyz"}
TIGHT = js.Newton(tolerance=1e-14)


def left(solution) -> float:
    """The largest change of energy that work and dissipation do not explain, over the largest energy."""
    energy = solution.energy
    change = energy.total - energy.total[0] - energy.external_work + energy.dissipated
    return float(jnp.max(jnp.abs(change)) / jnp.max(energy.total))


def dropped(*obstacles, velocity=(0.0, 0.0, -2.0), spin=(3.0, 2.0, 0.0), g=1000.0, watch=None):
    start = js.Initial.rigid(MESH, velocity=velocity, angular_velocity=spin)
    return js.Scene(
        MESH, SECTION, loads=[js.Gravity([0, 0, -g])], initial=start, obstacles=list(obstacles), watch=watch
    )


def test_all_kinds_at_once_moving_and_with_friction_keep_the_balance():
    """A plate in a drum that moves, over a floor, a ball and a block."""
    up = {"motion": [0.0, 0.0, 0.01], "history": js.History.ramp(0.01)}
    scene = dropped(
        js.Plane([0, 0, -0.02], [0, 0, 1], friction=0.3),
        js.Sphere([0.0, 0.0, -0.06], 0.05, friction=0.2, **up),
        js.Cylinder([0.1, 0.05, 0.0], [0, 1, 0], 0.1025, inside=True, friction=0.1, **up),
        js.Cylinder([0.1, 0.0, -0.03], [1, 0, 0], 0.02, 0.05),
        js.Box([0.2, 0.1, -0.03], [0.05, 0.05, 0.05]),
    )
    solution = js.simulate(scene, js.EnergyMomentum(), dt=1e-4, t_end=0.03, newton=TIGHT)
    assert all(found.depth.max() > 0 for found in js.penetration(solution))
    assert solution.energy.dissipated[-1] > 0 and solution.energy.external_work[-1] > 0
    assert left(solution) < 1e-10


@pytest.mark.parametrize("method", [js.EnergyMomentum(), js.GeneralizedEnergyMomentum(), js.Newmark()])
def test_a_belt_does_the_work_of_its_friction(method):
    """The weight m g slides back at the mean speed V - ½ μ g t: what the belt gives is μ m g V t."""
    mu, g, speed, time = 0.2, 9.81, 2.0, 0.02
    belt = js.Plane(
        [0, 0, -0.5 * H], [0, 0, 1], friction=mu, motion=[speed, 0, 0], history=js.History([0.0, 1.0], [0.0, 1.0])
    )
    scene = dropped(belt, velocity=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0), g=g)
    solution = js.simulate(scene, method, dt=2e-4, t_end=time, newton=TIGHT)
    given, gained = mu * MASS * g * speed * time, 0.5 * MASS * (mu * g * time) ** 2
    np.testing.assert_allclose(solution.energy.external_work[-1], given, rtol=1e-3)
    np.testing.assert_allclose(solution.energy.dissipated[-1], given - gained, rtol=1e-3)
    assert left(solution) < 1e-6


def test_central_differences_take_the_contact_into_their_critical_step():
    explicit = js.CentralDifference()
    hard = js.Plane([0, 0, -0.003], [0, 0, 1], stiffness=1e16)
    scene = dropped(hard)
    critical, free = explicit.critical_step(scene), explicit.critical_step(dropped())
    assert critical < 0.3 * free
    soft = dropped(js.Plane([0, 0, -0.003], [0, 0, 1]))
    dt = explicit.critical_step(soft)
    assert dt > 0.99 * free
    bounced = js.simulate(soft, explicit, dt=dt, t_end=0.003, save_every=100)
    assert js.penetration(bounced)[0].depth.max() > 0 and bounced.momentum.linear[-1, 2] > 0
    assert left(bounced) < 1e-3


def test_an_impact_does_not_stall_step_control():
    scene = dropped(js.Plane([0, 0, -0.011], [0, 0, 1]))
    control = js.StepControl(1e-5, 1e-5)
    solution = js.simulate(scene, js.EnergyMomentum(), dt=control, t_end=0.02)
    assert np.sum(np.diff((js.penetration(solution)[0].depth > 0).astype(int)) == 1) >= 1
    assert len(solution.times) < 1500
    assert left(solution) < 1e-7


def test_a_plate_comes_to_rest_with_its_weight_on_the_floor():
    floor = js.Plane([0, 0, -0.01], [0, 0, 1], name="obstacle")
    guides = [js.Support([0], ("ux", "uy", "rz")), js.Support([2], ("uy",))]
    load = [js.Gravity([0, 0, -9.81])]
    scene = js.Scene(MESH, SECTION, guides, load, obstacles=[floor], watch=FORCES)
    rest = js.settle(scene)
    np.testing.assert_allclose(rest.watched["fz"][-1], MASS * 9.81, rtol=1e-7)
    with pytest.raises(ValueError, match=r"translation along \(0, 0, 1\).*settle\(\) lets it come to rest"):
        js.solve_static(scene)
    start = js.Initial(displacements=rest.displacements[-1], rotations=rest.rotations[-1])
    scene = js.Scene(MESH, SECTION, guides, load, initial=start, obstacles=[floor], watch=FORCES)
    static = js.solve_static(scene, [1.0])
    np.testing.assert_allclose(static.watched["fz"][-1], MASS * 9.81, rtol=1e-9)


def test_loads_reactions_and_contact_are_in_balance_in_statics():
    roller = js.Cylinder([0.2, 0.05, -0.0515], [0, 1, 0], 0.05, name="obstacle")
    load = js.NodalForce([2, 5], [0, 0, -500.0])
    scene = js.Scene(MESH, SECTION, [js.clamped([0, 3])], [load], obstacles=[roller], watch=FORCES)
    solution = js.solve_static(scene)
    contact = jnp.stack([solution.watched[name][-1] for name in FORCES])
    total = jnp.sum(js.reactions(solution)[-1][:, :3], axis=0) + contact + jnp.array([0, 0, -1000.0])
    assert contact[2] > 100.0
    assert jnp.max(jnp.abs(total)) < 1e-6


def test_derivatives_go_through_an_impact():
    """By the floor's height, its stiffness, friction and slip velocity: adjoint, forward mode and differences."""
    given = jnp.array([-0.0012, 1e9, 0.2, 0.1])

    @jax.jit
    def place(parameters):
        height, stiffness, friction, slip = parameters * given
        floor = js.Plane(jnp.stack([0.0, 0.0, height]), [0, 0, 1], stiffness=stiffness, friction=friction, slip=slip)
        scene = dropped(floor, velocity=(1.0, 0.0, -2.0))
        solution = js.simulate(scene, js.EnergyMomentum(), dt=np.full(40, 2e-5), newton=TIGHT, throw=False)
        return jnp.sum(solution.displacements[-1] ** 2) * 1e6

    one = jnp.ones(4)
    reverse = jax.jit(jax.grad(place))(one)
    forward = jax.jit(jax.jacfwd(place))(one)
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)
    differences = [(place(one + d) - place(one - d)) / 2e-6 for d in 1e-6 * jnp.eye(4)]
    np.testing.assert_allclose(reverse, jnp.stack(differences), rtol=1e-6, atol=1e-7 * float(jnp.max(jnp.abs(reverse))))
