"""A run of one variant: solved from the start or a checkpoint and recorded in its folder; run.json has the outcome."""

import json
import os
import platform
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from threadpoolctl import threadpool_limits

from pipeline.case import Case
from pipeline.errors import OutputError, SolveError, shorten
from pipeline.formats.atomic import write_whole
from pipeline.problem.problem import Problem
from pipeline.problem.stage_solvers import list_linear_solvers
from pipeline.results.checkpoint import Checkpoint, CheckpointFolder
from pipeline.results.failure import FILE as FAILURE
from pipeline.results.failure import examine_failure
from pipeline.results.interrupt import Interrupted, InterruptRequest
from pipeline.results.resume import CHECKPOINTS, digest_body, frame_times, next_frame_index, prepare_resume
from pipeline.run.frame import Frame, Sink
from pipeline.run.frame_iterator import frames
from pipeline.run.recording import Recording, RunSummary, Watcher, drive
from pipeline.sinks.frame_formats import FORMATS
from pipeline.sinks.netcdf import NetcdfSink
from pipeline.sinks.writer_process import WORTH_A_PROCESS, WriterProcess
from pipeline.stepping.report import Effort
from pipeline.stepping.state import State
from pipeline.system.version import VERSION

Status = Literal["finished", "failed", "up to date"]
OnVariantFrame = Callable[[str, Problem, Frame, RunSummary], None]
# runs that can continue: killed, stopped by the user, or stopped because a file could not be written
UNFINISHED = ("running", "interrupted")
_ROUNDED = "output.precision = 'float32': statistics.nc cannot be rebuilt from the frames, which are rounded"
# packages whose version can change a digit of the results or a byte of the files
_PACKAGES = ("numpy", "scipy", "pyvista", "vtk", "meshio", "xarray", "netCDF4", "numba")


@dataclass(frozen=True, repr=False)
class VariantResult:
    """The folder of a variant, its outcome, and its run.json."""

    name: str
    folder: Path
    status: Status
    run: dict[str, Any]

    def __repr__(self) -> str:
        return f"<VariantResult {self.name}: {self.status}, in {self.folder}>"

    @property
    def index(self) -> Path:
        """Return the file that lists the frames, for ParaView and read_series."""
        return self.folder / FORMATS[self.run["case"]["output"]["format"]].index


