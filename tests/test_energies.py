"""Contributions with an energy of their own, and those that take energy, in every kind of method."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.model import generators
from jaxshell.model.connectors import Connector
from jaxshell.model.contribution import Elastic, Resisting, between, gradient_between, secant
from jaxshell.numerics.frozen import Frozen

DT = 2e-5


class Link(Connector, Elastic):
    """A spring between two nodes, of energy ½k(r·r - l²)²/(4l²), which an anchor in time may stretch."""

    kind: ClassVar[str] = "link"
    nodes: Frozen = eqx.field(static=True)
    modulus: jax.Array = eqx.field(converter=lambda value: jnp.asarray(value, float))
    grows: float = eqx.field(static=True, default=0.0)

    def parts(self):
        return (self,)

    @property
    def driven(self):
        return self.grows != 0.0

    def groups(self, triangles):
        return self.nodes

    def data(self, surface):
        x = surface.x0[self.nodes.array]
        return jnp.sum((x[:, 1] - x[:, 0]) ** 2, axis=1)

    def _square(self, place):
        r = place.x[1] - place.x[0]
        return r @ r

    def _energy(self, square, length, time):
        return self.modulus * (square - length * (1.0 + self.grows * time)) ** 2 / (8.0 * length)

    def energy(self, data, place):
        return self._energy(self._square(place), data, place.time)

    def mean_force(self, data, start, end):
        middle = between(start, end)
        slope = secant(lambda q: self._energy(q, data, middle.time), self._square(start), self._square(end))
        return -slope * gradient_between(self._square, middle)


class Damper(Connector, Resisting):
    """A force against the rate of the distance of two nodes."""

    kind: ClassVar[str] = "damper"
    nodes: Frozen = eqx.field(static=True)
    coefficient: jax.Array = eqx.field(converter=lambda value: jnp.asarray(value, float))

    def parts(self):
        return (self,)

    def groups(self, triangles):
        return self.nodes

    def data(self, surface):
        return jnp.zeros(len(self.nodes.array))

    def resistance(self, data, start, end, middle, rates):
        along = middle.x[1] - middle.x[0]
        force = self.coefficient * along * (along @ (rates[1, :3] - rates[0, :3])) / (along @ along)
        zero = jnp.zeros(3)
        return jnp.stack([jnp.concatenate([force, zero]), jnp.concatenate([-force, zero])])


def scene(*connectors) -> js.Scene:
    """A free plate that is thrown and spun, with connectors between two of its corners."""
    mesh = generators.rectangle(0.2, 0.1, (2, 1))
    section = js.Section(thickness=2e-3, young_modulus=70e9, poisson_ratio=0.3, density=2700.0)
    start = js.Initial.rigid(mesh, velocity=(1.0, 0.0, 2.0), angular_velocity=(40.0, 10.0, 0.0))
    velocities = start.velocities.at[0].add(jnp.array([0.0, 2.0, 3.0]))
    start = js.Initial(velocities, start.angular_velocities)
    return js.Scene(mesh, section, initial=start, connectors=list(connectors))


NODES = Frozen(np.array([[0, 5]]))


def run(method, *connectors, steps=20, **options):
    return js.simulate(scene(*connectors), method, dt=DT, t_end=steps * DT, save_every=steps, **options)


def closed(solution) -> float:
    """The largest change of energy that work and dissipation do not explain, over the largest energy."""
    energy = solution.energy
    total = energy.kinetic + energy.strain
    left = total - total[0] - energy.external_work + energy.dissipated
    return float(jnp.max(jnp.abs(left)) / jnp.max(jnp.abs(total)))


@pytest.mark.parametrize("grows", [0.0, 300.0])
def test_energy_momentum_keeps_the_balance_to_round_off(grows):
    solution = run(js.EnergyMomentum(), Link(NODES, 1e5, grows), Damper(NODES, 50.0), newton=js.Newton(tolerance=1e-11))
    assert closed(solution) < 1e-12
    assert float(solution.energy.dissipated[-1]) > 1e-3 * float(solution.energy.kinetic[0])
    assert (abs(float(solution.energy.external_work[-1])) > 1e-6) == (grows != 0.0)
    linear, angular = solution.momentum.linear, solution.momentum.angular
    assert jnp.max(jnp.abs(linear - linear[0])) < 1e-12 * jnp.linalg.norm(linear[0])
    assert jnp.max(jnp.abs(angular - angular[0])) < 1e-12 * jnp.linalg.norm(angular[0])


@pytest.mark.slow
@pytest.mark.parametrize("method", [js.GeneralizedEnergyMomentum(), js.Newmark()], ids=["emc", "newmark"])
def test_other_methods_keep_it_to_second_order(method):
    parts, newton = (Link(NODES, 1e5, 300.0), Damper(NODES, 50.0)), js.Newton(1e-11)  # the error is 1e-10 and less
    coarse, fine = (
        js.simulate(scene(*parts), method, dt=DT / n, t_end=20 * DT, save_every=20 * n, newton=newton) for n in (2, 8)
    )  # finer than what the start excites
    assert closed(fine) < 0.3 * closed(coarse)
    exact = js.simulate(scene(*parts), js.EnergyMomentum(), dt=DT / 8, t_end=20 * DT, save_every=160)
    for other in ("dissipated", "external_work"):
        found, expected = (getattr(solution.energy, other)[-1] for solution in (fine, exact))
        np.testing.assert_allclose(found, expected, rtol=1e-2)


def test_central_differences_keep_it():
    explicit, parts = js.CentralDifference(), (Link(NODES, 1e5, 300.0), Damper(NODES, 50.0))
    dt = 0.5 * explicit.critical_step(scene())
    solution = js.simulate(scene(*parts), explicit, dt=dt, t_end=400 * dt, save_every=400)
    assert closed(solution) < 1e-3
    assert float(solution.energy.dissipated[-1]) > 5e-4 * float(solution.energy.kinetic[0])


def test_a_secant_is_the_derivative_where_the_change_is_small():
    def cube(q):
        return q**3

    for change in (0.0, 1e-12, 1e-6, 1e-3, 0.5):
        a, b = 1.0, 1.0 + change
        exact = a * a + a * b + b * b
        found, slope = jax.value_and_grad(lambda b: secant(cube, 1.0, b))(b)
        assert abs(found - exact) < 1e-14 * exact
        assert abs(slope - (a + 2 * b)) < 1e-11
