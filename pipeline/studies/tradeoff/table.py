"""A trade-off study as rows, a row a setting: what it cost and how far it was from each reference.

model    from the converged solution with the same stepper, dt, mesh and mass: what the law and the iterations cost
motion   from the converged BDF2 of a small step on the same mesh: that, and what stepper, dt and mass cost
total    from that reference on the finest mesh, at the nodes that both have: that, and what the mesh costs
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.errors import SolveError
from pipeline.linear.work import Work
from pipeline.mesh.simplex import Mesh
from pipeline.problem.problem import build, build_mesh
from pipeline.studies.tradeoff.deviation import (
    DISTANCES,
    MEASURES,
    FirstMode,
    combine_error,
    find_first_mode,
    measure_deviation,
    measure_distances,
)
from pipeline.studies.tradeoff.motion import COUNTS, RecordedMotion, read_motion
from pipeline.studies.tradeoff.settings import Plan, Setting, find_coarse_nodes, make_point_case

REFERENCES = ("model", "motion", "total")


def _name_count(count: str) -> str:
    """Return a count's name in files, where `iterations` is a knob."""
    return {"iterations": "newton_iterations"}.get(count, count)


# unit and meaning of every cost
COSTS = {
    "seconds": ("s", "solver seconds of the run, median of its repeats"),
    "setup_seconds": ("s", "seconds before the first step, median of the repeats"),
    "seconds_per_step": ("s", "solver seconds a step"),
    "real_time_factor": ("1", "simulated seconds a solver second"),
    **{_name_count(name): ("1", f"{name} of the run") for name in COUNTS},
}


_ORDER, _LEAST_ORDER = 2.0, 0.5  # of bdf2; below the least a series of halvings says nothing


@dataclass(frozen=True)
class SettingRow:
    """A setting, its costs by the names of COSTS, its deviations "reference_measure", and why it has none."""

    setting: Setting
    costs: Mapping[str, float] = field(default_factory=dict)
    deviations: Mapping[str, float] = field(default_factory=dict)
    failure: str | None = None

    def error(self, reference: str = "motion") -> float:
        """Return the number that a tolerance is held against; NaN where it is not known."""
        prefix = f"{reference}_"
        found = {k.removeprefix(prefix): v for k, v in self.deviations.items() if k.startswith(prefix)}
        return combine_error(found) if found else float("nan")


@dataclass(frozen=True)
class ReferenceErrors:
    """What the references are off by themselves: of time (None: not run), its observed order, of the finest mesh."""

    time: float | None
    order: float | None
    mesh: float | None


class ErrorTable:
    """The rows of a study, made of the results of its points."""

    def __init__(self, plan: Plan, results: Mapping[str, dict[str, Any]]) -> None:
        self.plan = plan
        self._results = results
        self._motion: Callable[[Setting], RecordedMotion | None] = lru_cache(maxsize=64)(self._read)
        self._meshes = {r: self._mesh(r) for r in plan.refinements}
        self._modes = {r: self._mode(r) for r in plan.refinements}
        for refinement in plan.refinements:
            if self._motion(plan.reference(refinement)) is None:
                reason = results[plan.reference(refinement).key].get("error")
                raise SolveError(f"{plan.case.path}: no reference on mesh x{refinement}: {reason}")
        self.rows = [self._row(setting) for setting in plan.settings]

    def row(self, setting: Setting) -> SettingRow | None:
        """Return the row of a setting; None where it was not run."""
        return next((row for row in self.rows if row.setting == setting), None)

    def reference_error(self) -> ReferenceErrors:
        """Return what the references are off by, from how much they change with their step and mesh (Richardson)."""
        plan = self.plan
        fine, before = self._motion(plan.reference(1)), self._motion(plan.reference_before(1))
        if fine is None or before is None:
            return ReferenceErrors(None, None, self._mesh_error())
        halved = combine_error(measure_deviation(before, fine, None))
        last = self._motion(replace(plan.reference(1), dt=4 * plan.reference(1).dt))
        order = None
        if last is not None and halved > 0:
            order = float(np.log2(combine_error(measure_deviation(last, before, None)) / halved))
        sure = float(np.clip(_ORDER if order is None else order, _LEAST_ORDER, _ORDER))
        return ReferenceErrors(halved / (2**sure - 1), order, self._mesh_error())  # the rest of a geometric series

    def mesh_error(self, refinement: int) -> float:
        """Return how far the reference on a mesh is from that on the finest; NaN where there is one mesh only."""
        row = self.row(self.plan.reference(refinement))
        return row.error("total") if row and len(self.plan.refinements) > 1 else float("nan")

    def time_error(self, setting: Setting) -> float:
        """Return how far the converged solution of a setting's stepper and dt is from the reference; NaN if not run."""
        row = self.row(setting.converged())
        return row.error("motion") if row else float("nan")

    def _mesh_error(self) -> float | None:
        """Return what the finest mesh is off by, if errors fall with the square of the cells' size."""
        last = self.plan.refinements[-2:]
        if len(last) < 2:
            return None
        return self.mesh_error(last[0]) / ((last[1] / last[0]) ** 2 - 1)

    def _read(self, setting: Setting) -> RecordedMotion | None:
        result = self._results.get(setting.key, {"error": "not run"})
        return None if "error" in result else read_motion(result, self._meshes[setting.refinement])

    def _mesh(self, refinement: int) -> Mesh:
        return build_mesh(make_point_case(self.plan, self.plan.reference(refinement)))

    def _mode(self, refinement: int) -> FirstMode | None:
        return find_first_mode(build(make_point_case(self.plan, self.plan.reference(refinement))).body)

    def _row(self, setting: Setting) -> SettingRow:
        result = self._results[setting.key]
        if "error" in result:
            return SettingRow(setting, failure=str(result["error"]))
        motion = self._motion(setting)
        assert motion is not None
        mode = self._modes[setting.refinement]
        found: dict[str, float] = {}
        same = self._motion(setting.converged()) if setting.stepper != "symplectic_euler" else None
        reference = self._motion(self.plan.reference(setting.refinement))
        for name, other in (("model", same), ("motion", reference)):
            if other is not None:
                found |= {f"{name}_{key}": value for key, value in measure_deviation(motion, other, mode).items()}
        finest = self._motion(self.plan.reference(self.plan.refinements[-1]))
        if finest is not None and len(self.plan.refinements) > 1:
            nodes = self._nodes(setting.refinement)
            found |= {f"total_{key}": value for key, value in measure_distances(motion, finest, nodes).items()}
        return SettingRow(setting, self._costs(result), found)

    def _nodes(self, refinement: int) -> Any:
        cells = self.plan.case.mesh.cells
        assert cells is not None
        return find_coarse_nodes([refinement * c for c in cells], self.plan.refinements[-1] // refinement)

    def _costs(self, result: Mapping[str, Any]) -> dict[str, float]:
        work = Work(**result["work"])
        seconds = float(result["seconds"])
        simulated = self.plan.interval * self.plan.frames
        return {
            "seconds": seconds,
            "setup_seconds": float(result["setup_seconds"]),
            "seconds_per_step": seconds / work.steps,
            "real_time_factor": simulated / seconds,
            **{_name_count(name): float(getattr(work, name)) for name in COUNTS},
        }


def list_deviations(table: ErrorTable) -> list[str]:
    """Return the names of all deviations that some row has, in order."""
    present = {name for row in table.rows for name in row.deviations}
    names = [f"{r}_{m}" for r in REFERENCES for m in (DISTANCES if r == "total" else MEASURES)]
    return [name for name in names if name in present]
