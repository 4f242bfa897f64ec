"""Methods at their extremes: every method at every value of every slice, as a dataset, a picture and a few lines."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.case import Case
from pipeline.errors import CaseError, quote_value
from pipeline.formats.atomic import write_whole
from pipeline.formats.netcdf import write_dataset
from pipeline.problem.problem import build, build_mesh
from pipeline.studies.stability.figure import write_stability_figure
from pipeline.studies.stability.results import Stability, make_dataset, make_summary
from pipeline.studies.stability.slices import METHODS, SLICES, ExtremeScene, make_trial_settings
from pipeline.studies.stability.trial import NO_RUN, UNEXPECTED, run_trial
from pipeline.studies.sweep import Point, run_sweep

STEPS, TOLERANCE = 50, 0.05


def study_stability(
    case: Case,
    folder: str | os.PathLike[str],
    *,
    slices: Sequence[str] = (),
    steps: int = STEPS,
    tolerance: float = TOLERANCE,
    scheduler: str | None = None,
    on_point: Callable[[Point, int, int], None] | None = None,
) -> Stability:
    """Return the outcome of every method at every extreme of a case, after writing it into folder/<case>.

    `slices` are names of SLICES, all by default; explicit runs take five times the steps. Files: stability.nc,
    stability.png, summary.json, points/. The mesh, material, supports, loads and start of the case matter, but not its
    law, stepper and variants. Raises CaseError if a slice is unknown or the case cannot be built.
    """
    unknown = [name for name in slices if name not in SLICES]
    if unknown:
        raise CaseError(f"slice {quote_value(unknown[0])} is not one of {', '.join(SLICES)}")
    if steps < 1:
        raise CaseError(f"steps: {steps} is not 1 or more")
    if not 0 < tolerance < 1:
        raise CaseError(f"tolerance: {tolerance:g} is not between 0 and 1")
    build(case.variant(case.variant_names[0]))  # so that a case that cannot be built is one error, not one per point
    scene = ExtremeScene.from_mesh(case, build_mesh(case))
    chosen = {name: SLICES[name].list_values(scene) for name in SLICES if name in slices or not slices}
    points = {
        (name, i, method): Point(
            f"{name}-{i}-{method.replace(' ', '-')}",
            make_trial_settings(scene, name, value, method, steps=steps, tolerance=tolerance),
        )
        for name, values in chosen.items()
        for i, value in enumerate(values)
        for method in METHODS
    }  # fmt: skip
    target = Path(folder) / case.name
    computed = run_sweep(run_trial, list(points.values()), target, scheduler=scheduler, on_result=on_point)
    results = {place: add_outcome(computed[point.key]) for place, point in points.items()}
    return _write_study(Stability(case.name, chosen, results, steps, tolerance), target)


def add_outcome(result: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a result of the sweep with an outcome: an error that the trial did not handle is unexpected."""
    return result if "outcome" in result else {**NO_RUN, "outcome": UNEXPECTED, "message": result["error"]}


def _write_study(study: Stability, folder: Path) -> Stability:
    """Return the study with its files, after writing dataset, picture and summary; raises OutputError."""
    dataset, figure, summary = (folder / name for name in ("stability.nc", "stability.png", "summary.json"))
    write_dataset(make_dataset(study), dataset)
    write_stability_figure(study, figure)
    write_whole(summary, json.dumps(make_summary(study), indent=2, allow_nan=False) + "\n")
    return replace(study, files=(dataset, figure, summary))
