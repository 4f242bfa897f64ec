"""What keeps a result folder whole: one run at a time in it, an end on request, a start from where it stopped."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.case import OutputSpec
from pipeline.errors import CaseError, OutputError, SeriesError
from pipeline.formats.atomic import whole_file
from pipeline.formats.grid import Grid
from pipeline.formats.netcdf import NETCDF_LOCK
from pipeline.mesh.simplex import Mesh
from pipeline.problem.problem import Problem
from pipeline.results.checkpoint import Checkpoint, CheckpointFolder
from pipeline.run.measures import VARIABLES, measure
from pipeline.series.listing import FrameListing, Member
from pipeline.series.series import make_series
from pipeline.sinks.frame_formats import FORMATS
from pipeline.sinks.netcdf import NetcdfSink

CHECKPOINTS = "checkpoints"
LOCK = ".lock"
_PATIENCE = 2.0  # [s] what writes the frames of a run ends a moment after one that was killed
_STREAMS = 2  # the last number of a standard stream: a process that is started has its own there


class Interrupted(KeyboardInterrupt):
    """A run was asked to stop and did so after a step; the message says how to go on."""


@dataclass
class Interruption:
    """Whether a signal asked for an end; while `solving` it waits for the step, else it is a KeyboardInterrupt."""

    requested: bool = False
    solving: bool = False

    def ask(self, *_: Any) -> None:
        """Note that an end is asked for; the second time, or where no step is under way, end at once."""
        if self.requested or not self.solving:
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Yield what SIGINT and SIGTERM set: in the main thread, and where they are not ignored."""
    asked = Interruption()
    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            # None: a handler that is not Python's, which could not be put back
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, asked.ask)
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def folder_lock(folder: Path) -> Iterator[int]:
    """Hold the folder against every other run; the system lets go when this process ends, however it does.

    Yields the lock's descriptor: a process that inherits it holds the folder as well.

    Raises CaseError where another run holds it, OutputError where the lock file cannot be made. File systems without
    locks are not locked.
    """
    path = folder / LOCK
    descriptor = _locked(path)
    try:
        yield descriptor
    finally:
        # removed while it is held: who has opened it meanwhile finds that it is no longer the file of that name
        if _is_file_of(descriptor, path):
            with suppress(OSError):  # Windows does not remove open files
                path.unlink()
        os.close(descriptor)


def _locked(path: Path) -> int:
    """Return the descriptor of the lock file, locked; who holds it is given a moment to end."""
    deadline = time.monotonic() + _PATIENCE
    while True:
        descriptor = _opened(path)
        try:
            if _taken(descriptor, path):
                return descriptor
        except CaseError:
            if time.monotonic() > deadline:
                os.close(descriptor)
                raise
            time.sleep(0.02)
        os.close(descriptor)


def _opened(path: Path) -> int:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, low = os.open(path, os.O_RDWR | os.O_CREAT, 0o644), []
    except (FileExistsError, NotADirectoryError) as error:
        raise OutputError(f"{path}: part of this path is a file, not a folder") from error
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror})") from error
    while descriptor <= _STREAMS:
        low.append(descriptor)
        descriptor = os.dup(descriptor)
    for one in low:
        os.close(one)
    return descriptor


def _taken(descriptor: int, path: Path) -> bool:
    """Return whether the lock is ours and the file still the one of that name; raises CaseError."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError) as error:
        raise CaseError(f"{path.parent}: another run is writing there; wait for it, or use --out") from error
    except OSError:  # a file system without locks
        return True
    return _is_file_of(descriptor, path)


def _is_file_of(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:
        return False


def mesh_digest(mesh: Mesh) -> str:
    """Return a checksum of points and cells: a mesh file of the same name may have changed."""
    return sha256(mesh.points.tobytes() + mesh.cells.tobytes()).hexdigest()


def continuation(
    folder: Path, problem: Problem, output: OutputSpec, *, title: str
) -> tuple[Checkpoint | None, list[str]]:
    """Return the last checkpoint whose frames are all there, and notes; None where there is no such one.

    statistics.nc is made anew from the frames before the checkpoint: a killed run may have left it torn. Where the
    frames are rounded, the values of cells are those of the old file, each held against the frame.
    """
    for hidden in folder.rglob(".*.tmp*"):
        hidden.unlink(missing_ok=True)
    notes = []
    for found in CheckpointFolder(folder / CHECKPOINTS, seconds=0.0).readable():
        if isinstance(found, str):
            notes.append(found)
            continue
        try:
            _remake_statistics(folder, problem, output, next_frame(found, problem), title)
        except SeriesError as error:
            notes.append(f"the checkpoint of step {found.state.step} cannot be used ({error})")
        else:
            return found, notes
    return None, [*notes, f"{folder}: no checkpoint to go on from; solved from the start"]


def next_frame(checkpoint: Checkpoint, problem: Problem) -> int:
    """Return the index of the first frame that is to be written after a checkpoint."""
    return -(-checkpoint.state.step // problem.steps_per_frame)


def frame_times(count: int, problem: Problem) -> list[float]:
    """Return the times [s] of the first frames, to the bit those that a run gives them."""
    return [index * problem.steps_per_frame * problem.dt for index in range(count)]


def _remake_statistics(folder: Path, problem: Problem, output: OutputSpec, count: int, title: str) -> None:
    """Write statistics.nc of the first `count` frames from their files; raises SeriesError, OutputError."""
    places = [FORMATS[output.format].place(index) for index in range(count)]
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
        old = stack.enter_context(_old_statistics(path, count)) if rounded else None
        sink = NetcdfSink(stack.enter_context(whole_file(path)), title=title)
        stack.callback(sink.close)
        for index in range(count):
            grid = series.read_grid(index)
            read = replace(series.read_frame(index, grid), mesh=problem.body.mesh)
            if read.step != index * problem.steps_per_frame:
                raise SeriesError(f"{files[index]}: frame {index} is not there")
            sink.write(read, measure(read) if old is None else {**read.known, **_cell_rows(old, grid, index)})


@contextmanager
def _old_statistics(path: Path, count: int) -> Iterator[Any]:
    """Yield the dataset of statistics.nc, its first `count` frames still there; raises SeriesError."""
    import netCDF4

    try:
        with NETCDF_LOCK, netCDF4.Dataset(path) as old:
            old.set_auto_mask(False)
            if len(old.dimensions["time"]) < count:
                raise SeriesError(f"{path}: {len(old.dimensions['time'])} of {count} frames, and the files are rounded")
            yield old
    except (OSError, RuntimeError, KeyError, IndexError) as error:
        raise SeriesError(f"{path}: cannot be read, and the files are rounded ({error})") from error


def _cell_rows(old: Any, grid: Grid, index: int) -> dict[str, Any]:
    """Return what a dataset says of the cells in a frame; raises SeriesError where its file says something else."""
    rows = {name: old[name][index] for name, variable in VARIABLES.items() if variable.dims == ("cell",)}
    for name, row in rows.items():
        if not np.array_equal(row.astype(np.float32), grid.cell_data[name]):
            raise SeriesError(f"statistics.nc: {name} of frame {index} is not that of its file")
    return rows
