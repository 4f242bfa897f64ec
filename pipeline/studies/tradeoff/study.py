"""Which setting is enough for a scene: work against precision, measured, with a sentence as its answer."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from math import isfinite
from pathlib import Path
from statistics import median
from typing import Any

from pipeline.case import Case
from pipeline.formats.atomic import write_whole
from pipeline.formats.netcdf import write_dataset
from pipeline.results.variant_run import result_settings
from pipeline.studies.sweep import Point, run_sweep, to_json
from pipeline.studies.tradeoff.chosen_variant import write_chosen_variant
from pipeline.studies.tradeoff.dataset import make_dataset
from pipeline.studies.tradeoff.front_figure import write_front_figure
from pipeline.studies.tradeoff.mode_steps import find_steps_per_period
from pipeline.studies.tradeoff.motion import make_task_settings, run_motion, run_race
from pipeline.studies.tradeoff.settings import IMPLICIT, LINEAR, Plan, Setting, make_point_case
from pipeline.studies.tradeoff.table import ErrorTable
from pipeline.studies.tradeoff.verdict import (
    AUTO_BAR,
    MODE_BAR,
    AutoVerdict,
    describe_choice,
    describe_setting,
    find_cheapest,
    find_front,
    find_worst_auto,
    format_percent,
    judge_auto,
    list_choosable,
    row_to_dict,
    split_error,
)
from pipeline.system.version import VERSION

MODE_TOLERANCE = 0.01


@dataclass(frozen=True)
class Tradeoff:
    """A study's folder, its summary (what summary.json holds), the answer in one sentence, and lines beside it."""

    folder: Path
    summary: dict[str, Any]
    sentence: str
    lines: tuple[str, ...]
    made: tuple[Path, ...]


def study_tradeoff(
    plan: Plan,
    folder: Path,
    *,
    repeats: int = 3,
    scheduler: str | None = None,
    write_variant: bool = False,
    on_point: Callable[[Point, int, int], None] | None = None,
) -> Tradeoff:
    """Return what the settings of a plan cost and are worth; tradeoff.nc, tradeoff.png and summary.json are written.

    Timed settings run one at a time; `scheduler` names an existing dask scheduler. Raises SolveError where the
    reference cannot be computed, CaseError where the choice cannot be written, OutputError.
    """
    points = {setting.key: _make_point(plan, setting, repeats) for setting in plan.settings}
    results = run_sweep(
        _run_task,
        [*points.values(), *_make_mode_points(plan)],
        folder,
        scheduler=scheduler,
        timed=True,
        on_result=on_point,
    )
    table = ErrorTable(plan, {key: results[key] for key in points})
    mode = {stepper: results[f"first-mode-{stepper}"] for stepper in IMPLICIT}
    verdicts = _race_verdicts(plan, judge_auto(table), folder, scheduler)
    made = tuple(folder / name for name in ("tradeoff.nc", "tradeoff.png", "summary.json"))
    write_dataset(make_dataset(table), made[0])
    write_front_figure(table, made[1])
    said = describe_choice(table)
    summary = to_json(_make_summary(table, mode, verdicts) | {"sentence": said})
    write_whole(made[2], json.dumps(summary, indent=2, allow_nan=False) + "\n")
    notes = list(plan.notes)
    if write_variant:
        notes.append(_apply_choice(table, said))
    return Tradeoff(
        folder,
        summary,
        said,
        (*_list_lines(table, summary, find_worst_auto(verdicts)), *(f"note: {note}" for note in notes)),
        made,
    )


def _run_task(settings: Any) -> dict[str, Any]:
    """Return the result of one study point."""
    if "rival" in settings:
        return run_race(settings)
    return find_steps_per_period(settings) if "tolerance" in settings else run_motion(settings)


def _make_point(plan: Plan, setting: Setting, repeats: int) -> Point:
    case = make_point_case(plan, setting)
    once = setting in {plan.reference(r) for r in plan.refinements}
    return Point(setting.key, make_task_settings(case, 1 if once else repeats))


def _make_mode_points(plan: Plan) -> list[Point]:
    """Return the points that count the steps of each implicit stepper for the first mode of the linear body."""
    out = []
    for stepper in IMPLICIT:
        case: Case = make_point_case(plan, Setting(1, plan.case.method.mass, stepper, plan.dt, *LINEAR))
        out.append(Point(f"first-mode-{stepper}", make_task_settings(case, 1) | {"tolerance": MODE_TOLERANCE}))
    return out


def _race_verdicts(plan: Plan, verdicts: list[AutoVerdict], folder: Path, scheduler: str | None) -> list[AutoVerdict]:
    """Return the verdicts with their ratio of seconds measured anew, auto and its rival in turn."""
    points = {}
    for one in verdicts:
        if one.rival is not None:
            settings = make_task_settings(make_point_case(plan, one.setting), 1)
            settings["rival"] = result_settings(make_point_case(plan, one.rival))
            points[one.setting.key] = Point(f"race-{one.setting.key}", settings)
    found = run_sweep(_run_task, list(points.values()), folder, scheduler=scheduler, timed=True)
    ratios = {key: found[point.key].get("ratio") for key, point in points.items()}
    return [replace(one, ratio=ratios.get(one.setting.key)) for one in verdicts]


