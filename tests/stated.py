"""What a scene states, as arrays: to compare one that was read with one that is written by hand."""

import jax
import numpy as np

import jaxshell as js
from jaxshell.model.loads import DeadLoad

TIMES = (0.0, 0.003, 0.01, 0.5, 2.0)


def stated(scene: js.Scene) -> dict[str, np.ndarray]:
    """Mesh, stiffness and mass of the section in every element, supports, and all that acts, at some times."""
    mesh = scene.mesh
    found = scene.section.resultants(mesh)
    mass = np.asarray(found.mass_per_area)
    dead, moved = np.zeros((len(TIMES), mesh.n_nodes, 6)), np.zeros((len(TIMES), mesh.n_nodes, 6))
    pressure = np.zeros((len(TIMES), mesh.n_elements))
    heat = np.zeros((len(TIMES), 2))
    for i, time in enumerate(TIMES):
        for load in scene.loads:
            factor = float(load.history(time))
            if isinstance(load, DeadLoad):
                dead[i] += factor * np.asarray(load.nodal(mesh.nodes, mesh.triangles, mass))
            elif isinstance(load, js.Thermal):
                heat[i] += factor * np.array([float(load.temperature), float(load.gradient)])
            else:
                pressure[i] += factor * _of_all(load, mesh.n_elements)
        for support in scene.supports:
            moved[i].ravel()[support.dof_numbers.ravel()] += np.asarray(support.values(time)).ravel()
    states = {} if scene.initial is None else {"velocities": np.asarray(scene.initial.velocities)}
    damping = {}
    if scene.damping is not None:
        each = scene.damping.per_element(mesh.n_elements)
        damping = {key: np.asarray(value) for key, value in each._asdict().items() if value is not None}
    return {
        "nodes": np.asarray(mesh.nodes),
        "triangles": mesh.triangles,
        "stiffness": np.asarray(found.matrix),
        "mass": mass,
        "rotary inertia": np.asarray(found.rotary_inertia),
        "held": scene.held_dofs,
        "moved": moved,
        "dead loads": dead,
        "pressure": pressure,
        "heat": heat,
        **states,
        **damping,
    }


def _of_all(load: js.Pressure, count: int) -> np.ndarray:
    """A pressure in every element."""
    where = slice(None) if load.elements is None else load.elements.array
    each = np.zeros(count)
    each[where] = np.asarray(load.pressure)
    return each


def assert_alike(one: js.Scene, other: js.Scene) -> None:
    """Both scenes state the same, to 1e-12 of the largest value of its kind."""
    a, b = stated(one), stated(other)
    assert set(a) == set(b)
    for key, value in a.items():
        assert value.shape == b[key].shape, key
        size = np.abs(b[key]).max() if b[key].size else 0.0
        np.testing.assert_allclose(value, b[key], rtol=1e-12, atol=1e-12 * size, err_msg=key)


def same(one: js.Scene, other: js.Scene) -> bool:
    """Whether two scenes are the same to the last bit."""
    (a, structure), (b, again) = jax.tree.flatten(one), jax.tree.flatten(other)
    return structure == again and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
