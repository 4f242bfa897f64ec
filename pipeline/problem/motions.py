"""Motions of supports: from the keys of a case to the positions of held nodes at any time."""

from typing import Any

import numpy as np

from pipeline.case import Case, MotionSpec
from pipeline.case.python_values import PythonValue
from pipeline.errors import SolveError
from pipeline.fem.histories import History
from pipeline.fem.motions import RetimedMotion
from pipeline.fem.supports import Motion, PrescribedMotion, RigidMotion
from pipeline.problem.case_values import get_python_value, read_axis, read_history, read_vector

_FIRST_INSTANT = 1e-4  # of a step: the time over which the initial velocity of a prescribed motion is taken
_AT_REST = 1e-12  # of a history's start: 1 - cos(t) and the like are rounded
_GROWTH = 2.0  # of a slope over a sixteenth of the time: finite ones do not grow, that of sqrt(t) does, by 4


def make_motion(case: Case, key: str, spec: MotionSpec, d: int) -> Motion:
    """Return the motion of a support; raises CaseError."""
    until = {} if spec.until is None else {"until": spec.until}
    if spec.history is not None:
        history = read_history(case, f"{key}.history", spec.history, spec.until)
        if spec.displacement is not None:
            rate = _check_start(case, f"{key}.history", history)
            return RetimedMotion(_make_uniform_motion(case, key, spec, d), history, rate, **until)
        try:
            history.integrate(min(case.schedule.dt, spec.until or np.inf))
        except SolveError as error:
            raise case.make_error(f"{key}.history", str(error)) from None
        return RetimedMotion(_make_uniform_motion(case, key, spec, d), history.integrate, history(0.0), **until)
    motion = _make_uniform_motion(case, key, spec, d)
    return RetimedMotion(motion, float, 1.0, **until) if until else motion


def note_endless_motions(case: Case) -> list[str]:
    """Return notes on motions that end after the run."""
    s = case.schedule
    end = s.dt * s.steps_per_frame * s.frames
    return [
        f"supports.{i}.motion.until: {support.motion.until:g} s is after the end of the run, {end:g} s"
        for i, support in enumerate(case.supports)
        if support.motion is not None and support.motion.until is not None and support.motion.until > end
    ]


def _make_uniform_motion(case: Case, key: str, spec: MotionSpec, d: int) -> Motion:
    """Return the motion without its history and its end; a displacement is reached after one second."""
    if isinstance(spec.displacement, PythonValue):
        displacement: Any = get_python_value(case, f"{key}.displacement", spec.displacement)
        return PrescribedMotion(displacement, _FIRST_INSTANT * case.schedule.dt)
    name = "velocity" if spec.displacement is None else "displacement"
    velocity = read_vector(case, f"{key}.{name}", getattr(spec, name), d)
    if spec.spin is None:
        return RigidMotion(velocity, np.array([0.0, 0.0, 1.0]), 0.0, np.zeros(d))
    axis = read_axis(case, f"{key}.spin", spec.spin, d)
    if spec.spin.center is None:
        raise case.make_error(f"{key}.spin.center", "missing: the point that the supports turn about")
    center = read_vector(case, f"{key}.spin.center", spec.spin.center, d)
    return RigidMotion(velocity, axis, float(np.radians(spec.spin.rate)), center)


def _check_start(case: Case, key: str, history: History) -> float:
    """Return the slope of a displacement's history at t = 0 [1/s]; raises CaseError if it jumps there."""
    start = history(0.0)
    if abs(start) > _AT_REST:
        raise case.make_error(key, f"is {start:.9g} at t = 0; the nodes start at rest, so it must be 0")
    dt = case.schedule.dt
    slope, closer = (_find_slope(history, part * _FIRST_INSTANT * dt) for part in (1, 1 / 16))
    if abs(closer) > _GROWTH * abs(slope) and abs(closer) * dt > abs(history(dt)):
        message = f"starts with a velocity that is not finite: {slope:.3g} or {closer:.3g} 1/s, the closer to t = 0"
        raise case.make_error(key, f"{message}; start with a finite one, such as smooth(t/0.5)")
    return slope


def _find_slope(history: History, h: float) -> float:
    """Return the derivative at t = 0, from the right, of order two in h [s]."""
    return (4 * history(h) - history(2 * h) - 3 * history(0.0)) / (2 * h)
