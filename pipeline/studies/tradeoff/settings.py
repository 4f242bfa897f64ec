"""The settings that a trade-off study runs: slices through the knobs of a case, not their product.

On the case's mesh: every law, rotation and number of iterations for both implicit steppers at every dt, two steps more
of bdf2 with the laws that a choice is made of, symplectic Euler below its limit, and the other mass matrix once a
stepper. On finer meshes: the laws that a choice is made of.
Everything is seen at the same instants, multiples of the longest dt.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, prod
from typing import Any

import numpy as np

from pipeline.arrays import Ints
from pipeline.case import Case
from pipeline.case.specs import ONLY_VARIANT, MeshSpec
from pipeline.problem.methods import IMPLICIT_STEPPERS, STEP_LIMITS, find_traits
from pipeline.problem.problem import build, resolve_mass

IMPLICIT = IMPLICIT_STEPPERS
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
# of the smallest step: bdf2 alone takes these too, and half the last is the reference's
SMALLER = (0.5, 0.25)
REFERENCE_PART = 0.125
_MOST_FRAMES = 50  # seen of a run; more cost memory and tell little
_BELOW_LIMIT = 0.9  # the bound is that of the body at rest
_WHOLE = 1e-9  # a ratio this near to a whole number is meant to be one


@dataclass(frozen=True)
class Setting:
    """One value of every knob: the mesh's refinement, mass, stepper, dt [s], law, rotation and iterations.

    law "auto" is model = "auto"; rotation and iterations are "none" where the law has no such knob.
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

    def converged(self) -> "Setting":
        """Return the setting whose solution has no model error: same mesh, mass, stepper and dt."""
        law, rotation, iterations = CONVERGED
        return replace(self, law=law, rotation=rotation, iterations=iterations)


@dataclass(frozen=True)
class Plan:
    """What is run of a case: settings, the instants seen [s], the mesh refinements, and the references' steps."""

    case: Case
    settings: tuple[Setting, ...]
    interval: float
    frames: int
    dt: float
    dts: tuple[float, ...]
    refinements: tuple[int, ...]
    tolerance: float
    notes: tuple[str, ...]

    def reference(self, refinement: int) -> Setting:
        """Return the setting that stands for the exact motion on a mesh."""
        dt = self.dts[-1] * REFERENCE_PART
        return Setting(refinement, self.case.method.mass, "bdf2", dt, *CONVERGED)

    def reference_before(self, refinement: int) -> Setting:
        """Return the reference at twice its step, which its own error is estimated by."""
        reference = self.reference(refinement)
        return replace(reference, dt=2 * reference.dt)

    @property
    def own(self) -> Setting:
        """Return the setting of the case itself, as near as the plan has it."""
        method, mass = self.case.method, self.case.method.mass
        stepper = method.stepper if method.stepper in IMPLICIT else "bdf2"
        traits = find_traits(method)
        if traits.chooses_model or traits.is_linear:
            return Setting(1, mass, stepper, self.dt, *(AUTO if traits.chooses_model else LINEAR))
        one = Setting(1, mass, stepper, self.dt, "corotational", method.rotation, str(method.iterations))
        return one if one in self.settings else one.converged()


