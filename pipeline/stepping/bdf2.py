r"""BDF2: with v_h = (4 v_n - v_{n-1})/3, x_h = (4 x_n - x_{n-1})/3, h = 2 dt/3

    M (v - v_h) = h (f_ext + f_el(x_h + h v)),    x_{n+1} = x_h + h v

Order 2, L-stable for the linear law; started by one step of backward Euler. One solve linearises at the extrapolated
x* = 2 x_n - x_{n-1}, which keeps order 2. On one mode the larger root of (3/2 - 2/G + 1/(2 G^2))^2 = -z^2 is G.
Not for impacts: it remembers the state before.
"""

from cmath import sqrt
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.linear.work import Work
from pipeline.stepping.backward_euler import BackwardEuler
from pipeline.stepping.inversion import Treatment, tracked_rotations
from pipeline.stepping.stage import Stage, StageSolver
from pipeline.stepping.state import State


@dataclass(eq=False)
class BDF2:
    """A stepper; `first` makes the first step, memory carries `x_before` and `v_before`."""

    body: Body
    dt: float
    first: BackwardEuler
    stage_solver: StageSolver
    treatment: Treatment | None = None

    def __post_init__(self) -> None:
        self._stage = np.empty((3, *self.body.mesh.points.shape))

    def step(self, state: State) -> tuple[State, Work]:
        """Return the state dt later."""
        memory = {"x_before": state.x, "v_before": state.v}
        if state.step == 0:
            began, work = self.first.step(state)
            return State(1, began.x, began.v, {**began.memory, **memory}), work
        x, v = state.x, state.v
        x_before, v_before = state.memory["x_before"], state.memory["v_before"]
        h = 2 * self.dt / 3
        x_h, v_h = _onward(x, x_before, 1 / 3, self._stage[0]), _onward(v, v_before, 1 / 3, self._stage[1])
        extrapolated = _onward(x, x_before, 1.0, self._stage[2])
        end = (state.step + 1) * self.dt
        held, load = self.body.held_positions(end), self.body.load_at(end)
        R, remembered = tracked_rotations(self.treatment, self.body, extrapolated, state)
        x_new, v_new, work = self.stage_solver.solve(Stage(x_h, v_h, h, extrapolated, x, held, load, R))
        work.steps += 1
        return State(state.step + 1, x_new, v_new, {**remembered, **memory}), work


def _onward(now: Floats, before: Floats, part: float, out: Floats) -> Floats:
    """Write now + part (now - before) into out, and return it: written so that what rests stays to the last bit."""
    np.subtract(now, before, out=out)
    out *= part
    out += now
    return out


def mode_factor(z: float) -> complex:
    """Return the factor G of a step on a mode with z = omega dt; an exact step would turn it by e^(i z)."""
    return 1 / (2 - sqrt(1 + 2j * z))
