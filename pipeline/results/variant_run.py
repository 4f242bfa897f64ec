"""One variant solved and recorded into its folder, from its start or from a checkpoint; run.json says how it ended."""

import json
import os
import platform
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
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
from pipeline.results.resume import CHECKPOINTS, digest_mesh, frame_times, next_frame_index, prepare_resume
from pipeline.run.frame import Frame, Sink
from pipeline.run.frames import frames
from pipeline.run.recording import Recording, RunSummary, Watcher, drive
from pipeline.sinks.frame_formats import FORMATS
from pipeline.sinks.netcdf import NetcdfSink
from pipeline.sinks.writer_process import WORTH_A_PROCESS, WriterProcess
from pipeline.stepping.report import Effort
from pipeline.stepping.state import State
from pipeline.system.version import VERSION

Status = Literal["finished", "failed", "up to date"]
Notify = Callable[[str, Problem, Frame, RunSummary], None]
# of a run that could go on: killed, asked to stop, or stopped by what it could not write
UNFINISHED = ("running", "interrupted")
_COUNTS = ("steps", "solves", "iterations", "linear_iterations", "factorisations", "rotations")
_ROUNDED = "output.precision = 'float32': statistics.nc cannot be made again from the frames, which are rounded"
_PACKAGES = ("numpy", "scipy", "pyvista", "vtk", "meshio", "xarray", "netCDF4", "numba")


@dataclass(frozen=True)
class VariantResult:
    """One variant's folder, how it ended, and its run.json."""

    name: str
    folder: Path
    status: Status
    run: dict[str, Any]


def read_run(folder: Path) -> dict[str, Any]:
    """Return a variant's run.json, {} where there is none; raises OutputError where it cannot be read."""
    path = folder / "run.json"
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
    """Return the part of a case that its results depend on: all but the movie and the checkpoints."""
    document = {key: value for key, value in case.as_dict().items() if key != "movie"}
    document["output"] = {k: v for k, v in document["output"].items() if not k.startswith("checkpoint_")}
    return document


def describe_difference(old: dict[str, Any], new: dict[str, Any]) -> str:
    """Return the first three keys at which two cases differ, with both values."""
    before, after = _flatten(old), _flatten(new)
    keys = [key for key in {**before, **after} if before.get(key) != after.get(key)]
    shown = [f"{key}: {shorten(str(before.get(key)))} there, {shorten(str(after.get(key)))} here" for key in keys[:3]]
    return "; ".join(shown) + (f"; and {len(keys) - 3} more" if len(keys) > 3 else "")


