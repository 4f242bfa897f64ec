"""The settings that a trade-off study runs: slices through the knobs of a case, not their product.

On the case's mesh: every model for every implicit stepper at every dt, two smaller steps of the most accurate stepper
with the main models, explicit steppers below their limit, and the other mass matrix once for each stepper. On finer
meshes: the main models. All runs are compared at the same instants, multiples of the longest dt.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, prod
from typing import Any

import numpy as np

from pipeline.arrays import Ints
from pipeline.case import Case
from pipeline.case.keys import ONLY_VARIANT, MeshSpec
from pipeline.problem.methods import IMPLICIT_STEPPERS, STEP_LIMITS, STEPPERS, find_traits
from pipeline.problem.problem import build, resolve_mass
from pipeline.studies.coverage import list_left_out
from pipeline.system.times import TIME_RTOL, count_intervals

# of the reference motion
REFERENCE_STEPPER = max(IMPLICIT_STEPPERS, key=lambda name: STEPPERS[name].order)
CONVERGED = ("corotational", "polar", "converged")
AUTO = ("auto", "none", "none")
LINEAR = ("linear", "none", "none")
# law, rotation, iterations
MODELS = (
    LINEAR,
    ("corotational", "gram_schmidt", "1"),
    ("corotational", "polar", "1"),
    ("corotational", "polar", "2"),
    ("corotational", "polar", "3"),
    CONVERGED,
    AUTO,
)
FINE_MODELS = (LINEAR, ("corotational", "polar", "1"), CONVERGED, AUTO)
DT_FACTORS = (2.0, 1.0, 0.5, 0.25, 0.125)
QUICK_FACTORS = (1.0, 0.5, 0.25)
# parts of the smallest step: the reference stepper alone takes these too, and half the last is the reference's
SMALLER = (0.5, 0.25)
REFERENCE_PART = 0.125
_FINE_STEPS = 3  # of the plan's steps, from the case's own down: finer meshes cost eight times as much or more
_MOST_FRAMES = 50  # compared per run; more would cost memory and hardly change the errors
_BELOW_LIMIT = 0.9  # of the limit at rest, which falls as the body deforms


@dataclass(frozen=True)
class Setting:
    """One value of every knob: the mesh's refinement, mass, stepper, dt [s], law, rotation and iterations.

    law "auto" is model = "auto"; rotation and iterations are "none" if the law has no such knob.
    """

    refinement: int
    mass: str
    stepper: str
    dt: float
    law: str
    rotation: str
    iterations: str

    @property
    def key(self) -> str:
        """Return a name that is unique and can name a file."""
        return f"x{self.refinement}-{self.mass}-{self.stepper}-{self.dt!r}-{self.model}"

    @property
    def model(self) -> str:
        """Return law, rotation and iterations as one word."""
        if self.law != "corotational":
            return self.law
        return f"{self.rotation}-{self.iterations}"

    def as_converged(self) -> "Setting":
        """Return the setting of the same mesh, mass, stepper and dt whose solution has no model error."""
        law, rotation, iterations = CONVERGED
        return replace(self, law=law, rotation=rotation, iterations=iterations)


@dataclass(frozen=True)
class Plan:
    """The runs of a case: settings, the interval of the instants compared [s], steps and mesh refinements."""

    case: Case
    settings: tuple[Setting, ...]
    interval: float
    frames: int
    dt: float
    dts: tuple[float, ...]
    refinements: tuple[int, ...]
    tolerance: float
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        counts = f"{len(self.settings)} settings, {self.frames} instants"
        return f"<Plan of {self.case.name}: {counts}, refinements {self.refinements}>"

    def make_reference(self, refinement: int) -> Setting:
        """Return the setting whose motion counts as exact on a mesh."""
        dt = self.dts[-1] * REFERENCE_PART
        return Setting(refinement, self.case.method.mass, REFERENCE_STEPPER, dt, *CONVERGED)

    def make_coarser_reference(self, refinement: int) -> Setting:
        """Return the reference at twice its step, from which its own error is estimated."""
        reference = self.make_reference(refinement)
        return replace(reference, dt=2 * reference.dt)

    @property
    def case_setting(self) -> Setting:
        """Return the setting of the plan that is nearest to the case itself."""
        method, mass = self.case.method, self.case.method.mass
        stepper = method.stepper if method.stepper in IMPLICIT_STEPPERS else REFERENCE_STEPPER
        traits = find_traits(method)
        if traits.chooses_model or traits.is_linear:
            return Setting(1, mass, stepper, self.dt, *(AUTO if traits.chooses_model else LINEAR))
        setting = Setting(1, mass, stepper, self.dt, method.law, method.rotation, str(method.iterations))
        return setting if setting in self.settings else setting.as_converged()


def make_plan(
    case: Case,
    *,
    tolerance: float = 0.01,
    dts: Sequence[float] = (),
    refinements: Sequence[int] = (),
    steps: int | None = None,
    quick: bool = False,
) -> Plan:
    """Return the plan of a case without its variants, cut to `steps` of its own steps.

    Raises CaseError if steps or refinements do not fit the case.
    """
    build(case.model_copy(update={"variants": {}}).variant(ONLY_VARIANT))  # raises its errors now
    explicit = find_traits(case.method).is_explicit
    schedule = case.schedule
    # an explicit case's own step is too short for implicit steppers; the interval of its frames fits
    dt = schedule.dt * (schedule.steps_per_frame if explicit else 1)
    ladder = _choose_steps(case, dts, [dt * f for f in (QUICK_FACTORS if quick else DT_FACTORS)])
    own = schedule.steps_per_frame * schedule.frames
    end = schedule.dt * (own if steps is None else min(steps, own))
    count = int(end / ladder[0] * (1 + TIME_RTOL))
    if count < 1:
        raise case.make_error(
            "schedule.frames", f"{end:g} s is shorter than the longest step of the study, {ladder[0]:g} s"
        )
    stride = ceil(count / _MOST_FRAMES)
    meshes, notes = _choose_refinements(case, refinements, quick)
    nearest = min(ladder, key=lambda step: abs(step / dt - 1))
    case = case.model_copy(update={"method": case.method.model_copy(update={"inversion": "flip"})})
    plan = Plan(case, (), stride * ladder[0], count // stride, nearest, ladder, meshes, tolerance, notes)
    settings = dict.fromkeys(s for refinement in meshes for s in _list_settings(plan, refinement))
    if left_out := list_left_out(_list_method(plan, setting) for setting in settings):
        notes = (*notes, f"not tried: {', '.join(left_out)}")
    return replace(plan, settings=tuple(settings), notes=notes)


def _list_method(plan: Plan, setting: Setting) -> dict[str, Any]:
    """Return the method keys of a setting without their section."""
    return {key.removeprefix("method."): value for key, value in make_method_keys(plan, setting).items()}


def _choose_steps(case: Case, requested: Sequence[float], default: Sequence[float]) -> tuple[float, ...]:
    """Return the steps, longest first; raises CaseError if one does not divide the longest."""
    ladder = tuple(sorted(set(requested or default), reverse=True))
    for dt in ladder:
        if not 0 < dt < float("inf"):
            raise case.make_error("schedule.dt", f"--dt {dt:g} is not a positive number of seconds")
        if count_intervals(ladder[0], dt) is None:
            raise case.make_error(
                "schedule.dt", f"--dt {dt:g} does not divide the longest one, {ladder[0]:g}: no common instants"
            )
    return ladder


def _choose_refinements(case: Case, requested: Sequence[int], quick: bool) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Return the refinements that can be compared, 1 first, and notes if there is no mesh error."""
    if any(factor < 1 for factor in requested):
        raise case.make_error("mesh.cells", f"--refine {min(requested)}: factors must be whole numbers, 1 or more")
    odd = [factor for factor in requested if max(requested) % factor]
    if odd:
        raise case.make_error(
            "mesh.cells", f"--refine {odd[0]} does not divide the largest, {max(requested)}: no common nodes"
        )
    reason = None
    if case.mesh.shape is None:
        reason = "its mesh is a file, which is not refined here"
    elif any(region.nodes is not None for region in (*case.supports, *case.loads.traction)):
        reason = "a selection names nodes, whose numbers differ in a finer mesh"
    wanted = tuple(sorted({1, *(requested or ((1,) if quick else (1, 2)))}))
    if reason is None:
        return wanted, () if len(wanted) > 1 else ("mesh error not available: one mesh only (--refine 2)",)
    return (1,), (f"mesh error not available: {reason}",)


