"""Reads the files of frames: inline .vtu and our own files in this process, others in a child, which may crash."""

import os
import re
from collections.abc import Sequence
from functools import lru_cache
from os.path import isfile  # pathlib's version raises if a name is longer than the system allows
from pathlib import Path
from stat import S_ISREG
from typing import NamedTuple

from pipeline.errors import SeriesError, shorten
from pipeline.formats import readers
from pipeline.formats.grid import Grid
from pipeline.formats.multiblock import (
    PIECEWISE_SUFFIXES,
    check_depth,
    find_first_piece,
    is_piecewise,
    list_pieces,
    read_own_times,
    read_pieces,
)
from pipeline.formats.parts import BodyPart, join_parts
from pipeline.formats.preflight import find_refusal
from pipeline.formats.sandbox import SHARED_READER
from pipeline.formats.times import find_time_field
from pipeline.formats.vtu_read import read_inline
from pipeline.formats.vtu_steps import find_step_times

# a number of the whole under another name than TimeValue: XML, or the data of a legacy file
_TIME_FIELD = re.compile(
    rb"<FieldData>.*?Name=\"(?:\w*time\w*|t)\"|^\s*(?:\w*time\w*|t) 1 1 \w+\s*$", re.I | re.M | re.S
)
_ENDS_AS_VTK_FILE = frozenset({".vtu", ".vtp", *PIECEWISE_SUFFIXES})


class FileTimes(NamedTuple):
    """The times [s] in a file, none if there are none, and the field that holds them if it is not TimeValue."""

    values: tuple[float, ...] = ()
    field: str = ""


def read_grid(file: Path, step: int = 0, *, others: Sequence[Path] = (), ours: bool = False) -> Grid:
    """Return one instant of a file and of the `others`, which are further parts of the body; raises SeriesError."""
    if not others:
        return _read_file(file, step, ours, 0)
    parts = [BodyPart(part.name, _read_file(part, step, ours, 0)) for part in (file, *others)]
    return join_parts(parts, str(file))


def _read_file(file: Path, step: int, ours: bool, depth: int) -> Grid:
    """Return one instant of a file; raises SeriesError if it cannot be read or has no cells."""
    if (grid := read_inline(file)) is not None:
        return grid
    if ours:
        return readers.read_grid(file, step)
    if is_piecewise(file):
        check_depth(file, depth)
        return read_pieces(file, lambda piece: _read_file(piece, step, ours, depth + 1), readers.SUFFIXES)
    _check_file(file)
    fields = SHARED_READER.read("pipeline.formats.readers:read_plain_grid", file, step, error=SeriesError)
    return readers.make_plain_grid(fields)


def read_times(file: Path) -> FileTimes:
    """Return the times in a file; raises SeriesError if it cannot be read."""
    if (grid := read_inline(file)) is not None:
        return _find_time(grid)
    return _read_other_times(file, 0)


def _read_other_times(file: Path, depth: int) -> FileTimes:
    """Return the times in a file that is no inline .vtu."""
    if is_piecewise(file):
        check_depth(file, depth)
        own = read_own_times(file)
        first = find_first_piece(file)
        if len(own) == 1 or first is None:
            return FileTimes(own[:1])
        grid = read_inline(first)
        return _read_other_times(first, depth + 1) if grid is None else _find_time(grid)
    _check_file(file)
    times = SHARED_READER.read("pipeline.formats.readers:read_times", file, error=SeriesError)
    if times and (len(times) == 1 or readers.is_temporal(file) or find_step_times(file)):
        return FileTimes(tuple(times))
    if times or _TIME_FIELD.search(_read_start(file)) is None:
        return FileTimes()
    return _find_time(_read_file(file, 0, ours=False, depth=0))


def _find_time(grid: Grid) -> FileTimes:
    """Return the time among the numbers of a grid, if it is one number."""
    name = find_time_field(grid.field_data)
    value = None if name is None else grid.field_data[name]
    if name is None or value is None or value.size != 1 or value.dtype.kind not in "fiu":
        return FileTimes()
    return FileTimes((float(value.ravel()[0]),), "" if name == "TimeValue" else name)


def _read_start(file: Path) -> bytes:
    """Return the beginning of a file, where the numbers of the whole are."""
    with file.open("rb") as stream:
        return stream.read(4096)


def _check_file(file: Path) -> None:
    if not isfile(file) and not readers.is_folder(file):
        raise SeriesError(f"{file}: no such file")
    if why := find_refusal(file):
        raise SeriesError(f"{file}: {why}")


def find_fault(file: Path, depth: int = 0) -> str | None:
    """Return the visible fault of a file that is missing, empty or cut off; None if there is none."""
    name = str(file)  # for thousands of files, pathlib and file objects would double the time
    try:
        status = os.stat(name)
    except (OSError, ValueError):  # ValueError: a name that no file can have
        return "is missing"
    if not S_ISREG(status.st_mode):
        if readers.is_folder(file):
            return None
        return "is missing"
    if not status.st_size and file.suffix != ".foam":  # its name stands for a folder
        return "is empty"
    suffix = ".vtu" if name.endswith(".vtu") else os.path.splitext(name)[1].lower()
    if suffix in _ENDS_AS_VTK_FILE:
        if b"</VTKFile>" not in _read_end(name, status.st_size):
            return "is truncated: it does not end with </VTKFile>"
        return _find_piece_fault(file, depth) if suffix in PIECEWISE_SUFFIXES else None
    if suffix == ".vtk":  # nothing at its end shows that it is complete
        return _find_legacy_fault(file, status.st_mtime_ns)
    return None


def find_pieces(file: Path) -> list[Path]:
    """Return the files that a file names, none if it is damaged or not of such a kind."""
    try:
        return [piece.file for piece in list_pieces(file)] if is_piecewise(file) else []
    except SeriesError:  # reported when the file is read
        return []


def _find_piece_fault(file: Path, depth: int) -> str | None:
    """Return the fault of the first piece that has one."""
    try:
        check_depth(file, depth)
        pieces = list_pieces(file)
    except SeriesError as error:
        return str(error).removeprefix(f"{file}: ")
    for piece in pieces:
        if piece.file.suffix.lower() in readers.SUFFIXES and (fault := find_fault(piece.file, depth + 1)):
            return f"has a piece, {shorten(piece.file.name)}, that {fault}"
    return None


def _read_end(name: str, size: int) -> bytes:
    """Return the last 200 bytes of a file."""
    descriptor = os.open(name, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    try:
        os.lseek(descriptor, max(0, size - 200), os.SEEK_SET)
        return os.read(descriptor, 200)
    finally:
        os.close(descriptor)


@lru_cache(maxsize=100_000)
def _find_legacy_fault(file: Path, _modified: int) -> str | None:
    try:
        _read_file(file, 0, ours=False, depth=0)
    except SeriesError as error:
        return str(error).removeprefix(f"{file}: ")
    return None
