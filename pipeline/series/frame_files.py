"""The files that frames lie in: inline .vtu and our own are read here, the others in a child process that may die."""

import os
from functools import lru_cache
from os.path import isfile  # pathlib's raises where a name is longer than the system allows
from pathlib import Path
from stat import S_ISREG

from pipeline.errors import SeriesError
from pipeline.formats import vtk_readers as grids
from pipeline.formats.preflight import refusal
from pipeline.formats.sandbox import READER
from pipeline.formats.vtk_readers import SUFFIXES, Grid

__all__ = ["SUFFIXES", "Grid", "find_fault", "read_grid", "read_times"]


def read_grid(file: Path, step: int = 0, *, ours: bool = False) -> Grid:
    """Return one instant of a file; raises SeriesError where it cannot be read or is no unstructured grid."""
    if (grid := grids.inline_grid(file)) is not None:
        return grid
    if ours:
        return grids.read_grid(file, step)
    _check(file)
    return Grid(*READER.read("pipeline.formats.vtk_readers:plain_grid", file, step, error=SeriesError))


def read_times(file: Path) -> list[float] | None:
    """Return the times [s] that a file knows of itself, None where it says nothing; raises SeriesError."""
    if (grid := grids.inline_grid(file)) is not None:
        told = grid.field_data.get("TimeValue")
        return None if told is None else [float(time) for time in told.ravel()]
    _check(file)
    times: list[float] | None = READER.read("pipeline.formats.vtk_readers:file_times", file, error=SeriesError)
    return times


def _check(file: Path) -> None:
    if not isfile(file):
        raise SeriesError(f"{file}: no such file")
    if why := refusal(file):
        raise SeriesError(f"{file}: {why}")


def find_fault(file: Path) -> str | None:
    """Return what is wrong with a file that is not there, empty or cut off; None where nothing shows."""
    name = str(file)  # pathlib and file objects would take as long again, of thousands of files
    try:
        found = os.stat(name)
    except (OSError, ValueError):  # ValueError: a name that no file can have
        return "is missing"
    if not S_ISREG(found.st_mode):
        return "is missing"
    if not found.st_size:
        return "is empty"
    if name.endswith((".vtu", ".pvtu", ".vtp")):
        return None if b"</VTKFile>" in _end(name, found.st_size) else "is cut off: it does not end with </VTKFile>"
    if file.suffix == ".vtk":  # nothing at its end tells
        return _legacy_fault(file, file.stat().st_mtime_ns)
    return None


def _end(name: str, size: int) -> bytes:
    """Return the last bytes of a file."""
    opened = os.open(name, os.O_RDONLY | getattr(os, "O_BINARY", 0))
    try:
        os.lseek(opened, max(0, size - 200), os.SEEK_SET)
        return os.read(opened, 200)
    finally:
        os.close(opened)


@lru_cache(maxsize=100_000)
def _legacy_fault(file: Path, _modified: int) -> str | None:
    try:
        read_grid(file)
    except SeriesError as error:
        return str(error).removeprefix(f"{file}: ")
    return None
