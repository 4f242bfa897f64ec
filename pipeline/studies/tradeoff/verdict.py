"""The answers of a trade-off study: fronts, the cheapest accurate setting, the largest part of an error, the bars."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

from pipeline.problem.methods import STEPPERS
from pipeline.studies.tradeoff.deviation import VOLUME_SHARE
from pipeline.studies.tradeoff.finest_error import FinestError
from pipeline.studies.tradeoff.levels import MeshLevel
from pipeline.studies.tradeoff.settings import AUTO, Setting
from pipeline.studies.tradeoff.table import ErrorTable, SettingRow

AUTO_BAR = 1.3  # seconds of auto over the cheapest fixed setting of the same tolerance
MODE_BAR = 10.0  # by this factor the most accurate stepper needs fewer steps
_TIED = 1.1  # seconds within this ratio are equal: timing cannot separate them


@dataclass(frozen=True)
class AutoVerdict:
    """model = "auto" against the cheapest fixed setting of the same stepper, dt and mesh that meets the same tolerance.

    `volume` is the worst |J - J_ref| of auto against the converged solution, to be within twice the tolerance. The
    rival's is within the tolerance, or within auto's if auto exceeds that. `iterations` count linear solves, which do
    not depend on the machine; `ratio` is that of the seconds.
    """

    setting: Setting
    seconds: float
    iterations: float
    volume: float
    rival: Setting | None
    rival_seconds: float | None
    rival_iterations: float | None
    ratio: float | None
    is_within: bool


@dataclass(frozen=True)
class ErrorParts:
    """The three parts of a setting's error, and the name of the largest."""

    model: float
    dt: float
    mesh: float

    @property
    def dominant(self) -> str:
        """Return the largest part: model, dt or mesh; NaN counts as none."""
        parts = asdict(self)
        return max(parts, key=lambda name: parts[name] if isfinite(parts[name]) else -1.0)


def find_front(rows: Iterable[SettingRow], reference: str = "motion") -> list[SettingRow]:
    """Return the rows that no other beats in both solver seconds and error, cheapest first."""
    good = [row for row in rows if isfinite(row.compute_error(reference))]
    front: list[SettingRow] = []
    for row in sorted(good, key=lambda row: (row.costs["seconds"], row.compute_error(reference))):
        if not front or row.compute_error(reference) < front[-1].compute_error(reference):
            front.append(row)
    return front


def find_cheapest(rows: Iterable[SettingRow], tolerance: float, reference: str = "motion") -> SettingRow | None:
    """Return the row with the least solver seconds whose error is within the tolerance; None if there is none.

    Among those within a tenth of that cost it is the most accurate; Gram-Schmidt, which depends on the axes and has no
    potential, comes last.
    """
    accurate = [row for row in rows if row.compute_error(reference) <= tolerance]
    least = min((row.costs["seconds"] for row in accurate), default=0.0)
    tied = [row for row in accurate if row.costs["seconds"] <= _TIED * least]
    return min(
        tied, key=lambda row: (row.setting.rotation == "gram_schmidt", row.compute_error(reference)), default=None
    )


def list_choosable(table: ErrorTable, levels: Sequence[MeshLevel] | None = None) -> list[SettingRow]:
    """Return the rows to choose from: those of some meshes (None: of the case's own) without the references."""
    plan = table.plan
    references = {plan.make_reference(level) for level in plan.levels}
    chosen = (plan.own,) if levels is None else levels
    return [row for row in table.rows if row.setting not in references and row.setting.level in chosen]


def split_error(table: ErrorTable, row: SettingRow) -> ErrorParts:
    """Return the parts of a row's error: those of its model, of its stepper and dt, and of its mesh."""
    return ErrorParts(
        row.compute_error("model"), table.find_time_error(row.setting), table.find_mesh_error(row.setting.level)
    )


def judge_auto(table: ErrorTable) -> list[AutoVerdict]:
    """Return auto compared with fixed settings for every mesh, implicit stepper and dt that it was run with."""
    limit = table.plan.tolerance / VOLUME_SHARE
    verdicts = []
    for row in table.rows:
        s = row.setting
        if (s.law, s.rotation, s.iterations) != AUTO or "model_volume" not in row.deviations:
            continue
        fixed = [other for other in table.rows if other.setting.law != "auto" and _are_comparable(other.setting, s)]
        seconds, volume = row.costs["seconds"], row.deviations["model_volume"]
        most = max(table.plan.tolerance, volume)
        accurate = [other for other in fixed if other.deviations.get("model_volume", float("inf")) <= most]
        best = min(accurate, key=lambda other: other.costs["seconds"], default=None)
        rival_seconds = best.costs["seconds"] if best else None
        verdicts.append(
            AutoVerdict(
                s, seconds, row.costs["newton_iterations"], volume, best.setting if best else None,
                rival_seconds,
                best.costs["newton_iterations"] if best else None,
                seconds / rival_seconds if rival_seconds else None, volume <= limit,
            )
        )  # fmt: skip
    return verdicts