def make_plan(
    case: Case,
    *,
    tolerance: float,
    dts: Sequence[float] = (),
    refinements: Sequence[int] = (),
    steps: int | None = None,
    quick: bool = False,
) -> Plan:
    """Return the plan of a case as it is without variants, cut to `steps` of its own steps.

    Raises CaseError where steps or refinements do not fit it.
    """
    build(case.model_copy(update={"variants": {}}).variant(ONLY_VARIANT))  # what is wrong with it is told now
    explicit = find_traits(case.method).is_explicit
    schedule = case.schedule
    # an explicit case's own step says nothing of what implicit ones can take; its frames do
    dt = schedule.dt * (schedule.steps_per_frame if explicit else 1)
    ladder = _choose_steps(case, dts, [dt * f for f in (QUICK_FACTORS if quick else DT_FACTORS)])
    own = schedule.steps_per_frame * schedule.frames
    end = schedule.dt * (own if steps is None else min(steps, own))
    count = int(end / ladder[0] * (1 + _WHOLE))
    if count < 1:
        raise case.make_error(
            "schedule.frames", f"{end:g} s are shorter than the longest step of the study, {ladder[0]:g} s"
        )
    stride = ceil(count / _MOST_FRAMES)
    meshes, notes = _choose_refinements(case, refinements, quick)
    nearest = min(ladder, key=lambda one: abs(one / dt - 1))
    case = case.model_copy(update={"method": case.method.model_copy(update={"inversion": "flip"})})
    plan = Plan(case, (), stride * ladder[0], count // stride, nearest, ladder, meshes, tolerance, notes)
    settings = [s for refinement in meshes for s in _list_settings(plan, refinement)]
    return replace(plan, settings=tuple(dict.fromkeys(settings)))


def _choose_steps(case: Case, asked: Sequence[float], usual: Sequence[float]) -> tuple[float, ...]:
    """Return the steps, longest first; raises CaseError where one does not divide the longest."""
    ladder = tuple(sorted(set(asked or usual), reverse=True))
    for dt in ladder:
        if not 0 < dt < float("inf"):
            raise case.make_error("schedule.dt", f"--dt {dt:g} is not a positive number of seconds")
        ratio = ladder[0] / dt
        if abs(ratio - round(ratio)) > _WHOLE * ratio:
            raise case.make_error(
                "schedule.dt", f"--dt {dt:g} does not divide the longest one, {ladder[0]:g}: no common instants"
            )
    return ladder


def _choose_refinements(case: Case, asked: Sequence[int], quick: bool) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Return the refinements that can be compared, 1 first, and notes of what is not available."""
    if any(factor < 1 for factor in asked):
        raise case.make_error("mesh.cells", f"--refine {min(asked)}: factors are whole numbers from 1 on")
    odd = [factor for factor in asked if max(asked) % factor]
    if odd:
        raise case.make_error(
            "mesh.cells", f"--refine {odd[0]} does not divide the largest, {max(asked)}: no common nodes"
        )
    reason = None
    if case.mesh.shape is None:
        reason = "its mesh is a file, which is not refined here"
    elif any(one.nodes is not None for one in (*case.supports, *case.loads.traction)):
        reason = "a selection names nodes, which a finer mesh numbers otherwise"
    wanted = tuple(sorted({1, *(asked or ((1,) if quick else (1, 2)))}))
    if reason is None:
        return wanted, () if len(wanted) > 1 else ("mesh error not available: one mesh only (--refine 2)",)
    return (1,), (f"mesh error not available: {reason}",)


def _list_settings(plan: Plan, refinement: int) -> list[Setting]:
    mass, other = plan.case.method.mass, {"consistent": "lumped", "lumped": "consistent"}[plan.case.method.mass]
    fine = refinement > 1
    dts = [dt for dt in plan.dts if dt <= plan.dt][:3] if fine else plan.dts
    out = [plan.reference(refinement)]
    for stepper in IMPLICIT:
        out += [Setting(refinement, mass, stepper, dt, *m) for dt in dts for m in (FINE_MODELS if fine else MODELS)]
    smaller = () if fine else [plan.dts[-1] * part for part in SMALLER]
    out += [Setting(refinement, mass, "bdf2", dt, *m) for dt in smaller for m in FINE_MODELS]
    out += [Setting(refinement, other, stepper, plan.dt, *CONVERGED) for stepper in IMPLICIT]
    out.append(replace(plan.reference(refinement), mass=other, dt=dts[-1]))
    dt = _choose_explicit_step(plan, refinement)
    for part in (1, 2):
        out += [Setting(refinement, "lumped", "symplectic_euler", dt / part, "corotational", "polar", "1")]
    return out


def _choose_explicit_step(plan: Plan, refinement: int) -> float:
    """Return the longest step [s] that symplectic Euler can take between two instants in whole steps."""
    body = build(make_point_case(plan, plan.reference(refinement))).body
    bound, _ = STEP_LIMITS["symplectic_euler"]
    return plan.interval / ceil(plan.interval / (_BELOW_LIMIT * bound(body)))


def make_point_case(plan: Plan, setting: Setting) -> Case:
    """Return the case of one setting, with what its stepper decides written out."""
    return resolve_mass(
        plan.case.model_copy(update={"variants": {"point": make_overrides(plan, setting)}}).variant("point")
    )


def make_overrides(plan: Plan, setting: Setting) -> dict[str, Any]:
    """Return the setting as a variant's overrides, its schedule the plan's instants."""
    steps = round(plan.interval / setting.dt)
    schedule = {"dt": plan.interval / steps, "steps_per_frame": steps, "frames": plan.frames}
    return make_method_keys(plan, setting) | make_mesh_keys(plan, setting) | {"schedule": schedule}


def make_method_keys(plan: Plan, setting: Setting) -> dict[str, Any]:
    """Return the keys of the method that a setting stands for."""
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
    """Return the key of the mesh that a setting stands for; none for the case's own."""
    mesh: MeshSpec = plan.case.mesh
    if setting.refinement == 1 or mesh.cells is None:
        return {}
    return {"mesh.cells": [setting.refinement * count for count in mesh.cells]}


def find_coarse_nodes(cells: Sequence[int], factor: int) -> Ints:
    """Return the number of every node of a grid of cells in the grid refined by a whole factor (n,)."""
    coarse = np.stack(np.meshgrid(*[np.arange(c + 1) for c in cells], indexing="ij"), axis=-1)
    counts = tuple(factor * c + 1 for c in cells)
    found = np.ravel_multi_index(tuple(np.moveaxis(factor * coarse, -1, 0)), counts)
    return found.reshape(prod(c + 1 for c in cells)).astype(np.int64)
