"""How all pictures look: colours and dashes for every eye and for grey print, sizes, units on axes."""

import math
from typing import Any

import numpy as np

from jaxshell.model.scene import Scene

# Okabe & Ito 2008: told apart with every common colour-vision deficiency. Each goes with a dash pattern.
BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000",
)  # fmt: skip
COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 2)))
WIDTH = 6.7
"""Width of every picture [inch]: a page's text width, so that 9 pt stays 9 pt in print."""

STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.5,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "lines.linewidth": 1.3,
    "savefig.dpi": 200,
    "figure.dpi": 100,
}

_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def plain(text: str) -> str:
    """Text from outside as matplotlib draws it letter by letter: a dollar sign begins no formula."""
    return text.replace("$", r"\$")


def title(scene: Scene, name: str, what: str) -> str:
    """A picture's title: the scene, the run's name (its method) where there is one, and what is drawn."""
    return f"{plain(scene.name)}{', ' + name if name else ''}: {what}"


def line(position: int) -> dict:
    """Colour and dashes of the run at `position` among those compared."""
    return {"color": COLOURS[position % len(COLOURS)], "linestyle": DASHES[position % len(DASHES)]}


def scaled(scene: Scene, largest: float, symbol: str) -> tuple[float, str]:
    """(divisor, " in <unit>") for values up to `largest` of an SI unit; (1, "") for scenes in other units."""
    if scene.defaults is None or scene.defaults.units != "SI":
        return 1.0, ""
    if not (math.isfinite(largest) and largest > 0):
        return 1.0, f" in {symbol}"
    power = max(-9, min(9, 3 * math.floor(math.log10(2 * largest) / 3)))
    return 10.0**power, f" in {_PREFIXES[power]}{symbol}"


def length_unit(scene: Scene) -> tuple[float, str]:
    """(divisor, unit) of all lengths in a picture of the scene's shell: that of its size; (1, "") without units."""
    divisor, unit = scaled(scene, float(np.ptp(np.asarray(scene.mesh.nodes), axis=0).max()), "m")
    return divisor, unit.removeprefix(" in ")


def symmetry_note(planes: int) -> str:
    """What to add to the name of a sum over a model that planes of symmetry bound."""
    part = {0: "", 1: " of the modelled half", 2: " of the modelled quarter"}
    return part.get(planes, " of the modelled part")