def _list_settings(plan: Plan, refinement: int) -> list[Setting]:
    """Return the settings of one mesh, the reference first."""
    mass, other = plan.case.method.mass, {"consistent": "lumped", "lumped": "consistent"}[plan.case.method.mass]
    fine = refinement > 1
    dts = [dt for dt in plan.dts if dt <= plan.dt][:_FINE_STEPS] if fine else plan.dts
    out = [plan.make_reference(refinement)]
    for stepper in IMPLICIT_STEPPERS:
        out += [Setting(refinement, mass, stepper, dt, *m) for dt in dts for m in (FINE_MODELS if fine else MODELS)]
    smaller = () if fine else [plan.dts[-1] * part for part in SMALLER]
    out += [Setting(refinement, mass, REFERENCE_STEPPER, dt, *m) for dt in smaller for m in FINE_MODELS]
    out += [Setting(refinement, other, stepper, plan.dt, *CONVERGED) for stepper in IMPLICIT_STEPPERS]
    out.append(replace(plan.make_reference(refinement), mass=other, dt=dts[-1]))
    for stepper in STEP_LIMITS:
        dt = _choose_explicit_step(plan, refinement, stepper)
        out += [Setting(refinement, "lumped", stepper, dt / part, "corotational", "polar", "1") for part in (1, 2)]
    return out


