"""A trade-off study as rows, one for each setting: its cost and its distance from each reference.

model    from the converged solution with the same stepper, dt, mesh and mass: the error of law and iterations
motion   from the converged solution of a small step on the same mesh: that error and those of stepper, dt and mass
total    from that reference on the finest mesh, at the common nodes and in total volume: those and the mesh's error

The finest mesh has an error of its own, estimated from how references on coarser meshes of its order approach it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from pipeline.errors import SolveError
from pipeline.linear.work import Work
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.problem.methods import STEPPERS
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
from pipeline.studies.tradeoff.finest_error import FinestError, estimate_finest_error
from pipeline.studies.tradeoff.levels import MeshLevel, match_nodes
from pipeline.studies.tradeoff.motion import COUNTS, RecordedMotion, read_motion
from pipeline.studies.tradeoff.settings import REFERENCE_STEPPER, Plan, Setting, make_point_case

# meshes share nodes but no cells
TOTALS = (*DISTANCES, "drift")
REFERENCES = ("model", "motion", "total")


def _name_count(count: str) -> str:
    """Return a count's name in files, in which `iterations` is a knob."""
    return {"iterations": "newton_iterations"}.get(count, count)


# unit and meaning of every cost
COSTS = {
    "seconds": ("s", "solver seconds of the run, median of its repeats"),
    "setup_seconds": ("s", "seconds before the first step, median of the repeats"),
    "seconds_per_step": ("s", "solver seconds a step"),
    "real_time_factor": ("1", "simulated seconds a solver second"),
    **{_name_count(name): ("1", f"{name} of the run") for name in COUNTS},
}
_LEAST_ORDER = 0.5  # below this, halving the step says nothing about the error


@dataclass(frozen=True)
class SettingRow:
    """A setting, its costs by the names of COSTS, its deviations "reference_measure", and the error that ended it."""

    setting: Setting
    costs: Mapping[str, float] = field(default_factory=dict)
    deviations: Mapping[str, float] = field(default_factory=dict)
    failure: str | None = None

    def compute_error(self, reference: str = "motion") -> float:
        """Return the error that is compared with a tolerance; NaN if it is unknown."""
        prefix = f"{reference}_"
        measures = {k.removeprefix(prefix): v for k, v in self.deviations.items() if k.startswith(prefix)}
        return combine_error(measures) if measures else float("nan")


@dataclass(frozen=True)
class ReferenceErrors:
    """Estimated errors of the references: of time (None: not run), its observed order, and of the finest mesh."""

    time: float | None
    order: float | None
    finest: FinestError | None

    @property
    def mesh(self) -> float | None:
        """Return the error of the finest mesh; None if it is not known."""
        return None if self.finest is None else self.finest.error


class ErrorTable:
    """The rows of a study, from the results of its points."""

    def __init__(self, plan: Plan, results: Mapping[str, dict[str, Any]]) -> None:
        self.plan = plan
        self._results = results
        self._motion: Callable[[Setting], RecordedMotion | None] = lru_cache(maxsize=64)(self._read)
        self._meshes = {level: self._build_mesh(level) for level in plan.levels}
        self._modes = {level: self._find_mode(level) for level in plan.levels}
        self._nodes = {level: match_nodes(mesh, self._meshes[plan.finest]) for level, mesh in self._meshes.items()}
        for level in plan.levels:
            if self._motion(plan.make_reference(level)) is None:
                reason = results[plan.make_reference(level).key].get("error")
                raise SolveError(f"{plan.case.path}: no reference with {level}: {reason}")
        self.rows = [self._make_row(setting) for setting in plan.settings]

    def find_row(self, setting: Setting) -> SettingRow | None:
        """Return the row of a setting; None if it was not run."""
        return next((row for row in self.rows if row.setting == setting), None)

    def estimate_reference_errors(self) -> ReferenceErrors:
        """Return the errors of the references, from their change with step and mesh (Richardson)."""
        plan = self.plan
        fine, before = self._motion(plan.make_reference(plan.own)), self._motion(plan.make_coarser_reference(plan.own))
        if fine is None or before is None:
            return ReferenceErrors(None, None, self._estimate_mesh_error())
        halved = combine_error(measure_deviation(before, fine, None))
        last = self._motion(replace(plan.make_reference(plan.own), dt=4 * plan.make_reference(plan.own).dt))
        order = None
        if last is not None and halved > 0:
            order = float(np.log2(combine_error(measure_deviation(last, before, None)) / halved))
        formal = float(STEPPERS[REFERENCE_STEPPER].order)
        observed = float(np.clip(formal if order is None else order, _LEAST_ORDER, formal))
        # the sum of the remaining changes, a geometric series
        return ReferenceErrors(halved / (2**observed - 1), order, self._estimate_mesh_error())

    def find_mesh_error(self, level: MeshLevel) -> float:
        """Return the distance of the reference on a mesh from that on the finest; NaN if there is only one mesh."""
        row = self.find_row(self.plan.make_reference(level))
        return row.compute_error("total") if row and len(self.plan.levels) > 1 else float("nan")

    def find_time_error(self, setting: Setting) -> float:
        """Return the distance of a setting's stepper and dt, converged, from the reference; NaN if it was not run."""
        row = self.find_row(setting.as_converged())
        return row.compute_error("motion") if row else float("nan")

    def _estimate_mesh_error(self) -> FinestError | None:
        """Return the error of the finest mesh, from those of its order with cells 2 and 4 times as large."""
        finest = self.plan.finest
        coarser = [MeshLevel(finest.refinement / part, finest.order) for part in (2, 4)]
        return estimate_finest_error(finest.order, [self.find_mesh_error(level) for level in coarser])

    def _read(self, setting: Setting) -> RecordedMotion | None:
        result = self._results.get(setting.key, {"error": "not run"})
        return None if "error" in result else read_motion(result, self._meshes[setting.level])

    def _build_mesh(self, level: MeshLevel) -> ElementMesh:
        return build_mesh(make_point_case(self.plan, self.plan.make_reference(level)))

    def _find_mode(self, level: MeshLevel) -> FirstMode | None:
        return find_first_mode(build(make_point_case(self.plan, self.plan.make_reference(level))).body)

    def _make_row(self, setting: Setting) -> SettingRow:
        result = self._results[setting.key]
        if "error" in result:
            return SettingRow(setting, failure=str(result["error"]))
        motion = self._motion(setting)
        assert motion is not None
        mode = self._modes[setting.level]
        deviations: dict[str, float] = {}
        converged = self._motion(setting.as_converged()) if STEPPERS[setting.stepper].is_implicit else None
        reference = self._motion(self.plan.make_reference(setting.level))
        for name, other in (("model", converged), ("motion", reference)):
            if other is not None:
                measures = measure_deviation(motion, other, mode)
                deviations |= {f"{name}_{key}": value for key, value in measures.items()}
        finest = self._motion(self.plan.make_reference(self.plan.finest))
        if finest is not None and len(self.plan.levels) > 1:
            measures = measure_distances(motion, finest, self._nodes[setting.level])
            measures["drift"] = float(np.abs(motion.drift - finest.drift).max())
            deviations |= {f"total_{key}": value for key, value in measures.items()}
        return SettingRow(setting, self._list_costs(result), deviations)

    def _list_costs(self, result: Mapping[str, Any]) -> dict[str, float]:
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
    """Return the names of the deviations that any row has, in order."""
    present = {name for row in table.rows for name in row.deviations}
    names = [f"{r}_{m}" for r in REFERENCES for m in (TOTALS if r == "total" else MEASURES)]
    return [name for name in names if name in present]
