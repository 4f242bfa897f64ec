"""Colors of all figures, films and pages: each is defined here once.

The hues are those of Okabe and Ito: distinct for any color vision, and different in lightness when printed in gray.
"""

import numpy as np
from numpy.typing import NDArray

BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
SKY, PURPLE, ORANGE = "#56B4E9", "#CC79A7", "#E69F00"
INK, SOFT, FAINT, GRID = "#1b1e28", "#626875", "#b0b5bf", "#e3e5ea"  # text, secondary text, marks, grid lines
SLATE = "#7d8597"  # a neutral color beside the hues, as for another program or the mesh
FILM_INK, FILM_RULE = "#181b26", "#dee1e7"  # text and lines between the panels of a film
CURVE_AHEAD, FAILED = "#c6cbd5", "#be122c"  # of a film: the curve after the present, a series that ended early

BANDS = ((0.0, 1.0, 0.14), (0.05, 0.95, 0.22), (0.25, 0.75, 0.34))  # lower and upper quantile, opacity
ENERGIES = {"kinetic": (BLUE, "-"), "elastic": (VERMILION, "--"), "potential": (GREEN, "-.")}  # color, dashes

INVERTED = (214, 0, 196)  # magenta: far from every color of the map
UNKNOWN = (150, 152, 158)  # cells without data: darker than the middle of the map
OUTLINE = (143, 148, 161)  # of the rest shape
DIMMED = 0.68  # share of white in a panel whose series ended early


class Palette:
    """Volume ratio to color: a diverging map about 1 with a gray middle, saturated at both ends."""

    def __init__(self, radius: float) -> None:
        from matplotlib import colormaps

        self.radius = radius
        self.table = (np.asarray(colormaps["coolwarm"](np.linspace(0, 1, 256)))[:, :3] * 255).round().astype(np.uint8)

    def map_colors(self, ratio: NDArray[np.float32], dimmed: bool) -> NDArray[np.uint8]:
        """Return the color of every face (f, 3)."""
        place = np.nan_to_num((ratio - 1) / (2 * self.radius) + 0.5, nan=0.5)
        rgb = self.table[np.clip(place * 256, 0, 255).astype(np.int64)]
        rgb[ratio <= 0] = INVERTED
        rgb[np.isnan(ratio)] = UNKNOWN
        return (rgb * (1 - DIMMED) + 255 * DIMMED).astype(np.uint8) if dimmed else rgb
