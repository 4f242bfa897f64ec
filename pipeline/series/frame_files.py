"""The files that frames lie in: inline .vtu and our own are read here, the others in a child process that may die."""

from functools import lru_cache
from pathlib import Path

from pipeline.errors import SeriesError
from pipeline.foreign import grids
from pipeline.foreign.claims import refusal
from pipeline.foreign.grids import SUFFIXES, Grid
from pipeline.foreign.reader import READER

__all__ = ["SUFFIXES", "Grid", "fault", "file_times", "read_grid"]


def read_grid(file: Path, step: int = 0, *, ours: bool = False) -> Grid:
    """Return one instant of a file; raises SeriesError where it cannot be read or is no unstructured grid."""
    if (grid := grids.inline_grid(file)) is not None:
        return grid
    if ours:
        return grids.read_grid(file, step)
    _check(file)
    return Grid(*READER.read("pipeline.foreign.grids:plain_grid", file, step, error=SeriesError))


def file_times(file: Path) -> list[float] | None:
    """Return the times [s] that a file knows of itself, None where it says nothing; raises SeriesError."""
    _check(file)
    times: list[float] | None = READER.read("pipeline.foreign.grids:file_times", file, error=SeriesError)
    return times


def _check(file: Path) -> None:
    if not file.is_file():
        raise SeriesError(f"{file}: no such file")
    if why := refusal(file):
        raise SeriesError(f"{file}: {why}")


def fault(file: Path) -> str | None:
    """Return what is wrong with a file that is not there, empty or cut off; None where nothing shows."""
    if not file.is_file():
        return "is missing"
    size = file.stat().st_size
    if not size:
        return "is empty"
    if file.suffix in (".vtu", ".pvtu", ".vtp"):
        with file.open("rb") as opened:
            opened.seek(max(0, size - 200))
            return None if b"</VTKFile>" in opened.read() else "is cut off: it does not end with </VTKFile>"
    if file.suffix == ".vtk":  # nothing at its end tells
        return _legacy_fault(file, file.stat().st_mtime_ns)
    return None


@lru_cache(maxsize=100_000)
def _legacy_fault(file: Path, _modified: int) -> str | None:
    try:
        read_grid(file)
    except SeriesError as error:
        return str(error).removeprefix(f"{file}: ")
    return None
