"""Which cells of a grid are measured: those of the highest dimension, each once; a note counts the others.

Left out are cells of lower dimension (boundary faces, lines, vertices), ghost copies of other ranks' cells, cells that
are there twice, and kinds that cannot be measured.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from pipeline.arrays import Floats, Ints
from pipeline.errors import SeriesError, join_names
from pipeline.formats.cell_kinds import TYPES, explain_refusal
from pipeline.formats.grid import CellArray, Grid
from pipeline.series.body.cell_arrays import select_array
from pipeline.series.body.cell_sides import join_coincident

_GHOSTS = {"vtkghosttype": 1, "vtkghostlevels": 1, "ghosttype": 1, "ghostlevel": 1, "ghost_cells": 1, "ghostcells": 1,
           "is_ghost": 1, "isghost": 1, "ghost": 1, "ghostrank": 0, "ghost_rank": 0}  # fmt: skip
_HULLS = 1000  # cells whose volumes are estimated
_GHOST_BITS = 1 | 32  # of vtkGhostType: a duplicate, or a hidden cell


@dataclass(frozen=True)
class CellChoice:
    """The dimension of the measured cells, their numbers in the grid (e,), notes, and the cells left out."""

    dimension: int
    cells: Ints
    notes: tuple[str, ...]
    unmeasured: Ints  # cells of that dimension that cannot be measured
    without_volume: int  # cells of lower dimension


def choose_cells(grid: Grid, where: str) -> CellChoice:
    """Return the cells to measure; raises SeriesError if there are none."""
    types, sizes = grid.types.astype(np.int64), np.diff(grid.offsets)
    ghosts = find_ghosts(grid)
    dimensions, reasons = np.zeros(len(types), dtype=np.int64), dict[tuple[int, int], str]()
    refused = np.zeros(len(types), dtype=bool)
    keys = types << 40 | sizes  # one number for both: rows take ten times as long to sort
    for key in np.unique(keys).tolist():
        number, size, mask = key >> 40, key & ((1 << 40) - 1), keys == key
        dimensions[mask] = TYPES[number].dimension if number in TYPES else 0
        if reason := explain_refusal(number, size):
            refused |= mask
            reasons[number, size] = reason
    d = int(dimensions[~ghosts].max(initial=0))
    top = (dimensions == d) & ~ghosts
    chosen = top & ~refused
    if d < 2 or not chosen.any():
        raise SeriesError(f"{where}: {_explain_nothing(types[~ghosts], reasons, d)}")
    notes = []
    if count := int((ghosts & (dimensions == d)).sum()):
        notes.append(f"{count} ghost cells (copies of other parts' cells) are left out")
    if others := _count_names(types[(dimensions < d) & ~ghosts]):
        notes.append(f"cells of lower dimension are not measured (no volume): {_join_counts(others)}")
    if unmeasured := _count_names(types[top & refused]):
        why = next(
            reason for (number, _), reason in reasons.items() if number in TYPES and TYPES[number].dimension == d
        )
        notes.append(f"left out, because they cannot be measured: {_join_counts(unmeasured)}; {why}")
    lower = int(((dimensions < d) & ~ghosts).sum())
    return CellChoice(d, np.flatnonzero(chosen), tuple(notes), np.flatnonzero(top & refused), lower)


def find_ghosts(grid: Grid) -> NDArray[np.bool_]:
    """Return the mask of cells that an array marks as copies of other ranks' cells."""
    mask = np.zeros(len(grid.types), dtype=bool)
    for name in grid.cell_data:
        key = name.lower()
        if key not in _GHOSTS:
            continue
        values = np.asarray(grid.cell_data[name]).reshape(len(mask), -1)
        if values.shape[1] != 1 or values.dtype.kind not in "iufb":
            continue
        level = values[:, 0]
        if key == "vtkghosttype":
            mask |= (level.astype(np.int64) & _GHOST_BITS) > 0
        elif key in ("ghostrank", "ghost_rank"):  # GEOS: -2 and -1 for cells of this rank's own, else the owner
            mask |= (level >= 0) & (level.min(initial=0) < 0)
        else:
            mask |= level >= _GHOSTS[key]
    return mask if not mask.all() else np.zeros(len(mask), dtype=bool)