def _flatten(value: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(value, dict):
        return {prefix: value}
    return {k: v for key, one in value.items() for k, v in _flatten(one, f"{prefix}.{key}" if prefix else key).items()}


class VariantRun:
    """One variant being solved and recorded, from its start or from a checkpoint."""

    def __init__(
        self,
        case: Case,
        problem: Problem,
        folder: Path,
        asked: InterruptRequest,
        writer: WriterProcess,
        notify: Notify | None = None,
    ) -> None:
        self.case, self.problem, self.folder, self.interrupt, self.notify = case, problem, folder, asked, notify
        self.writer = writer
        self.name = case.variant_name or ""
        self.checkpoints = CheckpointFolder(folder / CHECKPOINTS, seconds=case.output.checkpoint_seconds)
        self.summary: RunSummary | None = None

    def solve(self, *, resume: bool) -> VariantResult:
        """Return how it ended; a SolveError is a result, kept in run.json, as is an end that comes too early."""
        run, began = self._open(resume=resume)
        status: Status = "finished"
        try:
            self._record(began)
        except SolveError as error:
            status = "failed"
            run |= self._describe_failure(error)
        except (Interrupted, OutputError) as error:
            with suppress(OutputError):  # the disk may be full; "running" can be resumed as well
                self._close(run | {"message": str(error)}, "interrupted")
            raise
        run = self._close(run, status)
        self.checkpoints.remove()
        return VariantResult(self.name, self.folder, status, run)

    def _open(self, *, resume: bool) -> tuple[dict[str, Any], Checkpoint | None]:
        """Return the run.json of a run that begins, and the checkpoint that it goes on from."""
        old = read_run(self.folder) if resume else {}
        run = _describe_start(self.case, self.problem)
        began = None
        if old.get("status") in UNFINISHED:
            began, notes = prepare_resume(self.folder, self.problem, self.case.output, title=self._title)
            run["notes"] += notes + _note_other_packages(old, run)
        if began is None:
            _clear_folder(self.folder)
        else:
            self.summary = began.summary
            run["resumed_after_steps"] = [*old.get("resumed_after_steps", ()), began.state.step]
        write_whole(self.folder / "case.toml", self.case.to_toml(self.folder))
        write_whole(self.folder / "run.json", _to_json(run))
        return run, began

    def _record(self, began: Checkpoint | None) -> None:
        written = next_frame_index(began, self.problem) if began else 0
        output, times = self.case.output, frame_times(written, self.problem)
        sinks: list[Sink] = [
            FORMATS[output.format].sink(self.folder, times, output.precision, self.problem.frame_count),
            NetcdfSink(self.folder / "statistics.nc", title=self._title, earlier=written),
        ]
        beside = len(self.problem.body.mesh.cells) >= WORTH_A_PROCESS
        record = self.writer.recording if beside else Recording
        recording = record(sinks, on_frame=self._on_frame, before=self.summary)

        def after_step(state: State, effort: Effort) -> None:
            self._after_step(state, effort, recording)

        start, effort = (began.state, began.effort) if began else (None, None)
        self._last = start or self.problem.start
        self.interrupt.solving = True
        try:
            # small dense factors gain nothing from BLAS threads, and stall where cores are shared
            with threadpool_limits(limits=1, user_api="blas"):
                source = frames(self.problem, start, effort=effort, after_step=after_step)
                drive(source, recording)
        finally:
            self.interrupt.solving = False
            if recording.summary.frames:
                self.summary = recording.summary

    def _describe_failure(self, error: SolveError) -> dict[str, Any]:
        """Return what run.json says of a failure, after the state before it was written to a file of its own."""
        if self.summary is None:  # it could not even start
            return {"message": str(error)}
        found = examine_failure(self.problem, self._last)
        message = found.message(error)
        with suppress(OutputError):  # the frames before it count more than this one
            found.write(self.folder, message)
        return {"message": message, "failure": found.record()}

    def _on_frame(self, frame: Frame, summary: RunSummary) -> None:
        self.summary = summary
        if self.notify is not None:
            self.notify(self.name, self.problem, frame, summary)

    def _after_step(self, state: State, effort: Effort, writer: Watcher) -> None:
        """Write a checkpoint where one is due; raises Interrupted where an end was asked for."""
        self._last = state
        frames = self.case.output.checkpoint_frames
        due = self.checkpoints.is_due(effort.work.seconds) or (
            frames and state.step % (frames * self.problem.steps_per_frame) == 0
        )
        if self.interrupt.requested or due:
            writer.drain()  # a checkpoint says that the frames before it are on the disk
            if self.summary is not None:
                self.checkpoints.write(Checkpoint(state, effort, self.summary))
        if self.interrupt.requested:
            raise Interrupted(
                f"interrupted after step {state.step} of {self.name}; the same command with --resume goes on from there"
            )

    def _close(self, run: dict[str, Any], status: str) -> dict[str, Any]:
        """Return the run.json of a run that ended, and write it."""
        run = run | {"status": status} | (_describe_end(self.summary, self.problem) if self.summary else {})
        write_whole(self.folder / "run.json", _to_json(run))
        return run

    @property
    def _title(self) -> str:
        return f"{self.case.name}: {self.name}"


def _note_other_packages(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return a note where packages or the machine changed before a run was resumed."""
    changes = describe_difference(*({"versions": run["versions"], "machine": run["machine"]} for run in (old, new)))
    return [f"resumed with other packages or on another machine ({changes}): digits may differ"] if changes else []


def _clear_folder(folder: Path) -> None:
    """Remove what an earlier run left, and nothing else."""
    try:
        # the record first: without it, what a kill leaves of the rest is cleared again and never resumed
        for name in ("run.json", "case.toml", *(one.index for one in FORMATS.values()), "statistics.nc", FAILURE):
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
        "mesh_digest": digest_mesh(problem.body.mesh),
    }


def _describe_end(summary: RunSummary, problem: Problem) -> dict[str, Any]:
    per_step = summary.seconds_per_step
    counts = {k: getattr(summary.work, k) for k in _COUNTS}
    return {
        "frames": summary.frames,
        "last_frame": {"index": summary.frames - 1, "step": summary.steps, "time": summary.time},
        "worst": {
            "volume_ratio": summary.worst_volume_ratio,
            "cell": summary.worst_cell,
            "time": summary.worst_time,
        },
        "work": counts,
        "seconds": {
            "setup": summary.setup_seconds,
            "solving": summary.work.seconds,
            "writing": summary.writing_seconds,
            # from the first frame on: writing overlaps solving
            "wall": summary.wall_seconds,
        },
        "seconds_per_step": per_step if summary.work.steps else None,
        # simulated seconds a second of solving: above 1 is faster than the motion
        "real_time_factor": problem.dt / per_step if summary.work.steps else None,
    }


def _to_json(run: dict[str, Any]) -> str:
    return json.dumps(run, indent=2, allow_nan=False) + "\n"
