"""The setting that is accurate enough for a scene: measured work against precision, and the answer in one sentence."""

import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from math import isfinite
from pathlib import Path
from statistics import median
from typing import Any

from pipeline.case import Case
from pipeline.formats.atomic import write_whole
from pipeline.formats.netcdf import write_dataset
from pipeline.problem.methods import IMPLICIT_STEPPERS, STEPPERS
from pipeline.results.variant_run import result_settings
from pipeline.studies.sweep import Point, run_sweep, to_json
from pipeline.studies.tradeoff.chosen_variant import write_chosen_variant
from pipeline.studies.tradeoff.dataset import make_dataset
from pipeline.studies.tradeoff.front_figure import write_front_figure
from pipeline.studies.tradeoff.mode_steps import find_steps_per_period
from pipeline.studies.tradeoff.motion import make_task_settings, run_motion, run_race
from pipeline.studies.tradeoff.order_figure import write_order_figure
from pipeline.studies.tradeoff.orders import describe_orders, find_order_costs, list_goals
from pipeline.studies.tradeoff.settings import LINEAR, REFERENCE_STEPPER, Plan, Setting, make_point_case
from pipeline.studies.tradeoff.table import ErrorTable
from pipeline.studies.tradeoff.verdict import (
    AUTO_BAR,
    MODE_BAR,
    AutoVerdict,
    describe_choice,
    describe_finest_error,
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

MODE_TOLERANCE = 0.01  # of the first mode's amplitude and phase after one period
_LEAST_ACCURATE = min(IMPLICIT_STEPPERS, key=lambda name: STEPPERS[name].order)


@dataclass(frozen=True)
class Tradeoff:
    """A study's folder, its table, its summary (as in summary.json), the answer in one sentence, more lines, files."""

    folder: Path
    table: ErrorTable
    summary: dict[str, Any]
    sentence: str
    lines: tuple[str, ...]
    files: tuple[Path, ...]

    def __repr__(self) -> str:
        return f"<Tradeoff {self.folder}: {self.sentence}>"


def study_tradeoff(
    plan: Plan,
    folder: str | os.PathLike[str],
    *,
    repeats: int = 3,
    scheduler: str | None = None,
    write_variant: bool = False,
    on_point: Callable[[Point, int, int], None] | None = None,
) -> Tradeoff:
    """Return the costs and errors of a plan's settings, after writing tradeoff.nc, summary.json and figures.

    Settings run one at a time; `scheduler` names an existing dask scheduler. Raises SolveError if the reference fails,
    CaseError if the choice cannot be written to the case, OutputError if a file cannot be written.
    """
    target = Path(folder)
    points = {setting.key: _make_point(plan, setting, repeats) for setting in plan.settings}
    results = run_sweep(
        _run_task,
        [*points.values(), *_make_mode_points(plan)],
        target,
        scheduler=scheduler,
        timed=True,
        on_result=on_point,
    )
    table = ErrorTable(plan, {key: results[key] for key in points})
    mode = {stepper: results[f"first-mode-{stepper}"] for stepper in IMPLICIT_STEPPERS}
    verdicts = _race_verdicts(plan, judge_auto(table), target, scheduler)
    files = [target / name for name in ("tradeoff.nc", "summary.json", "tradeoff.png")]
    write_dataset(make_dataset(table), files[0])
    write_front_figure(table, files[2])
    if find_order_costs(table, plan.tolerance):
        files.append(target / "orders.png")
        write_order_figure([table], files[-1])
    sentence = describe_choice(table)
    summary = to_json(_make_summary(table, mode, verdicts) | {"sentence": sentence})
    write_whole(files[1], json.dumps(summary, indent=2, allow_nan=False) + "\n")
    notes = list(plan.notes)
    if write_variant:
        notes.append(_apply_choice(table, sentence))
    return Tradeoff(
        target,
        table,
        summary,
        sentence,
        (*_list_lines(table, summary, find_worst_auto(verdicts)), *(f"note: {note}" for note in notes)),
        tuple(files),
    )


def _run_task(settings: Any) -> dict[str, Any]:
    """Return the result of one study point."""
    if "rival" in settings:
        return run_race(settings)
    return find_steps_per_period(settings) if "tolerance" in settings else run_motion(settings)


def _make_point(plan: Plan, setting: Setting, repeats: int) -> Point:
    case = make_point_case(plan, setting)
    is_reference = setting in {plan.make_reference(level) for level in plan.levels}
    return Point(setting.key, make_task_settings(case, 1 if is_reference else repeats))


def _make_mode_points(plan: Plan) -> list[Point]:
    """Return the points that count the steps of each implicit stepper for the first mode of the linear body."""
    points = []
    for stepper in IMPLICIT_STEPPERS:
        case: Case = make_point_case(plan, Setting(*plan.own, plan.case.method.mass, stepper, plan.dt, *LINEAR))
        points.append(Point(f"first-mode-{stepper}", make_task_settings(case, 1) | {"tolerance": MODE_TOLERANCE}))
    return points


def _race_verdicts(plan: Plan, verdicts: list[AutoVerdict], folder: Path, scheduler: str | None) -> list[AutoVerdict]:
    """Return the verdicts with their ratio of seconds measured again, auto and its rival in turn."""
    points = {}
    for verdict in verdicts:
        if verdict.rival is not None:
            settings = make_task_settings(make_point_case(plan, verdict.setting), 1)
            settings["rival"] = result_settings(make_point_case(plan, verdict.rival))
            points[verdict.setting.key] = Point(f"race-{verdict.setting.key}", settings)
    results = run_sweep(_run_task, list(points.values()), folder, scheduler=scheduler, timed=True)
    ratios = {key: results[point.key].get("ratio") for key, point in points.items()}
    return [replace(verdict, ratio=ratios.get(verdict.setting.key)) for verdict in verdicts]


def _make_summary(table: ErrorTable, mode: dict[str, dict[str, Any]], verdicts: list[AutoVerdict]) -> dict[str, Any]:
    """Return all results but the rows themselves, which are in tradeoff.nc."""
    plan, rows, reference = table.plan, list_choosable(table), table.estimate_reference_errors()
    own = table.find_row(plan.case_setting)
    chosen = find_cheapest(rows, plan.tolerance)
    all_meshes = list_choosable(table, plan.levels)
    parts = split_error(table, own) if own is not None else None
    counts = {stepper: result.get("steps") for stepper, result in mode.items()}
    slow, fast = counts[_LEAST_ACCURATE], counts[REFERENCE_STEPPER]
    return {
        "case": plan.case.name,
        "version": VERSION,
        "tolerance": plan.tolerance,
        "simulated_seconds": plan.interval * plan.frames,
        "reference": {
            "setting": asdict(plan.make_reference(plan.finest)),
            **asdict(reference),
            "mesh": reference.mesh,
        },
        "choice": row_to_dict(chosen),
        "choice_for_a_tenth": row_to_dict(find_cheapest(rows, plan.tolerance / 10)),
        "choice_with_the_mesh": row_to_dict(find_cheapest(all_meshes, plan.tolerance, "total")),
        "front": [row_to_dict(row) for row in find_front(rows)],
        "orders": [
            {"goal": goal, **asdict(cost)}
            for goal in list_goals(plan.tolerance)
            for cost in find_order_costs(table, goal)
        ],
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
        | {"errors": [result["error"] for result in mode.values() if "steps" not in result]},
        "failed": {row.setting.key: row.failure for row in table.rows if row.failure},
        "notes": list(plan.notes),
    }


def _list_lines(table: ErrorTable, summary: dict[str, Any], worst: AutoVerdict | None) -> list[str]:
    """Return the lines after the sentence: the reference's error, the parts of the case's own, and the bars."""
    plan, parts = table.plan, summary["own_error_parts"]
    reference = table.estimate_reference_errors()
    order = "" if reference.order is None else f", order {reference.order:.2f}"
    step = f"dt = {plan.make_reference(plan.own).dt:.3g} s"
    error = f"its own error is about {_format_error(reference.time)}{order}"
    lines = [f"reference: {REFERENCE_STEPPER}, converged, {step}; {error}"]
    if reference.finest is not None:
        lines.append(f"finest mesh: {plan.finest}; {describe_finest_error(reference.finest)}")
    if parts is not None:
        text = ", ".join(f"{name} {_format_error(parts[name])}" for name in ("model", "dt", "mesh"))
        lines.append(f"the case as it is: {text}; {parts['dominant']} dominates")
    lines += filter(None, (describe_orders(table, goal) for goal in list_goals(plan.tolerance)))
    lines += _list_bar_lines(summary, worst)
    if summary["failed"]:
        lines.append(f"{len(summary['failed'])} of {len(table.rows)} settings failed: see summary.json")
    return lines


def _list_bar_lines(summary: dict[str, Any], worst: AutoVerdict | None) -> list[str]:
    """Return the cost of auto beside fixed settings, and the steps of each stepper for the first mode."""
    lines = []
    ratios = [verdict["ratio"] for verdict in summary["auto"] if verdict["ratio"] is not None]
    if worst is not None and worst.rival is not None:
        within = "within" if all(verdict["is_within"] for verdict in summary["auto"]) else "NOT within"
        lines.append(
            f"auto: {median(ratios):.2f} times the cheapest fixed setting of the same tolerance (median), "
            f"at most {worst.ratio:.2f} ({describe_setting(worst.rival)}; bar {AUTO_BAR:g}); "
            f"|J - J_ref| {within} twice the tolerance"
        )
    mode = summary["first_mode"]
    if mode["fewer"] is not None:
        counts = mode["steps_a_period"]
        lines.append(
            f"first mode to {MODE_TOLERANCE:.0%}: {counts[_LEAST_ACCURATE]} steps a period of "
            f"{_LEAST_ACCURATE}, "
            f"{counts[REFERENCE_STEPPER]} of {REFERENCE_STEPPER}: {mode['fewer']:.1f} times fewer (bar {MODE_BAR:g})"
        )
    return lines


def _format_error(value: float | None) -> str:
    return "not available" if value is None or not isfinite(value) else format_percent(value)


def _apply_choice(table: ErrorTable, sentence: str) -> str:
    """Write the choice to the case file, and return a note about it."""
    chosen = find_cheapest(list_choosable(table), table.plan.tolerance)
    path = table.plan.case.path
    if chosen is None:
        return f"{path}: no variant written: no setting reaches the tolerance"
    write_chosen_variant(table.plan, chosen.setting, sentence.partition(": ")[2])
    return f'{path}: variant "adequate" written; pipeline run {path} --variant adequate'
