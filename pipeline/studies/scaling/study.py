"""How the cost of a step grows with the mesh, method by method, beside plain scipy and the machine's bandwidth.

bench.json has a row a point: case, method, cells, tets, nodes, dt [s], ms (median of a step), ns_per_tet, iterations
(Newton's, or frozen passes), solves and linear_iterations of a step, setup_s, loading_s (of kernels, once a process;
null: in setup_s), peak_MB (of a process of its own, without plain scipy), linear_solver, bytes (what a step moves at
least), bound_ms (those over the measured bandwidth), baseline_ms (one corotational solve by plain scipy), error. Rows
of other programs (peers.py) have version, ours_ms and differs instead of what they do not tell.
"""

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.case import Case
from pipeline.errors import CaseError, OutputError, quote_value
from pipeline.formats.atomic import replace_file, write_whole
from pipeline.studies.scaling.peers import INSTALL, PEERS, list_installed
from pipeline.studies.scaling.step_cost import METHODS
from pipeline.system.threads import make_thread_environment

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = {
    "linear": "#D55E00", "one_solve": "#0072B2", "gram_schmidt": "#56B4E9", "auto": "#1b1e28", "converged": "#009E73",
    "explicit": "#CC79A7", "felupe": "#a6761d", "mujoco": "#6a3d9a",
}  # fmt: skip
CostRow = dict[str, Any]


@dataclass(frozen=True)
class Scaling:
    """The rows, the bandwidth [GB/s] that they are compared with, and the files made."""

    rows: tuple[CostRow, ...]
    bandwidth: float
    made: tuple[Path, ...]

    def lines(self) -> list[str]:
        """Return the table, a line a point."""
        head = "method         tets   ms a step   ns a tet   iterations   set-up s   peak MB   bound ms   plain scipy"
        lines = [
            head,
            *(_format_row(row) for row in self.rows if row["method"] not in PEERS),
            *_list_newton_lines(self.rows),
        ]
        return lines + _list_peer_lines([row for row in self.rows if row["method"] in PEERS])


def study_scaling(
    cases: Sequence[Case],
    out: Path,
    *,
    cells: Sequence[Sequence[int]] = (),
    methods: Sequence[str] = (),
    rtol: float = 1e-6,
    baseline: bool = True,
    on_point: Callable[[int, int], None] | None = None,
) -> Scaling:
    """Return what steps of cases cost, of boxes with so many `cells` each; writes bench.json and scaling.png to `out`.

    A mesh from a file is taken as it is. `methods` are names of METHODS and PEERS, by default all of the first and the
    second where they are installed. Raises CaseError where one is unknown or not installed, OutputError where files
    cannot be written. A point that fails is a row with its `error`.
    """
    if unknown := [name for name in methods if name not in (*METHODS, *PEERS)]:
        raise CaseError(f"--method {quote_value(unknown[0])}: is not one of {', '.join((*METHODS, *PEERS))}")
    if missing := [name for name in methods if name in PEERS and name not in list_installed()]:
        raise CaseError(f"--method {missing[0]}: is not installed: {INSTALL}")
    points: list[dict[str, Any]] = []
    for case in cases:
        file = out / "cases" / f"{case.name}.toml"
        write_whole(file, case.to_toml(file.parent))
        point = {
            "name": case.name,
            "case": str(file),
            "variant": _choose_variant(case),
            "rtol": rtol,
            "baseline": baseline,
        }
        meshes = [list(one) for one in cells] if cells and case.mesh.shape else [None]
        points += [
            point | {"cells": mesh, "method": name}
            for mesh in meshes
            for name in (methods or (*METHODS, *list_installed()))
        ]
    rows, bandwidth = [], _measure_bandwidth()
    for index, point in enumerate(points):
        rows.append({"case": point["name"]} | _measure_row(point, bandwidth))
        if on_point is not None:
            on_point(index + 1, len(points))
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "bandwidth_GB_per_s": bandwidth}
    said = (
        "one thread; ms is the median processor time of a step, writing left out; linear systems to a relative "
        "residual of rtol"
    )
    path = out / "bench.json"
    write_whole(path, json.dumps({"rows": rows, "machine": machine, "rtol": rtol, "note": said}, indent=2) + "\n")
    _write_figure(rows, out / "scaling.png")
    return Scaling(tuple(rows), bandwidth, (path, out / "scaling.png"))


def _choose_variant(case: Case) -> str:
    """Return the variant that says least of its own: what is set for a point must not be undone by it."""
    return min(case.variant_names, key=lambda name: len(case.variant(name).own_keys))


def _measure_row(point: CostRow, bandwidth: float) -> CostRow:
    """Return the row of one point, measured in a process of its own on one thread."""
    environment = os.environ | make_thread_environment(1)
    module = "peers" if point["method"] in PEERS else "step_cost"
    command = [sys.executable, "-m", f"pipeline.studies.scaling.{module}", json.dumps(point)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr.strip().splitlines() or [f"the process ended with {done.returncode}"])[-1]
        return {"method": point["method"], "cells": point["cells"], "error": said}
    row: CostRow = json.loads(done.stdout)
    bound = {"bound_ms": row["bytes"] / bandwidth / 1e6} if "bytes" in row else {}
    return row | bound | {"error": None}


