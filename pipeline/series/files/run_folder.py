"""Our own result folders: whether frames are ours, and frames that the index of a killed run does not list yet."""

import json
from os import sep
from pathlib import Path

from pipeline.formats import readers

FRAMES = "frames"


def is_own(folder: Path, files: tuple[Path, ...]) -> bool:
    """Return whether the files are the frames of a run with a run.json beside them."""
    try:
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    # compared as text: for a thousand files, pathlib takes as long as looking at the files themselves
    frame, vtkhdf = str(folder / FRAMES / "frame_"), str(folder / "series.vtkhdf")
    known = isinstance(run, dict) and {"status", "case", "versions"} <= run.keys()
    return known and all(name == vtkhdf or _is_frame(name, frame) for name in map(str, files))


def _is_frame(name: str, beginning: str) -> bool:
    return name.startswith(beginning) and name.endswith(".vtu") and sep not in name[len(beginning) :]


def find_unlisted_frames(folder: Path, listed: int) -> list[tuple[float, Path]]:
    """Return times [s] and files of the complete frames after the `listed` ones: an index lags by up to a second.

    They end at the first gap; files after it belong to another run.
    """
    frames: list[tuple[float, Path]] = []
    while (file := folder / FRAMES / f"frame_{listed + len(frames):06d}.vtu").is_file():
        times = readers.read_times(file)
        if not times:
            break
        frames.append((times[0], file))
    return frames
