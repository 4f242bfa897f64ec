"""The settings that a trade-off study runs: slices through the knobs of a case, not their product.

On the case's mesh: every model for every implicit stepper at every dt, two smaller steps of the most accurate stepper
with the main models, explicit steppers below their limit, and the other mass matrix once for each stepper. On other
meshes: the main models. All runs are compared at the same instants, multiples of the longest dt.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

from pipeline.case import Case
from pipeline.case.keys import ONLY_VARIANT
from pipeline.problem.methods import IMPLICIT_STEPPERS, STEP_LIMITS, STEPPERS, find_traits
from pipeline.problem.problem import build, resolve_mass
from pipeline.studies.coverage import list_left_out
from pipeline.studies.tradeoff.levels import MeshLevel, choose_levels, make_mesh_keys
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
_FINE_STEPS = 3  # of the plan's steps, from the case's own down, on other meshes: finer ones cost much more
_MOST_FRAMES = 50  # compared per run; more would cost memory and hardly change the errors
_BELOW_LIMIT = 0.9  # of the limit at rest, which falls as the body deforms


@dataclass(frozen=True)
class Setting:
    """One value of every knob: refinement and order of the mesh, mass, stepper, dt [s], law, rotation, iterations.

    law "auto" is model = "auto"; rotation and iterations are "none" if the law has no such knob.
    """

    refinement: float
    order: int
    mass: str
    stepper: str
    dt: float
    law: str
    rotation: str
    iterations: str

    @property
    def key(self) -> str:
        """Return a name that is unique and can name a file."""
        return f"x{self.refinement:g}-order{self.order}-{self.mass}-{self.stepper}-{self.dt!r}-{self.model}"

    @property
    def level(self) -> MeshLevel:
        """Return the mesh."""
        return MeshLevel(self.refinement, self.order)

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
    """The runs of a case: settings, the interval of the instants compared [s], steps and meshes."""

    case: Case
    settings: tuple[Setting, ...]
    interval: float
    frames: int
    dt: float
    dts: tuple[float, ...]
    levels: tuple[MeshLevel, ...]
    tolerance: float
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        counts = f"{len(self.settings)} settings, {self.frames} instants"
        return f"<Plan of {self.case.name}: {counts}, {len(self.levels)} meshes>"

    @property
    def own(self) -> MeshLevel:
        """Return the case's own mesh."""
        return MeshLevel(1.0, self.case.mesh.order)

    @property
    def finest(self) -> MeshLevel:
        """Return the most accurate mesh."""
        return self.levels[-1]

    def make_reference(self, level: MeshLevel) -> Setting:
        """Return the setting whose motion counts as exact on a mesh."""
        dt = self.dts[-1] * REFERENCE_PART
        return Setting(*level, self.case.method.mass, REFERENCE_STEPPER, dt, *CONVERGED)

    def make_coarser_reference(self, level: MeshLevel) -> Setting:
        """Return the reference at twice its step, from which its own error is estimated."""
        reference = self.make_reference(level)
        return replace(reference, dt=2 * reference.dt)

    @property
    def case_setting(self) -> Setting:
        """Return the setting of the plan that is nearest to the case itself."""
        method, mass = self.case.method, self.case.method.mass
        stepper = method.stepper if method.stepper in IMPLICIT_STEPPERS else REFERENCE_STEPPER
        traits = find_traits(method)
        if traits.chooses_model or traits.is_linear:
            return Setting(*self.own, mass, stepper, self.dt, *(AUTO if traits.chooses_model else LINEAR))
        setting = Setting(*self.own, mass, stepper, self.dt, method.law, method.rotation, str(method.iterations))
        return setting if setting in self.settings else setting.as_converged()


def make_plan(
    case: Case,
    *,
    tolerance: float = 0.01,
    dts: Sequence[float] = (),
    refinements: Sequence[float] = (),
    orders: Sequence[int] = (),
    steps: int | None = None,
    quick: bool = False,
) -> Plan:
    """Return the plan of a case without its variants, cut to `steps` of its own steps.

    Raises CaseError if steps, refinements or orders do not fit the case.
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
    levels, notes = choose_levels(case, refinements, orders, quick=quick)
    nearest = min(ladder, key=lambda step: abs(step / dt - 1))
    case = case.model_copy(update={"method": case.method.model_copy(update={"inversion": "flip"})})
    plan = Plan(case, (), stride * ladder[0], count // stride, nearest, ladder, levels, tolerance, notes)
    settings = dict.fromkeys(s for level in levels for s in _list_settings(plan, level))
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


def _list_settings(plan: Plan, level: MeshLevel) -> list[Setting]:
    """Return the settings of one mesh, the reference first."""
    mass, other = plan.case.method.mass, {"consistent": "lumped", "lumped": "consistent"}[plan.case.method.mass]
    other_mesh = level != plan.own
    dts = [dt for dt in plan.dts if dt <= plan.dt][:_FINE_STEPS] if other_mesh else plan.dts
    out = [plan.make_reference(level)]
    for stepper in IMPLICIT_STEPPERS:
        out += [Setting(*level, mass, stepper, dt, *m) for dt in dts for m in (FINE_MODELS if other_mesh else MODELS)]
    smaller = () if other_mesh else [plan.dts[-1] * part for part in SMALLER]
    out += [Setting(*level, mass, REFERENCE_STEPPER, dt, *m) for dt in smaller for m in FINE_MODELS]
    out += [Setting(*level, other, stepper, plan.dt, *CONVERGED) for stepper in IMPLICIT_STEPPERS]
    out.append(replace(plan.make_reference(level), mass=other, dt=dts[-1]))
    for stepper in STEP_LIMITS:
        dt = _choose_explicit_step(plan, level, stepper)
        parts = (1,) if other_mesh else (1, 2)
        out += [Setting(*level, "lumped", stepper, dt / part, "corotational", "polar", "1") for part in parts]
    return out


def _choose_explicit_step(plan: Plan, level: MeshLevel, stepper: str) -> float:
    """Return the longest step [s] below a stepper's limit that divides the interval of the instants."""
    body = build(make_point_case(plan, plan.make_reference(level))).body
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
    return make_method_keys(plan, setting) | make_mesh_keys(plan.case, setting.level) | {"schedule": schedule}


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
