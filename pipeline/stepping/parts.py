"""The parts that a stepper is made of and that a case chooses."""

from typing import Protocol

from pipeline.stepping.inversion import Treatment
from pipeline.stepping.stage import StageSolver


class StepperParts(Protocol):
    """Makes the parts of a stepper for one body and one method."""

    def make_stage_solver(self, h: float) -> StageSolver:
        """Return a new solver of implicit stages of size h [s]."""
        ...

    def make_treatment(self) -> Treatment | None:
        """Return the treatment of inverted cells, None if the law treats them itself."""
        ...
