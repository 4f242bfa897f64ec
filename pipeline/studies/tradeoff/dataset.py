"""tradeoff.nc: every cost and deviation of a study, with a dimension for each knob, NaN for settings not run."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.studies.tradeoff.deviation import MEASURES
from pipeline.studies.tradeoff.settings import Setting
from pipeline.studies.tradeoff.table import COSTS, ErrorTable, SettingRow, list_deviations

if TYPE_CHECKING:
    import xarray

KNOBS = {
    "refinement": "cells of the case's mesh along each axis, times this",
    "order": "degree of the shape functions",
    "mass": "mass matrix",
    "stepper": "time stepper",
    "dt": "time step",
    "law": "constitutive law; auto is model = auto",
    "rotation": "rotation of the corotational law",
    "iterations": "solves a step",
}
_REFERENCES = {
    "model": "the converged solution of the same stepper, dt, mass and mesh",
    "motion": "the converged BDF2 of the smallest step on the same mesh",
    "total": "the same on the finest mesh, at the nodes of both",
}


def make_dataset(table: ErrorTable) -> "xarray.Dataset":
    """Return the study as a dataset with the dimensions of KNOBS; "failed" is 1 for a setting that failed."""
    import xarray

    rows = table.rows
    values = {name: _list_values(name, rows) for name in KNOBS}
    shape = tuple(len(v) for v in values.values())
    data: dict[str, Any] = {}
    for name, (units, text) in COSTS.items():
        data[name] = _fill_variable(shape, values, {row.setting: row.costs.get(name) for row in rows}, units, text)
    for name in list_deviations(table):
        reference, measure = name.split("_", 1)
        units, text = MEASURES[measure]
        deviations = {row.setting: row.deviations.get(name) for row in rows}
        data[name] = _fill_variable(shape, values, deviations, units, f"{text}; reference: {_REFERENCES[reference]}")
    failed = {row.setting: float(row.failure is not None) for row in rows}
    data["failed"] = _fill_variable(shape, values, failed, "1", "1 if the setting ended in an error, 0 if it ran")
    coordinates = {name: (name, _make_coordinate(values[name]), _make_attributes(name)) for name in KNOBS}
    own = table.estimate_reference_errors()
    attrs = {
        "Conventions": "CF-1.11",
        "title": f"{table.plan.case.name}: work against precision",
        "tolerance": table.plan.tolerance,
        "simulated_seconds": table.plan.interval * table.plan.frames,
        "reference_dt": table.plan.make_reference(table.plan.own).dt,
        "reference_error": float("nan") if own.time is None else own.time,
        "mesh_reference_error": float("nan") if own.mesh is None else own.mesh,
    }
    return xarray.Dataset(data, coordinates, attrs)


def _list_values(name: str, rows: list[SettingRow]) -> list[Any]:
    values = dict.fromkeys(getattr(row.setting, name) for row in rows)
    return sorted(values) if name in ("refinement", "order", "dt") else list(values)


def _make_coordinate(values: list[Any]) -> np.ndarray:
    return np.array(values, dtype=object if isinstance(values[0], str) else np.float64)


def _make_attributes(name: str) -> dict[str, str]:
    units = {"dt": {"units": "s"}, "refinement": {"units": "1"}, "order": {"units": "1"}}.get(name, {})
    return {"long_name": KNOBS[name], **units}


def _fill_variable(
    shape: tuple[int, ...], axes: dict[str, list[Any]], values: Mapping[Setting, float | None], units: str, text: str
) -> tuple[tuple[str, ...], np.ndarray, dict[str, str]]:
    out = np.full(shape, np.nan)
    for setting, value in values.items():
        if value is not None:
            out[tuple(axes[name].index(getattr(setting, name)) for name in KNOBS)] = value
    return tuple(KNOBS), out, {"units": units, "long_name": text}