def _make_summary(table: ErrorTable, mode: dict[str, dict[str, Any]], verdicts: list[AutoVerdict]) -> dict[str, Any]:
    """Return everything that was found but the rows themselves, which tradeoff.nc holds."""
    plan, rows = table.plan, list_choosable(table)
    own = table.row(plan.own)
    chosen = find_cheapest(rows, plan.tolerance)
    every = list_choosable(table, None)
    parts = split_error(table, own) if own is not None else None
    counts = {stepper: found.get("steps") for stepper, found in mode.items()}
    slow, fast = (counts[stepper] for stepper in IMPLICIT)
    return {
        "case": plan.case.name,
        "version": VERSION,
        "tolerance": plan.tolerance,
        "simulated_seconds": plan.interval * plan.frames,
        "reference": {"setting": asdict(plan.reference(plan.refinements[-1])), **asdict(table.reference_error())},
        "choice": row_to_dict(chosen),
        "choice_for_a_tenth": row_to_dict(find_cheapest(rows, plan.tolerance / 10)),
        "choice_with_the_mesh": row_to_dict(find_cheapest(every, plan.tolerance, "total")),
        "front": [row_to_dict(row) for row in find_front(rows)],
        "own": row_to_dict(own),
        "own_error_parts": None if parts is None else asdict(parts) | {"dominant": parts.dominant},
        "auto": [asdict(verdict) for verdict in verdicts],
        "auto_bar": AUTO_BAR,
        "first_mode": {
            "tolerance": MODE_TOLERANCE,
            "steps_a_period": counts,
            "fewer": slow / fast if slow and fast else None,
            "bar": MODE_BAR,
        }
        | {"errors": [found["error"] for found in mode.values() if "steps" not in found]},
        "failed": {row.setting.key: row.failure for row in table.rows if row.failure},
        "notes": list(plan.notes),
    }


def _list_lines(table: ErrorTable, summary: dict[str, Any], worst: AutoVerdict | None) -> list[str]:
    """Return what is told beside the sentence: the reference's own error, what dominates, and the bars."""
    plan, own = table.plan, summary["own_error_parts"]
    reference = table.reference_error()
    order = "" if reference.order is None else f", order {reference.order:.2f}"
    step = f"dt = {plan.reference(1).dt:.3g} s"
    lines = [f"reference: bdf2, converged, {step}; its own error is about {_format_error(reference.time)}{order}"]
    if reference.mesh is not None:
        lines.append(
            f"finest mesh: cells x {plan.refinements[-1]}; its own error is about {_format_error(reference.mesh)}, "
            "if errors fall with the square of the cells' size"
        )
    if own is not None:
        parts = ", ".join(f"{name} {_format_error(own[name])}" for name in ("model", "dt", "mesh"))
        lines.append(f"the case as it is: {parts}; {own['dominant']} dominates")
    lines += _list_bar_lines(summary, worst)
    if summary["failed"]:
        lines.append(f"{len(summary['failed'])} of {len(table.rows)} settings failed: see summary.json")
    return lines


def _list_bar_lines(summary: dict[str, Any], worst: AutoVerdict | None) -> list[str]:
    """Return what auto costs beside fixed settings, and what the first mode asks of each stepper."""
    lines = []
    ratios = [one["ratio"] for one in summary["auto"] if one["ratio"] is not None]
    if worst is not None and worst.rival is not None:
        kept = "within" if all(one["kept"] for one in summary["auto"]) else "NOT within"
        lines.append(
            f"auto: {median(ratios):.2f} times the cheapest fixed setting of the same tolerance (median), "
            f"at most {worst.ratio:.2f} ({describe_setting(worst.rival)}; bar {AUTO_BAR:g}); "
            f"|J - J_ref| {kept} twice the tolerance"
        )
    mode = summary["first_mode"]
    if mode["fewer"] is not None:
        counts = mode["steps_a_period"]
        lines.append(
            f"first mode to {MODE_TOLERANCE:.0%}: {counts['backward_euler']} steps a period of backward Euler, "
            f"{counts['bdf2']} of bdf2: {mode['fewer']:.1f} times fewer (bar {MODE_BAR:g})"
        )
    return lines


def _format_error(value: float | None) -> str:
    return "not available" if value is None or not isfinite(value) else format_percent(value)


def _apply_choice(table: ErrorTable, said: str) -> str:
    """Return a note of what was written into the case file."""
    chosen = find_cheapest(list_choosable(table), table.plan.tolerance)
    path = table.plan.case.path
    if chosen is None:
        return f"{path}: no variant written: no setting reaches the tolerance"
    write_chosen_variant(table.plan, chosen.setting, said.partition(": ")[2])
    return f'{path}: variant "adequate" written; pipeline run {path} --variant adequate'
