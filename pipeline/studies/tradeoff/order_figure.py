"""The picture of elements of order 1 and 2: total error against cost with their fronts."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.studies.tradeoff.levels import ORDERS
from pipeline.studies.tradeoff.orders import list_order_front
from pipeline.studies.tradeoff.table import ErrorTable, SettingRow
from pipeline.studies.tradeoff.verdict import find_front
from pipeline.views.figures import open_figure
from pipeline.views.palette import BLUE, FAINT, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = {1: VERMILION, 2: BLUE}
_MARKERS = {1: "o", 2: "s"}


def write_order_figure(tables: Sequence[ErrorTable], path: Path) -> None:
    """Write the fronts of some studies side by side as PNG; raises OutputError if the file cannot be written."""
    title = "what accuracy costs with elements of order 1 and 2"
    with open_figure(path, (0.6 + 3.6 * len(tables), 4.2), dpi=100, title=title, wspace=0.08) as figure:
        panels = np.atleast_1d(figure.subplots(1, len(tables), sharey=True))
        for axes, table in zip(panels, tables, strict=True):
            _draw_fronts(axes, table)
        panels[0].set_ylabel("total error: distance / size")
        panels[0].legend(frameon=False, fontsize=8, loc="lower left")


def _draw_fronts(axes: "Axes", table: ErrorTable) -> None:
    """Draw every setting by its order, the front of each order, the tolerance and the error of the finest mesh."""
    for order in ORDERS:
        rows = [row for row in list_order_front(table, order) if np.isfinite(row.compute_error("total"))]
        if not rows:
            continue
        front = find_front(rows, "total")
        style: dict[str, Any] = {"color": _COLORS[order], "marker": _MARKERS[order]}
        axes.plot(_list_costs(rows), _list_errors(rows), ls="none", alpha=0.35, markersize=3.5, **style)
        axes.plot(_list_costs(front), _list_errors(front), markersize=5, label=f"order {order}", **style)
    axes.axhline(table.plan.tolerance, color=FAINT, lw=1, ls=(0, (4, 3)), zorder=0)
    mesh = table.estimate_reference_errors().mesh
    if mesh is not None and mesh > 0:
        axes.axhspan(1e-12, mesh, color=FAINT, alpha=0.25, lw=0, zorder=0)
    axes.set(xscale="log", yscale="log", xlabel="solver ms a simulated second")
    lowest = [row.compute_error("total") for order in ORDERS for row in list_order_front(table, order)]
    finite = [error for error in lowest if np.isfinite(error) and error > 0]
    if finite:
        axes.set_ylim(bottom=min(finite) / 2)
    axes.spines["right"].set_visible(False)
    axes.set_title(table.plan.case.name.replace("_", " "), loc="left", fontsize=10)


def _list_costs(rows: Sequence[SettingRow]) -> list[float]:
    return [1e3 / row.costs["real_time_factor"] for row in rows]


def _list_errors(rows: Sequence[SettingRow]) -> list[float]:
    return [row.compute_error("total") for row in rows]
