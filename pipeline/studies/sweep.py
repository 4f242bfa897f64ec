"""Study points as tasks of dask.distributed, each result a file as it comes, so that a sweep resumes.

One point is one task. A local cluster of processes, one thread each, unless an existing scheduler is named. A point
whose worker is lost is computed again, at last alone; one that loses its worker always is an error of that point.
Without the package `distributed` (the extra `study`) the points are computed one after the other in this process.
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
# a second death on the same point, with others about, is reason enough to try it alone
_ALLOWED_FAILURES = 1
# Ctrl-C reaches every process of the terminal; this one closes the others
_IGNORE_INTERRUPTS = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
_CONNECT_SECONDS = 10
_CLOSE_SECONDS = 5


@dataclass(frozen=True)
class Point:
    """One point of a study: a key that is unique and can name a file, and the settings of its task, plain JSON."""

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

    `task` takes the settings and returns what JSON can hold; it must be importable where the workers are. NaN and
    infinities become None. What a task raises is its result, {"error": "SolveError: …"}, with "unexpected" where it is
    no PipelineError or its worker was lost. A point that stands in the folder with equal settings, from this version of
    the package and without "unexpected" is not computed again. `timed` points run one at a time. `on_result` gets each
    point, how many are done and of how many. Raises PipelineError where the scheduler is not there or goes away,
    CaseError where another sweep is at work in the folder, OutputError.
    """
    _check_keys(points)
    with lock_folder(folder):
        return _complete_sweep(task, points, folder, scheduler, timed, on_result)


def _complete_sweep(
    task: Task, points: Sequence[Point], folder: Path, scheduler: str | None, timed: bool, on_result: OnResult | None
) -> dict[str, PointResult]:
    results = {point.key: found for point in points if (found := _read_result(point, folder)) is not None}
    missing = [point for point in points if point.key not in results]
    told = 0
    for point in points if on_result else ():
        if point.key in results and on_result:
            told += 1
            on_result(point, told, len(points))
    for point, result in _compute_points(task, missing, scheduler, timed) if missing else ():
        results[point.key] = _write_result(point, result, folder)
        if on_result:
            on_result(point, len(results), len(points))
    return {point.key: results[point.key] for point in points}


def to_json(value: Any) -> Any:
    """Return the value as JSON holds it: arrays as lists, NaN and infinities as None."""
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
    """Return what an earlier sweep found of this very point; None where it has to be computed."""
    try:
        read = json.loads(_make_path(point, folder).read_text())
        same = (read["settings"], read["version"]) == (to_json(point.settings), VERSION)
        return dict(read["result"]) if same and "unexpected" not in read["result"] else None
    except (OSError, ValueError, KeyError, TypeError):  # not there, or no file of ours
        return None


def _write_result(point: Point, result: PointResult, folder: Path) -> PointResult:
    document = {"settings": to_json(point.settings), "version": VERSION, "result": to_json(result)}
    write_whole(_make_path(point, folder), json.dumps(document, indent=1, allow_nan=False) + "\n")
    return dict(document["result"])


def _compute_points(
    task: Task, points: Sequence[Point], scheduler: str | None, timed: bool
) -> Iterator[tuple[Point, PointResult]]:
    """Yield each point with its result, as they come."""
    if find_spec("distributed") is None:
        if scheduler is not None:
            raise PipelineError(
                f"scheduler {scheduler}: needs dask.distributed: pip install 'corotational-pipeline[study]'"
            )
        log.warning("no dask.distributed (pip install 'corotational-pipeline[study]'): one point after the other, here")
        yield from ((point, run_task(task, point.settings)) for point in points)
        return
    with _open_client(scheduler, 1 if timed else len(points)) as client:
        lost = []
        for point, result in _run_points(client, task, points, 1 if timed else len(points)):
            if "lost" in result:
                lost.append(point)  # or another point on that worker lost it: the second time each is alone
            else:
                yield point, result
        for point, result in _run_points(client, task, lost, 1):
            yield point, {key: value for key, value in result.items() if key != "lost"}


@contextmanager
def _open_client(scheduler: str | None, most: int) -> Iterator[Any]:
    """Yield a client of the scheduler at that address, or of a cluster of at most that many processes here."""
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
    # a worker that is paused for its memory would never end; one that is killed for it does
    asked = {"n_workers": min(most, dask.system.CPU_COUNT), "threads_per_worker": 1, "memory_limit": 0}
    environment = make_thread_environment(1)
    spoken = logging.getLogger("distributed")
    level = spoken.level
    spoken.setLevel(logging.CRITICAL)  # a worker that dies is told by its point
    with dask.config.set({"distributed.scheduler.allowed-failures": _ALLOWED_FAILURES}):
        cluster = LocalCluster(
            **asked,
            dashboard_address="127.0.0.1:0",
            env=environment,
            silence_logs=logging.CRITICAL,
            preload=[_IGNORE_INTERRUPTS],
        )
        try:
            with Client(cluster, set_as_default=False) as client:
                yield client
        finally:
            cluster.close(timeout=_CLOSE_SECONDS)
            spoken.setLevel(level)


def _run_points(client: Any, task: Task, points: Sequence[Point], most: int) -> Iterator[tuple[Point, PointResult]]:
    """Yield each point with its result, at most so many of them at work; "lost" in it: its worker died."""
    from distributed import KilledWorker, as_completed

    waiting = iter(points)
    point_of = {}

    def submitted(count: int) -> list[Any]:
        futures = []
        for point in islice(waiting, count):
            future = client.submit(run_task, task, dict(point.settings), pure=False)
            point_of[future.key] = point
            futures.append(future)
        return futures

    running = as_completed(submitted(most), loop=client.loop)
    for future in running:
        point = point_of[future.key]
        if future.status == "cancelled":
            raise PipelineError("the scheduler went away; the points done so far stand, the same command goes on")
        error = future.exception()
        if error is None:
            yield point, future.result()
        elif isinstance(error, KilledWorker):
            text = "KilledWorker: the process that computed this point died, each time it was tried"
            yield point, {"error": text, "unexpected": True, "lost": True}
        else:
            yield point, {"error": f"{type(error).__name__}: {error}", "unexpected": True}
        future.release()
        running.update(submitted(1))


def run_task(task: Task, settings: Mapping[str, Any]) -> PointResult:
    """Return what the task returns, on one thread; an error as {"error": text}, "unexpected" if it is none of ours."""
    try:
        with threadpool_limits(limits=1):
            return task(settings)
    except PipelineError as error:
        return {"error": f"{type(error).__name__}: {error}"}
    except Exception as error:  # a sweep goes on; what happened stands in the point's file
        log.debug("a study point failed", exc_info=True)
        return {"error": f"{type(error).__name__}: {error}", "unexpected": True}
