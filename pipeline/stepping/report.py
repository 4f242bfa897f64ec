"""Reports of steps: their work and, if the method chooses a model for each step, that choice."""

from dataclasses import dataclass
from typing import NamedTuple

from pipeline.linear.work import Work

LINEAR, COROTATIONAL, CONVERGED = 0, 1, 2  # the rungs
RUNG_NAMES = ("linear", "corotational", "converged")


class ModelChoice(NamedTuple):
    """The model that a step needed: its rung, the systems solved, and a bound on the spurious volume of the step."""

    rung: int
    solves: int
    indicator: float


@dataclass(slots=True)  # not frozen, like Work: both are made in every step
class StepReport:
    """The work of one step, and its choice of a model if the method makes one. The caller owns it."""

    work: Work
    choice: ModelChoice | None = None


@dataclass(frozen=True, slots=True)
class Effort:
    """The work of several steps, and the choices of those that made one, in order."""

    work: Work
    choices: tuple[ModelChoice, ...] = ()

    def __add__(self, report: StepReport) -> "Effort":
        choices = self.choices if report.choice is None else (*self.choices, report.choice)
        return Effort(self.work + report.work, choices)
