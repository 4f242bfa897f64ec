"""What a stepper carries from step to step, and what it counts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats
from pipeline.linear.work import Work


@dataclass(frozen=True, eq=False)
class State:
    """Positions x (n, d) [m] and velocities v (n, d) [m/s] after `step` steps; time is step * dt.

    `memory` is all else that the method carries, as plain named arrays. None of these arrays is to be changed: who made
    it knows it again in the next step (fidelity.py). Make a new state instead.
    """

    step: int
    x: Floats
    v: Floats
    memory: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)


class Stepper(Protocol):
    """Advances a prepared body by one step of size dt."""

    @property
    def dt(self) -> float:
        """Return the step's size [s]."""
        ...

    def step(self, state: State) -> tuple[State, Work]:
        """Return the state one step later and the work it took; raises SolveError."""
        ...
