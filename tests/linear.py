"""Linear statics from the two plane elements, assembled here with NumPy: independent of the shell's own assembly."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse
from isotropic import bending_stiffness, membrane_stiffness
from scipy.sparse.linalg import spsolve

from jaxshell.numerics.triangles import local_frame

_BATCH = 64
_MEMBRANE = np.array([0, 1, 5, 6, 7, 11, 12, 13, 17])
_BENDING = np.array([2, 3, 4, 8, 9, 10, 14, 15, 16])


@jax.jit
def _element(x, thickness, young_modulus, poisson_ratio, beta0):
    def one(x):
        frame, (length, bx, by) = local_frame(x)
        xy = jnp.array([[0.0, 0.0], [length, 0.0], [bx, by]])
        K = jnp.zeros((18, 18))
        membrane = membrane_stiffness(xy, thickness, young_modulus, poisson_ratio, beta0)
        K = K.at[jnp.ix_(_MEMBRANE, _MEMBRANE)].set(membrane)
        K = K.at[jnp.ix_(_BENDING, _BENDING)].set(bending_stiffness(xy, thickness, young_modulus, poisson_ratio))
        T = jnp.kron(jnp.eye(6), frame)
        return T.T @ K @ T

    return jax.vmap(one)(x)


def displacements(mesh, section, held, loads, beta0=None) -> np.ndarray:
    """(n, 6) linear displacements and rotations under nodal loads (n, 6); `held` are numbers 6·node + dof."""
    nodes, triangles = np.asarray(mesh.nodes), mesh.triangles
    nu = float(section.poisson_ratio)
    beta0 = 0.5 * (1 - 4 * nu**2) if beta0 is None else beta0
    values = [float(section.thickness), float(section.young_modulus), nu, beta0]
    # Batches of one size compile once for all meshes.
    padded = np.resize(np.arange(len(triangles)), -(-len(triangles) // _BATCH) * _BATCH).reshape(-1, _BATCH)
    matrices = np.concatenate([_element(nodes[triangles[batch]], *values) for batch in padded])[: len(triangles)]
    dofs = (6 * triangles[:, :, None] + np.arange(6)).reshape(-1, 18)
    rows, columns = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel()
    size = 6 * len(nodes)
    K = sparse.csr_matrix((matrices.ravel(), (rows, columns)), (size, size))
    free = np.setdiff1d(np.arange(size), held)
    u = np.zeros(size)
    u[free] = spsolve(K[free][:, free].tocsc(), np.asarray(loads, float).ravel()[free])
    return u.reshape(-1, 6)
