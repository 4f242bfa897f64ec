r"""BDF2: with v_h = (4 v_n - v_{n-1})/3, x_h = (4 x_n - x_{n-1})/3, h = 2 dt/3

    M (v - v_h) = h (f_ext + f_el(x_h + h v)),    x_{n+1} = x_h + h v

Order 2, L-stable for the linear law; started by one step of backward Euler. One solve linearizes at the extrapolated
x* = 2 x_n - x_{n-1}, which keeps order 2. For one mode, G is the larger root of (3/2 - 2/G + 1/(2 G^2))^2 = -z^2.
Not for impacts: it remembers the previous state.
"""

from cmath import sqrt
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.damping import find_mode_root
from pipeline.stepping.backward_euler import BackwardEuler
from pipeline.stepping.inversion import Treatment, track_rotations
from pipeline.stepping.parts import StepperParts
from pipeline.stepping.report import StepReport
from pipeline.stepping.stage import Stage, StageSolver
from pipeline.stepping.state import Memory, State


@dataclass(eq=False)
class BDF2:
    """A stepper; `first` makes the first step; the memory carries `x_before` and `v_before`."""

    body: Body
    dt: float
    first: BackwardEuler
    stage_solver: StageSolver
    treatment: Treatment | None = None

    def __post_init__(self) -> None:
        self._stage = np.empty((3, *self.body.mesh.points.shape))

    @classmethod
    def make(cls, body: Body, dt: float, parts: StepperParts) -> "BDF2":
        """Return the stepper with the parts that a case names."""
        first = BackwardEuler.make(body, dt, parts)
        return cls(body, dt, first, parts.make_stage_solver(2 * dt / 3), parts.make_treatment())

    @property
    def chooses_model(self) -> bool:
        """Return whether each step chooses its own model."""
        return self.stage_solver.chooses_model

    def step(self, state: State) -> tuple[State, StepReport]:
        """Return the state dt later."""
        x, v, before = state.x, state.v, {"x_before": state.x, "v_before": state.v}
        if state.step == 0:
            first, report = self.first.step(state)
            return State(1, first.x, first.v, Memory(before, first.memory.inversion, first.memory.energy)), report
        x_before, v_before = state.memory.stepper["x_before"], state.memory.stepper["v_before"]
        h, end = 2 * self.dt / 3, (state.step + 1) * self.dt
        x_h, v_h = _extrapolate(x, x_before, 1 / 3, self._stage[0]), _extrapolate(v, v_before, 1 / 3, self._stage[1])
        x_star = _extrapolate(x, x_before, 1.0, self._stage[2])
        held, load = self.body.held_positions(end), self.body.load_at(end)
        R, inversion = track_rotations(self.treatment, self.body, x_star, state)
        guided = self.body.guided_positions(end)
        stage = Stage(x_h, v_h, h, x_star, x, held, load, starts_at_x_n=False, R=R, guided=guided)
        x_new, v_new, report = self.stage_solver.solve(stage)
        report.work.steps += 1
        return State(state.step + 1, x_new, v_new, Memory(before, inversion, state.memory.energy)), report


def _extrapolate(now: Floats, before: Floats, part: float, out: Floats) -> Floats:
    """Return now + part (now - before), in `out`; written so that a body at rest stays so to the last bit."""
    np.subtract(now, before, out=out)
    out *= part
    out += now
    return out


def mode_factor(z: float, zeta: float = 0.0) -> complex:
    """Return the factor G by which a step multiplies a mode with z = omega dt and the damping ratio zeta.

    The exact one is e^(w z), with the root w of w^2 + 2 zeta w + 1 = 0: e^(i z) without damping.
    """
    return 1 / (2 - sqrt(1 + 2 * find_mode_root(zeta) * z))
