"""The picture of a scaling study: the cost of a step against the size of the mesh."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import OutputError
from pipeline.studies.scaling.rival import Rival
from pipeline.studies.scaling.step_cost import CostRow
from pipeline.views.figures import open_figure
from pipeline.views.palette import BLUE, GREEN, GRID, INK, ORANGE, PURPLE, SKY, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLORS = {
    "linear": VERMILION, "one_solve": BLUE, "gram_schmidt": SKY, "auto": INK, "converged": GREEN, "explicit": PURPLE,
    "order_two": ORANGE,
}  # fmt: skip


def write_cost_figure(rows: Sequence[CostRow], rivals: Sequence[Rival], path: Path) -> None:
    """Write the cost of a step against the size of the mesh, both logarithmic; raises OutputError."""
    good = [row for row in rows if not row["error"]]
    if not good:
        raise OutputError(f"{path}: no point was measured: {rows[0]['error']}")
    colors = _COLORS | {rival.name: rival.color for rival in rivals}
    labels = {rival.name: rival.label for rival in rivals}
    beside = [(rival.name, method) for rival in rivals for method in rival.beside]
    with open_figure(path, (8.0, 5.6), dpi=120) as figure:
        axes = figure.subplots()
        for method, color in colors.items():
            method_rows = [row for row in good if row["method"] == method]
            if method_rows:
                _draw_method(axes, method_rows, labels.get(method, method), color)
        for name, method in beside:
            rows_beside = [row for row in good if row["method"] == method and row.get("baseline_ms")]
            baseline = sorted((row["tets"], row["baseline_ms"]) for row in rows_beside)
            if baseline:
                label = f"{method}, {labels[name]}"
                axes.plot(*zip(*baseline, strict=True), "s--", color=colors[method], label=label)
        axes.set(xscale="log", yscale="log", xlabel="tetrahedra", ylabel="ms a step")
        dashed = f", dashed: {', '.join(dict.fromkeys(name for name, _ in beside))}" if beside else ""
        axes.set_title(f"Cost of a step; dotted: bound by the bandwidth{dashed}", loc="left", fontsize=10)
        axes.grid(visible=True, which="major", color=GRID)
        axes.legend(frameon=False, loc="upper left")


def _draw_method(axes: "Axes", rows: Sequence[CostRow], label: str, color: str) -> None:
    rows = sorted(rows, key=lambda row: int(row["tets"]))
    tets = [row["tets"] for row in rows]
    axes.plot(tets, [row["ms"] for row in rows], "o-", color=color, label=label)
    if "bound_ms" in rows[0]:
        axes.plot(tets, [row["bound_ms"] for row in rows], ":", color=color)
