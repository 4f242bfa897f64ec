"""Figures of a comparison dataset: volume ratio of every cell, and energies, over time."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import OutputError
from pipeline.formats.atomic import whole_file

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_LINES = 2000  # more lines than this merge into one patch and take seconds to draw
# Okabe and Ito: told apart with any colour vision, and in grey by lightness
BLUE, VERMILION, GREEN, BLACK = "#0072B2", "#D55E00", "#009E73", "#1b1e28"
BANDS = ((0.0, 1.0, 0.14), (0.05, 0.95, 0.22), (0.25, 0.75, 0.34))  # lower and upper quantile, opacity
ENERGIES = {"kinetic": (BLUE, "-"), "elastic": (VERMILION, "--"), "potential": (GREEN, "-.")}
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans", "font.size": 10, "axes.spines.top": False, "axes.edgecolor": "#626875",
    "axes.labelcolor": BLACK, "xtick.color": "#626875", "ytick.color": "#626875", "axes.titleweight": "bold",
}  # fmt: skip


def volume_figure(dataset: "xarray.Dataset", path: Path, *, title: str) -> None:
    """Write the volume ratio of every cell over time, a panel a variant, the worst cell marked.

    Takes volume_ratio (variant, time, cell) and rest_volume (cell). Above 2000 cells bands of quantiles
    stand for the lines. NaN, as after a failure, is left out. Raises OutputError where it cannot write.
    """
    from matplotlib import rc_context

    with rc_context(STYLE):
        methods = [str(name) for name in dataset["variant"].values]
        figure, panels = _panels(len(methods), title)
        time = dataset["time"].values
        ratio = dataset["volume_ratio"].transpose("variant", "time", "cell").values
        for axes, name, values in zip(panels, methods, ratio, strict=True):
            axes.set_title(name, loc="left", fontsize=11, color=BLACK)
            _draw_ratios(axes, time, values)
        cells = ratio.shape[2]
        meaning = "light to dark: extremes, 5-95 %, 25-75 %, median" if cells > MOST_LINES else "one line each"
        figure.supxlabel(f"{cells} cells, {meaning}; the worst one in colour", fontsize=8, color="#626875")
        _limits(panels, time, ratio)
        _label_outer(panels, "volume ratio V / V₀")
        rest = dataset["rest_volume"].values
        # 1e-6: far above rounding, far below what the axis can show
        if np.ptp(rest) <= 1e-6 * rest.max():
            _volume_axis(panels[-1], float(rest.mean()), str(dataset["rest_volume"].attrs.get("units", "m3")))
        _save(figure, path)


def energy_figure(dataset: "xarray.Dataset", path: Path, *, title: str) -> None:
    """Write kinetic, elastic, potential and total energy over time, a panel a variant.

    The total is that of the parts present. Raises OutputError where there is none of them.
    """
    from matplotlib import rc_context

    present = [name for name in ENERGIES if f"{name}_energy" in dataset]
    if not present:
        raise OutputError(f"{path}: no energies to draw: the dataset has none of {', '.join(ENERGIES)}_energy")
    with rc_context(STYLE):
        methods = [str(name) for name in dataset["variant"].values]
        figure, panels = _panels(len(methods), title)
        time = dataset["time"].values
        scale, prefix = _prefix(max(float(np.nan_to_num(np.abs(dataset[f"{n}_energy"].values)).max()) for n in present))
        for i, (axes, method) in enumerate(zip(panels, methods, strict=True)):
            axes.set_title(method, loc="left", fontsize=11, color=BLACK)
            axes.axhline(0, color="#b0b5bf", linewidth=0.8)
            parts = {n: dataset[f"{n}_energy"].transpose("variant", "time").values[i] / scale for n in present}
            for name, values in parts.items():
                colour, dashes = ENERGIES[name]
                axes.plot(time, values, dashes, color=colour, linewidth=1.5, label=name)
            if len(parts) > 1:
                axes.plot(time, sum(parts.values()), color=BLACK, linewidth=2.0, label="total")
        panels[0].set_xlim(*_time_limits(time))
        unit = str(dataset[f"{present[0]}_energy"].attrs.get("units", "J"))
        _label_outer(panels, f"energy [{prefix}{unit}]")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
        _save(figure, path)


def distance_figure(dataset: "xarray.Dataset", path: Path, *, title: str) -> None:
    """Write how far the nodes of each series are from those of the first over time, a panel each.

    Takes node_distance_worst and node_distance_rms (variant, time). Raises OutputError where it cannot write.
    """
    from matplotlib import rc_context

    with rc_context(STYLE):
        names, time = [str(name) for name in dataset["variant"].values], dataset["time"].values
        figure, panels = _panels(len(names) - 1, title)
        lines = (("worst node", "node_distance_worst", VERMILION, "-"), ("RMS of all", "node_distance_rms", BLUE, "--"))
        for i, (axes, name) in enumerate(zip(panels, names[1:], strict=True), start=1):
            axes.set_title(f"{name}, from {names[0]}", loc="left", fontsize=11, color=BLACK)
            for label, variable, colour, dashes in lines:
                values = dataset[variable].transpose("variant", "time").values[i]
                axes.plot(time, values, dashes, color=colour, linewidth=1.5, label=label)
        panels[0].set_xlim(*_time_limits(time))
        panels[0].set_ylim(bottom=0)
        _label_outer(panels, "distance of nodes [m]")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
        _save(figure, path)


RUNGS = (("linear", GREEN), ("corotational", BLUE), ("converged", VERMILION))


def effort_figure(datasets: "Mapping[str, xarray.Dataset]", path: Path, *, title: str) -> None:
    """Write which model every step of model = "auto" needed, and how many solves, a panel a variant.

    Takes step_rung and step_solves (step) of each variant. Raises OutputError where it cannot write.
    """
    from matplotlib import rc_context
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    with rc_context(STYLE):
        figure, panels = _panels(len(datasets), title)
        for axes, (name, dataset) in zip(panels, datasets.items(), strict=True):
            step, solves, rung = (dataset[n].values for n in ("step", "step_solves", "step_rung"))
            counts = [int((rung == i).sum()) for i in range(len(RUNGS))]
            for i, (_, colour) in enumerate(RUNGS):
                axes.bar(step[rung == i], solves[rung == i], width=1.0, color=colour, linewidth=0)
            told = ", ".join(f"{n} {label}" for n, (label, _) in zip(counts, RUNGS, strict=True) if n)
            axes.set_title(f"{name}: {told} steps", loc="left", fontsize=11, color=BLACK)
        _label_outer(panels, "solves")
        for axes in panels:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
            axes.set_xlabel("step" if axes.get_xlabel() else "")
        handles = [Patch(color=colour, label=label) for label, colour in RUNGS]
        figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
        _save(figure, path)


def _prefix(largest: float) -> tuple[float, str]:
    """Return the power of 1000, and its letter, that leaves one to three digits before the point."""
    return next(((f, p) for f, p in ((1e9, "G"), (1e6, "M"), (1e3, "k")) if largest >= f), (1.0, ""))


def _panels(count: int, title: str) -> "tuple[Figure, list[Axes]]":
    """Return a figure and its axes, shared, at most three in a row."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(count, 3) if count != 4 else 2
    rows = -(-count // columns)
    figure = Figure(figsize=(2.0 + 4.0 * columns + (2.0 if columns == 1 else 0), 1.2 + 3.4 * rows), dpi=150)
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained", wspace=0.04, hspace=0.06)
    figure.suptitle(title, fontsize=14, fontweight="bold", color=BLACK)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for empty in grid.ravel()[count:]:
        empty.set_visible(False)
    return figure, list(grid.ravel()[:count])


def _label_outer(panels: "list[Axes]", quantity: str) -> None:
    for axes in panels:
        spec = axes.get_subplotspec()
        assert spec is not None
        if spec.is_first_col():
            axes.set_ylabel(quantity)
        # a panel with nothing below it carries the times, also above an empty place of the grid
        below = spec.rowspan.stop * spec.get_gridspec().ncols + spec.colspan.start
        if below >= len(panels):
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
        axes.spines["right"].set_visible(False)
        axes.margins(x=0)


def _draw_ratios(axes: "Axes", time: Floats, values: Floats) -> None:
    """Draw one variant (time, cell): thin lines or bands, the level 1, and the worst cell."""
    from matplotlib.collections import LineCollection

    axes.axhline(1, color=BLACK, linewidth=0.9, linestyle=(0, (4, 3)), zorder=2)
    good = np.isfinite(values).all(axis=1)
    if not good.any():
        axes.text(0.5, 0.5, "no frame", transform=axes.transAxes, ha="center", color="#626875")
        return
    t, kept = time[good], values[good]
    cells = kept.shape[1]
    if cells > MOST_LINES:
        for low, high, opacity in BANDS:
            edges = np.quantile(kept, [low, high], axis=1)
            axes.fill_between(t, edges[0], edges[1], color=BLUE, alpha=opacity, linewidth=0, zorder=1)
        axes.plot(t, np.median(kept, axis=1), color=BLUE, linewidth=1.2, zorder=2)
    else:
        lines = np.stack([np.broadcast_to(t, (cells, len(t))), kept.T], axis=-1)
        opacity = float(np.clip(30 / cells, 0.06, 0.6))
        axes.add_collection(LineCollection(list(lines), colors=BLUE, alpha=opacity, linewidths=0.6, zorder=1))
    if not good.all():
        axes.set_title(f"ends after t = {t[-1]:.4g} s", loc="right", fontsize=9, fontweight="normal", color=VERMILION)
    _mark_worst(axes, t, kept, early=(t[0] + t[-1]) / 2 < (time[0] + time[-1]) / 2)


def _mark_worst(axes: "Axes", t: Floats, kept: Floats, *, early: bool) -> None:
    """Draw the cell with the largest |J - 1| strongly, and say which and when beside its peak."""
    when, cell = np.unravel_index(int(np.abs(kept - 1).argmax()), kept.shape)
    value = kept[when, cell]
    axes.plot(t, kept[:, cell], color=VERMILION, linewidth=1.8, zorder=3)
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


def _time_limits(time: Floats) -> tuple[float, float]:
    return (float(time[0]), float(time[-1])) if len(time) > 1 else (float(time[0]) - 0.5, float(time[0]) + 0.5)


def _limits(panels: "list[Axes]", time: Floats, ratio: Floats) -> None:
    """Give all panels the range of all values, at least 1 % to either side of 1."""
    finite = ratio[np.isfinite(ratio)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (1.0, 1.0)
    low, high = min(low, 0.99), max(high, 1.01)
    panels[0].set_ylim(low - 0.12 * (high - low), high + 0.12 * (high - low))
    panels[0].set_xlim(*_time_limits(time))


def _volume_axis(axes: "Axes", rest: float, unit: str) -> None:
    """Add volumes at the right: all cells have the same rest volume, so ratio and volume are one curve."""

    def to_volume(ratio: Any) -> Any:
        return ratio * rest

    def to_ratio(volume: Any) -> Any:
        return volume / rest

    right = axes.secondary_yaxis("right", functions=(to_volume, to_ratio))
    right.set_ylabel(f"volume of a cell [{unit.replace('m3', 'm³').replace('m2', 'm²')}]")


def _save(figure: "Figure", path: Path) -> None:
    with whole_file(path) as temporary:
        # no version in the file: the same results are the same bytes
        figure.savefig(temporary, metadata={"Software": None} if path.suffix == ".png" else None)
