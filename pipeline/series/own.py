"""Our own result folders: which frames are ours, and those that a killed run's index does not list yet."""

import json
from pathlib import Path

from pipeline.foreign import grids

FRAMES = "frames"


def is_own(folder: Path, files: tuple[Path, ...]) -> bool:
    """Return whether the files are the frames of a run that a run.json beside them tells of."""
    try:
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    place, one = folder / FRAMES, folder / "series.vtkhdf"
    known = isinstance(run, dict) and {"status", "case", "versions"} <= run.keys()
    return known and all(file == one or (file.parent == place and file.match("frame_*.vtu")) for file in files)


def unlisted(folder: Path, listed: int) -> list[tuple[float, Path]]:
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
