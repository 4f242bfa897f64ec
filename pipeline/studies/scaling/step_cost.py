"""The cost of a step of one method on one mesh, and its peak memory, measured in a process of its own.

Times of steps are processor times, not wall times: on a shared core, a call that outlasts its turn would seem slower.
"""

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.case import load_case
from pipeline.linear.choice import estimate_factor_bytes
from pipeline.problem.problem import Problem, build
from pipeline.problem.stage_solvers import list_linear_solvers
from pipeline.stepping.report import StepReport
from pipeline.stepping.state import Stepper
from pipeline.stepping.symplectic_euler import element_limit
from pipeline.studies.scaling.rival import import_task

CostRow = dict[str, Any]
# the keys that turn a case of any kind into each method
METHODS: dict[str, dict[str, Any]] = {
    "linear": {"method.law": "linear"},
    "one_solve": {"method.law": "corotational", "method.rotation": "polar", "method.iterations": 1},
    "gram_schmidt": {"method.law": "corotational", "method.rotation": "gram_schmidt", "method.iterations": 1},
    "auto": {"method.model": "auto"},
    "converged": {"method.law": "corotational", "method.iterations": "converged"},
    "order_two": {
        "mesh.order": 2,
        "method.law": "corotational",
        "method.rotation": "polar",
        "method.iterations": 1,
    },
    "explicit": {"method.stepper": "symplectic_euler", "method.mass": "lumped"},
}
_LIMIT_SHARE = 0.5  # the explicit step over its limit: far enough below it for a moving body
_SECONDS, _MOST_STEPS = 3.0, 200  # a method is timed until it reaches either: enough for a median on a busy machine
_LEAST_STEPS, _LEAST_SECONDS = 3, 0.3  # but at least for both of these
_TURNS = 3  # alternations with a rival
_MOST_CELLS_PREPARED_TWICE = 20_000  # above this, loading kernels hardly counts beside the set-up


def measure_step_cost(settings: dict[str, Any]) -> CostRow:
    """Return the row of one point; study.py describes its columns."""
    problem = build_point(settings)
    body, method = problem.body, settings["method"]
    stepper, setup, loading = _time_setup(problem, settings)
    ms, work = _time_steps(stepper, problem)
    cells = len(body.mesh.cells)
    solvers = list_linear_solvers(body, problem.dt, problem.method)
    peak, baseline = read_peak_megabytes(), None  # read before the rival runs, which may need more
    beside = settings.get("beside")
    if beside:
        ms, baseline = _race(stepper, problem, import_task(beside["task"])(problem))
    return {
        "method": method,
        "cells": settings.get("cells"),
        "tets": cells,
        "nodes": len(body.mesh.points),
        "dt": problem.dt,
        "ms": ms,
        "ns_per_tet": 1e6 * ms / cells,
        "iterations": work["iterations"],
        "solves": work["solves"],
        "linear_iterations": work["linear_iterations"],
        "setup_s": setup,
        "loading_s": loading,
        "linear_solver": [solver["name"] for solver in solvers],
        "bytes": _count_bytes(problem, method, work, solvers),
        "peak_MB": peak,
        "baseline_ms": baseline,
        "baseline": beside["differs"] if beside else None,
    }


def _time_setup(problem: Problem, settings: dict[str, Any]) -> tuple[Stepper, float, float | None]:
    """Return the stepper, the seconds of its set-up, and those of loading kernels, once per process.

    Loading is the excess of the first of two set-ups; for a large mesh only one is made, and loading is part of it.
    """
    began = time.perf_counter()
    stepper = problem.prepare()
    first = time.perf_counter() - began
    if len(problem.body.mesh.cells) > _MOST_CELLS_PREPARED_TWICE:
        return stepper, first, None
    again = build_point(settings)
    began = time.perf_counter()
    again.prepare()
    setup = time.perf_counter() - began
    return stepper, setup, first - setup


def build_point(settings: dict[str, Any]) -> Problem:
    """Return the problem of one point: a case, the cells of its mesh, a method and the tolerance of its systems."""
    cells = {"mesh.cells": settings["cells"]} if settings.get("cells") else {}
    keys = METHODS[settings["method"]] | cells | {"method.linear_rtol": settings["rtol"]}
    path, variant = Path(settings["case"]), settings["variant"]
    if settings["method"] == "explicit":
        body = build(load_case(path, overrides=cells).variant(variant)).body
        keys |= {"schedule.dt": _LIMIT_SHARE * element_limit(body)}
    return build(load_case(path, overrides=keys).variant(variant))


