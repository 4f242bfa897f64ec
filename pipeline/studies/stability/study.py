"""What breaks at the extremes: every method at every value of every slice, as a dataset, a picture and a few lines."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.case import Case
from pipeline.errors import CaseError, quote_value
from pipeline.formats.atomic import write_whole
from pipeline.formats.netcdf import write_dataset
from pipeline.problem.problem import build, build_mesh
from pipeline.studies.stability.slices import METHODS, SLICES, ExtremeScene, make_trial_settings
from pipeline.studies.stability.trial import NOTHING, OUTCOMES, REFUSED, SURVIVES, UNEXPECTED, run_trial
from pipeline.studies.sweep import Point, run_sweep

if TYPE_CHECKING:
    import xarray

STEPS, TOLERANCE = 50, 0.05
# the numbers of a trial: unit and meaning
_NUMBERS: Mapping[str, tuple[str, str]] = {
    "worst_volume_ratio": ("1", "volume ratio farthest from 1 of any cell after any step"),
    "energy_growth": ("1", "largest kinetic and elastic energy over what start, loads and supports brought"),
    "volume_error": ("1", "largest difference of a volume ratio from that of the reference"),
    "node_distance": ("1", "largest distance of a node from that of the reference, over the size of the body"),
    "steps": ("1", "steps made"),
    "iterations": ("1", "linear systems solved"),
}


@dataclass(frozen=True)
class Stability:
    """What a study found: each trial by slice, value and method, and where the files of it are."""

    name: str
    values: Mapping[str, tuple[float, ...]]
    results: Mapping[tuple[str, int, str], Mapping[str, Any]]
    steps: int
    tolerance: float
    made: tuple[Path, ...] = ()

    def outcomes(self, slice_name: str) -> list[list[str]]:
        """Return the outcomes of a slice, a row a method."""
        count = len(self.values[slice_name])
        return [[str(self.results[slice_name, i, method]["outcome"]) for i in range(count)] for method in METHODS]

    def sentences(self) -> list[str]:
        """Return a line for what nothing takes, if there is that, and a line a method."""
        everywhere = [
            f"{name} {value:g}"
            for name, values in self.values.items()
            for i, value in enumerate(values)
            if all(self.results[name, i, method]["outcome"] == REFUSED for method in METHODS)
        ]
        lines = [f"refused by every method: {', '.join(everywhere)}"] if everywhere else []
        return lines + [self._sentence(method, everywhere) for method in METHODS]

    def _sentence(self, method: str, everywhere: Sequence[str]) -> str:
        faults: dict[str, list[str]] = {}
        for name, values in self.values.items():
            at: dict[str, list[str]] = {}
            for i, value in enumerate(values):
                outcome = str(self.results[name, i, method]["outcome"])
                if outcome != SURVIVES and f"{name} {value:g}" not in everywhere:
                    at.setdefault(outcome, []).append(f"{value:g}")
            for outcome, places in at.items():
                faults.setdefault(outcome, []).append(f"{name} {' '.join(places)}")
        told = "; ".join(
            f"{outcome.replace('_', ' ')} at {', '.join(faults[outcome])}" for outcome in OUTCOMES if outcome in faults
        )
        return f"{method} survives everything" + (f" but: {told}" if told else "")


def study_stability(
    case: Case,
    folder: Path,
    *,
    slices: Sequence[str] = (),
    steps: int = STEPS,
    tolerance: float = TOLERANCE,
    scheduler: str | None = None,
    on_point: Callable[[Point, int, int], None] | None = None,
) -> Stability:
    """Return what became of every method at every extreme of a case, after writing it into folder/<case>.

    `slices` are names of SLICES, all by default; explicit runs take five times the steps. Files: stability.nc,
    stability.png, summary.json, points/. The case's own law, stepper and variants do not matter, its mesh, material,
    supports, loads and start do. Raises CaseError where a slice is unknown or the case cannot be built.
    """
    unknown = [name for name in slices if name not in SLICES]
    if unknown:
        raise CaseError(f"slice {quote_value(unknown[0])} is not one of {', '.join(SLICES)}")
    if steps < 1:
        raise CaseError(f"steps: {steps} is not 1 or more")
    if not 0 < tolerance < 1:
        raise CaseError(f"tolerance: {tolerance:g} is not between 0 and 1")
    build(case.variant(case.variant_names[0]))  # a case that cannot be built is one error, and not one a point
    scene = ExtremeScene.of(case, build_mesh(case))
    chosen = {name: SLICES[name].values(scene) for name in SLICES if name in slices or not slices}
    points = {
        (name, i, method): Point(
            f"{name}-{i}-{method.replace(' ', '-')}",
            make_trial_settings(scene, name, value, method, steps=steps, tolerance=tolerance),
        )
        for name, values in chosen.items()
        for i, value in enumerate(values)
        for method in METHODS
    }  # fmt: skip
    into = folder / case.name
    found = run_sweep(run_trial, list(points.values()), into, scheduler=scheduler, on_result=on_point)
    results = {place: complete_result(found[point.key]) for place, point in points.items()}
    return _write_study(Stability(case.name, chosen, results, steps, tolerance), into)


def complete_result(result: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a result of the sweep with an outcome: an error that no trial tells of is an unexpected one."""
    return result if "outcome" in result else {**NOTHING, "outcome": UNEXPECTED, "message": result["error"]}


