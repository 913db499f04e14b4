"""What joins nodes with each other or with points of space; one file each."""

from jaxshell.model.connectors.base import Connector
from jaxshell.model.connectors.dashpot import Dashpot
from jaxshell.model.connectors.distributed import Distributed
from jaxshell.model.connectors.edge_tie import EdgeTie
from jaxshell.model.connectors.elastic_support import ElasticSupport
from jaxshell.model.connectors.hinge import Hinge
from jaxshell.model.connectors.rigid_bar import RigidBar
from jaxshell.model.connectors.rigid_body import RigidBody
from jaxshell.model.connectors.slider import Slider
from jaxshell.model.connectors.spherical import Spherical
from jaxshell.model.connectors.spring import Spring
from jaxshell.model.connectors.tie import Tie
from jaxshell.model.connectors.torsion_spring import TorsionSpring

CONNECTORS: tuple[type[Connector], ...] = (
    Spring,
    Dashpot,
    TorsionSpring,
    ElasticSupport,
    RigidBody,
    Distributed,
    Spherical,
    Hinge,
    Slider,
    RigidBar,
    Tie,
    EdgeTie,
)
"""All of them, in the order of the manual."""

__all__ = [
    "CONNECTORS",
    "Connector",
    "Dashpot",
    "Distributed",
    "EdgeTie",
    "ElasticSupport",
    "Hinge",
    "RigidBar",
    "RigidBody",
    "Slider",
    "Spherical",
    "Spring",
    "Tie",
    "TorsionSpring",
]