def _choose_explicit_step(plan: Plan, refinement: int, stepper: str) -> float:
    """Return the longest step [s] below a stepper's limit that divides the interval of the instants."""
    body = build(make_point_case(plan, plan.make_reference(refinement))).body
    bound, _ = STEP_LIMITS[stepper]
    return plan.interval / ceil(plan.interval / (_BELOW_LIMIT * bound(body)))


def make_point_case(plan: Plan, setting: Setting) -> Case:
    """Return the case of one setting, with the mass that its stepper takes."""
    return resolve_mass(
        plan.case.model_copy(update={"variants": {"point": make_overrides(plan, setting)}}).variant("point")
    )


def make_overrides(plan: Plan, setting: Setting) -> dict[str, Any]:
    """Return the setting as a variant's overrides, with a frame at each instant of the plan."""
    steps = round(plan.interval / setting.dt)
    schedule = {"dt": plan.interval / steps, "steps_per_frame": steps, "frames": plan.frames}
    return make_method_keys(plan, setting) | make_mesh_keys(plan, setting) | {"schedule": schedule}


def make_method_keys(plan: Plan, setting: Setting) -> dict[str, Any]:
    """Return the method keys of a setting."""
    keys: dict[str, Any] = {"method.stepper": setting.stepper, "method.mass": setting.mass}
    if setting.law == "auto":
        return keys | {"method.model": "auto", "method.volume_tolerance": plan.tolerance}
    keys |= {"method.model": "fixed", "method.law": setting.law}
    if setting.law == "corotational":
        passes = setting.iterations
        keys["method.rotation"] = setting.rotation
        keys["method.iterations"] = int(passes) if passes.isdigit() else passes
    return keys


def make_mesh_keys(plan: Plan, setting: Setting) -> dict[str, Any]:
    """Return the mesh key of a setting; none for the case's own mesh."""
    mesh: MeshSpec = plan.case.mesh
    if setting.refinement == 1 or mesh.cells is None:
        return {}
    return {"mesh.cells": [setting.refinement * count for count in mesh.cells]}


def find_coarse_nodes(cells: Sequence[int], factor: int) -> Ints:
    """Return the number of every node of a grid of cells in the grid refined by an integer factor (n,)."""
    coarse = np.stack(np.meshgrid(*[np.arange(c + 1) for c in cells], indexing="ij"), axis=-1)
    counts = tuple(factor * c + 1 for c in cells)
    numbers = np.ravel_multi_index(tuple(np.moveaxis(factor * coarse, -1, 0)), counts)
    return numbers.reshape(prod(c + 1 for c in cells)).astype(np.int64)
