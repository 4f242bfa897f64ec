"""A case to its result folder: every variant solved and recorded, then compared and drawn."""

import json
import os
import platform
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from threadpoolctl import threadpool_limits

from pipeline.build import Problem, build, settled
from pipeline.case import Case, load_case
from pipeline.errors import CaseError, OutputError, SolveError
from pipeline.frame import Frame, Sink, Values
from pipeline.run import RunSummary, frames, record
from pipeline.series import read_series
from pipeline.sinks.atomic import write_whole
from pipeline.sinks.netcdf import NetcdfSink
from pipeline.sinks.vtu import VtuSink
from pipeline.statistics import joined, read_statistics, write_dataset
from pipeline.version import VERSION

Status = Literal["finished", "failed", "up to date"]
Notify = Callable[[str, Problem, Frame, Values, RunSummary], None]
_PACKAGES = ("numpy", "scipy", "pyvista", "vtk", "meshio", "xarray", "netCDF4", "numba")


@dataclass(frozen=True)
class VariantResult:
    """One variant's folder, how it ended, and its run.json."""

    name: str
    folder: Path
    status: Status
    run: dict[str, Any]


@dataclass(frozen=True)
class CampaignResult:
    """All variants asked for, the pictures and datasets made of them, and what there is to say."""

    folder: Path
    variants: tuple[VariantResult, ...]
    made: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """Return 3 where a variant failed, else 0."""
        return SolveError.exit_code if any(v.status == "failed" for v in self.variants) else 0


def run_campaign(
    case: Case,
    out: Path,
    *,
    variants: Sequence[str] = (),
    force: bool = False,
    movie: bool = True,
    notify: Notify | None = None,
    on_drawing: Callable[[int, int], None] | None = None,
) -> CampaignResult:
    """Solve the variants asked for (default: all) into out/<case name>/ and compare every finished one.

    Raises CaseError before anything is solved where a variant cannot be built, or where a folder holds another case's
    result or an unfinished one and force is not given; OutputError where files cannot be written.
    """
    resolved = {name: settled(case.variant(name)) for name in variants or case.variant_names}
    folder = Path(out) / case.name
    problems = {name: build(one) for name, one in resolved.items()}
    todo = [name for name, one in resolved.items() if _must_solve(one, folder / name, force=force)]
    write_whole(folder / "case.toml", case.to_toml(folder))
    results = []
    for name, one in resolved.items():
        if name in todo:
            results.append(_solve(one, problems[name], folder / name, notify))
        else:
            results.append(VariantResult(name, folder / name, "up to date", read_run(folder / name)))
    notes = [note for name in resolved for note in problems[name].notes]
    made, more = compare(case, folder, movie=movie, on_drawing=on_drawing, fresh=bool(todo))
    return CampaignResult(folder, tuple(results), tuple(made), tuple(dict.fromkeys([*notes, *more])))


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


def _must_solve(case: Case, folder: Path, *, force: bool) -> bool:
    """Return whether a variant is to be solved; raises CaseError where that would overwrite without leave."""
    run = {} if force else read_run(folder)
    if not run:
        return True
    changes = _difference(run.get("case", {}), _solved(case))
    if changes:
        raise CaseError(f"{folder}: holds the result of another case ({changes}); --force replaces it, --out avoids it")
    if run["status"] == "running":
        raise CaseError(f"{folder}: an unfinished run of this case (or one still going on); --force starts it again")
    return bool(run["status"] != "finished" or run["versions"]["pipeline"] != VERSION)


def _solved(case: Case) -> dict[str, Any]:
    """Return the part of a case that its results depend on: all but the movie."""
    return {key: value for key, value in case.as_dict().items() if key != "movie"}


def _difference(old: dict[str, Any], new: dict[str, Any]) -> str:
    """Return the first three keys at which two cases differ, with both values."""
    before, after = _flat(old), _flat(new)
    keys = [key for key in {**before, **after} if before.get(key) != after.get(key)]
    shown = [f"{key}: {before.get(key)} there, {after.get(key)} here" for key in keys[:3]]
    return "; ".join(shown) + (f"; and {len(keys) - 3} more" if len(keys) > 3 else "")


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(value, dict):
        return {prefix: value}
    return {k: v for key, one in value.items() for k, v in _flat(one, f"{prefix}.{key}" if prefix else key).items()}


def _solve(case: Case, problem: Problem, folder: Path, notify: Notify | None) -> VariantResult:
    """Solve and record one variant; a SolveError is a result, kept in run.json."""
    name = case.variant_name or ""
    _clear(folder)
    run = _opening(case, problem)
    write_whole(folder / "case.toml", case.to_toml(folder))
    write_whole(folder / "run.json", _json(run))
    so_far: list[RunSummary] = []

    def on_frame(frame: Frame, measured: Values, summary: RunSummary) -> None:
        so_far[:] = [summary]
        if notify is not None:
            notify(name, problem, frame, measured, summary)

    sinks: list[Sink] = [VtuSink(folder), NetcdfSink(folder / "statistics.nc", title=f"{case.name}: {name}")]
    status: Status = "finished"
    try:
        # small dense factors gain nothing from BLAS threads, and stall where cores are shared
        with threadpool_limits(limits=1, user_api="blas"):
            record(frames(problem), sinks, on_frame=on_frame)
    except SolveError as error:
        status = "failed"
        run["message"] = str(error)
    run |= {"status": status} | (_closing(so_far[0], problem) if so_far else {})
    write_whole(folder / "run.json", _json(run))
    return VariantResult(name, folder, status, run)