def _are_comparable(setting: Setting, other: Setting) -> bool:
    return (setting.level, setting.mass, setting.stepper, setting.dt) == (
        other.level, other.mass, other.stepper, other.dt,
    )  # fmt: skip


def find_worst_auto(verdicts: Sequence[AutoVerdict]) -> AutoVerdict | None:
    """Return the verdict with the largest ratio of seconds."""
    return max((v for v in verdicts if v.ratio is not None), key=lambda v: v.ratio or 0.0, default=None)


def describe_choice(table: ErrorTable) -> str:
    """Return the choice as one sentence: the setting, the cost of its steps, and the cost of a tenth of the error."""
    plan, rows = table.plan, list_choosable(table)
    tolerance, reference_error = plan.tolerance, table.estimate_reference_errors().time or 0.0
    chosen, tighter = find_cheapest(rows, tolerance), find_cheapest(rows, tolerance / 10)
    if chosen is None:
        text = f"no setting that was run reaches {format_percent(tolerance)}" + _describe_nearest(rows)
    else:
        steps, simulated = chosen.costs["seconds_per_step"], 1 / chosen.costs["real_time_factor"]
        text = (
            f"for {format_percent(tolerance)} use {describe_setting(chosen.setting)}: {1e3 * steps:.3g} ms a step, "
            f"{1e3 * simulated:.3g} ms a simulated second; "
        )
        if reference_error > tolerance / 10:
            text += f"{format_percent(tolerance / 10)} is below the accuracy of the reference"
        elif tighter is None:
            text += f"{format_percent(tolerance / 10)} was not reached" + _describe_nearest(rows)
        else:
            more = _compare_costs(tighter, chosen)
            text += f"{format_percent(tolerance / 10)} costs {more} ({describe_setting(tighter.setting)})"
    if reference_error > tolerance / 10:
        text += f"; the reference itself has an error of {format_percent(reference_error)}: try smaller steps (--dt)"
    mesh = table.find_mesh_error(plan.own)
    if isfinite(mesh):
        text += f"; the mesh itself differs by {format_percent(mesh)} from {plan.finest}"
    return f"{plan.case.name}: {text}"


def _describe_nearest(rows: Sequence[SettingRow]) -> str:
    """Return the smallest error and its setting in parentheses, or nothing."""
    best = min((row for row in rows if isfinite(row.compute_error())), key=SettingRow.compute_error, default=None)
    return "" if best is None else f" ({format_percent(best.compute_error())} by {describe_setting(best.setting)})"


def _compare_costs(tighter: SettingRow, chosen: SettingRow) -> str:
    ratio = tighter.costs["seconds"] / chosen.costs["seconds"]
    return "no more" if ratio <= 1 else f"{ratio:.2g} times as much"


def describe_finest_error(finest: FinestError) -> str:
    """Return the error of the finest mesh and the ground of its estimate."""
    if finest.error is None:
        seen = " and ".join(map(format_percent, finest.distances))
        return f"its own error is unknown: coarser meshes are {seen} away, which is no convergence; refine further"
    ground = "as observed" if finest.is_observed else "assumed, since two meshes do not show it"
    return f"its own error is about {format_percent(finest.error)}, if it falls with size^{finest.rate:.1f} ({ground})"


def format_percent(value: float) -> str:
    """Return a ratio in percent with two digits."""
    return f"{100 * value:.2g} %" if value < 1 else f"{100 * value:.0f} %"


def describe_setting(setting: Setting) -> str:
    """Return a setting in words."""
    model = {"linear": "the linear law", "auto": 'model = "auto"'}.get(setting.law)
    if model is None:
        count = setting.iterations
        solves = "converged" if count == "converged" else f"{count} solve{'s' * (count != '1')} a step"
        if not STEPPERS[setting.stepper].is_implicit:
            solves = "explicit"
        model = f"{setting.rotation.replace('_', '-')}, {solves}"
    mesh = f"cells x {setting.refinement:g}, " if setting.refinement != 1 else ""
    return f"{setting.stepper}, {model}, {setting.mass} mass, {mesh}order {setting.order}, dt = {setting.dt:.4g} s"


def row_to_dict(row: SettingRow | None) -> dict[str, Any] | None:
    """Return a row as plain JSON; None if there is none."""
    if row is None:
        return None
    return {
        "setting": asdict(row.setting),
        "text": describe_setting(row.setting),
        "error": row.compute_error(),
        "costs": dict(row.costs),
        "deviations": dict(row.deviations),
    }