def _measure_bandwidth() -> float:
    """Return what one thread copies [GB/s], read and written: the best of some copies of 200 MB."""
    source = np.ones(25_000_000)
    target = np.empty_like(source)
    times = []
    for _ in range(5):
        began = time.perf_counter()
        np.copyto(target, source)
        times.append(time.perf_counter() - began)
    return 2 * source.nbytes / min(times) / 1e9


def _format_row(row: CostRow) -> str:
    if row["error"]:
        return f"{row['method']:<10} {row['cells']}: {row['error']}"
    peak = f"{row['peak_MB']:9.0f}" if row["peak_MB"] else f"{'':9}"
    plain = f"{row['baseline_ms']:10.2f} ({row['baseline_ms'] / row['ms']:.1f} x)" if row["baseline_ms"] else ""
    return (
        f"{row['method']:<10} {row['tets']:8d} {row['ms']:11.3f} {row['ns_per_tet']:10.0f} "
        f"{row['linear_iterations']:12g} {row['setup_s']:10.3f} {peak} {row['bound_ms']:10.3f}   {plain}"
    )


def _list_newton_lines(rows: Sequence[CostRow]) -> list[str]:
    """Return what an iteration of the converged method costs beside the one solve of the same mesh."""
    good = [row for row in rows if not row["error"] and row["method"] in ("one_solve", "converged")]
    one = {(row["case"], row["tets"]): row["ms"] for row in good if row["method"] == "one_solve"}
    return [
        f"converged, {row['tets']} tets: an iteration costs {row['ms'] / row['iterations'] / one[at]:.1f} x one solve"
        for row in good
        if row["method"] == "converged" and row["iterations"] and (at := (row["case"], row["tets"])) in one
    ]


def _list_peer_lines(rows: Sequence[CostRow]) -> list[str]:
    """Return the table of other programs, what differs, and which could be installed."""
    missing = [name for name in PEERS if name not in list_installed()]
    lines = [f"not compared with {', '.join(missing)}: {INSTALL}"] if missing else []
    if not rows:
        return lines
    lines = ["other programs     tets         ms   ns a tet   set-up s   ours ms", *map(_format_peer_row, rows), *lines]
    return lines + [f"{name}: {peer.differs}" for name, peer in PEERS.items() if any(r["method"] == name for r in rows)]


def _format_peer_row(row: CostRow) -> str:
    if row["error"]:
        return f"{row['method']:<10} {row['cells']}: {row['error']}"
    return (
        f"{row['method'] + ' ' + row['version']:<14} {row['tets']:8d} {row['ms']:10.3f} {row['ns_per_tet']:10.0f} "
        f"{row['setup_s']:10.3f} {row['ours_ms']:9.3f} ({row['ms'] / row['ours_ms']:.1f} x)"
    )


def _write_figure(rows: Sequence[CostRow], path: Path) -> None:
    """Write the cost of a step against the size of the mesh, both logarithmic; raises OutputError."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from pipeline.views.figures import STYLE

    good = [row for row in rows if not row["error"]]
    if not good:
        raise OutputError(f"{path}: no point was measured: {rows[0]['error']}")
    with rc_context(STYLE):
        figure = Figure(figsize=(8.0, 5.6), dpi=120)
        FigureCanvasAgg(figure)
        figure.set_layout_engine("constrained")
        axes = figure.subplots()
        for method, colour in _COLOURS.items():
            label = f"{method}, {PEERS[method].what}" if method in PEERS else method
            _draw(axes, [row for row in good if row["method"] == method], label, colour)
        axes.set(xscale="log", yscale="log", xlabel="tetrahedra", ylabel="ms a step")
        title = "Cost of a step; dotted: what the bandwidth allows, dashed: plain scipy"
        axes.set_title(title, loc="left", fontsize=10)
        axes.grid(visible=True, which="major", color="#e3e5ea")
        axes.legend(frameon=False, loc="upper left")
        with replace_file(path) as hidden:
            figure.savefig(hidden, metadata={"Software": None})


def _draw(axes: "Axes", rows: Sequence[CostRow], label: str, colour: str) -> None:
    if not rows:
        return
    rows = sorted(rows, key=lambda row: int(row["tets"]))
    tets = [row["tets"] for row in rows]
    axes.plot(tets, [row["ms"] for row in rows], "o-", color=colour, label=label)
    if "bound_ms" in rows[0]:
        axes.plot(tets, [row["bound_ms"] for row in rows], ":", color=colour)
    plain = [(row["tets"], row["baseline_ms"]) for row in rows if row.get("baseline_ms")]
    if plain:
        axes.plot(*zip(*plain, strict=True), "s--", color="#7d8597", label="one_solve, plain scipy")
