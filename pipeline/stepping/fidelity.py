r"""model = "auto": the cheapest rotations that a step can do with, by one number, tolerance, on spurious volume.

A step's spurious volume is tan^2 of the angle between the rotation its solve USED and the rotation it REACHED:
linear elasticity used I, one solve the rotations that it started from, a converged step those that it reaches. In
strained cells that turn, the stress that the solve balanced strays by more: the indicator (fem/turning.py) is the
larger of the two, in the worst cell. Hence

    use   I and the matrix factored at rest, while the present cells are that near to I;  else the present rotations
    solve the stage with them; look at the rotations reached
    accept where the indicator of (used, reached) <= tolerance;  else use those reached and solve again
    where that does not shrink, or a cell turned by 90 degrees and more, Newton's method finishes the step

No accepted step has an indicator above the tolerance. It bounds volume, not phase: what damping a step has still
depends on how often it was solved.
"""

import numpy as np

from pipeline.fem.body import Body
from pipeline.fem.turning import Turning
from pipeline.mesh.simplex import Floats
from pipeline.stepping.implicit import FrozenPasses, Prefactored, Stage
from pipeline.stepping.newton import Converged
from pipeline.stepping.state import Work

LINEAR, COROTATIONAL, CONVERGED = 0, 1, 2  # the rungs
_SHRINKS = 0.5  # a frozen pass that leaves more than this part of the indicator is not getting there
_PASSES = 8


class Auto:
    """Solves stages to a tolerance on spurious volume and stray stress."""

    def __init__(
        self, body: Body, linear: Prefactored, passes: FrozenPasses, newton: Converged, tolerance: float
    ) -> None:
        self.body = body
        self.linear = linear
        self.passes = passes
        self.newton = newton
        self.tolerance = tolerance
        self._unturned = np.eye(body.mesh.dimension)[None]
        self._last = (np.empty((0, 0)), Turning(np.inf, None))  # positions and how far they are from unturned

    def solve(self, stage: Stage) -> tuple[Floats, Work]:
        """Return the accepted velocity; work says which rung and indicator; raises SolveError where Newton does."""
        v, used, work = self._first(stage)
        turned = self._turning(stage.x_h + stage.h * v, used)
        for _ in range(_PASSES):
            if turned.indicator <= self.tolerance:
                return v, work + Work(indicator=turned.indicator)
            assert turned.reached is not None
            used, before = turned.reached, turned.indicator
            v, done = self.passes.pass_from(stage.x_h, stage, used)
            work += done + Work(rung=COROTATIONAL)
            turned = self._turning(stage.x_h + stage.h * v, used)
            if not turned.indicator <= max(self.tolerance, _SHRINKS * before):
                break
        if turned.indicator <= self.tolerance:
            return v, work + Work(indicator=turned.indicator)
        v, done = self.newton.solve(stage)
        return v, work + done + Work(rung=CONVERGED)

    def _first(self, stage: Stage) -> tuple[Floats, Floats, Work]:
        """Return v of the first solve, the rotations it used, and its work."""
        present = self._turning(stage.start, self._unturned)
        if present.indicator <= self.tolerance:
            v, work = self.linear.solve(stage)
            return v, self._unturned, work + Work(rotations=1)
        assert present.reached is not None
        v, work = self.passes.pass_from(stage.x_h, stage, present.reached)
        return v, present.reached, work + Work(rung=COROTATIONAL)

    def _turning(self, x: Floats, used: Floats) -> Turning:
        """Return how far x has turned from the rotations used; a step starts where the one before it was judged."""
        if used is not self._unturned:
            return self.body.turning(x, used)
        if not np.array_equal(x, self._last[0]):
            self._last = x, self.body.turning(x, used, self.tolerance)
        return self._last[1]
