"""The picture of a trade-off study: error against cost with its front, and which part of an error dominates."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.formats.atomic import replace_file
from pipeline.studies.tradeoff.settings import IMPLICIT, MODELS, Setting
from pipeline.studies.tradeoff.table import ErrorTable, SettingRow
from pipeline.studies.tradeoff.verdict import find_front, list_choosable, split_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito
_COLOURS = {
    "linear": "#D55E00",
    "gram_schmidt-1": "#CC79A7",
    "polar-1": "#0072B2",
    "polar-2": "#56B4E9",
    "polar-3": "#9ad3f2",
    "polar-converged": "#009E73",
    "auto": "#1b1e28",
}
_MARKERS = {"backward_euler": "o", "bdf2": "^", "symplectic_euler": "x"}
_PARTS = {"model": "#0072B2", "dt": "#E69F00", "mesh": "#7d8597"}
_LEAST = 1e-7  # of an error in the picture: below it single precision is all that is seen


def write_front_figure(table: ErrorTable, path: Path) -> None:
    """Write the figure of a study as PNG; raises OutputError where it cannot."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from pipeline.views.figures import STYLE

    with rc_context(STYLE):
        figure = Figure(figsize=(12.4, 5.0), dpi=100)
        FigureCanvasAgg(figure)
        figure.set_layout_engine("constrained", wspace=0.05)
        figure.suptitle(
            f"{table.plan.case.name.replace('_', ' ')}: what accuracy costs", fontweight="bold", fontsize=13
        )
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        _draw_costs(left, table)
        _draw_shares(right, table)
        with replace_file(path) as hidden:
            metadata: dict[str, Any] = {"Software": None}  # the same results are the same bytes
            figure.savefig(hidden, metadata=metadata)


def _draw_costs(axes: "Axes", table: ErrorTable) -> None:
    """Draw every row of the case's mesh, the front through them, the tolerance and the mesh's own error."""
    rows = list_choosable(table)
    for row in rows:
        axes.plot(_compute_cost(row), max(row.error(), _LEAST), **_choose_style(row.setting))
    best = find_front(rows)
    axes.plot(
        [_compute_cost(r) for r in best], [max(r.error(), _LEAST) for r in best], color="#626875", lw=1.2, zorder=1
    )
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("solver milliseconds for a simulated second")
    axes.set_ylabel("error: the larger of distance / size, ½ |J − J_ref|")
    axes.axhline(table.plan.tolerance, color="#b0b5bf", lw=1, ls=(0, (4, 3)), zorder=0)
    mesh = table.mesh_error(1)
    if np.isfinite(mesh):
        axes.axhline(mesh, color=_PARTS["mesh"], lw=1.4, zorder=0)
        axes.annotate("the mesh's own error", (0.01, mesh), xycoords=("axes fraction", "data"), fontsize=8, va="bottom")
    axes.spines["right"].set_visible(False)
    present = {row.setting.model: row.setting for row in rows if row.setting.stepper in IMPLICIT}
    used = dict.fromkeys(row.setting.stepper for row in rows)
    handles = [
        _make_handle(model.replace("_", "-").replace("-", " "), c, "s")
        for model, c in _COLOURS.items()
        if model in present
    ]
    handles += [_make_handle(name.replace("_", " "), "#626875", _MARKERS[name]) for name in used]
    axes.legend(handles=handles, fontsize=8, frameon=False, ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.13))
    axes.set_title("every setting on the case's mesh; line: the front", loc="left", fontsize=10)


def _compute_cost(row: SettingRow) -> float:
    return 1e3 / row.costs["real_time_factor"]


def _choose_style(setting: Setting) -> dict[str, Any]:
    auto = setting.law == "auto"
    return {
        "marker": _MARKERS[setting.stepper],
        "color": _COLOURS.get(setting.model, "#626875"),
        "markersize": 9 if auto else 6,
        "markerfacecolor": "none" if auto else None,
        "markeredgewidth": 1.6 if auto else 0.8,
        "linestyle": "none",
        "zorder": 4 if auto else 3,
        "alpha": 0.85,
    }


def _make_handle(label: str, colour: str, marker: str) -> Any:
    from matplotlib.lines import Line2D

    hollow = "none" if label == "auto" else colour
    return Line2D([], [], ls="none", marker=marker, color=colour, markerfacecolor=hollow, label=label)


def _draw_shares(axes: "Axes", table: ErrorTable) -> None:
    """Draw the parts of the error of each model at the case's own stepper and dt."""
    own = table.plan.own
    rows = []
    for law, rotation, iterations in MODELS:
        row = table.row(Setting(1, own.mass, own.stepper, own.dt, law, rotation, iterations))
        if row is not None and row.failure is None:
            rows.append(row)
    floor = 1e-5
    for place, row in enumerate(rows):
        parts = split_error(table, row)
        for shift, (name, colour) in enumerate(_PARTS.items()):
            value = getattr(parts, name)
            if np.isfinite(value) and value > floor:
                axes.barh(place + 0.27 * (shift - 1), value, 0.25, left=0, color=colour)
    axes.set(xscale="log", yticks=range(len(rows)), xlabel="error by itself")
    axes.set_xlim(left=floor)
    axes.set_yticklabels([row.setting.model.replace("_", "-").replace("-", " ") for row in rows])
    axes.invert_yaxis()
    axes.spines["right"].set_visible(False)
    axes.set_title(f"{own.stepper.replace('_', ' ')}, dt = {own.dt:.4g} s: what dominates", loc="left", fontsize=10)
    handles = [_make_handle(name, colour, "s") for name, colour in _PARTS.items()]
    axes.legend(handles=handles, fontsize=8, frameon=False, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.13))