def measure_median_ms(call: Callable[[], object]) -> float:
    """Return the median milliseconds of a call, the first left out."""
    return 1e3 * float(np.median(_time_calls(call, least=_LEAST_STEPS, total=_SECONDS)))


def _time_calls(call: Callable[[], object], *, least: int, total: float) -> list[float]:
    """Return the seconds of each call but the first: of `least` calls or more, until their sum reaches `total`."""
    call()
    times: list[float] = []
    while len(times) < least or (sum(times) < total and len(times) < _MOST_STEPS):
        began = time.process_time()
        call()
        times.append(time.process_time() - began)
    return times


def _time_steps(stepper: Stepper, problem: Problem) -> tuple[float, dict[str, float]]:
    """Return the median milliseconds of a step and the medians of its work, the first left out."""
    reports, seconds = list[StepReport](), list[float]()
    while sum(seconds) < _LEAST_SECONDS:  # from the start again: a motion that comes to rest costs less
        seconds += _time_calls(_start_motion(stepper, problem, reports), least=_LEAST_STEPS, total=_SECONDS)
    names = ("iterations", "linear_iterations", "solves")
    medians = {name: float(np.median([getattr(report.work, name) for report in reports[1:]])) for name in names}
    medians["rung"] = float(np.median([report.choice.rung if report.choice else 0 for report in reports[1:]]))
    return 1e3 * float(np.median(seconds)), medians


def _race(
    stepper: Stepper, problem: Problem, rivals: Sequence[Callable[[], Callable[[], None]]]
) -> tuple[float, float]:
    """Return the median milliseconds of a step, and of the fastest rival's step.

    They take turns, each from the start: a shared machine changes its pace.
    """
    starts = [lambda: _start_motion(stepper, problem), *rivals]
    times: list[list[float]] = [[] for _ in starts]
    for _ in range(_TURNS):
        for start, seconds in zip(starts, times, strict=True):
            seconds += _time_calls(start(), least=1, total=_SECONDS / _TURNS)
    ours, *theirs = (1e3 * float(np.median(seconds)) for seconds in times)
    return ours, min(theirs)


def _start_motion(stepper: Stepper, problem: Problem, reports: list[StepReport] | None = None) -> Callable[[], None]:
    """Return a function that makes one step per call, from the problem's start on, and appends its report."""
    state = problem.start

    def step() -> None:
        nonlocal state
        state, report = stepper.step(state)
        if reports is not None:
            reports.append(report)

    return step


def _count_bytes(problem: Problem, method: str, work: dict[str, float], solvers: list[dict[str, str]]) -> float:
    """Return the least number of bytes that a step reads and writes, vectors left out: cells, matrix and factor.

    A cell counts its corners, gradients, volume and blocks; the matrix is written once and read once per iteration; a
    factor is read twice per solve, or per iteration. If auto solves linearly, it still visits every cell once to check
    that.
    """
    body, pattern = problem.body, problem.body.free_pattern
    per_cell = body.mesh.integration.gradients[0, :, 1:].nbytes + 8 + 4 * body.mesh.cells.shape[1]
    cells = len(body.mesh.cells)
    if method == "explicit":
        return float(cells * per_cell)
    matrix = 8.0 * pattern.blocks * pattern.dimension**2
    linear = method == "linear" or (method == "auto" and work["rung"] == 0)
    factor = estimate_factor_bytes(pattern, solvers[0 if linear else -1]["name"])
    iterations, solves = work["linear_iterations"], max(work["solves"], 1)
    solving = iterations * matrix + 2 * max(solves, iterations) * factor
    if linear:
        return solving + matrix + (cells * per_cell if method == "auto" else 0)
    blocks = 4 * body.assembly.pairs.shape[1]
    return solving + work["solves"] * (cells * (per_cell + blocks) + 2 * matrix)


def read_peak_megabytes() -> float | None:
    """Return the peak memory of this process; None if the system does not report it."""
    # Linux's getrusage starts from the memory of the parent process; VmHWM is that of this program alone
    with suppress(OSError, IndexError, ValueError):
        lines = [line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM:" in line]
        return 1.024e-3 * int(lines[0])
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
