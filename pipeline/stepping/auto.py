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

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.frame_error import Turning
from pipeline.linear.work import Work
from pipeline.stepping.newton import Converged
from pipeline.stepping.stage import FrozenPasses, Prefactored, Stage, reached

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
        # the positions judged last, how far they had turned, and from I or not: the array that one step ends with is
        # the one that the next begins with
        self._x: Floats | None = None
        self._turned, self._from_rest = Turning(np.inf, np.inf), False
        # rotations used and rotations reached, in turn
        e, d = len(body.mesh.cells), body.mesh.dimension
        self._used, self._reached = np.empty((2, e, d, d))

    def solve(self, stage: Stage) -> tuple[Floats, Floats, Work]:
        """Return the accepted x and v; work says which rung and indicator; raises SolveError where Newton does."""
        x, v, work = self._first(stage)
        turned = self._judged(x)
        for _ in range(_PASSES):
            if turned.indicator <= self.tolerance:
                break
            before = turned.indicator
            work += self._pass(x, stage, v)
            turned = self._judged(reached(self.body, stage, v, out=x))
            if not turned.indicator <= max(self.tolerance, _SHRINKS * before):
                break
        if turned.indicator <= self.tolerance:
            work.indicator = turned.indicator
            return x, v, work
        x, v, done = self.newton.solve(stage)
        work += done
        work.rung = CONVERGED
        return x, v, work

    def _first(self, stage: Stage) -> tuple[Floats, Floats, Work]:
        """Return x and v of the first solve and its work."""
        if self._is_near_rest(stage.now):
            self._from_rest = True
            return self.linear.solve(stage)
        if stage.start is not stage.now:
            self.body.turn(stage.start, self._reached)
        v = stage.v_h.copy()
        work = self._pass(stage.start, stage, v)
        return reached(self.body, stage, v), v, work

    def _pass(self, x: Floats, stage: Stage, v: Floats) -> Work:
        """Improve v by a solve with the rotations reached at x (n, d), which are used from now on."""
        self._used, self._reached = self._reached, self._used
        self._from_rest = False
        work = self.passes.pass_from(x, stage, v, self._used)
        work.rung = COROTATIONAL
        return work

    def _judged(self, x: Floats) -> Turning:
        """Return how far cells at x have turned from the rotations used; a bound will do where it is low enough."""
        self._x = x
        bound = self.body.turning_bound(x) if self._from_rest else np.inf
        if bound <= self.tolerance:
            self._turned = Turning(bound, bound)
        else:
            self._turned = self.body.turning(x, None if self._from_rest else self._used, self._reached)
        return self._turned

    def _is_near_rest(self, x: Floats) -> bool:
        """Return whether cells at x are so little turned that the linear law will do; if not, find their rotations."""
        if x is self._x:
            if self._from_rest:
                return self._turned.indicator <= self.tolerance
            if self._turned.from_rest > self.tolerance:
                return False
        if self.body.turning_bound(x) <= self.tolerance:
            return True
        # the second part of the indicator takes longer to find: only where the first does not settle it
        if self.body.turn(x, self._reached) > self.tolerance:
            return False
        return self.body.turning(x, None, self._reached).indicator <= self.tolerance
