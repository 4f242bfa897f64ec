r"""model = "auto": in every step the cheapest model that keeps a tolerance on spurious volume.

A step's spurious volume is tan^2 of the angle between the rotation U that its solve used and the rotation R that it
reached. Linear elasticity uses I, one solve the rotations that it starts from, and a converged step those that it
reaches. In strained cells that turn, the stress that the solve balanced is off by more: the indicator
(fem/frame_error.py) is the larger of the two, in the worst cell. Hence, with T the tolerance,

    U = I and the factor of the rest state, if cells at x_n are that close to I;  else U = R(x_n)
    solve the stage with U;  find R at the positions reached
    accept if indicator(U, R) <= T;  else U = R and solve again
    if that does not shrink the indicator, or a cell turned by 90 degrees or more, Newton's method solves the step

Damped by beta, a body skips U = I: rates of strain in a frame that is off by the angle t brake a rotation by sin t.

No accepted step has an indicator above T. It bounds volume, not phase: numerical damping still depends on the number
of solves.
"""

from typing import ClassVar

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.frame_error import FrameError
from pipeline.linear.work import Work
from pipeline.stepping.newton import Converged
from pipeline.stepping.report import CONVERGED, COROTATIONAL, LINEAR, ModelChoice, StepReport
from pipeline.stepping.stage import FrozenPasses, Prefactored, Stage, advance

_SHRINKS = 0.5  # a pass that leaves more than this fraction of the indicator is not converging
_PASSES = 8  # 7 halvings take an indicator of 1, which is 45 degrees, below the default tolerance of .01


class Auto:
    """Solves stages to a tolerance on spurious volume and stray stress."""

    chooses_model: ClassVar[bool] = True

    def __init__(
        self, body: Body, linear: Prefactored, passes: FrozenPasses, newton: Converged, tolerance: float
    ) -> None:
        self.body = body
        self.linear = linear
        self.passes = passes
        self.newton = newton
        self.tolerance = tolerance
        # a copy of the positions measured last, the result, and whether it was measured from I. A step usually begins
        # at the positions at which the previous one ended: then they are not measured again
        self._x, self._is_measured = np.zeros_like(body.mesh.points), False
        self._error, self._from_rest = FrameError(np.inf, np.inf), False
        # rotations used and rotations reached, in turn
        d = body.mesh.dimension
        self._used, self._reached = np.empty((2, body.site_count, d, d))
        from pipeline.stepping.kernels.positions import are_equal

        self._are_equal = are_equal
        are_equal(self._x, self._x)  # it is compiled or loaded here, not in a timed step

    def solve(self, stage: Stage) -> tuple[Floats, Floats, StepReport]:
        """Return the accepted x and v, and a report with rung and indicator; raises SolveError as Newton does."""
        x, v, work, rung = self._solve_first(stage)
        error = self._measure(x)
        is_frozen = rung == COROTATIONAL and not stage.starts_at_x_n
        for _ in range(_PASSES):
            if error.indicator <= self.tolerance:
                break
            before = error.indicator
            if not is_frozen:
                self.passes.system.freeze_damping(stage, at_start=False)
                is_frozen = True
            work += self._run_pass(x, stage, v, at_x_h=False)
            rung = COROTATIONAL
            error = self._measure(advance(self.body, stage, v, out=x))
            if not error.indicator <= max(self.tolerance, _SHRINKS * before):
                break
        if error.indicator <= self.tolerance:
            return x, v, StepReport(work, ModelChoice(rung, work.solves, error.indicator))
        x, v, report = self.newton.solve(stage)
        work += report.work
        return x, v, StepReport(work, ModelChoice(CONVERGED, work.solves, 0.0))

    def _solve_first(self, stage: Stage) -> tuple[Floats, Floats, Work, int]:
        """Return x and v of the first solve, its work and its rung."""
        near_rest = self._is_near_rest(stage.now)
        self._is_measured = False  # from here on the buffers change; a solve may fail
        if near_rest:
            self._from_rest = True
            x, v, report = self.linear.solve(stage)
            return x, v, report.work, LINEAR
        if not stage.starts_at_x_n:
            self.body.update_rotations(stage.start, self._reached)
        v = stage.v_h.copy()
        self.passes.system.freeze_damping(stage, at_start=True)
        work = self._run_pass(stage.start, stage, v, at_x_h=stage.starts_at_x_n)
        return advance(self.body, stage, v), v, work, COROTATIONAL

    def _run_pass(self, x: Floats, stage: Stage, v: Floats, *, at_x_h: bool) -> Work:
        """Improve v by a solve with the rotations reached at x (n, d), which are the ones used from now on."""
        self._used, self._reached = self._reached, self._used
        self._from_rest = False
        return self.passes.run_pass(x, stage, v, self._used, at_x_h=at_x_h)

    def _measure(self, x: Floats) -> FrameError:
        """Return how far the rotations at x are from those used; a bound replaces the result if it is low enough."""
        self._x[:] = x
        self._is_measured = True
        bound = self.body.bound_frame_error(x) if self._from_rest else np.inf
        if bound <= self.tolerance:
            self._error = FrameError(bound, bound)
        else:
            self._error = self.body.measure_frame_error(x, None if self._from_rest else self._used, self._reached)
        return self._error

    def _is_near_rest(self, x: Floats) -> bool:
        """Return whether the linear law will do for cells at x; if not, their rotations are in `_reached`."""
        # the kernel is compiled for one kind of array; others are measured again
        if self._is_measured and x.flags.carray and self._are_equal(x, self._x):
            if self._from_rest:
                return self._error.indicator <= self.tolerance
            if self._error.from_rest > self.tolerance:
                return False
        if self.body.damping is not None and self.body.damping.stiffness:
            self.body.update_rotations(x, self._reached)
            return False
        if self.body.bound_frame_error(x) <= self.tolerance:
            return True
        # the second part of the indicator costs more: it is measured only if the first does not decide
        if self.body.update_rotations(x, self._reached) > self.tolerance:
            return False
        return self.body.measure_frame_error(x, None, self._reached).indicator <= self.tolerance
