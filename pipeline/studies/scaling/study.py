"""How the cost of a step grows with the mesh, method by method, beside the machine's bandwidth and other programs.

bench.json has a row for each point: case, method, cells, tets, nodes, dt [s], ms (median of a step), ns_per_tet,
iterations (Newton's, or frozen passes), solves and linear_iterations of a step, setup_s, loading_s (of kernels, once
per process; null: in setup_s), peak_MB (of a process of its own, before any rival ran in it), linear_solver, bytes
(least traffic of a step), bound_ms (those over the measured bandwidth), baseline_ms (of the rival that took turns with
this method; null: none), error. Rows of other programs have version, ours_ms and differs, and no work counts.
"""

import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.case import Case
from pipeline.errors import CaseError, SolveError, quote_value
from pipeline.formats.atomic import write_whole
from pipeline.studies.coverage import list_left_out
from pipeline.studies.scaling.cost_figure import write_cost_figure
from pipeline.studies.scaling.cost_table import format_costs
from pipeline.studies.scaling.point import measure_in_process
from pipeline.studies.scaling.rival import Rival
from pipeline.studies.scaling.step_cost import METHODS, CostRow, measure_step_cost

_OUR_TASK = f"{measure_step_cost.__module__}:{measure_step_cost.__name__}"
_NOTE = (
    "one thread; ms is the median processor time of a step, writing left out; linear systems to a relative residual of "
    "rtol"
)
_COPIED_FLOATS, _COPIES = 25_000_000, 5  # 200 MB: far more than any cache holds


@dataclass(frozen=True)
class Scaling:
    """The rows, the bandwidth [GB/s] that they are compared with, the rivals measured and the files written."""

    rows: tuple[CostRow, ...]
    bandwidth: float
    rivals: tuple[Rival, ...]
    files: tuple[Path, ...]

    def __repr__(self) -> str:
        return f"<Scaling: {len(self.rows)} rows, bandwidth {self.bandwidth:.1f} GB/s>"

    def format_lines(self) -> list[str]:
        """Return the table, with a line for each point, and the rows of the method tables that are not measured."""
        methods = [{key.removeprefix("method."): value for key, value in keys.items()} for keys in METHODS.values()]
        return [*format_costs(self.rows, self.rivals), f"not measured: {', '.join(list_left_out(methods))}"]


def parse_cells(text: str) -> list[int]:
    """Return the cells along every axis, from text such as 8x26x8; raises CaseError."""
    try:
        return [int(count) for count in text.split("x")]
    except ValueError:
        raise CaseError(f"--cells {quote_value(text)}: is not like 8x26x8") from None


def study_scaling(
    cases: Sequence[Case],
    out: str | os.PathLike[str],
    *,
    cells: Sequence[Sequence[int]] = (),
    methods: Sequence[str] | None = None,
    rtol: float = 1e-6,
    rivals: Sequence[Rival] = (),
    on_point: Callable[[int, int], None] | None = None,
) -> Scaling:
    """Return the costs of steps of cases, on boxes of these `cells`; writes bench.json and scaling.png to `out`.

    A mesh from a file is taken as it is. `methods` are names of METHODS, all by default. `rivals` are measured on the
    same meshes. Raises CaseError if a method is unknown, OutputError if files cannot be written or no point could be
    measured. A point that fails is a row with its `error`.
    """
    names = tuple(METHODS) if methods is None else methods
    if unknown := [name for name in names if name not in METHODS]:
        raise CaseError(f"--method {quote_value(unknown[0])}: is not one of {', '.join(METHODS)}")
    folder = Path(out)
    points = [point for case in cases for point in _list_points(case, folder, cells, names, rivals)]
    rows, bandwidth = [], _measure_bandwidth()
    for index, point in enumerate(points):
        rows.append(_measure_row(point | {"rtol": rtol}, bandwidth))
        if on_point is not None:
            on_point(index + 1, len(points))
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "bandwidth_GB_per_s": bandwidth}
    document = {"rows": rows, "machine": machine, "rtol": rtol, "note": _NOTE}
    files = folder / "bench.json", folder / "scaling.png"
    write_whole(files[0], json.dumps(document, indent=2) + "\n")
    write_cost_figure(rows, rivals, files[1])
    return Scaling(tuple(rows), bandwidth, tuple(rivals), files)


def _list_points(
    case: Case, folder: Path, cells: Sequence[Sequence[int]], methods: Sequence[str], rivals: Sequence[Rival]
) -> list[dict[str, Any]]:
    """Return the settings of every point of a case, which is written to the folder for the processes to read."""
    file = folder / "cases" / f"{case.name}.toml"
    write_whole(file, case.to_toml(file.parent))
    common = {"name": case.name, "case": str(file), "variant": _choose_variant(case)}
    beside = {name: {"task": r.task, "differs": r.differs} for r in rivals for name in r.beside}
    points = [{"method": name, "task": _OUR_TASK, "beside": beside.get(name)} for name in methods]
    points += [{"method": rival.name, "task": rival.task} for rival in rivals if not rival.beside]
    meshes = [list(counts) for counts in cells] if cells and case.mesh.shape else [None]
    return [common | {"cells": mesh} | point for mesh in meshes for point in points]


def _choose_variant(case: Case) -> str:
    """Return the variant with the fewest keys of its own: it must not undo the settings of a point."""
    return min(case.variant_names, key=lambda name: len(case.variant(name).own_keys))


def _measure_row(point: dict[str, Any], bandwidth: float) -> CostRow:
    """Return the row of a point, measured in a process of its own."""
    case = {"case": point["name"]}
    try:
        row = measure_in_process(point["task"], point)
    except SolveError as error:
        return case | {"method": point["method"], "cells": point["cells"], "error": str(error)}
    bound = {"bound_ms": row["bytes"] / bandwidth / 1e6} if "bytes" in row else {}
    return case | row | bound | {"error": None}


def _measure_bandwidth() -> float:
    """Return the rate at which one thread copies [GB/s], reads and writes together: the best of some copies."""
    source = np.ones(_COPIED_FLOATS)
    target = np.empty_like(source)
    times = []
    for _ in range(_COPIES):
        began = time.perf_counter()
        np.copyto(target, source)
        times.append(time.perf_counter() - began)
    return 2 * source.nbytes / min(times) / 1e9
