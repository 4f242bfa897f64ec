"""What the rows of a trade-off study say: fronts, the cheapest setting that is enough, what dominates, the bars."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

from pipeline.studies.tradeoff.deviation import VOLUME_SHARE
from pipeline.studies.tradeoff.settings import AUTO, IMPLICIT, Setting
from pipeline.studies.tradeoff.table import ErrorTable, SettingRow

AUTO_BAR = 1.3  # times the cheapest fixed setting that meets the same tolerance
MODE_BAR = 10.0  # times fewer steps
_TIED = 1.1


@dataclass(frozen=True)
class AutoVerdict:
    """model = "auto" beside the cheapest fixed setting of the same stepper, dt and mesh that meets the same tolerance.

    `volume` is the worst |J - J_ref| of auto against the converged solution, to be at most twice the tolerance; that of
    the rival is at most the tolerance, or auto's where auto exceeds it.
    `iterations` count linear solves, which do not depend on the machine; `ratio` is that of the seconds.
    """

    setting: Setting
    seconds: float
    iterations: float
    volume: float
    rival: Setting | None
    rival_seconds: float | None
    rival_iterations: float | None
    ratio: float | None
    kept: bool


@dataclass(frozen=True)
class ErrorParts:
    """The three parts of a setting's error, each an error by itself, and the name of the largest."""

    model: float
    dt: float
    mesh: float

    @property
    def dominant(self) -> str:
        """Return the part that is largest: model, dt or mesh; NaN counts as none."""
        parts = asdict(self)
        return max(parts, key=lambda name: parts[name] if isfinite(parts[name]) else -1.0)


def find_front(rows: Iterable[SettingRow], reference: str = "motion") -> list[SettingRow]:
    """Return the rows that no other beats in both solver seconds and error, cheapest first."""
    good = [row for row in rows if isfinite(row.error(reference))]
    out: list[SettingRow] = []
    for row in sorted(good, key=lambda one: (one.costs["seconds"], one.error(reference))):
        if not out or row.error(reference) < out[-1].error(reference):
            out.append(row)
    return out


def find_cheapest(rows: Iterable[SettingRow], tolerance: float, reference: str = "motion") -> SettingRow | None:
    """Return the row of least solver seconds whose error is at most the tolerance; None where there is none.

    Of those within a tenth of that cost, which no timing tells apart, it is the most accurate; Gram-Schmidt, which
    depends on the axes and has no potential, comes last.
    """
    enough = [row for row in rows if row.error(reference) <= tolerance]
    least = min((row.costs["seconds"] for row in enough), default=0.0)
    tied = [row for row in enough if row.costs["seconds"] <= _TIED * least]
    return min(tied, key=lambda row: (row.setting.rotation == "gram_schmidt", row.error(reference)), default=None)


def list_choosable(table: ErrorTable, refinement: int | None = 1) -> list[SettingRow]:
    """Return the rows that a choice is made of: those of a mesh (None: of any) less the references."""
    plan = table.plan
    left_out = {plan.reference(r) for r in plan.refinements}
    rows = [row for row in table.rows if row.setting not in left_out]
    return [row for row in rows if refinement in (None, row.setting.refinement)]


def split_error(table: ErrorTable, row: SettingRow) -> ErrorParts:
    """Return the parts of a row's error: its model's, its stepper and dt's, its mesh's."""
    return ErrorParts(row.error("model"), table.time_error(row.setting), table.mesh_error(row.setting.refinement))


def judge_auto(table: ErrorTable) -> list[AutoVerdict]:
    """Return auto beside fixed settings for every mesh, implicit stepper and dt that it was run with."""
    limit = table.plan.tolerance / VOLUME_SHARE
    out = []
    for row in table.rows:
        s = row.setting
        if (s.law, s.rotation, s.iterations) != AUTO or "model_volume" not in row.deviations:
            continue
        rivals = [one for one in table.rows if one.setting.law != "auto" and _are_comparable(one.setting, s)]
        seconds, volume = row.costs["seconds"], row.deviations["model_volume"]
        met = max(table.plan.tolerance, volume)
        enough = [one for one in rivals if one.deviations.get("model_volume", float("inf")) <= met]
        best = min(enough, key=lambda one: one.costs["seconds"], default=None)
        other = best.costs["seconds"] if best else None
        out.append(
            AutoVerdict(
                s, seconds, row.costs["newton_iterations"], volume, best.setting if best else None, other,
                best.costs["newton_iterations"] if best else None,
                seconds / other if other else None, volume <= limit,
            )
        )  # fmt: skip
    return out


