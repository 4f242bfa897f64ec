"""The picture of a stability study: a panel for each slice, methods by values, colored by outcome, with the worst J."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.studies.stability.results import Stability
from pipeline.studies.stability.slices import METHODS, SLICES
from pipeline.studies.stability.trial import OUTCOMES, REFUSED
from pipeline.views.figures import make_panels, open_figure
from pipeline.views.palette import INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# they differ in lightness too, for gray printing; the last one calls for attention
_COLORS = ("#b7e3d0", "#fff2b3", "#f2b37a", "#d9dce3", "#9dc3e6", "#f4f5f7", "#d1495b")
_COLUMNS = 2


def write_stability_figure(study: Stability, path: Path) -> None:
    """Write the heat maps of a study as PNG; raises OutputError if the file cannot be written."""
    from matplotlib.patches import Patch

    columns = min(_COLUMNS, len(study.values))
    rows = -(-len(study.values) // columns)
    title = f"{study.name}: what breaks at the extremes"
    with open_figure(path, (1.6 + 6.2 * columns, 1.4 + 3.9 * rows), dpi=100, title=title) as figure:
        panels = make_panels(figure, len(study.values), columns)
        for place, name in enumerate(study.values):
            _draw_slice(panels[place], study, name, labels=place % columns == 0)
        seen = {outcome for name in study.values for row in study.list_outcomes(name) for outcome in row}
        handles = [
            Patch(facecolor=color, edgecolor=SOFT, linewidth=0.5, label=outcome.replace("_", " "))
            for outcome, color in zip(OUTCOMES, _COLORS, strict=True)
            if outcome in seen
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)


def _draw_slice(axes: "Axes", study: Stability, name: str, *, labels: bool) -> None:
    """Draw one slice; the number in a square is the volume ratio farthest from 1."""
    from matplotlib.colors import BoundaryNorm, ListedColormap

    outcomes, values = study.list_outcomes(name), study.values[name]
    codes = np.array([[list(OUTCOMES).index(outcome) for outcome in row] for row in outcomes])
    norm = BoundaryNorm(np.arange(len(OUTCOMES) + 1) - 0.5, len(OUTCOMES))
    axes.imshow(codes, cmap=ListedColormap(_COLORS), norm=norm, aspect="auto", interpolation="nearest")
    for row, method in enumerate(METHODS):
        for column in range(len(values)):
            result = study.results[name, column, method]
            if result["outcome"] != REFUSED:
                text = _format_short(float(result["worst_volume_ratio"]))
                axes.text(column, row, text, ha="center", va="center", fontsize=6, color=INK)
    units = SLICES[name].units
    suffix = "" if units == "1" else f" [{units}]"
    axes.set_title(f"{SLICES[name].long_name}{suffix}", loc="left", fontsize=9)
    axes.set_xticks(range(len(values)), [f"{value:g}" for value in values], fontsize=7)
    axes.set_yticks(range(len(METHODS)), list(METHODS) if labels else [""] * len(METHODS), fontsize=7)
    axes.set_xticks(np.arange(len(values) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(METHODS) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=0.8)
    axes.tick_params(which="both", length=0)
    axes.spines[:].set_visible(False)


def _format_short(value: float) -> str:
    """Return a number in at most six characters."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0e}".replace("e+0", "e").replace("e+", "e")
