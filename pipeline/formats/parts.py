"""Joins the parts of a body, read from several files, pieces or blocks, into one grid."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.blocks import join_blocks
from pipeline.formats.cell_kinds import TYPES
from pipeline.formats.grid import Grid, have_same_cells

_COUNTS: dict[str, Callable[[Grid], int]] = {
    "point_data": lambda grid: grid.count, "cell_data": lambda grid: len(grid.types)
}  # fmt: skip


class BodyPart(NamedTuple):
    """A part of a body and its name."""

    name: str
    grid: Grid


def join_parts(parts: Sequence[BodyPart], where: str) -> Grid:
    """Return one grid with the points and cells of all parts, in their order; coincident points are not merged.

    Parts whose cells have fewer dimensions, such as the boundary of a body, are left out with a note: they often lack
    its fields. Parts with equal points and cells are one part with the fields of both. A field that some parts lack is
    NaN there, with a note. Raises SeriesError if equal parts have different values of one field.
    """
    solid, notes = _drop_boundaries(parts)
    separate, more_notes = _combine_equal_parts(solid, where)
    notes += more_notes
    if len(separate) == 1 and len(parts) == 1:
        return parts[0].grid
    grids = _mark_none_as_copies([part.grid for part in separate])
    joined = join_blocks(grids, [part.name for part in separate])
    whole, whole_notes = _join_numbers(grids)
    sizes, names = _name_parts(separate)
    own_notes = dict.fromkeys((*(note for part in parts for note in part.grid.notes), *joined.notes))
    sizes, names = (sizes, names) if len(sizes) > 1 else ((), ())
    return replace(joined, field_data=whole, parts=sizes, part_names=names, notes=(*own_notes, *notes, *whole_notes))


def _drop_boundaries(parts: Sequence[BodyPart]) -> tuple[list[BodyPart], list[str]]:
    """Return the parts that have cells of the highest dimension, and a note on the others."""
    dimensions = [_find_dimension(part.grid) for part in parts]
    lower = [part.name for part, own in zip(parts, dimensions, strict=True) if own < max(dimensions)]
    if not lower:
        return list(parts), []
    note = f"left out, as their cells have fewer dimensions than those of the body: {join_names(lower)}"
    return [part for part, own in zip(parts, dimensions, strict=True) if own == max(dimensions)], [note]


def _find_dimension(grid: Grid) -> int:
    """Return the highest dimension of the cells."""
    return max((TYPES[kind].dimension for kind in np.unique(grid.types).tolist() if kind in TYPES), default=0)


def _combine_equal_parts(parts: Sequence[BodyPart], where: str) -> tuple[list[BodyPart], list[str]]:
    """Return the parts without repeated ones, whose fields go to the first of them, and a note."""
    separate, notes = list[BodyPart](), list[str]()
    alike = dict[tuple[int, int], list[int]]()  # places in `separate` by numbers of points and cells
    for part in parts:
        places = alike.setdefault((part.grid.count, len(part.grid.types)), [])
        same = next((i for i in places if _are_same(separate[i].grid, part.grid)), None)
        if same is None:
            places.append(len(separate))
            separate.append(part)
        else:
            other = separate[same]
            separate[same] = BodyPart(other.name, _combine_fields(other, part, where))
            notes.append(f"{shorten(other.name)} and {shorten(part.name)} have the same cells: one part of the body")
    return separate, notes


def _are_same(a: Grid, b: Grid) -> bool:
    """Return whether two parts have the same cells in the same place; marked copies are left to the layout."""
    if any(_is_mark(name) for grid in (a, b) for name in (*grid.cell_data, *grid.point_data)):
        return False
    return have_same_cells(a, b) and np.array_equal(a.points, b.points)


def _combine_fields(first: BodyPart, second: BodyPart, where: str) -> Grid:
    """Return the first of two equal parts with the fields of both."""
    fields: dict[str, Any] = {}
    for kind in ("point_data", "cell_data"):
        known, more = dict(getattr(first.grid, kind)), getattr(second.grid, kind)
        for name in known.keys() & more.keys():
            if not _are_equal(known[name], more[name]):
                raise SeriesError(
                    f"{where}: {shorten(first.name)} and {shorten(second.name)} have the same points and cells but "
                    f"different values of {shorten(name)}: name one of them as the series"
                )
        fields[kind] = known | dict(more)
    return replace(first.grid, **fields)


def _are_equal(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == b.dtype.kind == "f")


def _mark_none_as_copies(grids: Sequence[Grid]) -> list[Grid]:
    """Return the grids with a zero mark if only others mark their copies of cells or points."""
    marked = list(grids)
    for kind, count in _COUNTS.items():
        marks = {name: a for grid in grids for name, a in getattr(grid, kind).items() if _is_mark(name)}
        for i, grid in enumerate(marked):
            fields = getattr(grid, kind)
            none = {n: np.zeros((count(grid), *a.shape[1:]), a.dtype) for n, a in marks.items() if n not in fields}
            more: dict[str, Any] = {kind: {**fields, **none}}
            marked[i] = replace(marked[i], **more) if none else marked[i]
    return marked


def _name_parts(parts: Sequence[BodyPart]) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Return the sizes and names of the parts; a part that was joined itself counts as its own parts."""
    sizes, names = list[int](), list[str]()
    for name, grid in parts:
        sizes += grid.parts or (grid.count,)
        names += [f"{name}/{own}" for own in grid.part_names] or [name]
    return tuple(sizes), tuple(names)


def _is_mark(name: str) -> bool:
    """Return whether a field marks copies of cells or points, which parts without copies need not have."""
    return "ghost" in name.lower()


def _join_numbers(grids: Sequence[Grid]) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Return the numbers of the whole that all parts agree on, the first one's time, and a note on the others."""
    whole, unequal = dict[str, NDArray[Any]](), list[str]()
    for name in dict.fromkeys(name for grid in grids for name in grid.field_data):
        values = [grid.field_data[name] for grid in grids if name in grid.field_data]
        if name == "TimeValue" or all(_are_equal(values[0], value) for value in values[1:]):
            whole[name] = values[0]
        else:
            unequal.append(name)
    return whole, [f"the numbers {join_names(unequal)} differ between parts and are left out"] if unequal else []
