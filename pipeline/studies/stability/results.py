"""The outcomes of a stability study: as sentences, as a dataset and as plain JSON."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.studies.coverage import list_left_out
from pipeline.studies.stability.slices import METHODS, SLICES
from pipeline.studies.stability.trial import OUTCOMES, REFUSED, SURVIVES

if TYPE_CHECKING:
    import xarray

# the numbers of a trial: unit and meaning
_NUMBERS: Mapping[str, tuple[str, str]] = {
    "worst_volume_ratio": ("1", "volume ratio farthest from 1 of any cell after any step"),
    "energy_growth": ("1", "largest kinetic and elastic energy over that supplied by start, loads and supports"),
    "volume_error": ("1", "largest difference of a volume ratio from that of the reference"),
    "node_distance": ("1", "largest distance of a node from that of the reference, over the size of the body"),
    "steps": ("1", "steps made"),
    "iterations": ("1", "linear systems solved"),
}


@dataclass(frozen=True)
class Stability:
    """The trials of a study by slice, index of the value, and method; and the files written."""

    name: str
    values: Mapping[str, tuple[float, ...]]
    results: Mapping[tuple[str, int, str], Mapping[str, Any]]
    steps: int
    tolerance: float
    files: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        return f"<Stability of {self.name}: {len(self.results)} trials of slices {', '.join(self.values)}>"

    def list_outcomes(self, slice_name: str) -> list[list[str]]:
        """Return the outcomes of a slice, a row for each method."""
        count = len(self.values[slice_name])
        return [[str(self.results[slice_name, i, method]["outcome"]) for i in range(count)] for method in METHODS]

    def list_sentences(self) -> list[str]:
        """Return a line for the values that all methods refuse, one for each method, and one for methods left out."""
        everywhere = [
            f"{name} {value:g}"
            for name, values in self.values.items()
            for i, value in enumerate(values)
            if all(self.results[name, i, method]["outcome"] == REFUSED for method in METHODS)
        ]
        lines = [f"refused by every method: {', '.join(everywhere)}"] if everywhere else []
        lines += [self._describe_method(method, everywhere) for method in METHODS]
        left_out = list_left_out(METHODS.values())
        return lines + ([f"not tried: {', '.join(left_out)}"] if left_out else [])

    def _describe_method(self, method: str, everywhere: Sequence[str]) -> str:
        faults: dict[str, list[str]] = {}
        for name, values in self.values.items():
            places: dict[str, list[str]] = {}
            for i, value in enumerate(values):
                outcome = str(self.results[name, i, method]["outcome"])
                if outcome != SURVIVES and f"{name} {value:g}" not in everywhere:
                    places.setdefault(outcome, []).append(f"{value:g}")
            for outcome, texts in places.items():
                faults.setdefault(outcome, []).append(f"{name} {' '.join(texts)}")
        exceptions = "; ".join(
            f"{outcome.replace('_', ' ')} at {', '.join(faults[outcome])}" for outcome in OUTCOMES if outcome in faults
        )
        return f"{method} survives everything" + (f" but: {exceptions}" if exceptions else "")


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
        dims = ("method", name)
        attributes = {"units": SLICES[name].units, "long_name": SLICES[name].long_name}
        coordinates[name] = (name, np.array(values), attributes)
        codes = [[list(OUTCOMES).index(outcome) for outcome in row] for row in study.list_outcomes(name)]
        data[f"outcome_{name}"] = (dims, np.array(codes, dtype=np.int8), flags)
        for number, (units, meaning) in _NUMBERS.items():
            rows = [[float(study.results[name, i, m][number]) for i in range(len(values))] for m in METHODS]
            data[f"{number}_{name}"] = (dims, np.array(rows), {"units": units, "long_name": meaning})
        messages = [[str(study.results[name, i, m]["message"]) for i in range(len(values))] for m in METHODS]
        text = "error that ended the run"
        data[f"message_{name}"] = (dims, np.array(messages, dtype=object), {"long_name": text})
    about = {
        "Conventions": "CF-1.11",
        "title": f"{study.name}: what breaks at the extremes",
        "steps": study.steps,
        "tolerance": study.tolerance,
    }
    return xarray.Dataset(data, coordinates, about)


def make_summary(study: Stability) -> dict[str, Any]:
    """Return the study as plain JSON: the number of trials for each outcome, the lines, and messages with places."""
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
        "sentences": study.list_sentences(),
        "values": {name: list(values) for name, values in study.values.items()},
        "messages": messages,
    }
