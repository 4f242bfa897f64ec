"""Reads the files of frames: inline .vtu and our own files in this process, others in a child, which may crash."""

import os
from functools import lru_cache
from os.path import isfile  # pathlib's version raises if a name is longer than the system allows
from pathlib import Path
from stat import S_ISREG

from pipeline.errors import SeriesError
from pipeline.formats import readers
from pipeline.formats.grid import Grid
from pipeline.formats.preflight import find_refusal
from pipeline.formats.sandbox import SHARED_READER
from pipeline.formats.vtu_read import read_inline


def read_grid(file: Path, step: int = 0, *, ours: bool = False) -> Grid:
    """Return one instant of a file; raises SeriesError if it cannot be read or is not an unstructured grid."""
    if (grid := read_inline(file)) is not None:
        return grid
    if ours:
        return readers.read_grid(file, step)
    _check_file(file)
    fields = SHARED_READER.read("pipeline.formats.readers:read_plain_grid", file, step, error=SeriesError)
    return readers.make_plain_grid(fields)


def read_times(file: Path) -> list[float] | None:
    """Return the times [s] in a file, or None if it has none; raises SeriesError if it cannot be read."""
    if (grid := read_inline(file)) is not None:
        values = grid.field_data.get("TimeValue")
        return None if values is None else [float(time) for time in values.ravel()]
    _check_file(file)
    times: list[float] | None = SHARED_READER.read("pipeline.formats.readers:read_times", file, error=SeriesError)
    return times


def _check_file(file: Path) -> None:
    if not isfile(file):
        raise SeriesError(f"{file}: no such file")
    if why := find_refusal(file):
        raise SeriesError(f"{file}: {why}")


def find_fault(file: Path) -> str | None:
    """Return the visible fault of a file that is missing, empty or cut off; None if there is none."""
    name = str(file)  # for thousands of files, pathlib and file objects would double the time
    try:
        status = os.stat(name)
    except (OSError, ValueError):  # ValueError: a name that no file can have
        return "is missing"
    if not S_ISREG(status.st_mode):
        return "is missing"
    if not status.st_size and file.suffix != ".foam":  # its name stands for a folder
        return "is empty"
    if name.endswith((".vtu", ".pvtu", ".vtp")):
        if b"</VTKFile>" in _read_end(name, status.st_size):
            return None
        return "is truncated: it does not end with </VTKFile>"
    if file.suffix == ".vtk":  # nothing at its end shows that it is complete
        return _find_legacy_fault(file, file.stat().st_mtime_ns)
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
        read_grid(file)
    except SeriesError as error:
        return str(error).removeprefix(f"{file}: ")
    return None
