r"""Backward Euler: M (v - v_n) = dt (f_ext + f_el(x_n + dt v)),  x_{n+1} = x_n + dt v   (T 4.47, 4.48 with + for -).

Order 1; L-stable for the linear law. It damps: with z = omega dt a mode keeps 1/sqrt(1 + z^2) of its amplitude a step
and lags by atan z a step. Not for motions whose oscillation matters: 1 % of damping needs z < .02.
"""

from dataclasses import dataclass
from math import atan, hypot, log

from pipeline.fem.body import Body
from pipeline.linear.work import Work
from pipeline.stepping.inversion import Treatment, tracked_rotations
from pipeline.stepping.stage import Stage, StageSolver
from pipeline.stepping.state import State


@dataclass(frozen=True, eq=False)
class BackwardEuler:
    """A stepper; how far the stage is solved makes the method."""

    body: Body
    dt: float
    stage_solver: StageSolver
    treatment: Treatment | None = None

    def step(self, state: State) -> tuple[State, Work]:
        """Return the state dt later."""
        end = (state.step + 1) * self.dt
        held, load = self.body.held_positions(end), self.body.load_at(end)
        R, memory = tracked_rotations(self.treatment, self.body, state.x, state)
        x, v, work = self.stage_solver.solve(Stage(state.x, state.v, self.dt, state.x, state.x, held, load, R))
        work.steps += 1
        return State(state.step + 1, x, v, memory), work


def damping_ratio(z: float) -> float:
    """Return the damping ratio that backward Euler gives a mode with z = omega dt [1]."""
    decay, turn = log(1 + z * z), 2 * atan(z)
    return decay / hypot(decay, turn)


def mode_factor(z: float) -> complex:
    """Return the factor G of a step on a mode with z = omega dt; an exact step would turn it by e^(i z)."""
    return 1 / (1 - 1j * z)
