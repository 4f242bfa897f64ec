"""The rest state of a series: a file, the field rest_position, x - u of a deformed first frame, or its points."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError, join_names
from pipeline.formats.grid import Grid, have_same_cells
from pipeline.formats.readers import SUFFIXES
from pipeline.series.body.arrangement import IdTable, match_by_ids
from pipeline.series.body.displacement import DisplacementChoice
from pipeline.series.files.frame_files import read_grid

_NAMED = ("first", "points", "rest_position")


class RestPositions(NamedTuple):
    """The rest positions (n, 3) of the first frame's points, notes, and a text for the two lines of an answer."""

    points: Floats
    notes: tuple[str, ...]
    text: str


def read_reference(
    rest: str | os.PathLike[str] | None, first: Grid, ids: IdTable, where: str
) -> tuple[Floats | None, str]:
    """Return the rest positions that a file or the field rest_position gives, and their source; None if neither does.

    The points of the file are the rest state, in the order of the first frame's points. Raises SeriesError.
    """
    if rest == "rest_position" or (rest is None and "rest_position" in first.point_data):
        if "rest_position" not in first.point_data:
            fields = join_names(sorted(first.point_data)) or "none"
            raise SeriesError(f"{where}: no point field rest_position; it has {fields}")
        values = np.asarray(first.point_data["rest_position"], dtype=np.float64)
        if values.ndim != 2 or values.shape[1] not in (2, 3):
            raise SeriesError(f"{where}: the point field rest_position {values.shape} is not a vector field")
        return np.pad(values, [(0, 0), (0, 3 - values.shape[1])]), "the field rest_position"
    if rest is None or rest in ("first", "points"):
        return None, ""
    file = Path(rest)
    if file.suffix not in SUFFIXES:
        raise SeriesError(f"rest state {file}: must be a file ({', '.join(SUFFIXES)}), {', '.join(_NAMED)}")
    grid = read_grid(file)
    if have_same_cells(grid, first) and ids.are_in_place(grid):
        return grid.points, f"the points of {file.name}"
    arrangement = match_by_ids(grid, ids)
    if arrangement is None:
        raise SeriesError(f"{where}: its cells are not those of the rest state {file}")
    return arrangement.select_nodes(grid.points), f"the points of {file.name}, matched by {ids.names}"


def find_rest_state(
    first: Grid, rest: str | os.PathLike[str] | None, reference: Floats | None, source: str, choice: DisplacementChoice
) -> RestPositions:
    """Return the rest state, given the reference that was read and the choice of the displacement."""
    if reference is not None:
        notes = () if source == "the field rest_position" else (f"the rest state is {source}",)
        return RestPositions(reference, notes, source)
    u = None if choice.vector is None else choice.vector.read(first)
    if choice.added:
        if rest == "first":
            moved = first.points if u is None else first.points + u
            return RestPositions(moved, (), "the first frame, deformed by its displacement")
        return RestPositions(first.points, (), "the points, without the displacement")
    if rest is None and u is not None and np.abs(u).max(initial=0.0) > 0:
        name = choice.vector.name if choice.vector is not None else ""
        if not np.isfinite(u).all():
            return RestPositions(first.points, ("the rest state is the first frame",), "the first frame")
        return RestPositions(first.points - u, (f"the rest state is the points of the first frame minus {name}",),
                         f"points of the first frame minus {name}")  # fmt: skip
    notes = () if rest else ("the rest state is the first frame",)
    return RestPositions(first.points, notes, "the points of the first frame")
