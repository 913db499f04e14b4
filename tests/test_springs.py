"""Springs, cables, dashpots, torsion springs and elastic supports: exact means, the balance, what is watched."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_energies import closed

import jaxshell as js
from jaxshell.model import generators
from jaxshell.model.connectors.dashpot import Drag
from jaxshell.model.connectors.elastic_support import Held
from jaxshell.model.connectors.laws import mean_positive, positive
from jaxshell.model.connectors.spring import Pull
from jaxshell.model.connectors.torsion import TorsionDamping, TorsionFriction, TorsionStiffness, TorsionStops
from jaxshell.model.contribution import Place, Surface, displaced, mean_rates
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.rotations import cayley, exp

DT = 2e-5
SECTION = js.Section(thickness=2e-3, young_modulus=70e9, poisson_ratio=0.3, density=2700.0)
MESH = generators.rectangle(0.2, 0.1, (2, 1))
WATCH = {
    "tension": ("spring", "force"),
    "rope": ("cable", "elongation"),
    "drag": ("dashpot", "force"),
    "angle": ("torsion", "angle"),
    "moment": ("torsion", "moment"),
    "ground": ("ground", "fz"),
    "stored": ("spring", "energy"),
    "corner": (5, "uz"),
}
PAIR, SINGLE = Frozen([[0, 1]]), Frozen([[1]])
AXIS = jnp.array([[1.0, 2.0, -0.5]])
ELASTIC = {
    "slack cable": Pull(PAIR, None, jnp.array(3.0), jnp.array(1.1), True),
    "without length": Pull(PAIR, None, jnp.array(3.0), jnp.array(0.0), False),
    "grounded": Pull(SINGLE, jnp.array([[0.1, 0.2, 1.0]]), jnp.array(3.0), jnp.array(0.7), False),
    "torsion": TorsionStiffness(PAIR, AXIS, 2.0, 0.3),
    "stops": TorsionStops(SINGLE, AXIS, -0.1, 0.05, 3.0),
}
RESISTING = {
    "dashpot": Drag(PAIR, None, jnp.array(3.0)),
    "grounded dashpot": Drag(SINGLE, jnp.array([[0.1, 0.2, 1.0]]), jnp.array(3.0)),
    "torsion": TorsionDamping(PAIR, AXIS, 2.0),
    "friction": TorsionFriction(SINGLE, AXIS, 2.0, 0.5),
}


def moved(part, scale: float, seed: int = 0):
    """Data of the one group of a part, two places of it, and the increments between them."""
    rng = np.random.default_rng(seed)
    count = part.groups(MESH.triangles).array.shape[1]
    x0 = jnp.array([[0.0, 0.0, 0.0], [0.9, 0.3, -0.2]])
    surface = Surface(x0, jnp.zeros((0, 3), int), jnp.zeros(0), jnp.zeros(0), jnp.zeros((0, 3)), jnp.ones(()))
    data = jax.tree.map(lambda a: a[0], part.data(surface))
    x = x0[2 - count :] + 0.3 * rng.normal(size=(count, 3))
    R = jax.vmap(exp)(jnp.asarray(0.3 * rng.normal(size=(count, 3))))
    u = jnp.asarray(scale * rng.normal(size=(count, 6)))
    turned = jax.vmap(cayley)(u[:, 3:]) @ R
    return data, Place(x, R, jnp.array(0.0)), Place(x + u[:, :3], turned, jnp.array(0.1)), u


@pytest.fixture(scope="module")
def facts():
    """Of every elastic part in one program: works of mean forces over steps of many sizes, forces and tangents."""

    def of(part):
        cases = [moved(part, scale, seed) for scale in (1e-9, 1e-3, 0.3, 0.6) for seed in (1, 2, 3)]
        data, start, end, u = jax.tree.map(lambda *a: jnp.stack(a), *cases)

        def works(data, start, end, u):
            before, after = part.energy(data, start), part.energy(data, end)
            return jnp.sum(part.mean_force(data, start, end) * u), after - before, jnp.maximum(before, after)

        data_one, before, after, _ = cases[8]
        still = jnp.zeros(after.x.size * 2)

        def forces(change):
            place = displaced(after, change)
            return part.force(data_one, place).reshape(-1), part.mean_force(data_one, before, place).reshape(-1)

        way = jnp.linspace(-1.0, 1.0, still.size)
        return {
            "works": jax.vmap(works)(data, start, end, u),
            "slope": jax.grad(lambda change: part.energy(data_one, displaced(after, change)))(still),
            "forces": (part.force(data_one, after), part.mean_force(data_one, after, after)),
            "tangents": (part.stiffness(data_one, after) @ way, part.mean_stiffness(data_one, before, after) @ way),
            "changes": [
                (above - below) / 2e-6 for above, below in zip(forces(1e-6 * way), forces(-1e-6 * way), strict=True)
            ],
        }

    return jax.jit(lambda: {name: of(part) for name, part in ELASTIC.items()})()


@pytest.mark.parametrize("name", ELASTIC)
def test_a_mean_force_does_the_work_of_the_energy_whatever_the_step(facts, name):
    work, change, largest = facts[name]["works"]
    assert jnp.all(jnp.abs(work + change) < 4e-15 * jnp.maximum(1.0, largest))
    assert jnp.max(jnp.abs(change)) > 0.01


@pytest.mark.parametrize("name", ELASTIC)
def test_a_force_is_minus_the_derivative_of_the_energy_and_the_limit_of_means(facts, name):
    for force in facts[name]["forces"]:
        np.testing.assert_allclose(force.reshape(-1), -facts[name]["slope"], atol=1e-14)


@pytest.mark.parametrize("name", ELASTIC)
def test_a_tangent_is_that_of_differences(facts, name):
    for tangent, change in zip(facts[name]["tangents"], facts[name]["changes"], strict=True):
        np.testing.assert_allclose(tangent, change, atol=1e-7)


def test_the_closed_form_of_an_elastic_support_is_that_of_jax():
    part = Held(Frozen([1]), jnp.array([1.0, 2.0, 3.0]), None, None)
    data, start, end, u = moved(part, 0.3)

    def forces(change):
        place = displaced(end, change)
        return part.force(data, place).reshape(-1), part.mean_force(data, start, place).reshape(-1)

    @jax.jit
    def found():
        change = part.energy(data, end) - part.energy(data, start)
        tangents = part.stiffness(data, end), part.mean_stiffness(data, start, end)
        return jnp.sum(part.mean_force(data, start, end) * u), change, tangents, jax.jacfwd(forces)(jnp.zeros(6))

    work, change, tangents, by_jax = found()
    assert abs(work + change) < 1e-15
    for tangent, reference in zip(tangents, by_jax, strict=True):
        np.testing.assert_allclose(tangent, reference, atol=1e-11)


@pytest.mark.parametrize("name", RESISTING)
def test_what_resists_takes_energy_and_turns_nothing_as_a_whole(name):
    part = RESISTING[name]
    for scale in (1e-6, 0.3):
        data, start, end, u = moved(part, scale)
        middle = jax.tree.map(lambda a, b: 0.5 * (a + b), start, end)
        rates = jax.jit(mean_rates)(start, end)
        np.testing.assert_allclose(rates, u / 0.1, rtol=1e-7)
        force = jax.jit(lambda *given: part.resistance(*given))(data, start, end, middle, rates)
        assert -jnp.sum(force * rates) > 0
        if len(u) == 2:
            assert jnp.max(jnp.abs(jnp.sum(force[:, :3], axis=0))) < 1e-14
            turning = jnp.sum(jnp.cross(middle.x, force[:, :3]) + force[:, 3:], axis=0)
            assert jnp.max(jnp.abs(turning)) < 1e-14


def test_a_mean_is_exact_on_either_side_of_the_place_where_a_cable_gets_taut():
    for before, after in ((-1.0, 2.0), (2.0, -1.0), (-1e-18, 1e-18), (-1.0, -2.0), (1.0, 1.0), (0.0, 0.0), (0.0, 1e-9)):
        change = 0.5 * (positive(jnp.array(after)) ** 2 - positive(jnp.array(before)) ** 2)
        mean, slope = jax.value_and_grad(mean_positive, argnums=1)(jnp.array(before), jnp.array(after))
        assert abs(mean * (after - before) - change) < 1e-16 and jnp.isfinite(slope)


def test_a_twist_of_more_than_half_a_turn_is_a_failure_and_no_jump():
    part = TorsionStops(PAIR, AXIS, -0.1, 0.05, 3.0)
    data, start, *_ = moved(part, 0.0)
    axis = AXIS[0] / jnp.linalg.norm(AXIS)

    def turned(angle):
        return start._replace(R=jnp.stack([start.R[0], start.R[0] @ exp(angle * axis)]))

    for before, after in ((3.0, 3.12), (2.9, -2.9), (-2.9, 2.9)):  # the last two a step of 0.48 rad over the gap
        for force in (part.mean_force, part.end_force):
            assert jnp.all(jnp.isnan(force(data, turned(before), turned(after))[:, 3:]))
    assert jnp.all(jnp.isfinite(part.mean_force(data, turned(3.0), turned(2.9))))


def flying(**given) -> js.Scene:
    """A plate that is thrown and spun, with a connector of every kind; stiffnesses and the like as `given`."""
    start = js.Initial.rigid(MESH, velocity=(1.0, 0.0, 2.0), angular_velocity=(40.0, 10.0, 0.0))
    velocities = start.velocities.at[0].add(jnp.array([0.0, 2.0, 3.0]))
    values = {"spring": 1e5, "coefficient": 5.0, "anchor": (0.3, 0.2, 0.1), "torsion": 3.0, "angle": 0.4, "ground": 2e4}
    values |= given
    history = js.History.ramp(2e-4)
    connectors = [
        js.Spring(0, 5, values["spring"], name="spring"),
        js.Spring(
            1, values["anchor"], 2e5, 0.22, tension_only=True, motion=(0, 0, 0.05), history=history, name="cable"
        ),
        js.Dashpot([0, 2], [5, 3], values["coefficient"]),
        js.Dashpot(1, (0.0, 0.0, 0.3), values["coefficient"], name="dashpot"),
        js.TorsionSpring(0, 5, (1.0, 0.2, 0.0), values["torsion"], values["angle"], damping=1e-3, name="torsion"),
        js.TorsionSpring(4, None, (0.0, 1.0, 0.0), 2.0),
        js.ElasticSupport("corner", (1e3, 0.0, values["ground"]), motion=(0, 0, 0.01), history=history, name="ground"),
    ]
    mesh = MESH.with_sets(node_sets={"corner": [4, 5]})
    start = js.Initial(velocities, start.angular_velocities)
    return js.Scene(mesh, SECTION, initial=start, connectors=connectors, watch=WATCH)


def fly(scene: js.Scene, method=None, steps: int = 40, **options) -> js.Solution:
    method = js.EnergyMomentum() if method is None else method
    return js.simulate(scene, method, dt=DT, t_end=steps * DT, save_every=steps, **options)


@pytest.fixture(scope="module")
def run():
    return fly(flying(), newton=js.Newton(tolerance=1e-11))


def test_all_kinds_together_keep_the_balance_to_round_off(run):
    assert closed(run) < 1e-12
    energy = run.energy
    assert float(energy.dissipated[-1]) > 1e-3 * float(energy.kinetic[0])
    assert abs(float(energy.external_work[-1])) > 1e-3 * float(energy.kinetic[0])


def test_what_is_watched_is_what_the_shape_says(run):
    x, watched = np.asarray(MESH.nodes + run.displacements), run.watched
    r = np.linalg.norm(x[:, 5] - x[:, 0], axis=1)
    np.testing.assert_allclose(watched["tension"][jnp.array([0, -1])], 1e5 * (r - r[0]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(watched["stored"], 0.5 * watched["tension"] ** 2 / 1e5, rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(watched["ground"][-1], -2e4 * np.sum(x[-1, 4:, 2] - 0.01), rtol=1e-9)
    rope = np.linalg.norm(x[:, 1] - np.array([[0.3, 0.2, 0.1], [0.3, 0.2, 0.15]]), axis=1) - 0.22
    np.testing.assert_allclose(watched["rope"][jnp.array([0, -1])], rope, rtol=1e-9)
    assert watched["drag"][0] == 0.0 and np.all(watched["drag"][1:] != 0)
    change = np.diff(watched["angle"]) / DT
    mean = 3.0 * (watched["angle"][1:] - 0.4) + 1e-3 * change
    np.testing.assert_allclose(watched["moment"][1:], mean, rtol=1e-2)
    assert np.max(np.abs(watched["angle"])) > 0.01


def test_a_file_holds_them(run, tmp_path):
    run.save(tmp_path / "run.h5")
    back = js.Solution.load(tmp_path / "run.h5")
    assert [type(c) for c in back.scene.connectors] == [type(c) for c in run.scene.connectors]
    assert jax.tree.structure(back.scene) == jax.tree.structure(run.scene)
    assert all(np.array_equal(*pair) for pair in zip(*map(jax.tree.leaves, (back.scene, run.scene)), strict=True))


@pytest.mark.slow
def test_a_run_goes_on_with_what_it_watched(run):
    half = fly(flying(), steps=20, newton=js.Newton(tolerance=1e-11))
    rest = js.simulate(
        half.scene,
        js.EnergyMomentum(),
        dt=DT,
        t_end=20 * DT,
        save_every=20,
        newton=js.Newton(tolerance=1e-11),
        restart=half,
    )
    for label in WATCH:
        np.testing.assert_array_equal(rest.watched[label][0], half.watched[label][-1])
        np.testing.assert_allclose(rest.watched[label][-1], run.watched[label][-1], rtol=1e-9)