def _clear(folder: Path) -> None:
    """Remove what an earlier run left, and nothing else."""
    try:
        shutil.rmtree(folder / "frames", ignore_errors=True)
        for name in ("run.json", "case.toml", "series.pvd", "statistics.nc"):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be cleared ({error.strerror})") from error


def _opening(case: Case, problem: Problem) -> dict[str, Any]:
    from importlib.metadata import version

    return {
        "name": case.name,
        "variant": case.variant_name,
        "status": "running",
        "case": _solved(case),
        "notes": list(problem.notes),
        "versions": {"pipeline": VERSION, "python": platform.python_version()}
        | {package: version(package) for package in _PACKAGES},
        "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
        "cells": len(problem.body.mesh.cells),
        "nodes": len(problem.body.mesh.points),
    }


def _closing(summary: RunSummary, problem: Problem) -> dict[str, Any]:
    per_step = summary.seconds_per_step
    counts = {k: getattr(summary.work, k) for k in ("steps", "solves", "iterations", "factorisations", "rotations")}
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
        },
        "seconds_per_step": per_step if summary.work.steps else None,
        # simulated seconds a second of solving: above 1 is faster than the motion
        "real_time_factor": problem.dt / per_step if summary.work.steps else None,
    }


def _json(run: dict[str, Any]) -> str:
    return json.dumps(run, indent=2, allow_nan=False) + "\n"


def compare(
    case: Case,
    folder: Path,
    *,
    movie: bool,
    fresh: bool = True,
    on_drawing: Callable[[int, int], None] | None = None,
) -> tuple[list[Path], list[str]]:
    """Join and draw every variant in the folder that is a result of this case; return the files made and notes."""
    ended = {name: read_run(folder / name) for name in case.variant_names}
    usable = [
        name
        for name, run in ended.items()
        if run.get("frames") and run["status"] != "running" and run["case"] == _solved(settled(case.variant(name)))
    ]
    if not usable:
        return [], ["no variant left a frame: nothing to compare"]
    paths = {n: folder / n for n in ("comparison.nc", "volume.png", "energy.png", "comparison.mp4", "comparison.png")}
    if not fresh and all(path.exists() for name, path in paths.items() if movie or "comparison.m" not in name):
        return [], []
    for stale in ("comparison.mp4", "comparison.png"):
        paths[stale].unlink(missing_ok=True)
    title = case.movie.title or case.name.replace("_", " ")
    dataset, notes = joined({name: read_statistics(folder / name / "statistics.nc") for name in usable}, title=title)
    write_dataset(dataset, paths["comparison.nc"])
    from pipeline.views.plots import energy_figure, volume_figure

    volume_figure(dataset, paths["volume.png"], title=title)
    energy_figure(dataset, paths["energy.png"], title=title)
    made = [paths["comparison.nc"], paths["volume.png"], paths["energy.png"]]
    shown = [name for name in case.movie.variants if name in usable]
    if movie and shown:
        try:
            draw_movie(case, folder, shown, on_drawing=on_drawing)
            made += [paths["comparison.mp4"], paths["comparison.png"]]
        except OutputError as error:
            notes.append(str(error))
    return made, notes


def draw_movie(
    case: Case, folder: Path, shown: Sequence[str], *, on_drawing: Callable[[int, int], None] | None = None
) -> Path:
    """Draw comparison.mp4 and comparison.png of the variants' recorded frames; raises OutputError without OpenGL."""
    from pipeline.views.movie import write_movie

    path = folder / "comparison.mp4"
    write_movie(
        [replace(read_series(folder / name), name=name) for name in shown],
        [name.replace("_", " ") for name in shown],
        path,
        title=case.movie.title or case.name.replace("_", " "),
        poster=folder / "comparison.png",
        speed=case.movie.speed,
        fps=case.movie.fps,
        size=(case.movie.size[0], case.movie.size[1]),
        on_frame=on_drawing,
    )
    return path


def movie_of_folder(folder: Path, *, on_drawing: Callable[[int, int], None] | None = None) -> Path:
    """Draw the movie of a result folder again, from its frames alone; raises PipelineError where it is not one."""
    case = load_case(folder / "case.toml")
    shown = [name for name in case.movie.variants if read_run(folder / name).get("frames")]
    if not shown:
        raise OutputError(f"{folder}: none of {', '.join(case.movie.variants)} has a recorded frame")
    return draw_movie(case, folder, shown, on_drawing=on_drawing)
