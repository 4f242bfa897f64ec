"""What a step of one method costs on one mesh, measured alone in a process: `python -m` this module with JSON.

The process prints one line of JSON. Each point has a process of its own, so that the peak of memory is its own.
"""

import json
import sys
import time
from collections.abc import Callable
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
from pipeline.studies.scaling.plain_scipy import PlainStep

# what a case of any kind is turned into; the explicit step is half its limit
METHODS: dict[str, dict[str, Any]] = {
    "linear": {"method.law": "linear"},
    "one_solve": {"method.law": "corotational", "method.rotation": "polar", "method.iterations": 1},
    "gram_schmidt": {"method.law": "corotational", "method.rotation": "gram_schmidt", "method.iterations": 1},
    "auto": {"method.model": "auto"},
    "converged": {"method.law": "corotational", "method.iterations": "converged"},
    "explicit": {"method.stepper": "symplectic_euler", "method.mass": "lumped"},
}
_LEAST_SECONDS = 0.3
_SECONDS, _MOST_STEPS, _LEAST_STEPS, _TURNS = 3.0, 200, 3, 3
_MOST_CELLS_PREPARED_TWICE = 20_000  # cells
_MOST_CELLS_SUPERLU = 50_000  # cells: above it a factor a step takes minutes


def measure_step_cost(settings: dict[str, Any]) -> dict[str, Any]:
    """Return the row of one point: see scaling.py for what its columns mean."""
    problem = build_point(settings)
    body, method = problem.body, settings["method"]
    stepper, setup, loading = _time_setup(problem, settings)
    ms, work = _time_steps(stepper, problem)
    cells = len(body.mesh.cells)
    solvers = list_linear_solvers(body, problem.dt, problem.method)
    peak, plain = read_peak_megabytes(), None  # the peak before plain scipy, which takes more
    if method == "one_solve" and settings["baseline"]:
        ms, plain = _race_plain(stepper, problem)
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
        "linear_solver": [one["name"] for one in solvers],
        "bytes": _count_bytes(problem, method, work, solvers),
        "peak_MB": peak,
        "baseline_ms": plain,
        "baseline": "plain scipy: the better of SuperLU and Jacobi-CG" if method == "one_solve" else None,
    }


def _time_setup(problem: Problem, settings: dict[str, Any]) -> tuple[Stepper, float, float | None]:
    """Return the stepper, the seconds to make it, and those of loading kernels, once a process.

    These are what the first of two makings takes longer; of large meshes only one is made: there they hardly count.
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
        keys |= {"schedule.dt": 0.5 * element_limit(build(load_case(path, overrides=cells).variant(variant)).body)}
    return build(load_case(path, overrides=keys).variant(variant))


def measure_median_ms(call: Callable[[], object]) -> float:
    """Return the median milliseconds of a call, the first left out: of the processor's time, on one thread.

    Where others share the core, calls longer than a turn on it would seem slower beside short ones.
    """
    return 1e3 * float(np.median(_time_calls(call, least=_LEAST_STEPS, total=_SECONDS)))


def _time_calls(call: Callable[[], object], *, least: int, total: float) -> list[float]:
    call()
    times: list[float] = []
    while len(times) < least or (sum(times) < total and len(times) < _MOST_STEPS):
        began = time.process_time()
        call()
        times.append(time.process_time() - began)
    return times


def _time_steps(stepper: Stepper, problem: Problem) -> tuple[float, dict[str, float]]:
    """Return the median milliseconds of a step and the medians of its work, the first left out."""
    reports, found = list[StepReport](), list[float]()
    while sum(found) < _LEAST_SECONDS:  # from the start again: a motion that comes to rest costs less
        found += _time_calls(_make_steps(stepper, problem, reports), least=_LEAST_STEPS, total=_SECONDS)
    names = ("iterations", "linear_iterations", "solves")
    medians = {name: float(np.median([getattr(report.work, name) for report in reports[1:]])) for name in names}
    medians["rung"] = float(np.median([report.choice.rung if report.choice else 0 for report in reports[1:]]))
    return 1e3 * float(np.median(found)), medians


def _race_plain(stepper: Stepper, problem: Problem) -> tuple[float, float]:
    """Return the median milliseconds of a step, and of one of plain scipy, direct or iterative, whichever is faster.

    They take turns, each from the start: a shared machine changes its pace.
    """
    solvers = ("cg", "superlu") if len(problem.body.mesh.cells) <= _MOST_CELLS_SUPERLU else ("cg",)
    plain = [PlainStep(problem.body, problem.dt, solver) for solver in solvers]
    times: list[list[float]] = [[] for _ in range(1 + len(plain))]
    for _ in range(_TURNS):
        steps = [_make_steps(stepper, problem), *(_make_plain_steps(one, problem) for one in plain)]
        for step, found in zip(steps, times, strict=True):
            found += _time_calls(step, least=1, total=_SECONDS / _TURNS)
    ours, *theirs = (1e3 * float(np.median(found)) for found in times)
    return ours, min(theirs)


def _make_steps(stepper: Stepper, problem: Problem, reports: list[StepReport] | None = None) -> Callable[[], None]:
    state = problem.start

    def step() -> None:
        nonlocal state
        state, report = stepper.step(state)
        if reports is not None:
            reports.append(report)

    return step


def _make_plain_steps(stepper: PlainStep, problem: Problem) -> Callable[[], None]:
    x, v = problem.start.x, problem.start.v

    def step() -> None:
        nonlocal x, v
        x, v = stepper.step(x, v)

    return step


def _count_bytes(problem: Problem, method: str, work: dict[str, float], solvers: list[dict[str, str]]) -> float:
    """Return what a step has to read and write at least, vectors left out: cells, matrix and factor.

    A cell is its corners, gradients, volume and blocks; the matrix is written once and read once an iteration; a factor
    is read twice a solve, or an iteration. A step that auto solves linearly visits every cell once to find that out.
    """
    body, pattern = problem.body, problem.body.free_pattern
    per_cell = body.mesh.shape_gradients[0, 1:].nbytes + 8 + 4 * body.mesh.cells.shape[1]
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
    """Return the process' largest memory; None where the system does not tell."""
    # first what Linux says of this program alone: its getrusage starts with the memory of the process that started it
    with suppress(OSError, IndexError, ValueError):
        found = [line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM:" in line]
        return 1.024e-3 * int(found[0])
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def main() -> None:
    """Print the row of the settings given as JSON."""
    sys.stdout.write(json.dumps(measure_step_cost(json.loads(sys.argv[1]))) + "\n")


if __name__ == "__main__":
    main()
