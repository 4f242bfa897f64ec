"""The picture of a trade-off study: error against cost with its front, and the parts of the error of each model."""

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.problem.methods import STEPPERS
from pipeline.studies.tradeoff.settings import MODELS, Setting
from pipeline.studies.tradeoff.table import ErrorTable, SettingRow
from pipeline.studies.tradeoff.verdict import find_front, list_choosable, split_error
from pipeline.views.figures import open_figure
from pipeline.views.palette import BLUE, FAINT, GREEN, INK, ORANGE, PURPLE, SKY, SLATE, SOFT, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = {
    "linear": VERMILION,
    "gram_schmidt-1": PURPLE,
    "polar-1": BLUE,
    "polar-2": SKY,
    "polar-3": "#9ad3f2",  # a lighter sky
    "polar-converged": GREEN,
    "auto": INK,
}
_MARKERS = dict(zip(STEPPERS, cycle("o^xsDv"), strict=False))
_PARTS = {"model": BLUE, "dt": ORANGE, "mesh": SLATE}
_LEAST_ERROR = 1e-7  # of a point: motions are stored in single precision
_LEAST_PART = 1e-5  # of a bar: far below any tolerance that a user asks for
_LEGEND_PLACE: dict[str, Any] = {"fontsize": 8, "frameon": False, "loc": "upper center", "bbox_to_anchor": (0.5, -0.13)}


def write_front_figure(table: ErrorTable, path: Path) -> None:
    """Write the figure of a study as PNG; raises OutputError if the file cannot be written."""
    title = f"{table.plan.case.name.replace('_', ' ')}: what accuracy costs"
    with open_figure(path, (12.4, 5.0), dpi=100, title=title, wspace=0.05) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        _draw_costs(left, table)
        _draw_parts(right, table)


def _draw_costs(axes: "Axes", table: ErrorTable) -> None:
    """Draw every row of the case's mesh, the front through them, the tolerance and the mesh's own error."""
    rows = list_choosable(table)
    for row in rows:
        axes.plot(_compute_cost(row), _limit_error(row), **_choose_style(row.setting))
    front = find_front(rows)
    axes.plot([_compute_cost(row) for row in front], [_limit_error(row) for row in front], color=SOFT, lw=1.2, zorder=1)
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("solver milliseconds for a simulated second")
    axes.set_ylabel("error: the larger of distance / size, ½ |J − J_ref|")
    axes.axhline(table.plan.tolerance, color=FAINT, lw=1, ls=(0, (4, 3)), zorder=0)
    mesh = table.find_mesh_error(table.plan.own)
    if np.isfinite(mesh):
        axes.axhline(mesh, color=_PARTS["mesh"], lw=1.4, zorder=0)
        axes.annotate("the mesh's own error", (0.01, mesh), xycoords=("axes fraction", "data"), fontsize=8, va="bottom")
    axes.spines["right"].set_visible(False)
    models = {row.setting.model for row in rows if STEPPERS[row.setting.stepper].is_implicit}
    steppers = dict.fromkeys(row.setting.stepper for row in rows)
    handles = [_make_handle(_format_model(name), color, "s") for name, color in _COLORS.items() if name in models]
    handles += [_make_handle(name.replace("_", " "), SOFT, _MARKERS[name]) for name in steppers]
    axes.legend(handles=handles, ncols=5, **_LEGEND_PLACE)
    axes.set_title("every setting on the case's mesh; line: the front", loc="left", fontsize=10)


def _compute_cost(row: SettingRow) -> float:
    return 1e3 / row.costs["real_time_factor"]


def _limit_error(row: SettingRow) -> float:
    return max(row.compute_error(), _LEAST_ERROR)


def _format_model(model: str) -> str:
    return model.replace("_", "-").replace("-", " ")


def _choose_style(setting: Setting) -> dict[str, Any]:
    auto = setting.law == "auto"
    return {
        "marker": _MARKERS[setting.stepper],
        "color": _COLORS.get(setting.model, SOFT),
        "markersize": 9 if auto else 6,
        "markerfacecolor": "none" if auto else None,
        "markeredgewidth": 1.6 if auto else 0.8,
        "linestyle": "none",
        "zorder": 4 if auto else 3,
        "alpha": 0.85,
    }


def _make_handle(label: str, color: str, marker: str) -> Any:
    from matplotlib.lines import Line2D

    face = "none" if label == "auto" else color
    return Line2D([], [], ls="none", marker=marker, color=color, markerfacecolor=face, label=label)


def _draw_parts(axes: "Axes", table: ErrorTable) -> None:
    """Draw the parts of the error of each model at the case's own stepper and dt."""
    own = table.plan.case_setting
    settings = [Setting(*own.level, own.mass, own.stepper, own.dt, *model) for model in MODELS]
    rows = [row for setting in settings if (row := table.find_row(setting)) is not None and row.failure is None]
    for place, row in enumerate(rows):
        parts = split_error(table, row)
        for shift, (name, color) in enumerate(_PARTS.items()):
            value = getattr(parts, name)
            if np.isfinite(value) and value > _LEAST_PART:
                axes.barh(place + 0.27 * (shift - 1), value, 0.25, left=0, color=color)
    axes.set(xscale="log", yticks=range(len(rows)), xlabel="part of the error")
    axes.set_xlim(left=_LEAST_PART)
    axes.set_yticklabels([_format_model(row.setting.model) for row in rows])
    axes.invert_yaxis()
    axes.spines["right"].set_visible(False)
    axes.set_title(f"{own.stepper.replace('_', ' ')}, dt = {own.dt:.4g} s: what dominates", loc="left", fontsize=10)
    axes.legend(handles=[_make_handle(name, color, "s") for name, color in _PARTS.items()], ncols=3, **_LEGEND_PLACE)
