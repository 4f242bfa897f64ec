"""Study points as tasks of dask.distributed, each result written as soon as it is ready, so that a sweep can resume.

One point is one task, on a local cluster of single-threaded processes unless an existing scheduler is named. A point
whose worker dies is computed again, the last time alone; if its worker dies every time, that is the point's error.
Without the package `distributed` (the extra `study`), the points are computed one at a time in this process.
"""

import json
import logging
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from pipeline.errors import PipelineError, quote_value
from pipeline.formats.atomic import write_whole
from pipeline.results.lock import lock_folder
from pipeline.system.threads import make_thread_environment
from pipeline.system.version import VERSION

PointResult = dict[str, Any]
Task = Callable[[Mapping[str, Any]], PointResult]

log = logging.getLogger(__name__)
_FILE_SAFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,199}")
# after a second death of its worker, a point is tried alone: another point on that worker may be the cause
_ALLOWED_FAILURES = 1
# Ctrl-C reaches every process of the terminal; this process closes the others
_IGNORE_INTERRUPTS = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
_CONNECT_SECONDS = 10
_CLOSE_SECONDS = 5  # workers that do not end by then are killed


@dataclass(frozen=True)
class Point:
    """One point of a study: a unique key that can name a file, and the settings of its task as plain JSON."""

    key: str
    settings: Mapping[str, Any]


OnResult = Callable[[Point, int, int], None]


def run_sweep(
    task: Task,
    points: Sequence[Point],
    folder: Path,
    *,
    scheduler: str | None = None,
    timed: bool = False,
    on_result: OnResult | None = None,
) -> dict[str, PointResult]:
    """Return the result of every point by its key, in the order of the points; each is in folder/points/<key>.json.

    `task` takes the settings and returns JSON values; the workers must be able to import it. NaN and infinities become
    None. An exception in a task becomes its result, {"error": "SolveError: …"}, with "unexpected" if it is not a
    PipelineError or the worker died. A point is not computed again if the folder has its result for equal settings,
    from this version of the package and without "unexpected". `timed` points run one at a time. `on_result` gets each
    point, the number of points done and their total. Raises PipelineError if the scheduler does not answer or goes
    away, CaseError if another sweep is at work in the folder, OutputError if a result cannot be written.
    """
    _check_keys(points)
    with lock_folder(folder):
        return _complete_sweep(task, points, folder, scheduler, timed, on_result)


def _complete_sweep(
    task: Task, points: Sequence[Point], folder: Path, scheduler: str | None, timed: bool, on_result: OnResult | None
) -> dict[str, PointResult]:
    results = {point.key: result for point in points if (result := _read_result(point, folder)) is not None}
    missing = [point for point in points if point.key not in results]
    for count, point in enumerate((point for point in points if point.key in results), start=1):
        if on_result:
            on_result(point, count, len(points))
    for point, result in _compute_points(task, missing, scheduler, timed) if missing else ():
        results[point.key] = _write_result(point, result, folder)
        if on_result:
            on_result(point, len(results), len(points))
    return {point.key: results[point.key] for point in points}


def to_json(value: Any) -> Any:
    """Return the value in the types of JSON: arrays as lists, NaN and infinities as None."""
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_json(value.tolist())
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _check_keys(points: Sequence[Point]) -> None:
    seen = set()
    for key in (point.key for point in points):
        if key in seen or not _FILE_SAFE.fullmatch(key):
            fault = "twice in one sweep" if key in seen else "cannot name a file; use letters, digits and . _ + -"
            raise PipelineError(f"study point {quote_value(key)}: {fault}")
        seen.add(key)


def _make_path(point: Point, folder: Path) -> Path:
    return folder / "points" / f"{point.key}.json"


def _read_result(point: Point, folder: Path) -> PointResult | None:
    """Return the point's result from an earlier sweep; None if it has to be computed."""
    try:
        document = json.loads(_make_path(point, folder).read_text())
        same = (document["settings"], document["version"]) == (to_json(point.settings), VERSION)
        return dict(document["result"]) if same and "unexpected" not in document["result"] else None
    except (OSError, ValueError, KeyError, TypeError):  # no such file, or not one of ours
        return None


