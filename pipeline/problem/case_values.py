"""Values of a case as numpy needs them: vectors of the mesh's dimension, axes, histories, values from Python."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.case import Case, SpinSpec
from pipeline.case.python_values import PythonValue
from pipeline.errors import SolveError
from pipeline.fem.histories import History, make_history

_MOST_SAMPLES = 1000  # times at which a history is evaluated before a run


def read_vector(case: Case, key: str, value: tuple[float, ...] | None, d: int) -> Floats:
    """Return a vector (d,) of the case, zeros if it is None; raises CaseError if its length is not d."""
    if value is None:
        return np.zeros(d)
    if len(value) != d:
        raise case.make_error(key, f"{list(value)} has {len(value)} components, the mesh has {d} dimensions")
    return np.array(value, dtype=np.float64)


def read_axis(case: Case, key: str, spin: SpinSpec, d: int) -> Floats:
    """Return the unit axis (3,); in the plane it must be along z."""
    axis = np.array(spin.axis, dtype=np.float64)
    if d == 2 and axis[:2].any():
        raise case.make_error(f"{key}.axis", f"{list(spin.axis)} is not along z; the mesh is planar")
    axis /= np.abs(axis).max()  # the square of a tiny component would underflow
    return np.asarray(axis / np.linalg.norm(axis))


def get_python_value(case: Case, key: str, entry: PythonValue) -> Any:
    """Return an array or function that the case carries; raises CaseError if it was read back from a file."""
    if entry.value is None:
        raise case.make_error(key, "was given in Python and is not in the file; make the case in Python again")
    return entry.value


def read_history(
    case: Case, key: str, spec: str | Sequence[tuple[float, float]], until: float | None = None
) -> History:
    """Return a history of the case; raises CaseError if it has no value at a time of the schedule before `until`."""
    history = make_history(spec, case.schedule.dt)
    try:
        for time in list_times(case):
            history(time if until is None else min(time, until))
    except SolveError as error:
        raise case.make_error(key, str(error)) from None
    return history


def list_times(case: Case) -> list[float]:
    """Return the times of all steps of the case, or of a thousand of them, the first and the last included [s]."""
    s = case.schedule
    count = s.frames * s.steps_per_frame
    steps = np.unique(np.linspace(0, count, min(count + 1, _MOST_SAMPLES)).round().astype(np.int64))
    return [step * s.dt for step in steps.tolist()]
