"""Time integrators, one a file."""

from jaxshell.methods.base import Method
from jaxshell.methods.generalized_energy_momentum import GeneralizedEnergyMomentum

__all__ = ["GeneralizedEnergyMomentum", "Method"]
