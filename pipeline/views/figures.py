"""The common part of all matplotlib figures: one style, drawn by Agg without a display, saved whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.formats.atomic import replace_file
from pipeline.views.palette import INK, SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "font.size": 10, "axes.spines.top": False, "axes.edgecolor": SOFT,
    "axes.labelcolor": INK, "xtick.color": SOFT, "ytick.color": SOFT, "axes.titleweight": "bold",
}  # fmt: skip


@contextmanager
def open_figure(
    path: Path, size: tuple[float, float], *, dpi: int, title: str = "", **spacing: float
) -> "Iterator[Figure]":
    """Yield an empty figure of this size [inch] to draw on; afterwards it is written to `path`.

    `spacing` is wspace, hspace, … of matplotlib's constrained layout. After an exception nothing is written.
    Raises OutputError if the file cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=size, dpi=dpi)
        FigureCanvasAgg(figure)
        figure.set_layout_engine("constrained", **spacing)
        if title:
            figure.suptitle(title, fontsize=14, fontweight="bold", color=INK)
        yield figure
        with replace_file(path) as temporary:
            # no version in the file, so that the same results give the same bytes
            figure.savefig(temporary, metadata={"Software": None} if path.suffix == ".png" else None)


def make_panels(figure: "Figure", count: int, columns: int, *, share: bool = False) -> "list[Axes]":
    """Return `count` axes of a grid, row by row; those left over in the last row are hidden."""
    rows = -(-count // columns)
    grid = figure.subplots(rows, columns, sharex=share, sharey=share, squeeze=False).ravel()
    for empty in grid[count:]:
        empty.set_visible(False)
    return list(grid[:count])