def read_run(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return a variant's run.json, or {} if there is none; raises OutputError if it cannot be read."""
    path = Path(folder) / "run.json"
    try:
        run = json.loads(path.read_text())
    except FileNotFoundError:
        return {}
    except NotADirectoryError as error:
        raise OutputError(f"{path}: part of this path is a file, not a folder") from error
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: cannot be read ({error}); remove it or use --force") from error
    if not (isinstance(run, dict) and {"status", "case", "versions"} <= run.keys()):
        raise OutputError(f"{path}: cannot be read (not the record of a run); remove it or use --force")
    return run


def result_settings(case: Case) -> dict[str, Any]:
    """Return the part of a case that its results depend on: everything except the movie and the checkpoints."""
    document = {key: value for key, value in case.as_dict().items() if key != "movie"}
    document["output"] = {key: value for key, value in document["output"].items() if not key.startswith("checkpoint_")}
    return document


def describe_difference(old: dict[str, Any], new: dict[str, Any]) -> str:
    """Return the first three keys in which two cases differ, with both values."""
    before, after = _flatten(old), _flatten(new)
    keys = [key for key in {**before, **after} if before.get(key) != after.get(key)]
    lines = [f"{key}: {shorten(str(before.get(key)))} there, {shorten(str(after.get(key)))} here" for key in keys[:3]]
    return "; ".join(lines) + (f"; and {len(keys) - 3} more" if len(keys) > 3 else "")


def _flatten(value: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(value, dict):
        return {prefix: value}
    inner = (_flatten(entry, f"{prefix}.{key}" if prefix else key) for key, entry in value.items())
    return {key: entry for entries in inner for key, entry in entries.items()}


class VariantRun:
    """Solves one variant and records it, from the start or from a checkpoint."""

    def __init__(
        self,
        case: Case,
        problem: Problem,
        folder: Path,
        interrupt: InterruptRequest,
        writer: WriterProcess,
        on_frame: OnVariantFrame | None = None,
    ) -> None:
        self.case, self.problem, self.folder, self.interrupt, self.on_frame = case, problem, folder, interrupt, on_frame
        self.writer = writer
        self.name = case.variant_name or ""
        self.checkpoints = CheckpointFolder(folder / CHECKPOINTS, seconds=case.output.checkpoint_seconds)
        self.summary: RunSummary | None = None

    def solve(self, *, resume: bool) -> VariantResult:
        """Solve the variant and return the outcome; a SolveError and an interruption are recorded in run.json."""
        run, checkpoint = self._open(resume=resume)
        status: Status = "finished"
        try:
            self._record(checkpoint)
        except SolveError as error:
            status = "failed"
            run |= self._describe_failure(error)
        except (Interrupted, OutputError) as error:
            with suppress(OutputError):  # the disk may be full; a run left as "running" can be resumed too
                self._close(run | {"message": str(error)}, "interrupted")
            raise
        run = self._close(run, status)
        self.checkpoints.remove()
        return VariantResult(self.name, self.folder, status, run)

    def _open(self, *, resume: bool) -> tuple[dict[str, Any], Checkpoint | None]:
        """Prepare the folder; return the run.json of the new run and the checkpoint from which it continues, if any."""
        old = read_run(self.folder) if resume else {}
        run = _describe_start(self.case, self.problem)
        checkpoint = None
        if old.get("status") in UNFINISHED:
            checkpoint, notes = prepare_resume(self.folder, self.problem, self.case.output, title=self._title)
            run["notes"] += notes + _note_other_packages(old, run)
        if checkpoint is None:
            _clear_folder(self.folder)
        else:
            self.summary = checkpoint.summary
            run["resumed_after_steps"] = [*old.get("resumed_after_steps", ()), checkpoint.state.step]
        write_whole(self.folder / "case.toml", self.case.to_toml(self.folder))
        write_whole(self.folder / "run.json", _to_json(run))
        return run, checkpoint

    def _record(self, checkpoint: Checkpoint | None) -> None:
        written = next_frame_index(checkpoint, self.problem) if checkpoint else 0
        output, times = self.case.output, frame_times(written, self.problem)
        sinks: list[Sink] = [
            FORMATS[output.format].make_sink(self.folder, times, output.precision, self.problem.frame_count),
            NetcdfSink(self.folder / "statistics.nc", title=self._title, earlier=written),
        ]
        in_child = len(self.problem.body.mesh.cells) >= WORTH_A_PROCESS
        record = self.writer.start_recording if in_child else Recording
        recording = record(sinks, on_frame=self._on_frame, before=self.summary)

        def after_step(state: State, effort: Effort) -> None:
            self._after_step(state, effort, recording)

        start, effort = (checkpoint.state, checkpoint.effort) if checkpoint else (None, None)
        self._last = start or self.problem.start
        self.interrupt.solving = True
        try:
            # small dense factors gain nothing from BLAS threads and stall if cores are shared
            with threadpool_limits(limits=1, user_api="blas"):
                source = frames(self.problem, start, effort=effort, after_step=after_step)
                drive(source, recording)
        finally:
            self.interrupt.solving = False
            if recording.summary.frames:
                self.summary = recording.summary

    def _describe_failure(self, error: SolveError) -> dict[str, Any]:
        """Write the last state before a failure to failure.vtu and return the entries of run.json."""
        if self.summary is None:  # it failed before the first frame
            return {"message": str(error)}
        failure = examine_failure(self.problem, self._last)
        message = failure.describe(error)
        with suppress(OutputError):  # not essential: the frames are complete
            failure.write(self.folder, message)
        return {"message": message, "failure": failure.as_dict()}

    def _on_frame(self, frame: Frame, summary: RunSummary) -> None:
        self.summary = summary
        if self.on_frame is not None:
            self.on_frame(self.name, self.problem, frame, summary)

    def _after_step(self, state: State, effort: Effort, writer: Watcher) -> None:
        """Write a checkpoint if one is due; raises Interrupted if the user requested an end."""
        self._last = state
        frames = self.case.output.checkpoint_frames
        due = self.checkpoints.is_due(effort.work.seconds) or (
            frames and state.step % (frames * self.problem.steps_per_frame) == 0
        )
        if self.interrupt.requested or due:
            writer.drain()  # a checkpoint guarantees that the frames before it are on the disk
            if self.summary is not None:
                self.checkpoints.write(Checkpoint(state, effort, self.summary))
        if self.interrupt.requested:
            raise Interrupted(f"step {state.step} of {self.name}")

    def _close(self, run: dict[str, Any], status: str) -> dict[str, Any]:
        """Write the run.json of a run that ended and return it."""
        run = run | {"status": status} | (_describe_end(self.summary, self.problem) if self.summary else {})
        write_whole(self.folder / "run.json", _to_json(run))
        return run

    @property
    def _title(self) -> str:
        return f"{self.case.name}: {self.name}"


def _note_other_packages(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return a note if packages or the machine changed before a run was resumed."""
    changes = describe_difference(*({"versions": run["versions"], "machine": run["machine"]} for run in (old, new)))
    return [f"resumed with other packages or on another machine ({changes}): digits may differ"] if changes else []


def _clear_folder(folder: Path) -> None:
    """Remove the files of an earlier run and nothing else."""
    try:
        # run.json first: without it, files that a kill leaves behind are cleared again and never resumed
        for name in ("run.json", "case.toml", *(row.index for row in FORMATS.values()), "statistics.nc", FAILURE):
            (folder / name).unlink(missing_ok=True)
        for name in (CHECKPOINTS, "frames"):
            shutil.rmtree(folder / name, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be cleared ({error.strerror})") from error


def _describe_start(case: Case, problem: Problem) -> dict[str, Any]:
    from importlib.metadata import version

    return {
        "name": case.name,
        "variant": case.variant_name,
        "status": "running",
        "case": result_settings(case),
        "notes": [*problem.notes, *([_ROUNDED] if case.output.precision == "float32" else [])],
        "versions": {"pipeline": VERSION, "python": platform.python_version()}
        | {package: version(package) for package in _PACKAGES},
        "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
        "linear_solvers": list_linear_solvers(problem.body, problem.dt, problem.method),
        "cells": len(problem.body.mesh.cells),
        "nodes": len(problem.body.mesh.points),
        "mesh_digest": digest_body(problem.body),
    }


def _describe_end(summary: RunSummary, problem: Problem) -> dict[str, Any]:
    per_step = summary.seconds_per_step
    return {
        "frames": summary.frames,
        "last_frame": {"index": summary.frames - 1, "step": summary.steps, "time": summary.time},
        "worst": {
            "volume_ratio": summary.worst_volume_ratio,
            "cell": summary.worst_cell,
            "time": summary.worst_time,
        },
        "work": {name: count for name, count in asdict(summary.work).items() if name != "seconds"},
        "seconds": {
            "setup": summary.setup_seconds,
            "solving": summary.work.seconds,
            "writing": summary.writing_seconds,
            # counted from the first frame; writing overlaps solving
            "wall": summary.wall_seconds,
        },
        "seconds_per_step": per_step if summary.work.steps else None,
        # simulated time per solving time: above 1 is faster than the motion
        "real_time_factor": problem.dt / per_step if summary.work.steps else None,
    }


def _to_json(run: dict[str, Any]) -> str:
    return json.dumps(run, indent=2, allow_nan=False) + "\n"
