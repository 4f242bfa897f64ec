"""The picture of a stability study: a panel a slice, methods by values, colour the outcome, number the worst J."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.formats.atomic import replace_file
from pipeline.studies.stability.slices import METHODS, SLICES
from pipeline.studies.stability.trial import OUTCOMES, REFUSED

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pipeline.studies.stability.study import Stability

# told apart in grey by lightness too; the last two are what a user has to look at
_COLOURS = ("#b7e3d0", "#fff2b3", "#f2b37a", "#d9dce3", "#9dc3e6", "#f4f5f7", "#d1495b")
_COLUMNS = 2


def write_stability_figure(study: "Stability", path: Path) -> None:
    """Write the heat maps of a study as PNG; raises OutputError where it cannot."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    from pipeline.views.figures import STYLE

    columns = min(_COLUMNS, len(study.values))
    rows = -(-len(study.values) // columns)
    with rc_context(STYLE):
        figure = Figure(figsize=(1.6 + 6.2 * columns, 1.4 + 3.9 * rows), dpi=100)
        FigureCanvasAgg(figure)
        figure.set_layout_engine("constrained")
        figure.suptitle(f"{study.name}: what breaks at the extremes", fontsize=14, fontweight="bold")
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes in grid.ravel()[len(study.values) :]:
            axes.set_visible(False)
        for place, name in enumerate(study.values):
            _draw(grid.ravel()[place], study, name, labels=place % columns == 0)
        seen = {outcome for name in study.values for row in study.outcomes(name) for outcome in row}
        handles = [
            Patch(facecolor=colour, edgecolor="#626875", linewidth=0.5, label=outcome.replace("_", " "))
            for outcome, colour in zip(OUTCOMES, _COLOURS, strict=True)
            if outcome in seen
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
        with replace_file(path) as temporary:
            # no version in the file: the same results are the same bytes
            figure.savefig(temporary, metadata={"Software": None})


def _draw(axes: "Axes", study: "Stability", name: str, *, labels: bool) -> None:
    """Draw one slice; the number in a field is the volume ratio farthest from 1."""
    from matplotlib.colors import BoundaryNorm, ListedColormap

    outcomes, values = study.outcomes(name), study.values[name]
    codes = np.array([[list(OUTCOMES).index(outcome) for outcome in row] for row in outcomes])
    norm = BoundaryNorm(np.arange(len(OUTCOMES) + 1) - 0.5, len(OUTCOMES))
    axes.imshow(codes, cmap=ListedColormap(_COLOURS), norm=norm, aspect="auto", interpolation="nearest")
    for row, method in enumerate(METHODS):
        for column in range(len(values)):
            result = study.results[name, column, method]
            if result["outcome"] != REFUSED:
                text = _format_short(float(result["worst_volume_ratio"]))
                axes.text(column, row, text, ha="center", va="center", fontsize=6, color="#1b1e28")
    one = SLICES[name]
    unit = "" if one.units == "1" else f" [{one.units}]"
    axes.set_title(f"{one.long_name}{unit}", loc="left", fontsize=9)
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
