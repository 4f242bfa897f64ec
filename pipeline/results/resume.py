"""Continuing an unfinished run: the last usable checkpoint, and statistics.nc rebuilt from the frames before it."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.case import OutputSpec
from pipeline.errors import SeriesError
from pipeline.fem.body import Body
from pipeline.formats.atomic import replace_file
from pipeline.formats.grid import Grid
from pipeline.formats.netcdf import NETCDF_LOCK
from pipeline.problem.problem import Problem
from pipeline.results.checkpoint import Checkpoint, CheckpointFolder
from pipeline.run.frame import Frame
from pipeline.run.measures import VARIABLES, measure
from pipeline.series.files.instants import Member
from pipeline.series.files.listing import FrameListing
from pipeline.series.series import make_series
from pipeline.sinks.frame_formats import FORMATS
from pipeline.sinks.netcdf import NetcdfSink

CHECKPOINTS = "checkpoints"


def digest_body(body: Body) -> str:
    """Return a checksum of points, cells and materials by cell, which shows whether a mesh file has changed."""
    total, m = sha256(body.mesh.points.tobytes() + body.mesh.cells.tobytes()), body.material
    for values in (m.youngs_modulus, m.poisson_ratio, m.density):
        if isinstance(values, np.ndarray):  # numbers are in the case
            total.update(values.tobytes())
    return total.hexdigest()


def prepare_resume(
    folder: Path, problem: Problem, output: OutputSpec, *, title: str
) -> tuple[Checkpoint | None, list[str]]:
    """Return the last checkpoint whose frames all exist, or None if there is none, and notes.

    statistics.nc is rebuilt from the frames before the checkpoint, since a killed run may have damaged it. If frames
    are rounded, the values of cells come from the old file and are compared with each frame.
    """
    for unfinished in folder.rglob(".*.tmp*"):
        unfinished.unlink(missing_ok=True)
    notes = []
    for checkpoint in CheckpointFolder(folder / CHECKPOINTS, seconds=0.0).iterate_readable():
        if isinstance(checkpoint, str):
            notes.append(checkpoint)
            continue
        try:
            _rebuild_statistics(folder, problem, output, next_frame_index(checkpoint, problem), title)
        except SeriesError as error:
            notes.append(f"{folder}: the checkpoint of step {checkpoint.state.step} cannot be used ({error})")
        else:
            return checkpoint, notes
    return None, [*notes, f"{folder}: no usable checkpoint; solved from the start"]


def next_frame_index(checkpoint: Checkpoint, problem: Problem) -> int:
    """Return the index of the first frame after a checkpoint."""
    return -(-checkpoint.state.step // problem.steps_per_frame)


def frame_times(count: int, problem: Problem) -> list[float]:
    """Return the times [s] of the first frames, bit for bit as a run computes them."""
    return [index * problem.steps_per_frame * problem.dt for index in range(count)]


def _rebuild_statistics(folder: Path, problem: Problem, output: OutputSpec, count: int, title: str) -> None:
    """Write statistics.nc of the first `count` frames from their files; raises SeriesError, OutputError."""
    places = [FORMATS[output.format].locate(index) for index in range(count)]
    files = tuple(folder / name for name, _ in places)
    for file in files:
        if not file.is_file():
            raise SeriesError(f"{file}: missing")
    steps = [step for _, step in places]
    members = tuple(Member(*row) for row in zip(frame_times(count, problem), files, steps, strict=True))
    series, _ = make_series(FrameListing(title, folder, members, (), ours=True))
    path = folder / "statistics.nc"
    rounded = output.precision == "float32"
    with ExitStack() as stack:
        old = stack.enter_context(_open_old_statistics(path, count)) if rounded else None
        sink = NetcdfSink(stack.enter_context(replace_file(path)), title=title)
        stack.callback(sink.close)
        for index in range(count):
            grid = series.read_grid(index)
            read = replace(series.read_frame(index, grid), mesh=problem.body.mesh)
            if read.step != index * problem.steps_per_frame:
                raise SeriesError(f"{files[index]}: holds step {read.step}, not step {index * problem.steps_per_frame}")
            sink.write(read, measure(read) if old is None else _collect_values(read, old, grid, index))


@contextmanager
def _open_old_statistics(path: Path, count: int) -> Iterator[Any]:
    """Yield the dataset of statistics.nc; raises SeriesError if it has fewer than `count` frames."""
    import netCDF4

    try:
        with NETCDF_LOCK, netCDF4.Dataset(path) as old:
            old.set_auto_mask(False)
            if len(old.dimensions["time"]) < count:
                raise SeriesError(
                    f"{path}: has {len(old.dimensions['time'])} of {count} frames, and the frame files are rounded"
                )
            yield old
    except (OSError, RuntimeError, KeyError, IndexError) as error:
        raise SeriesError(f"{path}: cannot be read, and the frame files are rounded ({error})") from error


def _collect_values(read: Frame, old: Any, grid: Grid, index: int) -> dict[str, Any]:
    """Return the values of a frame whose positions are rounded: those of its file, and of the old statistics."""
    center = grid.field_data["center_of_mass"].ravel()
    return {"center_of_mass": center, **read.known, **_read_cell_values(old, grid, index)}


def _read_cell_values(old: Any, grid: Grid, index: int) -> dict[str, Any]:
    """Return a dataset's values of the cells in a frame; raises SeriesError if the frame's file has other values."""
    rows = {
        name: old[name][index]
        for name, variable in VARIABLES.items()
        if name in old.variables and variable.dims == ("cell",)
    }
    for name, row in rows.items():
        if not np.array_equal(row.astype(np.float32), grid.cell_data[name]):
            raise SeriesError(f"statistics.nc: {name} of frame {index} differs from that in the frame's file")
    return rows
