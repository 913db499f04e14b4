"""Point masses: mass and inertia tensors at nodes, besides the shell's own."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import OfSets, SetName, check_on_mesh, nodes_or_name, size_of
from jaxshell.numerics.checks import check_finite, check_text, float_array, is_concrete
from jaxshell.numerics.frozen import Frozen


class PointMass(OfSets):
    """Masses at nodes.

    Arguments:
        nodes: node indices, or the name of a set.
        mass: of each node, or (k,) [mass]; not negative. Differentiable.
        inertia: tensor about the node, (3, 3) or (k, 3, 3) in global axes at the start [mass·length²], which turns with
            the node; one value is a ball's. None is none. Differentiable.
        name: what watches call them.

    Weight acts on them, and their momenta and kinetic energy are the scene's; `RayleighDamping` is the shell's alone.
    With `EnergyMomentum` energy and momenta are kept exactly. Raises ValueError for negative masses and for a tensor
    that no body has (not symmetric, or a moment above the sum of the two others).
    """

    kind: ClassVar[str] = "point mass"
    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    mass: Float[jax.Array, "*k"]
    inertia: Float[jax.Array, "*k 3 3"] | None
    name: str | None = eqx.field(static=True)

    def __init__(self, nodes, mass, inertia=None, name: str | None = None):
        self.nodes = nodes_or_name("point mass nodes", nodes)
        self.mass = float_array(mass, "point mass")
        self.inertia = None if inertia is None else tensor(inertia, "point mass inertia")
        self.name = name

    def __check_init__(self):
        if self.name is not None:
            check_text("A point mass's name", self.name)
        check_masses("point mass", self.mass, self.inertia)
        count = size_of(self.nodes)
        shapes = [self.mass.shape] + ([] if self.inertia is None else [self.inertia.shape[:-2]])
        for shape in shapes:
            if len(shape) > 1 or (shape and count is not None and shape != (count,)):
                raise ValueError(f"A point mass has one value or one for each of {count} nodes, but shape {shape}.")

    def check(self, mesh: Mesh) -> None:
        """Raise ValueError where it does not fit the mesh; called when the scene is made."""
        check_on_mesh("point mass", "node", self.nodes.array, mesh.n_nodes)


class Masses(eqx.Module):
    """All point masses of a scene, those of rigid bodies too."""

    nodes: Frozen = eqx.field(static=True)
    """(k,) a node may be there twice."""
    mass: Float[Array, " k"]
    turning: Frozen = eqx.field(static=True)
    """(r,) nodes with an inertia tensor."""
    inertia: Float[Array, "r 3 3"]


def beside_shell(masses: Masses | None, masters: Frozen | None, mesh: Mesh) -> np.ndarray:
    """Nodes with a mass that hang on no element, not by a rigid body either; `masters` are the nodes' references."""
    if masses is None:
        return np.zeros(0, int)
    owner = np.arange(mesh.n_nodes) if masters is None else masters.array
    nodes = masses.nodes.array
    heavy = nodes[np.asarray(masses.mass) > 0] if is_concrete(masses.mass) else nodes
    return np.unique(heavy[~np.isin(owner[heavy], owner[mesh.triangles])])


def tensor(value, name: str) -> Float[jax.Array, "*k 3 3"]:
    """An inertia tensor; one value is a ball's. Raises ValueError calling it `name` for another shape."""
    found = float_array(value, name)
    if found.ndim == 0:
        found = found * jnp.eye(3)
    if found.ndim not in (2, 3) or found.shape[-2:] != (3, 3):
        raise ValueError(f"{name} must be one value or a tensor (3, 3), but it has shape {found.shape}.")
    return found


def euler_tensor(inertia: Float[Array, "k 3 3"]) -> Float[Array, "k 3 3"]:
    """Euler's tensors E = ½ tr(J) I - J: ½ tr(Ṙ E Ṙᵀ) is the energy of a spin, Σ E_jk r_j × ( · )_k its moments."""
    trace = jnp.trace(inertia, axis1=1, axis2=2)
    return 0.5 * trace[:, None, None] * jnp.eye(3) - inertia


def check_masses(what: str, mass, inertia) -> None:
    """Raise ValueError for a negative mass, and for an inertia tensor that no body has."""
    check_finite(f"{what} mass", mass)
    if is_concrete(mass) and np.any(np.asarray(mass) < 0):
        raise ValueError(f"{what} mass must not be negative, but it is {np.asarray(mass).min():g}.")
    if inertia is None:
        return
    check_finite(f"{what} inertia", inertia)
    if not is_concrete(inertia):
        return
    tensors = np.asarray(inertia)
    size = np.abs(tensors).max()
    if np.abs(tensors - np.swapaxes(tensors, -1, -2)).max() > 1e-9 * size:
        raise ValueError(f"{what} inertia must be symmetric, but it is {tensors.tolist()}.")
    moments = np.linalg.eigvalsh(tensors)
    if (moments[..., 0] < -1e-9 * size).any() or (moments[..., 2] > moments[..., :2].sum(axis=-1) + 1e-9 * size).any():
        raise ValueError(
            f"{what} inertia: principal moments {moments.tolist()} are no body's: none is negative or above the sum of "
            "the two others."
        )
