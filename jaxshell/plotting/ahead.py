"""What the first picture of a process waits for, made ready beside other work: matplotlib, its fonts, VTK."""

import io

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from jaxshell.plotting.projection import View, Window
from jaxshell.plotting.rendering import Sheet, renderer


def draw_one() -> None:
    """Draw a picture of one triangle and throw it away: what it had to load, the next ones find."""
    figure = Figure(figsize=(1.0, 1.0), layout="constrained")
    panel = figure.subplots()
    panel.set_title("$10^3$")
    sheet = Sheet(np.eye(3), np.array([[0, 1, 2]]), np.zeros((1, 3)))
    colours = ScalarMappable()
    colours.set_clim(0.0, 1.0)
    renderer().draw(panel, [sheet], View(np.eye(3)), Window(np.zeros(2), np.ones(2)), colours)
    figure.savefig(io.BytesIO())
