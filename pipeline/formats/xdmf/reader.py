"""XDMF 2 and 3: the instants of a file as grids.

Several collections, one a function, describe one body: their fields are joined. Grids side by side are its parts.
"""

import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.blocks import join_blocks
from pipeline.formats.bodies import are_apart
from pipeline.formats.cell_types import find_cell_fault
from pipeline.formats.grid import CellArray, Grid, have_same_cells
from pipeline.formats.xdmf.cells import get_dimension, read_mesh
from pipeline.formats.xdmf.document import XdmfDocument
from pipeline.formats.xdmf.fields import read_fields
from pipeline.formats.xdmf.steps import XdmfPiece, XdmfSeries, list_steps


class _OpenFile(NamedTuple):
    """A file's elements and instants; `meshes` has the meshes read last, by their elements."""

    document: XdmfDocument
    series: XdmfSeries
    meshes: dict[tuple[int, int], tuple[Floats, CellArray]]


def read_xdmf(file: Path, step: int) -> Grid:
    """Return one instant of a file; raises SeriesError."""
    with _name_file(file):
        opened = _open(file, file.stat().st_mtime_ns)
        notes = list(opened.series.notes)
        layers = [_read_pieces(opened, pieces) for pieces in opened.series.select(step)]
        grid = _join_layers(layers, notes) if layers else None
        grid = _add_static(opened, grid, notes)
        return replace(grid, notes=(*dict.fromkeys(notes), *grid.notes))


def read_xdmf_times(file: Path) -> list[float] | None:
    """Return the times [s] of the instants, None for a single one without a time."""
    with _name_file(file):
        times = _open(file, file.stat().st_mtime_ns).series.times
    return None if times is None else list(times)


