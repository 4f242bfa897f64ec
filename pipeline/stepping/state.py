"""The state that a stepper advances, and the memory carried from step to step besides positions and velocities."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from pipeline.arrays import Floats
from pipeline.stepping.report import StepReport


class EnergyRecord(NamedTuple):
    """The energy guard's numbers: energy at the start [J], |work of supports| since then [J], bad steps in a row."""

    start: float
    supplied: float
    strikes: int


NO_ARRAYS: Mapping[str, Floats] = {}


class Memory(NamedTuple):
    """The part of a state besides x and v; each field is read and changed by its owner alone and passed on by others.

    `stepper` has the arrays of the stepper by name, `inversion` those of the treatment of inverted cells; `energy`
    belongs to the energy guard.
    """

    stepper: Mapping[str, Floats] = NO_ARRAYS
    inversion: Mapping[str, Floats] = NO_ARRAYS
    energy: EnergyRecord | None = None


NO_MEMORY = Memory()


@dataclass(frozen=True, eq=False)
class State:
    """Positions x (n, d) [m] and velocities v (n, d) [m/s] after `step` steps; time is step * dt.

    A step changes none of these arrays; states may share them.
    """

    step: int
    x: Floats
    v: Floats
    memory: Memory = NO_MEMORY


class Stepper(Protocol):
    """Advances a prepared body by one step of size dt."""

    @property
    def dt(self) -> float:
        """Return the step's size [s]."""
        ...

    @property
    def chooses_model(self) -> bool:
        """Return whether each step chooses its own model; its reports then say which."""
        ...

    def step(self, state: State) -> tuple[State, StepReport]:
        """Return the state one step later and a report of the step; raises SolveError."""
        ...
