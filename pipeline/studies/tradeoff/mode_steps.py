r"""The steps per period that a stepper needs to keep the first mode's amplitude and phase to a tolerance.

The body is linear, without loads, displaced along its first mode and released. After one period the mode is back at its
start:

    z = q + i dq/dt / omega,    error = |z(T) - z(0)| / |z(0)|,    T = 2 pi / omega

The error falls as a power of the steps per period, so a few runs find the count.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import ceil, pi
from typing import Any

import numpy as np

from pipeline.errors import SolveError
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.problem.methods import STEPPERS
from pipeline.problem.problem import Problem
from pipeline.problem.stage_solvers import make_stepper
from pipeline.stepping.state import State
from pipeline.studies.tradeoff.motion import build_problem

_FIRST = 64  # steps a period of the first run
_MOST = 1_000_000  # steps a period: no search goes further
_RUNS = 12  # extrapolation by the order, then bisection, need fewer unless errors do not fall as a power


def find_steps_per_period(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fewest steps per period for the tolerance, found by trial runs, their error, and omega [rad/s].

    Settings are those of `motion.make_task_settings` and `tolerance`. Raises SolveError if the body has no elastic mode
    or the tolerance is not reached.
    """
    problem = build_problem(settings, "case")
    stepper, tolerance = problem.method.stepper, float(settings["tolerance"])
    omegas, modes = find_lowest_frequencies(problem.body)
    if not len(omegas):
        raise SolveError("the body has no elastic mode")
    omega, mode = float(omegas[0]), modes[0]
    reached: dict[int, float] = {}
    missed, count = 0, _FIRST
    for _ in range(_RUNS):
        error = measure_period_error(problem, mode, omega, count)
        if error <= tolerance:
            reached[count] = error
        else:
            missed = max(missed, count)
        best = min(reached, default=_MOST)
        if best - missed <= max(1, best // 100):  # to 1 %
            return {"steps": best, "error": reached[best], "omega": omega}
        # 1.001: rounding of the power must not miss the tolerance
        guess = ceil(count * (error / tolerance) ** (1 / STEPPERS[stepper].order) * 1.001)
        count = guess if missed < guess < best else (missed + best + 1) // 2
    raise SolveError(f"the first mode is not followed to {tolerance:g} by {missed} steps of {stepper} a period")


def measure_period_error(problem: Problem, mode: np.ndarray, omega: float, count: int) -> float:
    """Return |z(T) - z(0)| / |z(0)| after `count` steps over one period of a mode (n, d)."""
    body = replace(problem.body, load=np.zeros_like(problem.body.load), varying_load=None)
    dt = 2 * pi / omega / count
    stepper = make_stepper(body, dt, problem.method)
    X = body.mesh.points
    scale = 1e-3 * body.mesh.size / np.abs(mode).max()  # the body is linear: its response is proportional
    state = State(0, X + scale * mode, np.zeros_like(X))
    for _ in range(count):
        state, _ = stepper.step(state)
    weighted = body.momentum(mode) / scale
    z = (weighted * (state.x - X)).sum() + 1j * (weighted * state.v).sum() / omega
    return float(abs(z - 1))