def _are_comparable(one: Setting, other: Setting) -> bool:
    return (one.refinement, one.mass, one.stepper, one.dt) == (
        other.refinement, other.mass, other.stepper, other.dt,
    )  # fmt: skip


def find_worst_auto(verdicts: Sequence[AutoVerdict]) -> AutoVerdict | None:
    """Return the verdict with the largest ratio of seconds."""
    return max((v for v in verdicts if v.ratio is not None), key=lambda v: v.ratio or 0.0, default=None)


def describe_choice(table: ErrorTable) -> str:
    """Return the choice as one sentence: what to use, what a step costs, what a tenth of the error would cost."""
    plan, rows = table.plan, list_choosable(table)
    tolerance, sure = plan.tolerance, table.reference_error().time or 0.0
    chosen, tighter = find_cheapest(rows, tolerance), find_cheapest(rows, tolerance / 10)
    if chosen is None:
        text = f"no setting that was run reaches {format_percent(tolerance)}" + _describe_nearest(rows)
    else:
        steps, simulated = chosen.costs["seconds_per_step"], 1 / chosen.costs["real_time_factor"]
        text = (
            f"for {format_percent(tolerance)} use {describe_setting(chosen.setting)}: {1e3 * steps:.3g} ms a step, "
            f"{1e3 * simulated:.3g} ms a simulated second; "
        )
        if sure > tolerance / 10:
            text += f"{format_percent(tolerance / 10)} cannot be told"
        elif tighter is None:
            text += f"{format_percent(tolerance / 10)} was not reached" + _describe_nearest(rows)
        else:
            more = _compare_costs(tighter, chosen)
            text += f"{format_percent(tolerance / 10)} costs {more} ({describe_setting(tighter.setting)})"
    if sure > tolerance / 10:
        text += f"; the reference itself is good to {format_percent(sure)}: smaller steps (--dt) tell more"
    mesh = table.mesh_error(1)
    if isfinite(mesh):
        text += f"; the mesh itself is {format_percent(mesh)} from cells x {plan.refinements[-1]}"
    return f"{plan.case.name}: {text}"


def _describe_nearest(rows: Sequence[SettingRow]) -> str:
    """Return the setting of the smallest error and that error, if there is any."""
    best = min((row for row in rows if isfinite(row.error())), key=lambda row: row.error(), default=None)
    return "" if best is None else f" ({format_percent(best.error())} by {describe_setting(best.setting)})"


def _compare_costs(tighter: SettingRow, chosen: SettingRow) -> str:
    ratio = tighter.costs["seconds"] / chosen.costs["seconds"]
    return "no more" if ratio <= 1 else f"{ratio:.2g} times as much"


def format_percent(value: float) -> str:
    """Return a part as per cent with two digits."""
    return f"{100 * value:.2g} %" if value < 1 else f"{100 * value:.0f} %"


def describe_setting(setting: Setting) -> str:
    """Return a setting in words."""
    model = {"linear": "the linear law", "auto": 'model = "auto"'}.get(setting.law)
    if model is None:
        passes = setting.iterations
        solved = "converged" if passes == "converged" else f"{passes} solve{'s' * (passes != '1')} a step"
        if setting.stepper not in IMPLICIT:
            solved = "explicit"
        model = f"{setting.rotation.replace('_', '-')}, {solved}"
    mesh = f", cells x {setting.refinement}" if setting.refinement > 1 else ""
    return f"{setting.stepper}, {model}, {setting.mass} mass, dt = {setting.dt:.4g} s{mesh}"


def row_to_dict(row: SettingRow | None) -> dict[str, Any] | None:
    """Return a row as JSON holds it."""
    if row is None:
        return None
    return {
        "setting": asdict(row.setting),
        "text": describe_setting(row.setting),
        "error": row.error(),
        "costs": dict(row.costs),
        "deviations": dict(row.deviations),
    }
