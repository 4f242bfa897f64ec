"""A step that failed: the state of the body before it, the worst cell, and possible remedies."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.element import deformation_gradient
from pipeline.fem.rotation import angle, polar
from pipeline.formats.atomic import write_whole
from pipeline.formats.vtu_write import encode_static_parts, encode_vtu
from pipeline.mesh.simplex import quality
from pipeline.problem.methods import STEP_LIMITS, find_traits
from pipeline.problem.problem import Problem
from pipeline.run.frame import Frame
from pipeline.run.measures import measure, spatial
from pipeline.stepping.state import State

FILE = "failure.vtu"
# one solve per step is off by 1/cos^2 of the angle that a cell turns in the step: 3 % at 10 degrees
_TURN = 10.0
_POOR = 0.1  # quality of a cell; a regular cell has 1
_MOST_DEGREES = 90.0  # rotation of a cell in a step; larger angles are meaningless


@dataclass(frozen=True, eq=False)
class Failure:
    """The last state before the failing step and its fields per cell (e,), for the message and failure.vtu."""

    problem: Problem
    state: State
    volume_ratio: Floats
    rotation_angle: Floats  # [degree]
    energy_density: Floats  # [J/m3]
    turn: Floats  # [degree] rotation of each cell in a step at the current velocities
    quality: Floats

    @property
    def worst(self) -> int:
        """Return the cell whose volume ratio is farthest from one."""
        return int(np.abs(self.volume_ratio - 1).argmax())

    def message(self, error: SolveError) -> str:
        """Return one line: what happened, where, and the likeliest remedies with their numbers."""
        cell, step = self.worst, self.state.step
        where = (
            f"after step {step} {int((self.volume_ratio <= 0).sum())} of {len(self.volume_ratio)} cells are inverted, "
            f"the worst, cell {cell}, has volume ratio {self.volume_ratio[cell]:.3g} and quality "
            f"{self.quality[cell]:.2g} at rest; cells turn by up to {self.turn.max():.3g} degrees per step"
        )
        return f"{error}; {where}; {'; or '.join(self.list_remedies())} ({FILE} shows where)"

    def list_remedies(self) -> list[str]:
        """Return possible remedies, the likeliest first."""
        method, dt = self.problem.method, self.problem.dt
        traits = find_traits(method)
        out = []
        if method.stepper in STEP_LIMITS:
            bound, _ = STEP_LIMITS[method.stepper]
            out.append(f"{method.stepper} is stable below {bound(self.problem.body):.3g} s at rest: use half of that")
        else:
            turn = min(float(self.turn.max()), _MOST_DEGREES)
            shorter = dt * min(0.5, _TURN / turn if turn else 0.5)
            out.append(f"try schedule.dt = {shorter:.2g}")
            if traits.is_converged:
                out.append(f"method.max_iterations = {10 * method.max_iterations}")
            elif not (traits.chooses_model or traits.is_linear):
                out.append('method.iterations = "converged" with method.rotation = "polar"')
        poor = int(self.quality.argmin())
        if self.quality[poor] < _POOR:
            out.append(f"a better mesh: the quality of cell {poor} is {self.quality[poor]:.2g} (1 is regular)")
        return out

    def record(self) -> dict[str, Any]:
        """Return the entry for run.json."""
        worst = self.worst
        return {
            "file": FILE,
            "step": self.state.step,
            "time": self.state.step * self.problem.dt,
            "inverted_count": int((self.volume_ratio <= 0).sum()),
            "worst": {"cell": worst, "volume_ratio": float(self.volume_ratio[worst])},
            "turn_a_step": float(self.turn.max()),
            "worst_quality": {"cell": int(self.quality.argmin()), "quality": float(self.quality.min())},
        }

    def write(self, folder: Path, message: str) -> None:
        """Write the state as failure.vtu, which no index lists; raises OutputError."""
        mesh, state = self.problem.body.mesh, self.state
        rest = spatial(mesh.points)
        point_data = {
            "displacement": spatial(state.x - mesh.points),
            "velocity": spatial(state.v),
            "speed": np.linalg.norm(state.v, axis=1),
        }
        cell_data = {
            name: getattr(self, name)
            for name in ("volume_ratio", "rotation_angle", "energy_density", "turn", "quality")
        }
        field_data = {
            "TimeValue": np.array([[state.step * self.problem.dt]]),
            "step": np.array([[state.step]]),
            "message": np.array([message.encode(errors="replace")]),
        }
        static = encode_static_parts(mesh.cells, rest)
        write_whole(folder / FILE, encode_vtu(spatial(state.x), point_data, cell_data, field_data, static))


def examine_failure(problem: Problem, state: State) -> Failure:
    """Return the last state before a step that failed, with its fields per cell."""
    body, mesh = problem.body, problem.body.mesh
    with np.errstate(all="ignore"):  # the values may be huge
        F = deformation_gradient(mesh, state.x)
        ahead = deformation_gradient(mesh, state.x + problem.dt * state.v)
        measured = measure(Frame(0, 0.0, mesh, state.x))
        return Failure(
            problem,
            state,
            volume_ratio=measured["volume_ratio"],
            rotation_angle=measured["rotation_angle"],
            energy_density=body.law.energy_density(F, body.law.rotations(F)),
            turn=np.degrees(angle(np.swapaxes(polar(F), 1, 2) @ polar(ahead))),
            quality=quality(mesh),
        )
