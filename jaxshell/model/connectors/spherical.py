"""Spherical joints."""

from typing import ClassVar

import equinox as eqx

from jaxshell.model.connectors.joint import Joint, Together, named
from jaxshell.model.contribution import Contribution
from jaxshell.model.sets import SetName, nodes_or_name
from jaxshell.numerics.frozen import Frozen


class Spherical(Joint):
    """A joint about which everything may turn: nodes in one place that stay together.

    Arguments:
        a, b: nodes, or names of sets, joined one by one; in one place at the start.
        name: what watches call it.

    Enforced by multipliers: exact at the ends of steps. It does no work and keeps the momenta (`EnergyMomentum`).
    Raises ValueError for nodes that are apart.
    """

    kind: ClassVar[str] = "spherical"

    a: Frozen | SetName = eqx.field(static=True)
    b: Frozen | SetName = eqx.field(static=True)

    def __init__(self, a, b, name: str | None = None):
        self.a, self.b = nodes_or_name("spherical a", a), nodes_or_name("spherical b", b)
        self.name = named(self.kind, name)

    def parts(self) -> tuple[Contribution, ...]:
        return (Together(self.pairs),)
