"""Figures of a comparison dataset: volume ratio of every cell, energies, distances and solves over time."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats
from pipeline.errors import OutputError
from pipeline.stepping.report import RUNG_NAMES
from pipeline.views.figures import make_panels, open_figure
from pipeline.views.palette import BANDS, BLUE, ENERGIES, FAINT, GREEN, INK, SOFT, VERMILION

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_LINES = 2000  # more lines than this merge into one patch and take seconds to draw
RUNGS = tuple(zip(RUNG_NAMES, (GREEN, BLUE, VERMILION), strict=True))  # by step_rung


def write_volume_figure(dataset: "xarray.Dataset", path: Path, *, title: str) -> None:
    """Write the volume ratio of every cell over time, one panel for each variant, the worst cell marked.

    Takes volume_ratio (variant, time, cell) and rest_volume (cell), and volume_ratio_min and volume_ratio_max if the
    cells are curved. Above 2000 cells, bands of quantiles replace the lines. Values that are NaN, as after a failure,
    are left out. Raises OutputError if the file cannot be written.
    """
    variants, time = _list_variants(dataset), dataset["time"].values
    ratio = dataset["volume_ratio"].transpose("variant", "time", "cell").values
    extremes = _find_extremes(dataset)
    with _open_panels(path, len(variants), title) as figure:
        panels = _make_panels(figure, variants)
        for axes, values in zip(panels, ratio, strict=True):
            _draw_ratios(axes, time, values)
        for axes, edges in zip(panels, extremes, strict=False):  # there are none for linear simplices
            axes.plot(time, edges.T, linestyle=(0, (1, 2)), color=INK, linewidth=1.0, zorder=2)
        cells = ratio.shape[2]
        meaning = "light to dark: extremes, 5–95 %, 25–75 %, median" if cells > MOST_LINES else "one line each"
        dots = "; dotted: smallest and largest det F in any cell" if len(extremes) else ""
        figure.supxlabel(f"{cells} cells, {meaning}; the worst cell in orange{dots}", fontsize=8, color=SOFT)
        _set_limits(panels, time, np.concatenate([ratio.ravel(), extremes.ravel()]))
        _label_outer(panels, "volume ratio V / V₀")
        rest = dataset["rest_volume"].values
        # 1e-6: far above rounding, far below what the axis can show
        if np.ptp(rest) <= 1e-6 * rest.max():
            _add_volume_axis(panels[-1], float(rest.mean()), str(dataset["rest_volume"].attrs.get("units", "m3")))


def write_energy_figure(dataset: "xarray.Dataset", path: Path, *, title: str) -> None:
    """Write kinetic, elastic, potential and total energy over time, one panel for each variant.

    The total is the sum of the parts present. Raises OutputError if the dataset has none of them or if the
    file cannot be written.
    """
    present = [name for name in ENERGIES if f"{name}_energy" in dataset]
    if not present:
        raise OutputError(f"{path}: no energies to draw: the dataset has none of {', '.join(ENERGIES)}_energy")
    variants, time = _list_variants(dataset), dataset["time"].values
    energies = {name: dataset[f"{name}_energy"].transpose("variant", "time").values for name in present}
    scale, prefix = _choose_prefix(max(float(np.nan_to_num(np.abs(values)).max()) for values in energies.values()))
    with _open_panels(path, len(variants), title) as figure:
        panels = _make_panels(figure, variants)
        for i, axes in enumerate(panels):
            axes.axhline(0, color=FAINT, linewidth=0.8)
            parts = {name: values[i] / scale for name, values in energies.items()}
            for name, values in parts.items():
                color, dashes = ENERGIES[name]
                axes.plot(time, values, dashes, color=color, linewidth=1.5, label=name)
            if len(parts) > 1:
                axes.plot(time, sum(parts.values()), color=INK, linewidth=2.0, label="total")
        panels[0].set_xlim(*_choose_time_limits(time))
        unit = str(dataset[f"{present[0]}_energy"].attrs.get("units", "J"))
        _label_outer(panels, f"energy [{prefix}{unit}]")
        _add_legend(figure, panels[0], columns=4)


def write_distance_figure(dataset: "xarray.Dataset", path: Path, *, title: str) -> None:
    """Write the distance of each series' nodes from those of the first series over time, one panel for each.

    Takes node_distance_worst and node_distance_rms (variant, time). Raises OutputError if the file cannot
    be written.
    """
    variants, time = _list_variants(dataset), dataset["time"].values
    lines = (("worst node", "node_distance_worst", VERMILION, "-"), ("RMS of all", "node_distance_rms", BLUE, "--"))
    with _open_panels(path, len(variants) - 1, title) as figure:
        panels = _make_panels(figure, [f"{name}, from {variants[0]}" for name in variants[1:]])
        for i, axes in enumerate(panels, start=1):
            for label, variable, color, dashes in lines:
                values = dataset[variable].transpose("variant", "time").values[i]
                axes.plot(time, values, dashes, color=color, linewidth=1.5, label=label)
        panels[0].set_xlim(*_choose_time_limits(time))
        panels[0].set_ylim(bottom=0)
        _label_outer(panels, "node distance [m]")
        _add_legend(figure, panels[0], columns=2)


def write_effort_figure(datasets: "Mapping[str, xarray.Dataset]", path: Path, *, title: str) -> None:
    """Write the model and the number of solves of every step of model = "auto", one panel for each variant.

    Takes step_rung and step_solves (step) of each variant. Raises OutputError if the file cannot be written.
    """
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    with _open_panels(path, len(datasets), title) as figure:
        panels = _make_panels(figure, [f"{name}: {_count_rungs(dataset)} steps" for name, dataset in datasets.items()])
        for axes, dataset in zip(panels, datasets.values(), strict=True):
            step, solves, rung = (dataset[n].values for n in ("step", "step_solves", "step_rung"))
            for i, (_, color) in enumerate(RUNGS):
                axes.bar(step[rung == i], solves[rung == i], width=1.0, color=color, linewidth=0)
        _label_outer(panels, "solves")
        for axes in panels:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
            axes.set_xlabel("step" if axes.get_xlabel() else "")
        handles = [Patch(color=color, label=label) for label, color in RUNGS]
        figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)


def _count_rungs(dataset: "xarray.Dataset") -> str:
    counts = [(int((dataset["step_rung"].values == i).sum()), label) for i, (label, _) in enumerate(RUNGS)]
    return ", ".join(f"{n} {label}" for n, label in counts if n)


def _list_variants(dataset: "xarray.Dataset") -> list[str]:
    return [str(name) for name in dataset["variant"].values]


def _choose_prefix(largest: float) -> tuple[float, str]:
    """Return the power of 1000 that leaves one to three digits before the point, and its letter."""
    return next(((f, p) for f, p in ((1e9, "G"), (1e6, "M"), (1e3, "k")) if largest >= f), (1.0, ""))


def _count_columns(count: int) -> int:
    return 2 if count == 4 else min(count, 3)


def _open_panels(path: Path, count: int, title: str) -> "AbstractContextManager[Figure]":
    """Return the context manager of a figure with room for `count` panels, at most three in a row."""
    columns = _count_columns(count)
    size = (2.0 + 4.0 * columns + (2.0 if columns == 1 else 0), 1.2 + 3.4 * -(-count // columns))
    return open_figure(path, size, dpi=150, title=title, wspace=0.04, hspace=0.06)


def _make_panels(figure: "Figure", titles: list[str]) -> "list[Axes]":
    panels = make_panels(figure, len(titles), _count_columns(len(titles)), share=True)
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title, loc="left", fontsize=11, color=INK)
    return panels


def _add_legend(figure: "Figure", axes: "Axes", *, columns: int) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def _label_outer(panels: "list[Axes]", quantity: str) -> None:
    """Label the axes at the left and at the bottom of the grid."""
    for axes in panels:
        spec = axes.get_subplotspec()
        assert spec is not None
        if spec.is_first_col():
            axes.set_ylabel(quantity)
        # a panel without another one below it shows the times, even if the grid has an empty place there
        below = spec.rowspan.stop * spec.get_gridspec().ncols + spec.colspan.start
        if below >= len(panels):
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
        axes.spines["right"].set_visible(False)
        axes.margins(x=0)


def _draw_ratios(axes: "Axes", time: Floats, values: Floats) -> None:
    """Draw one variant (time, cell): thin lines or bands, the level 1, and the worst cell."""
    from matplotlib.collections import LineCollection

    axes.axhline(1, color=INK, linewidth=0.9, linestyle=(0, (4, 3)), zorder=2)
    good: NDArray[np.bool_] = np.asarray(np.isfinite(values).any(axis=1))
    if not good.any():
        axes.text(0.5, 0.5, "no frames", transform=axes.transAxes, ha="center", color=SOFT)
        return
    span = slice(int(good.argmax()), len(good) - int(good[::-1].argmax()))  # from the first frame to the last one
    t, ratio = time[span], values[span]
    cells = ratio.shape[1]
    if cells > MOST_LINES:
        levels = [level for low, high, _ in BANDS for level in (low, high)]
        *edges, median = _find_quantiles(ratio, [*levels, 0.5])
        for i, (_, _, opacity) in enumerate(BANDS):
            axes.fill_between(t, edges[2 * i], edges[2 * i + 1], color=BLUE, alpha=opacity, linewidth=0, zorder=1)
        axes.plot(t, median, color=BLUE, linewidth=1.2, zorder=2)
    else:
        lines = np.stack([np.broadcast_to(t, (cells, len(t))), ratio.T], axis=-1)
        opacity = float(np.clip(30 / cells, 0.06, 0.6))  # 30 lines on top of each other are opaque
        axes.add_collection(LineCollection(list(lines), colors=BLUE, alpha=opacity, linewidths=0.6, zorder=1))
    if not good[-1]:
        axes.set_title(f"ends after t = {t[-1]:.4g} s", loc="right", fontsize=9, fontweight="normal", color=VERMILION)
    _mark_worst(axes, t, ratio, early=(t[0] + t[-1]) / 2 < (time[0] + time[-1]) / 2)


def _find_quantiles(ratio: Floats, levels: list[float]) -> Floats:
    """Return quantiles (q, t) of the cells of every frame (t, e) that have a value; NaN if none has."""
    out = np.full((len(levels), len(ratio)), np.nan)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(ratio).any(axis=1))
    whole = bool(np.isfinite(ratio[known]).all())
    out[:, known] = (np.quantile if whole else np.nanquantile)(ratio[known], levels, axis=1)
    return out


def _find_extremes(dataset: "xarray.Dataset") -> Floats:
    """Return the smallest and the largest det F in any cell (variant, 2, time); empty if they were not recorded."""
    names = ("volume_ratio_min", "volume_ratio_max")
    if not all(name in dataset for name in names):
        return np.empty((0, 2, 0))
    low, high = dataset[names[0]].min("cell"), dataset[names[1]].max("cell")  # without NaN
    return np.stack([edge.transpose("variant", "time").values for edge in (low, high)], axis=1)


def _mark_worst(axes: "Axes", t: Floats, ratio: Floats, *, early: bool) -> None:
    """Draw the cell with the largest |J - 1| as a thick line and label its peak."""
    when, cell = np.unravel_index(int(np.nan_to_num(np.abs(ratio - 1), nan=-1.0).argmax()), ratio.shape)
    value = ratio[when, cell]
    axes.plot(t, ratio[:, cell], color=VERMILION, linewidth=1.8, zorder=3)
    axes.plot(t[when], value, "o", color=VERMILION, markersize=5, markeredgecolor="white", zorder=4)
    rightward, upward = early or t[when] < (t[0] + t[-1]) / 2, value > 1
    axes.annotate(
        f"cell {cell}: {value:.3g} at t = {t[when]:.4g} s",
        (t[when], value),
        (0, 7 if upward else -7),
        textcoords="offset points",
        ha="left" if rightward else "right",
        va="bottom" if upward else "top",
        fontsize=9,
        color=VERMILION,
        zorder=5,
    )


def _choose_time_limits(time: Floats) -> tuple[float, float]:
    return (float(time[0]), float(time[-1])) if len(time) > 1 else (float(time[0]) - 0.5, float(time[0]) + 0.5)


def _set_limits(panels: "list[Axes]", time: Floats, ratio: Floats) -> None:
    """Give all panels the range of all values, at least 1 % on either side of 1."""
    finite = ratio[np.isfinite(ratio)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (1.0, 1.0)
    low, high = min(low, 0.99), max(high, 1.01)
    panels[0].set_ylim(low - 0.12 * (high - low), high + 0.12 * (high - low))
    panels[0].set_xlim(*_choose_time_limits(time))


def _add_volume_axis(axes: "Axes", rest: float, unit: str) -> None:
    """Add an axis of volumes on the right: all cells have the same rest volume, so one curve shows both."""

    def to_volume(ratio: Any) -> Any:
        return ratio * rest

    def to_ratio(volume: Any) -> Any:
        return volume / rest

    right = axes.secondary_yaxis("right", functions=(to_volume, to_ratio))
    right.set_ylabel(f"cell volume [{unit.replace('m3', 'm³').replace('m2', 'm²')}]")