def find_doubled_cells(points: Floats, cells: CellArray) -> Ints:
    """Return the numbers of the cells that have the nodes of an earlier one, or nodes at the same places."""
    joined = join_coincident(points)
    sizes, doubled = np.diff(cells.offsets), [np.zeros(0, dtype=np.int64)]
    # cells with the same nodes have the same sum of random numbers of these; few others do
    marks = np.random.default_rng(0).integers(1 << 62, size=len(points), dtype=np.uint64)[joined[cells.connectivity]]
    sums = np.diff(np.concatenate([np.zeros(1, np.uint64), np.cumsum(marks, dtype=np.uint64)])[cells.offsets])
    _, inverse, counts = np.unique(sums, return_inverse=True, return_counts=True)
    suspected = counts[inverse.ravel()] > 1
    for size in np.unique(sizes[suspected]).tolist():
        group = np.flatnonzero((sizes == size) & suspected)
        nodes = np.sort(joined[cells.connectivity[cells.offsets[group][:, None] + np.arange(size)]], axis=1)
        _, first = np.unique(nodes, axis=0, return_index=True)
        doubled.append(np.delete(group, first))
    return np.sort(np.concatenate(doubled)).astype(np.int64)


def extract_cells(grid: Grid, chosen: Ints) -> CellArray:
    """Return some cells of a grid, by their numbers."""
    if len(chosen) == len(grid.types):
        return grid.cells
    return select_array(grid.cells, chosen)


def describe_left_out(grid: Grid, rest: Floats, choice: CellChoice, flat: int, measured: float) -> str:
    """Return the cells that are not measured, and their share of the volume; empty if there are none.

    The volume of cells that cannot be measured is estimated by the convex hulls of their points.
    """
    texts = []
    if count := len(choice.unmeasured):
        total = sum(_estimate_volume(rest[_find_nodes(grid, cell)]) for cell in choice.unmeasured[:_HULLS].tolist())
        total *= count / min(count, _HULLS)
        share = f"about {100 * total / (total + measured):.2g} %" if choice.dimension == 3 else "an unknown share"
        texts.append(f"{_count_cells(count)} that cannot be measured ({share} of the volume)")
    if flat:
        texts.append(f"{_count_cells(flat)} that are flat (0 % of the volume)")
    if choice.without_volume:
        texts.append(f"{_count_cells(choice.without_volume)} of lower dimension (no volume)")
    return ", ".join(texts)


def _count_cells(count: int) -> str:
    return f"{count} cell{'s' if count > 1 else ''}"


def _find_nodes(grid: Grid, cell: int) -> Ints:
    return np.unique(grid.connectivity[grid.offsets[cell] : grid.offsets[cell + 1]])


def _estimate_volume(points: Floats) -> float:
    """Return the volume of the convex hull of points, 0 if they are flat."""
    try:
        return float(ConvexHull(points).volume)
    except QhullError:
        return 0.0


def _count_names(types: Ints) -> dict[str, int]:
    counts = Counter(types.tolist())
    return {_name(number): count for number, count in sorted(counts.items())}


def _name(number: int) -> str:
    return TYPES[number].name if number in TYPES else f"type {number}"


def _join_counts(counts: dict[str, int]) -> str:
    return join_names(f"{count} {name}" for name, count in counts.items())


def _explain_nothing(types: Ints, reasons: dict[tuple[int, int], str], dimension: int) -> str:
    """Return why no cell can be measured, and the remedy."""
    if not len(types):
        return "it has no cells; write the mesh along with the points"
    if dimension >= 2:
        return next(reason for (number, _), reason in reasons.items() if TYPES[number].dimension == dimension)
    return (
        f"it has no cells with a volume or an area, but {_join_counts(_count_names(types))}: trusses, beams and "
        "particles cannot be measured; write the solid or surface cells of the body"
    )
