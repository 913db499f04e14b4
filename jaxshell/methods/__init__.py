"""Time integrators, one a file."""

from jaxshell.methods.bathe import Bathe
from jaxshell.methods.central_difference import CentralDifference
from jaxshell.methods.energy_momentum import EnergyMomentum
from jaxshell.methods.generalized_energy_momentum import GeneralizedEnergyMomentum
from jaxshell.methods.method import Method
from jaxshell.methods.newmark import HHT, GeneralizedAlpha, Newmark

__all__ = [
    "HHT",
    "Bathe",
    "CentralDifference",
    "EnergyMomentum",
    "GeneralizedAlpha",
    "GeneralizedEnergyMomentum",
    "Method",
    "Newmark",
]
