r"""Backward Euler: M (v - v_n) = dt (f_ext + f_el(x_n + dt v)),  x_{n+1} = x_n + dt v   (T 4.47, 4.48 with + for -).

Order 1; L-stable for the linear law. It damps: with z = omega dt, a step leaves a mode 1/sqrt(1 + z^2) of its amplitude
and turns it by atan z instead of z. Not for motions whose oscillation matters: 1 % damping needs z < .02.
"""

from dataclasses import dataclass
from math import atan, hypot, log

from pipeline.fem.body import Body
from pipeline.fem.damping import find_mode_root
from pipeline.stepping.inversion import Treatment, track_rotations
from pipeline.stepping.parts import StepperParts
from pipeline.stepping.report import StepReport
from pipeline.stepping.stage import Stage, StageSolver
from pipeline.stepping.state import NO_ARRAYS, Memory, State


@dataclass(frozen=True, eq=False)
class BackwardEuler:
    """A stepper; the method depends on how far the stage is solved."""

    body: Body
    dt: float
    stage_solver: StageSolver
    treatment: Treatment | None = None

    @classmethod
    def make(cls, body: Body, dt: float, parts: StepperParts) -> "BackwardEuler":
        """Return the stepper with the parts that a case names."""
        return cls(body, dt, parts.make_stage_solver(dt), parts.make_treatment())

    @property
    def chooses_model(self) -> bool:
        """Return whether each step chooses its own model."""
        return self.stage_solver.chooses_model

    def step(self, state: State) -> tuple[State, StepReport]:
        """Return the state dt later."""
        end, x_n = (state.step + 1) * self.dt, state.x
        held, load = self.body.held_positions(end), self.body.load_at(end)
        R, inversion = track_rotations(self.treatment, self.body, x_n, state)
        guided = self.body.guided_positions(end)
        stage = Stage(x_n, state.v, self.dt, x_n, x_n, held, load, starts_at_x_n=True, R=R, guided=guided)
        x, v, report = self.stage_solver.solve(stage)
        report.work.steps += 1
        return State(state.step + 1, x, v, Memory(NO_ARRAYS, inversion, state.memory.energy)), report


def damping_ratio(z: float) -> float:
    """Return the damping ratio that backward Euler gives a mode with z = omega dt [1]."""
    decay, turn = log(1 + z * z), 2 * atan(z)
    return decay / hypot(decay, turn)


def mode_factor(z: float, zeta: float = 0.0) -> complex:
    """Return the factor G by which a step multiplies a mode with z = omega dt and the damping ratio zeta.

    The exact one is e^(w z), with the root w of w^2 + 2 zeta w + 1 = 0: e^(i z) without damping.
    """
    return 1 / (1 - find_mode_root(zeta) * z)
