r"""model = "auto": the cheapest rotations that a step can do with, by one number, tolerance, on spurious volume.

A step's spurious volume is tan^2 of the angle between the rotation its solve USED and the rotation it REACHED:
linear elasticity used I, one solve the rotations that it started from, a converged step those that it reaches. Hence

    use   I and the matrix factored at rest, while tan^2 of the present angles <= tolerance;  else the present rotations
    solve the stage with them; look at the rotations reached
    accept where max over cells of tan^2 angle(R_used, R_reached) <= tolerance;  else use those reached and solve again
    where that does not shrink, or a cell turned by 90 degrees and more, Newton's method finishes the step

No accepted step has an indicator above the tolerance. It bounds volume, not phase: what damping a step has still
depends on how often it was solved.
"""

import numpy as np

from pipeline.fem.body import Body
from pipeline.fem.element import deformation_gradient
from pipeline.fem.rotation import polar
from pipeline.mesh.simplex import Floats
from pipeline.stepping.implicit import FrozenPasses, Prefactored, Stage
from pipeline.stepping.newton import Converged
from pipeline.stepping.state import Work

LINEAR, COROTATIONAL, CONVERGED = 0, 1, 2  # the rungs
_SHRINKS = 0.5  # a frozen pass that leaves more than this part of the indicator is not getting there
_PASSES = 8


class Auto:
    """Solves stages to a tolerance on spurious volume."""

    def __init__(
        self, body: Body, linear: Prefactored, passes: FrozenPasses, newton: Converged, tolerance: float
    ) -> None:
        self.body = body
        self.linear = linear
        self.passes = passes
        self.newton = newton
        self.tolerance = tolerance
        e, d = len(body.mesh.cells), body.mesh.dimension
        self._unturned = np.broadcast_to(np.eye(d), (e, d, d))

    def solve(self, stage: Stage) -> tuple[Floats, Work]:
        """Return the accepted velocity; work says which rung and indicator; raises SolveError where Newton does."""
        v, used, work = self._first(stage)
        reached = self._rotations(stage.x_h + stage.h * v)
        indicator = spurious_volume(used, reached)
        for _ in range(_PASSES):
            if indicator <= self.tolerance:
                return v, work + Work(indicator=indicator)
            v, done = self.passes.pass_from(stage.x_h, stage, reached)
            work += done + Work(rung=COROTATIONAL)
            used, reached = reached, self._rotations(stage.x_h + stage.h * v)
            before, indicator = indicator, spurious_volume(used, reached)
            if not indicator <= max(self.tolerance, _SHRINKS * before):
                break
        if indicator <= self.tolerance:
            return v, work + Work(indicator=indicator)
        v, done = self.newton.solve(stage)
        return v, work + done + Work(rung=CONVERGED)

    def _first(self, stage: Stage) -> tuple[Floats, Floats, Work]:
        """Return v of the first solve, the rotations it used, and its work."""
        present = self._rotations(stage.start)
        if spurious_volume(self._unturned, present) <= self.tolerance:
            v, work = self.linear.solve(stage)
            return v, self._unturned, work + Work(rotations=1)
        v, work = self.passes.pass_from(stage.x_h, stage, present)
        return v, present, work + Work(rung=COROTATIONAL)

    def _rotations(self, x: Floats) -> Floats:
        return polar(deformation_gradient(self.body.mesh, x))


def spurious_volume(used: Floats, reached: Floats) -> float:
    """Return max over cells of tan^2 of the angle between two rotations (e, d, d); infinite from 90 degrees on."""
    d = used.shape[-1]
    trace = np.einsum("eij,eij->e", used, reached).min()
    cosine = (trace - 1) / 2 if d == 3 else trace / 2
    return float(1 / cosine**2 - 1) if cosine > 0 else np.inf
