"""Every format that frames are read from: one row per file suffix.

These readers run in the calling process, which a damaged file can crash, so foreign files are read through the sandbox.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.errors import SeriesError, shorten
from pipeline.formats.grid import Grid, PolyhedronFaces
from pipeline.formats.vtk_readers import read_legacy_times, read_vtk, read_vtk_times
from pipeline.formats.xdmf import read_xdmf, read_xdmf_times


class FrameReader(NamedTuple):
    """Reads one instant of a file, and the times [s] stored in it (None if there are none)."""

    read: Callable[[Path, int], Grid]
    read_times: Callable[[Path], list[float] | None]
    has_steps: bool = False  # one file holds a whole series


READERS: Mapping[str, FrameReader] = {
    ".vtu": FrameReader(read_vtk, read_vtk_times),
    ".pvtu": FrameReader(read_vtk, read_vtk_times),
    ".vtk": FrameReader(read_vtk, read_legacy_times),
    ".vtp": FrameReader(read_vtk, read_vtk_times),
    ".vtkhdf": FrameReader(read_vtk, read_vtk_times, has_steps=True),
    ".xdmf": FrameReader(read_xdmf, read_xdmf_times, has_steps=True),
    ".xmf": FrameReader(read_xdmf, read_xdmf_times, has_steps=True),
}
SUFFIXES = tuple(suffix for suffix, row in READERS.items() if not row.has_steps)
TEMPORAL_SUFFIXES = tuple(suffix for suffix, row in READERS.items() if row.has_steps)


def read_grid(file: Path, step: int = 0) -> Grid:
    """Return one instant of a file; raises SeriesError if it cannot be read or is not an unstructured grid."""
    if not file.is_file():
        raise SeriesError(f"{file}: no such file")
    return _find_reader(file).read(file, step)


def read_plain_grid(file: Path, step: int) -> tuple[Any, ...]:
    """Return the fields of read_grid's Grid as plain arrays, numbers and texts, which a child process can send."""
    grid = read_grid(file, step)
    fields = (grid.point_data, grid.cell_data, grid.field_data)
    cells = (grid.types, grid.offsets, grid.connectivity)
    faces = None if grid.faces is None else tuple(grid.faces)
    return grid.points, grid.count, *cells, *fields, faces, grid.parts, grid.part_names, grid.notes


def make_plain_grid(fields: tuple[Any, ...]) -> Grid:
    """Return the Grid whose fields read_plain_grid returned."""
    points, count, types, offsets, connectivity, nodal, cellular, whole, faces, *parts = fields
    own_faces = None if faces is None else PolyhedronFaces(*faces)
    return Grid(points, count, types, offsets, connectivity, nodal, cellular, whole, own_faces, *parts)


def read_times(file: Path) -> list[float] | None:
    """Return the times [s] stored in a file, None if there are none; raises SeriesError."""
    return _find_reader(file).read_times(file)


def _find_reader(file: Path) -> FrameReader:
    if file.suffix not in READERS:
        suffix = shorten(file.suffix) or "a file without suffix"
        raise SeriesError(f"{file}: there is no reader for {suffix}; choose from {', '.join(READERS)}")
    return READERS[file.suffix]
