"""Materials, an unsymmetric laminate and a square mesh that several files test, and how far results are apart."""

import jax
import numpy as np

import jaxshell as js

CARBON = js.Orthotropic(140e9, 10e9, 0.3, 5e9, 1600.0, -0.3e-6, 28e-6)
GLASS = js.Orthotropic(40e9, 8e9, 0.25, 4e9, 1900.0, 7e-6, 21e-6)
STEEL = js.Isotropic(210e9, 0.3, 7850.0, 12e-6)
PLIES = [(CARBON, 0.2e-3, 30.0), (GLASS, 0.35e-3, -50.0), (CARBON, 0.2e-3, 0.0), (GLASS, 0.1e-3, 90.0)]
UNSYMMETRIC = js.Laminate([js.Ply(*ply) for ply in PLIES])
SQUARE = js.Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def relative(found, expected) -> float:
    """Largest difference over the largest entry."""
    found, expected = np.asarray(found), np.asarray(expected)
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def resultants(section, mesh=SQUARE, element=0):
    return jax.tree.map(lambda a: np.asarray(a)[element], section.resultants(mesh))
