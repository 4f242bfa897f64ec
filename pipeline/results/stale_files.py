"""Results of an earlier analysis in a folder: those of another series must not stay beside new ones."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from pipeline.errors import OutputError, join_names

# all that an analysis or a comparison writes
_NAMES = ("statistics.nc", "comparison.nc", "volume.png", "distance.png", "movie.mp4", "movie.png", "report.html",
          "series.pvd", "open_in_paraview.py")  # fmt: skip


def hash_file(path: Path) -> str | None:
    """Return a hash of a file's content, None if there is none."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def remove_stale(folder: Path, dataset: Path, before: str | None, written: Iterable[Path]) -> list[str]:
    """Remove an earlier analysis from a folder unless it is of the same series; return a note if there was one.

    `dataset` is the new dataset, `before` the hash of the file that it replaced: the same numbers are the same bytes.
    Files just `written` stay. Raises OutputError.
    """
    if before is not None and before == hash_file(dataset):
        return []
    fresh = {path.name for path in written}
    stale = [name for name in _NAMES if name not in fresh and (folder / name).is_file()]
    if not any(name.endswith(".nc") for name in stale) and before is None:
        return []  # nothing there was written by an analysis
    try:
        for name in stale:
            (folder / name).unlink()
    except OSError as error:
        raise OutputError(f"{folder}: files of an earlier analysis cannot be removed ({error.strerror})") from error
    return [f"{folder}: {join_names(stale)} of another analysis removed"] if stale else []
