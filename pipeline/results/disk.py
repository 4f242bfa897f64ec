"""The disk space that a run will need, checked before anything is solved."""

import shutil
from collections.abc import Mapping
from pathlib import Path

from pipeline.case.keys import OutputSpec
from pipeline.errors import OutputError
from pipeline.problem.problem import Problem
from pipeline.run.measures import QUANTILES
from pipeline.sinks.netcdf import CHUNK_FRAMES

# Fitted to eight scenes of 64 to 10 000 cells: the estimate is 0.88 to 1.68 times their size; with eight of order 2 it
# is 0.93 to 1.10 times. A motion's numbers hardly compress: zlib at its best level and base64 give 1.27 times their
# size. Cells and regular rest points compress well.
_FRAME_BYTES, _FRAME_CELL_BYTES = 6500, 7
_ENCODED_SHARE = {"vtu": 1.27, "vtkhdf": 1.0}
_VALUE_BYTES = {"float64": 8, "float32": 4}
_NUMBERS_PER_FRAME = 36 + len(QUANTILES)  # per body, in statistics.nc
_DATASET_BYTES = 20_000
_MARGIN = 1.1


def estimate_bytes(problem: Problem, output: OutputSpec) -> float:
    """Return the estimated size of the frames and statistics of a problem, and of its share of comparison.nc."""
    mesh = problem.body.mesh
    (n, d), e, count = mesh.points.shape, len(mesh.cells), problem.frame_count
    # volume ratio and rotation angle per cell, also the extremes of the ratio if it varies in a cell
    varying = 2 if mesh.order == 1 else 4
    # position, displacement and velocity per node; a cell also has its volume
    numbers = (3 * d * n + (varying + 1) * e) * _VALUE_BYTES[output.precision] * _ENCODED_SHARE[output.format]
    frame = _FRAME_BYTES + numbers + _FRAME_CELL_BYTES * e
    chunked = -(-count // CHUNK_FRAMES) * CHUNK_FRAMES
    dataset = _DATASET_BYTES + 8 * varying * e * count + 8 * _NUMBERS_PER_FRAME * chunked
    return count * frame + 2 * dataset


def check_disk_space(folder: Path, problems: Mapping[str, tuple[Problem, OutputSpec]]) -> None:
    """Raise OutputError if the variants of a case need more space than is free.

    The files already in their folders count as free, since a run continues or replaces them.
    """
    needed = sum(max(estimate_bytes(*row) - _measure_folder(folder / name), 0.0) for name, row in problems.items())
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    free = shutil.disk_usage(existing).free
    if needed * _MARGIN <= free:
        return
    frames = sum(problem.frame_count for problem, _ in problems.values())
    raise OutputError(
        f"{folder}: {frames} frames of {', '.join(problems)} need about {_format_bytes(needed)} and "
        f"{_format_bytes(free)} are free; use fewer schedule.frames, fewer variants (--variant) or another disk (--out)"
    )


def _measure_folder(folder: Path) -> float:
    return float(sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()))


def _format_bytes(size: float) -> str:
    """Return bytes as MB, GB or TB."""
    unit, name = next(((u, n) for u, n in ((1e12, "TB"), (1e9, "GB")) if size >= u), (1e6, "MB"))
    return f"{size / unit:.3g} {name}"
