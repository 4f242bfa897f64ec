"""Print what a step costs, ours beside plain scipy, in one run: python -m benchmarks.steps [--large]

The thesis' bar in 192, 10k and, with --large, 100k tetrahedra; dt = .07 s, residual 1e-6, no writing; medians.
"""

import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.baseline import PlainStep
from pipeline import build, load_case
from pipeline.fem.body import Body
from pipeline.fem.laws import Corotational

BAR = Path(__file__).resolve().parent.parent / "cases" / "bar_as_printed.toml"
SIZES = {192: ([2, 8, 2], 100), 9984: ([8, 26, 8], 10), 101088: ([18, 52, 18], 3)}


def ours(cells: list[int], steps: int, variant: str) -> tuple[float, float, Body]:
    """Return set-up [s], median step [ms] and the body."""
    overrides = {"mesh.cells": cells, "method.linear_rtol": 1e-6}
    problem = build(load_case(BAR, overrides=overrides).variant(variant))
    began = time.perf_counter()
    stepper = problem.prepare()
    setup = time.perf_counter() - began
    state, _ = stepper.step(problem.start)
    times = []
    for _ in range(steps):
        began = time.perf_counter()
        state, _ = stepper.step(state)
        times.append(time.perf_counter() - began)
    return setup, 1e3 * float(np.median(times)), problem.body


def plain(body: Body, steps: int, solver: str) -> float:
    """Return the median step [ms] of plain scipy on the same body."""
    same = Body(body.mesh, Corotational(body.material), body.supports, body.load, body.mass_pairs)
    stepper = PlainStep(same, 0.07, solver)
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -40.0], 0.0)
    x, v = stepper.step(body.mesh.points, v)
    times = []
    for _ in range(max(2, steps // 3)):
        began = time.perf_counter()
        x, v = stepper.step(x, v)
        times.append(time.perf_counter() - began)
    return 1e3 * float(np.median(times))


def main() -> None:
    """Print one line a size."""
    print("    tets   set-up s   one solve ms   linear ms   scipy SuperLU ms   scipy CG ms   ratio to the better")
    for tets, (cells, steps) in SIZES.items():
        if tets > 50_000 and "--large" not in sys.argv:
            continue
        setup, step, body = ours(cells, steps, "polar")
        _, linear, _ = ours(cells, steps, "linear")
        conjugate = plain(body, steps, "cg")
        direct = plain(body, steps, "superlu") if tets < 50_000 else float("nan")
        ratio = np.nanmin([direct, conjugate]) / step
        print(f"{tets:8d} {setup:10.3f} {step:14.3f} {linear:11.3f} {direct:18.2f} {conjugate:13.2f} {ratio:12.1f}")


if __name__ == "__main__":
    main()