def make_dataset(study: Stability) -> "xarray.Dataset":
    """Return the study as a CF dataset: for every slice outcome_<slice> (method, <slice>), its numbers and messages."""
    import xarray

    data: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"method": ("method", np.array(list(METHODS), dtype=object), {"long_name": "method"})}
    flags = {
        "long_name": "outcome",
        "flag_values": np.arange(len(OUTCOMES), dtype=np.int8),
        "flag_meanings": " ".join(OUTCOMES),
        "comment": "; ".join(f"{name}: {meaning}" for name, meaning in OUTCOMES.items()),
    }
    for name, values in study.values.items():
        one, dims = SLICES[name], ("method", name)
        coordinates[name] = (name, np.array(values), {"units": one.units, "long_name": one.long_name})
        codes = [[list(OUTCOMES).index(outcome) for outcome in row] for row in study.outcomes(name)]
        data[f"outcome_{name}"] = (dims, np.array(codes, dtype=np.int8), flags)
        for number, (units, meaning) in _NUMBERS.items():
            rows = [[float(study.results[name, i, m][number]) for i in range(len(values))] for m in METHODS]
            data[f"{number}_{name}"] = (dims, np.array(rows), {"units": units, "long_name": meaning})
        told = [[str(study.results[name, i, m]["message"]) for i in range(len(values))] for m in METHODS]
        data[f"message_{name}"] = (dims, np.array(told, dtype=object), {"long_name": "error that ended the run"})
    attributes = {
        "Conventions": "CF-1.11",
        "title": f"{study.name}: what breaks at the extremes",
        "steps": study.steps,
        "tolerance": study.tolerance,
    }
    return xarray.Dataset(data, coordinates, attributes)


def make_summary(study: Stability) -> dict[str, Any]:
    """Return the study as plain JSON: how many trials ended how, the lines, and every message with its places."""
    messages: dict[str, list[str]] = {}
    for (name, i, method), result in study.results.items():
        if result["message"]:
            messages.setdefault(str(result["message"]), []).append(f"{name} {study.values[name][i]:g}: {method}")
    return {
        "case": study.name,
        "steps": study.steps,
        "tolerance": study.tolerance,
        "trials": len(study.results),
        "outcomes": {name: Counter(r["outcome"] for r in study.results.values())[name] for name in OUTCOMES},
        "sentences": study.sentences(),
        "values": {name: list(values) for name, values in study.values.items()},
        "messages": messages,
    }


def _write_study(study: Stability, folder: Path) -> Stability:
    """Write the study's dataset, picture and summary; raises OutputError."""
    from pipeline.studies.stability.figure import write_stability_figure

    paths = tuple(folder / name for name in ("stability.nc", "stability.png", "summary.json"))
    write_dataset(make_dataset(study), paths[0])
    write_stability_figure(study, paths[1])
    write_whole(paths[2], json.dumps(make_summary(study), indent=2, allow_nan=False) + "\n")
    return Stability(study.name, study.values, study.results, study.steps, study.tolerance, paths)
