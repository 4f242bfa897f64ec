"""Our own result folders: which frames are ours, and those that a killed run's index does not list yet."""

import json
from os import sep
from pathlib import Path

from pipeline.formats import vtk_readers as grids

FRAMES = "frames"


def is_own(folder: Path, files: tuple[Path, ...]) -> bool:
    """Return whether the files are the frames of a run that a run.json beside them tells of."""
    try:
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    # by names: pathlib takes as long for a thousand files as it takes to look at them
    frame, one = str(folder / FRAMES / "frame_"), str(folder / "series.vtkhdf")
    known = isinstance(run, dict) and {"status", "case", "versions"} <= run.keys()
    return known and all(name == one or _is_frame(name, frame) for name in map(str, files))


def _is_frame(name: str, beginning: str) -> bool:
    return name.startswith(beginning) and name.endswith(".vtu") and sep not in name[len(beginning) :]


def find_unlisted_frames(folder: Path, listed: int) -> list[tuple[float, Path]]:
    """Return times [s] and files of the complete frames after the listed ones: an index is up to a second behind.

    They are taken in order; what lies behind a gap is of another run.
    """
    found: list[tuple[float, Path]] = []
    while (file := folder / FRAMES / f"frame_{listed + len(found):06d}.vtu").is_file():
        times = grids.file_times(file)
        if not times:
            break
        found.append((times[0], file))
    return found
