"""The decisions about a series in two lines: its points, rest state and times, and its cells and those left out."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats
from pipeline.formats.grid import Grid
from pipeline.mesh.cell_kinds import TYPES, explain_refusal
from pipeline.mesh.cell_mesh import CellMesh, measure_volumes
from pipeline.run.measures import get_units
from pipeline.series import Series
from pipeline.views.cell_text import describe_cells


def describe_reading(series: Series) -> tuple[str, str]:
    """Return the two lines."""
    count, times = len(series), series.times
    span = f"{count} frames from t = {times[0]:g} to {times[-1]:g} s" if count > 1 else f"one frame, t = {times[0]:g} s"
    counted = " (counted: the files have no times)" if any("counted from 0" in note for note in series.notes) else ""
    mesh = series.mesh
    volume = f"{mesh.rest_volumes.sum():.4g} {get_units('rest_volume', mesh.dimension)}"
    return (
        f"positions: {_describe_points(series)}; rest state: {_describe_rest(series)}; {span}{counted}",
        f"measured: {describe_cells([mesh])}, {volume} at rest; left out: {_describe_left_out(series)}",
    )


def _describe_points(series: Series) -> str:
    motion = series.layout.motion
    if motion.field is None:
        return "the points" + (", which do not move" if motion.at_rest else "")
    if motion.is_added:
        return f"points plus the field {motion.field.label}"
    return f"the points, which include the displacement {motion.field.label}"


def _describe_rest(series: Series) -> str:
    layout = series.layout
    if layout.rest_field is not None:
        return f"the field {layout.rest_field}"
    rest, points, motion = layout.at_rest.points, layout.grid.points, layout.motion
    if np.array_equal(rest, points, equal_nan=True):
        return "the points without the field" if motion.is_added else "the first frame"
    stated = [note for note in layout.notes if "rest state is " in note]
    if stated:
        return stated[0].partition("rest state is ")[2].partition(":")[0]
    return "not the points of the first frame"


def _describe_left_out(series: Series) -> str:
    """Return the number of cells of the first frame that are not measured, and their share of the volume."""
    layout, mesh = series.layout, series.mesh
    grid = layout.at_rest
    if layout.arrangement.cells is None:
        return "nothing"
    left = np.ones(len(grid.types), dtype=bool)
    left[layout.arrangement.cells] = False
    if not left.any():
        return "nothing"
    dimensions = np.array([TYPES[int(t)].dimension if int(t) in TYPES else 3 for t in grid.types])
    bulky = left & (dimensions == mesh.dimension)
    if not bulky.any():
        return f"{_count(left)} without volume (boundaries, lines, points)"
    volumes = _measure(series, grid)
    unknown = bulky & ~np.isfinite(volumes)
    share = np.nansum(np.abs(volumes[bulky])) / np.nansum(np.abs(volumes[dimensions == mesh.dimension]))
    text = f"{_count(left)}, {100 * share:.3g} % of the volume"
    return f"{text} and {_count(unknown)} of unknown volume" if unknown.any() else text


def _count(mask: NDArray[np.bool_]) -> str:
    return f"{mask.sum()} cell{'s' if mask.sum() > 1 else ''}"


def _measure(series: Series, grid: Grid) -> Floats:
    """Return the volumes of all cells of a grid, NaN for those that cannot be measured."""
    mesh = series.mesh
    pairs: Sequence[tuple[int, int]] = list(zip(grid.types.tolist(), np.diff(grid.offsets).tolist(), strict=True))
    if any(explain_refusal(*pair) for pair in set(pairs) if pair[0] in TYPES and TYPES[pair[0]].dimension > 1):
        return np.full(len(grid.types), np.nan)
    plane = mesh.plane if isinstance(mesh, CellMesh) else None
    return measure_volumes(grid.points[:, : mesh.points.shape[1]], grid.cells, mesh.dimension, plane)
