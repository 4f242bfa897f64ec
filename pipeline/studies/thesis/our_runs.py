"""The results of our runs of the seeds' scenes, read from their folders; nothing is solved here."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.case import Case
from pipeline.formats.netcdf import read_dataset
from pipeline.results.case_run import CaseResult
from pipeline.results.variant_run import VariantResult


@dataclass(frozen=True)
class RunOutcome:
    """One variant's run: counts, the largest growth over all cells and frames, its place and time, and the cost."""

    status: str
    folder: Path
    nodes: int
    cells: int
    steps: int
    dt: float
    largest_ratio: float
    cell: int
    iteration: int
    smallest_ratio: float
    largest_volume: float
    its_rest_volume: float
    largest_rest_volume: float
    kinetic_left: float  # kinetic energy at the end over its maximum
    seconds_per_step: float
    message: str = ""


@dataclass(frozen=True)
class ThesisScene:
    """One case: its folder, the factor on its numbers, its outcomes by variant, and notes."""

    name: str
    folder: Path
    factor: float = 1.0
    factor_of: str = ""
    outcomes: Mapping[str, RunOutcome] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_scene(case: Case, result: CaseResult) -> ThesisScene:
    """Return the results of a case; a variant without a frame is left out, a failed one has a note."""
    outcomes, notes = {}, list(result.notes)
    for variant in result.variants:
        if variant.run.get("frames"):
            outcomes[variant.name] = read_outcome(variant)
        if variant.status == "failed" or variant.run.get("status") == "failed":
            notes.append(f"{variant.name} failed: {variant.run.get('message', '')}")
    factor, factor_of = _find_factor(case)
    return ThesisScene(case.name, result.folder, factor, factor_of, outcomes, tuple(notes))


def _find_factor(case: Case) -> tuple[float, str]:
    """Return the factor on a case's initial velocity or body force, and its name; 1 if there is none."""
    if case.initial.factor != 1:
        return case.initial.factor, "initial velocity"
    force = case.loads.body_force
    return (force.factor, "body force") if force is not None and force.factor != 1 else (1.0, "")


def read_outcome(variant: VariantResult) -> RunOutcome:
    """Return the outcome of a recorded variant, from its statistics.nc and its run.json."""
    dataset = read_dataset(variant.folder / "statistics.nc")
    run = variant.run
    ratio = dataset["volume_ratio"].transpose("time", "cell").values
    rest = dataset["rest_volume"].values
    frame, cell = np.unravel_index(int(ratio.argmax()), ratio.shape)
    volumes = ratio * rest
    kinetic = dataset["kinetic_energy"].values
    dt = float(run["case"]["schedule"]["dt"])
    largest = int(volumes.argmax()) % rest.size
    return RunOutcome(
        status=run["status"],
        folder=variant.folder,
        nodes=run["nodes"],
        cells=run["cells"],
        steps=run["last_frame"]["step"],
        dt=dt,
        largest_ratio=float(ratio[frame, cell]),
        cell=int(cell),
        iteration=round(float(dataset["time"].values[frame]) / dt),
        smallest_ratio=float(ratio.min()),
        largest_volume=float(volumes.max()),
        its_rest_volume=float(rest[largest]),
        largest_rest_volume=float(rest.max()),
        kinetic_left=float(kinetic[-1] / kinetic.max()) if kinetic.max() > 0 else 0.0,
        seconds_per_step=float(run["seconds_per_step"] or float("nan")),
        message=str(run.get("message", "")),
    )