def _write_result(point: Point, result: PointResult, folder: Path) -> PointResult:
    document = {"settings": to_json(point.settings), "version": VERSION, "result": to_json(result)}
    write_whole(_make_path(point, folder), json.dumps(document, indent=1, allow_nan=False) + "\n")
    return dict(document["result"])


def _compute_points(
    task: Task, points: Sequence[Point], scheduler: str | None, timed: bool
) -> Iterator[tuple[Point, PointResult]]:
    """Yield each point with its result as soon as it is ready."""
    if find_spec("distributed") is None:
        if scheduler is not None:
            raise PipelineError(
                f"scheduler {scheduler}: needs dask.distributed: pip install 'corotational-pipeline[study]'"
            )
        log.warning("no dask.distributed (pip install 'corotational-pipeline[study]'): points run one after the other")
        yield from ((point, run_task(task, point.settings)) for point in points)
        return
    with _open_client(scheduler, 1 if timed else len(points)) as client:
        lost = []
        for point, result in _run_points(client, task, points, 1 if timed else len(points)):
            if "lost" in result:
                lost.append(point)  # maybe due to another point on that worker: the second time each runs alone
            else:
                yield point, result
        for point, result in _run_points(client, task, lost, 1):
            yield point, {key: value for key, value in result.items() if key != "lost"}


@contextmanager
def _open_client(scheduler: str | None, most: int) -> Iterator[Any]:
    """Yield a client of the scheduler at that address, or of a local cluster of at most `most` processes."""
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=_CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise PipelineError(f"scheduler {scheduler}: does not answer ({error}); start `dask scheduler`") from error
        with client:
            yield client
        return
    # without a memory limit: a worker paused by the limit would never end, one killed by the system does
    options = {"n_workers": min(most, dask.system.CPU_COUNT), "threads_per_worker": 1, "memory_limit": 0}
    dask_log = logging.getLogger("distributed")
    level = dask_log.level
    dask_log.setLevel(logging.CRITICAL)  # the death of a worker is the error of its point
    with dask.config.set({"distributed.scheduler.allowed-failures": _ALLOWED_FAILURES}):
        cluster = LocalCluster(
            **options,
            dashboard_address="127.0.0.1:0",
            env=make_thread_environment(1),
            silence_logs=logging.CRITICAL,
            preload=[_IGNORE_INTERRUPTS],
        )
        try:
            with Client(cluster, set_as_default=False) as client:
                yield client
        finally:
            cluster.close(timeout=_CLOSE_SECONDS)
            dask_log.setLevel(level)


def _run_points(client: Any, task: Task, points: Sequence[Point], most: int) -> Iterator[tuple[Point, PointResult]]:
    """Yield each point with its result, at most `most` at work at a time; "lost" in a result: the worker died."""
    from distributed import KilledWorker, as_completed

    waiting = iter(points)
    point_of = {}

    def submit(count: int) -> list[Any]:
        futures = []
        for point in islice(waiting, count):
            future = client.submit(run_task, task, dict(point.settings), pure=False)
            point_of[future.key] = point
            futures.append(future)
        return futures

    running = as_completed(submit(most), loop=client.loop)
    for future in running:
        point = point_of[future.key]
        if future.status == "cancelled":
            raise PipelineError("the scheduler went away; finished points are kept, and the same command resumes")
        error = future.exception()
        if error is None:
            yield point, future.result()
        elif isinstance(error, KilledWorker):
            text = "KilledWorker: the process that computed this point died every time"
            yield point, {"error": text, "unexpected": True, "lost": True}
        else:
            yield point, {"error": f"{type(error).__name__}: {error}", "unexpected": True}
        future.release()
        running.update(submit(1))


def run_task(task: Task, settings: Mapping[str, Any]) -> PointResult:
    """Return the task's result, on one thread, or its error as {"error": text}, "unexpected" if it is not ours."""
    try:
        with threadpool_limits(limits=1):
            return task(settings)
    except PipelineError as error:
        return {"error": f"{type(error).__name__}: {error}"}
    except Exception as error:  # the sweep goes on; the error is in the point's file
        log.debug("a study point failed", exc_info=True)
        return {"error": f"{type(error).__name__}: {error}", "unexpected": True}
