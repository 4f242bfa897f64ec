"""One grid of several: blocks, partitions and pieces of a body at one instant."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Fields, Ints
from pipeline.formats.grid import Grid, PolyhedronFaces


def join_blocks(grids: Sequence[Grid], names: Sequence[str]) -> Grid:
    """Return one grid with the points and cells of all of them, one after another, and each one's name in part_names.

    A field that some of them lack is NaN there. A field with other components in one of them is left out with a note.
    """
    if len(grids) == 1:
        return grids[0]
    starts = np.cumsum([0, *(grid.count for grid in grids)])
    connectivity = [grid.connectivity + start for grid, start in zip(grids, starts, strict=False)]
    notes = dict.fromkeys(note for grid in grids for note in grid.notes)
    whole: dict[str, NDArray[Any]] = {}
    for grid in grids:
        for name, values in grid.field_data.items():
            whole.setdefault(name, values)
    return Grid(
        np.concatenate([grid.points for grid in grids]),
        int(starts[-1]),
        np.concatenate([grid.types for grid in grids]),
        _join_offsets([grid.offsets for grid in grids]),
        np.concatenate(connectivity),
        _join_fields(grids, lambda grid: grid.point_data, lambda grid: grid.count, notes),
        _join_fields(grids, lambda grid: grid.cell_data, lambda grid: len(grid.types), notes),
        whole,
        _join_faces(grids, starts),
        tuple(grid.count for grid in grids),
        tuple(names),
        tuple(notes),
    )


def join_by_number(grids: Sequence[Grid], names: Sequence[str], number: str) -> Grid:
    """Return one grid of blocks that share points: equal values of the point field `number` are one point.

    The points are in the order of these numbers; the field itself is left out.
    """
    joined = join_blocks(grids, names)
    numbers, first, inverse = np.unique(joined.point_data[number], return_index=True, return_inverse=True)
    faces = joined.faces
    return replace(
        joined,
        stored_points=joined.points[first],
        count=len(numbers),
        connectivity=inverse[joined.connectivity],
        point_data={name: values[first] for name, values in joined.point_data.items() if name != number},
        faces=None if faces is None else faces._replace(connectivity=inverse[faces.connectivity]),
        parts=(),
        part_names=(),
    )


def _join_offsets(offsets: Sequence[Ints]) -> Ints:
    ends = np.cumsum([0, *(int(part[-1]) for part in offsets)])
    parts = [part[1:] + end for part, end in zip(offsets, ends, strict=False)]
    return np.concatenate([np.zeros(1, dtype=np.int64), *parts])


def _join_fields(
    grids: Sequence[Grid], get: Callable[[Grid], Fields], count: Callable[[Grid], int], notes: dict[str, None]
) -> dict[str, NDArray[Any]]:
    fields: dict[str, NDArray[Any]] = {}
    for name in dict.fromkeys(name for grid in grids for name in get(grid)):
        parts = [np.asarray(get(grid)[name]) if name in get(grid) else None for grid in grids]
        shapes = {part.shape[1:] for part in parts if part is not None}
        if len(shapes) > 1 or any(part is not None and part.dtype.kind not in "fiub" for part in parts):
            notes[f"the field {name} differs in shape between the parts and is left out"] = None
            continue
        shape = shapes.pop()
        missing = [part is None for part in parts]
        filled = [
            np.full((count(grid), *shape), np.nan) if part is None else part
            for grid, part in zip(grids, parts, strict=True)
        ]
        if any(missing):
            notes[f"the field {name} is missing in {sum(missing)} of {len(grids)} parts: NaN there"] = None
        fields[name] = np.concatenate(filled)
    return fields


def _join_faces(grids: Sequence[Grid], starts: Ints) -> PolyhedronFaces | None:
    if all(grid.faces is None for grid in grids):
        return None
    empty = np.zeros(0, dtype=np.int64)
    faces = [
        PolyhedronFaces(empty, np.zeros(1, np.int64), np.zeros(len(grid.types) + 1, np.int64))
        if grid.faces is None
        else grid.faces
        for grid in grids
    ]
    connectivity = np.concatenate([part.connectivity + start for part, start in zip(faces, starts, strict=False)])
    offsets = _join_offsets([part.offsets for part in faces])
    return PolyhedronFaces(connectivity, offsets, _join_offsets([part.cell_offsets for part in faces]))
