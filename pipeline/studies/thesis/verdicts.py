"""A published value against ours: reproduced, reproduced with a factor, or not reproduced, and why."""

from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.studies.thesis.our_runs import RunOutcome, ThesisScene
from pipeline.studies.thesis.published import AS_PRINTED, COUNTED, PublishedNumber

REPRODUCED, NOT_REPRODUCED = "reproduced", "not reproduced"
OTHER_HARDWARE = "other hardware"  # depends on the speed of the machine, so neither reproduced nor not


@dataclass(frozen=True)
class Finding:
    """A published number with ours, as printed and with the factor (None: not run), and the verdict."""

    number: PublishedNumber
    as_printed: float | None
    calibrated: float | None
    verdict: str


def judge(number: PublishedNumber, as_printed: float | None, calibrated: float | None, factor: float) -> str:
    """Return the verdict with the remark; the run as printed is judged first; a failed verdict has the deviations."""
    remark = f" ({number.remark})" if number.remark else ""
    if as_printed is not None and abs(as_printed - number.value) <= number.tolerance:
        return f"{REPRODUCED}{remark}"
    if calibrated is not None and abs(calibrated - number.value) <= number.tolerance:
        return f"{REPRODUCED} with factor {factor:g}{remark}"
    values = [(as_printed, "as printed"), (calibrated, f"with factor {factor:g}")]
    parts = [f"{_format_deviation(value, number)} {scene}" for value, scene in values if value is not None]
    return f"{NOT_REPRODUCED}: {', '.join(parts) or 'not run'}{remark}"


def _format_deviation(value: float, number: PublishedNumber) -> str:
    """Return the deviation in percent, or, for a count or an iteration, the value itself."""
    if number.quantity in COUNTED:
        return f"{value:.0f}"
    return f"{100 * (value / number.value - 1):+.1f} %"


def judge_number(number: PublishedNumber, scenes: Mapping[str, ThesisScene]) -> Finding:
    """Return a published number with the values of our runs and the verdict."""
    values = [_find_value(number, scenes, ending) for ending in (AS_PRINTED, "")]
    factor = scenes[number.scene].factor if number.scene in scenes else 1.0
    return Finding(number, values[0], values[1], judge(number, values[0], values[1], factor))


def _find_value(number: PublishedNumber, scenes: Mapping[str, ThesisScene], ending: str) -> float | None:
    """Return our value of a number, or of a difference of two scenes; None if a run is missing."""
    minuend = find_outcome(scenes, number.scene + ending, number.variant)
    if minuend is None:
        return None
    value = float(getattr(minuend, number.quantity))
    if not number.less:
        return value
    subtrahend = find_outcome(scenes, number.less + ending, number.variant)
    return None if subtrahend is None else value - float(getattr(subtrahend, number.quantity))


def find_outcome(scenes: Mapping[str, ThesisScene], scene: str, variant: str) -> RunOutcome | None:
    """Return the outcome of a scene's variant; None unless it ran to its end."""
    outcome = scenes[scene].outcomes.get(variant) if scene in scenes else None
    return outcome if outcome is not None and outcome.status == "finished" else None
