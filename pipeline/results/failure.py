"""A failed step: the state of the body before it, the worst cell, and possible remedies."""

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
from pipeline.mesh.simplex import measure_quality
from pipeline.problem.methods import STEP_LIMITS, find_traits
from pipeline.problem.problem import Problem
from pipeline.run.frame import Frame, Values
from pipeline.run.measures import measure, pad_to_space
from pipeline.stepping.state import State

FILE = "failure.vtu"
# with one solve per step, volumes are off by 1/cos^2 of the angle by which a cell turns: 3 % at 10 degrees
_ACCURATE_DEGREES = 10.0
_POOR_QUALITY = 0.1  # quality of a cell; a regular cell has 1
_MOST_DEGREES = 90.0  # rotation of a cell in a step; larger angles are meaningless


@dataclass(frozen=True, eq=False)
class Failure:
    """The last state before the failing step and its fields per cell (e,), for the message and failure.vtu."""

    problem: Problem
    state: State
    volume_ratio: Floats
    rotation_angle: Floats  # [degree]
    energy_density: Floats  # [J/m3], the mean in the cell
    rotation_per_step: Floats  # [degree], the largest in the cell, at the current velocities
    quality: Floats
    extremes: Values  # the smallest and largest det F of cells in which it varies

    @property
    def inverted_count(self) -> int:
        """Return the number of cells with det F <= 0 somewhere."""
        return int((self.extremes.get("volume_ratio_min", self.volume_ratio) <= 0).sum())

    @property
    def worst(self) -> int:
        """Return the cell whose volume ratio is farthest from one."""
        return int(np.abs(self.volume_ratio - 1).argmax())

    def describe(self, error: SolveError) -> str:
        """Return one line: what happened, where, and the likeliest remedies with their numbers."""
        cell, step = self.worst, self.state.step
        place = (
            f"after step {step} {self.inverted_count} of {len(self.volume_ratio)} cells are inverted, "
            f"the worst, cell {cell}, has volume ratio {self.volume_ratio[cell]:.3g} and quality "
            f"{self.quality[cell]:.2g} at rest; cells turn by up to {self.rotation_per_step.max():.3g} degrees per step"
        )
        return f"{error}; {place}; {'; or '.join(self.list_remedies())} ({FILE} shows where)"

    def list_remedies(self) -> list[str]:
        """Return possible remedies, the likeliest first."""
        method, dt = self.problem.method, self.problem.dt
        traits = find_traits(method)
        remedies = []
        if method.stepper in STEP_LIMITS:
            bound, _ = STEP_LIMITS[method.stepper]
            remedies.append(
                f"{method.stepper} is stable below {bound(self.problem.body):.3g} s at rest: use half of that"
            )
        else:
            degrees = min(float(self.rotation_per_step.max()), _MOST_DEGREES)
            shorter = dt * min(0.5, _ACCURATE_DEGREES / degrees if degrees else 0.5)
            remedies.append(f"try schedule.dt = {shorter:.2g}")
            if traits.is_converged:
                remedies.append(f"method.max_iterations = {10 * method.max_iterations}")
            elif not (traits.chooses_model or traits.is_linear):
                remedies.append('method.iterations = "converged" with method.rotation = "polar"')
        poor = int(self.quality.argmin())
        if self.quality[poor] < _POOR_QUALITY:
            remedies.append(f"a better mesh: the quality of cell {poor} is {self.quality[poor]:.2g} (1 is regular)")
        return remedies

    def as_dict(self) -> dict[str, Any]:
        """Return the entry `failure` of run.json."""
        worst = self.worst
        return {
            "file": FILE,
            "step": self.state.step,
            "time": self.state.step * self.problem.dt,
            "inverted_count": self.inverted_count,
            "worst": {"cell": worst, "volume_ratio": float(self.volume_ratio[worst])},
            "rotation_per_step": float(self.rotation_per_step.max()),
            "worst_quality": {"cell": int(self.quality.argmin()), "quality": float(self.quality.min())},
        }

    def write(self, folder: Path, message: str) -> None:
        """Write the state as failure.vtu, which no index lists; raises OutputError."""
        mesh, state = self.problem.body.mesh, self.state
        rest = pad_to_space(mesh.points)
        point_data = {
            "displacement": pad_to_space(state.x - mesh.points),
            "velocity": pad_to_space(state.v),
            "speed": np.linalg.norm(state.v, axis=1),
        }
        names = ("volume_ratio", "rotation_angle", "energy_density", "rotation_per_step", "quality")
        cell_data = {**{name: getattr(self, name) for name in names}, **self.extremes}
        field_data = {
            "TimeValue": np.array([[state.step * self.problem.dt]]),
            "step": np.array([[state.step]]),
            "message": np.array([message.encode(errors="replace")]),
        }
        static = encode_static_parts(mesh.cell_array, rest)
        write_whole(folder / FILE, encode_vtu(pad_to_space(state.x), point_data, cell_data, field_data, static))


def examine_failure(problem: Problem, state: State) -> Failure:
    """Return the last state before a step that failed, with its fields per cell."""
    body, mesh = problem.body, problem.body.mesh
    weights = mesh.integration.weights
    with np.errstate(all="ignore"):  # the values may be huge
        F = deformation_gradient(mesh, state.x)
        F_next = deformation_gradient(mesh, state.x + problem.dt * state.v)
        turned = np.degrees(angle(np.swapaxes(polar(F), 1, 2) @ polar(F_next)))
        measured = measure(Frame(0, 0.0, mesh, state.x))
        density = body.energy_density(state.x).reshape(weights.shape)
        return Failure(
            problem,
            state,
            volume_ratio=measured["volume_ratio"],
            rotation_angle=measured["rotation_angle"],
            energy_density=(weights * density).sum(axis=1) / mesh.rest_volumes,
            rotation_per_step=turned.reshape(weights.shape).max(axis=1),
            quality=measure_quality(mesh),
            extremes={name: measured[name] for name in ("volume_ratio_min", "volume_ratio_max") if name in measured},
        )
