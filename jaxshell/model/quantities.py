"""Words for what connectors and obstacles measure, which scenes watch: of which kind each is, and how parts add up."""

from typing import NamedTuple


class Quantity(NamedTuple):
    """What a word stands for."""

    kind: str
    """Of quantity: "force", "moment", "length", "angle", "energy"."""
    over: str
    """What is read where several nodes or pairs have one: their "sum" or the "largest"; "one" is of one alone."""
    says: str
    """On an axis."""
    same: bool = False
    """Whether all parts that measure it measure the same; else their values are added."""


QUANTITIES = {
    "force": Quantity("force", "one", "force"),
    "moment": Quantity("moment", "one", "moment"),
    "length": Quantity("length", "one", "length", True),
    "elongation": Quantity("length", "one", "elongation", True),
    "angle": Quantity("angle", "one", "angle", True),
    "energy": Quantity("energy", "sum", "energy"),
    "fx": Quantity("force", "sum", "$F_x$"),
    "fy": Quantity("force", "sum", "$F_y$"),
    "fz": Quantity("force", "sum", "$F_z$"),
    "penetration": Quantity("length", "largest", "penetration"),
}
"""Every word; none is one of a node's components or a gauge's text (`jaxshell.model.gauge`)."""