@contextmanager
def _name_file(file: Path) -> Iterator[None]:
    """Turn the faults of a file into a SeriesError."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise SeriesError(f"{file}: its arrays are in an HDF5 file; pip install {error.name}") from error
    except FileNotFoundError as error:
        raise SeriesError(f"{file}: {shorten(' '.join(str(error).split()), 300)}") from error
    except (ValueError, KeyError, IndexError, OSError, OverflowError, ET.ParseError, zlib.error) as error:
        raise SeriesError(f"{file}: cannot be read: {shorten(' '.join(str(error).split()), 400)}") from error


@lru_cache(maxsize=4)
def _open(file: Path, _modified: int) -> _OpenFile:
    document = XdmfDocument(file)
    return _OpenFile(document, list_steps(document), {})


def _read_pieces(opened: _OpenFile, pieces: tuple[XdmfPiece, ...]) -> Grid:
    """Return the grids of one layer as one."""
    opened.meshes.update(fresh := {_key(piece): _read_mesh(opened, piece) for piece in pieces})
    for key in opened.meshes.keys() - fresh.keys():
        if len(opened.meshes) > 2 * len(fresh) + 4:  # a moving mesh would fill the memory
            del opened.meshes[key]
    return _join_pieces([_read_piece(opened, piece) for piece in pieces], [piece.name for piece in pieces])


def _join_pieces(grids: Sequence[Grid], names: Sequence[str]) -> Grid:
    """Return parts as one grid; raises ValueError if two of them are one body at two times."""
    for (one, a), (two, b) in pairwise(zip(names, grids, strict=True)):
        if have_same_cells(a, b) and not np.array_equal(a.points, b.points) and not are_apart(a, b):
            raise ValueError(
                f"its grids {shorten(one)} and {shorten(two)} are the same cells in almost the same place, so they are "
                "frames, not parts of a body: put them into a temporal collection, each with its Time"
            )
    return join_blocks(grids, names)


def _key(piece: XdmfPiece) -> tuple[int, int]:
    return id(piece.topology), id(piece.geometry)


def _read_mesh(opened: _OpenFile, piece: XdmfPiece) -> tuple[Floats, CellArray]:
    if _key(piece) in opened.meshes:
        return opened.meshes[_key(piece)]
    if piece.topology is None or piece.geometry is None:
        missing = "topology" if piece.topology is None else "geometry"
        raise ValueError(f"its grid {shorten(piece.name)} has no {missing}")
    points, cells = read_mesh(opened.document, piece.topology, piece.geometry)
    if fault := find_cell_fault(cells.types, cells.offsets, len(cells.connectivity)):
        raise ValueError(fault)
    return points, cells


def _read_piece(opened: _OpenFile, piece: XdmfPiece) -> Grid:
    points, cells = _read_mesh(opened, piece)
    fields = read_fields(opened.document, piece.attributes, len(points), cells)
    return Grid(
        points, len(points), cells.types, cells.offsets, cells.connectivity, fields.nodal, fields.cellular,
        fields.whole, cells.faces, notes=tuple(fields.notes),
    )  # fmt: skip


def _join_layers(layers: list[Grid], notes: list[str]) -> Grid:
    """Return the first grid with the fields of all; raises ValueError if another one has a mesh of its own."""
    first = layers[0]
    for other in layers[1:]:
        if not _have_same_mesh(first, other):
            raise ValueError(
                f"its collections have different meshes ({_describe(first)}, and {_describe(other)}): "
                "write each into a file of its own"
            )
        first = _merge_fields(first, other, notes)
    return first


def _have_same_mesh(a: Grid, b: Grid) -> bool:
    return have_same_cells(a, b) and np.array_equal(a.points, b.points, equal_nan=True)


def _describe(grid: Grid) -> str:
    fields = join_names([*grid.point_data, *grid.cell_data]) or "no fields"
    return f"{grid.count} points and {len(grid.types)} cells with {fields}"


def _merge_fields(grid: Grid, other: Grid, notes: list[str]) -> Grid:
    """Return a grid with the fields of another one of the same mesh; a name used by both gets a number."""
    merged = []
    for own, more in (
        (grid.point_data, other.point_data), (grid.cell_data, other.cell_data), (grid.field_data, other.field_data)
    ):  # fmt: skip
        fields = dict(own)
        for name, values in more.items():
            if name in fields and np.array_equal(fields[name], values):
                continue
            free = next(n for n in (name, *(f"{name}_{i}" for i in range(2, 1000))) if n not in fields)
            if free != name:
                notes.append(f"two collections have a field {shorten(name)}; the second is named {shorten(free)}")
            fields[free] = values
        merged.append(fields)
    return replace(
        grid, point_data=merged[0], cell_data=merged[1], field_data=merged[2], notes=(*grid.notes, *other.notes)
    )


def _add_static(opened: _OpenFile, grid: Grid | None, notes: list[str]) -> Grid:
    """Return the grid with the fields of grids without a time that have its mesh.

    Without any grid in time, grids of the largest dimension are parts of the body. Others are left out with a note:
    mostly boundary cells with marks.
    """
    parts, names = [] if grid is None else [grid], [""]
    for piece in opened.series.static:
        other = _read_pieces(opened, (piece,))
        same = next((i for i, part in enumerate(parts) if _have_same_mesh(part, other)), None)
        if same is not None:
            parts[same] = _merge_fields(parts[same], other, notes)
        elif grid is not None:
            notes.append(f"the grid {shorten(piece.name)} ({_describe(other)}) has no time and is left out")
        else:
            names = [*names[: len(parts)], piece.name]
            parts.append(other)
    if not parts:
        raise ValueError("it has no grid with cells")
    largest = max(get_dimension(part.cells) for part in parts)
    kept = [i for i, part in enumerate(parts) if get_dimension(part.cells) == largest]
    for i in sorted(set(range(len(parts))) - set(kept)):
        notes.append(f"the grid {shorten(names[i])} ({_describe(parts[i])}) has cells of less dimensions: left out")
    return _join_pieces([parts[i] for i in kept], [names[i] for i in kept])
