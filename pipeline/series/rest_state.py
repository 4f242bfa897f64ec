"""The rest state of a series: a field or a file of rest positions, points minus displacement, or the first frame."""

import os
from pathlib import Path

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.grid import Grid
from pipeline.formats.readers import SUFFIXES
from pipeline.series.displacement import Displacement
from pipeline.series.frame_files import read_grid

FIELD = "rest_position"
_WORDS = ("first", "points", "subtract")


def read_rest_file(rest: str | os.PathLike[str] | None, first: Grid, where: str) -> Floats | None:
    """Return the points (n, 3) of the rest state if the caller names a file, else None.

    Raises SeriesError if it is neither a file nor a word, or if the cells of the file differ from the first frame's.
    """
    if rest is None or str(rest) in (*_WORDS, FIELD) or str(rest) in first.point_data:
        return None
    file = Path(rest)
    if file.suffix.lower() not in SUFFIXES:
        raise SeriesError(
            f"rest state {file}: must be a file ({', '.join(SUFFIXES)}), a point field, or one of "
            f"{', '.join((*_WORDS, FIELD))}"
        )
    grid = read_grid(file)
    if grid.count != first.count or not np.array_equal(grid.connectivity, first.connectivity):
        raise SeriesError(f"{where}: its cells are not those of the rest state {file}")
    return grid.points


def choose_rest_points(
    first: Grid, displacement: Displacement, rest: str | os.PathLike[str] | None, from_file: Floats | None, where: str
) -> tuple[Floats, tuple[str, ...]]:
    """Return the points of the rest state (n, 3), and a note about the choice; raises SeriesError."""
    field = displacement.field
    moved = field.read(first) if field is not None else np.zeros((first.count, 3))
    if from_file is not None:
        return from_file, (f"the rest state is {Path(str(rest)).name}",)
    if rest is None and FIELD in first.point_data:
        return _read_field(first, FIELD, where), ()
    if rest is None and displacement.is_added:
        return first.points, ()
    if rest == "subtract":
        if field is None:
            raise SeriesError(f'{where}: rest = "subtract" needs a displacement field (displacement = NAME)')
        return first.points - moved, (f"the rest state is the first frame minus {field.label}",)
    if rest is None and field is not None and np.abs(moved).max() > 0:
        note = f"the first frame is displaced already: the rest state is its points minus {field.label}"
        return first.points - moved, (note,)
    if rest in (None, "first"):
        points = first.points + moved if displacement.is_added else first.points
        return points, ("the rest state is the first frame",) if rest is None else ()
    if rest == "points":
        return first.points, ()
    return _read_field(first, str(rest), where), ()


def _read_field(first: Grid, name: str, where: str) -> Floats:
    if name not in first.point_data:
        known = join_names(sorted(first.point_data)) or "none"
        raise SeriesError(f"{where}: no point field {shorten(name)}; it has {known}")
    values = np.asarray(first.point_data[name], dtype=np.float64)
    if values.ndim != 2 or values.shape[1] not in (2, 3):
        raise SeriesError(f"{where}: the point field {shorten(name)} {values.shape} cannot be rest positions")
    return np.pad(values, [(0, 0), (0, 3 - values.shape[1])])
