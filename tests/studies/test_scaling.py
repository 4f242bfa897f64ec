"""The cost of a step against the size of the mesh: every row has its numbers, and a point that fails is a row."""

import json
import subprocess
import sys

import numpy as np
import pytest

from pipeline import load_case
from pipeline.cli import main
from pipeline.errors import CaseError
from pipeline.studies.scaling import step_cost
from pipeline.studies.scaling.cost_table import format_costs
from pipeline.studies.scaling.rival import Rival
from pipeline.studies.scaling.step_cost import METHODS, measure_step_cost
from pipeline.studies.scaling.study import study_scaling

NUMBERS = ("tets", "nodes", "dt", "ms", "ns_per_tet", "setup_s", "peak_MB", "bytes", "bound_ms")


def make_point(cases_folder, method: str) -> dict[str, object]:
    case = str(cases_folder / "bar_as_printed.toml")
    return {"case": case, "variant": "polar", "rtol": 1e-6, "method": method, "cells": [1, 3, 1]}


@pytest.mark.slow
def test_every_method_has_a_row_with_its_numbers(cases_folder, tmp_path, capsys) -> None:
    arguments = ["study", "scaling", str(cases_folder / "bar_as_printed.toml"), "--cells", "1x3x1", "--quiet"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "bench.json").read_text())["rows"]
    assert [row["method"] for row in rows] == list(METHODS)
    for row in rows:
        assert row["error"] is None and row["tets"] == 18 and all(row[name] > 0 for name in NUMBERS)
        assert row["baseline_ms"] is None
    assert (tmp_path / "scaling.png").stat().st_size > 10_000
    lines = capsys.readouterr().out.splitlines()
    ms, newton = ({row["method"]: row.get(name) for row in rows} for name in ("ms", "iterations"))
    ratio = ms["converged"] / newton["converged"] / ms["one_solve"]
    assert newton["one_solve"] == 1 <= newton["converged"]
    assert lines[1 + len(METHODS)] == f"converged, 18 tets: an iteration costs {ratio:.1f} x one solve"
    assert lines[2 + len(METHODS) :] == ["not measured: stepper bdf2"]


def test_a_point_names_its_linear_solver(cases_folder) -> None:
    row = measure_step_cost(make_point(cases_folder, "one_solve"))
    assert row["linear_solver"] == ["banded"] and row["solves"] == 1 and row["linear_iterations"] == 0
    assert row["ns_per_tet"] == pytest.approx(1e6 * row["ms"] / 18)


def test_the_peak_of_memory_is_that_of_the_process_alone() -> None:
    parent = np.ones(60_000_000)  # memory of the parent process does not count
    code = (
        "from pipeline.studies.scaling.step_cost import read_peak_megabytes as p; a = p(); "
        "b = b'1' * 10**8; print(a, p())"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    before, after = map(float, out.split())
    assert before < parent.nbytes / 1e6 and after - before == pytest.approx(100, rel=0.1)


def start_rival(problem):
    """A rival for the tests: two starts of a step that does nothing."""
    return [lambda: lambda: None, lambda: lambda: None]


def test_the_peak_of_memory_is_read_before_a_rival_runs(cases_folder, monkeypatch) -> None:
    calls: list[str] = []
    monkeypatch.setattr(step_cost, "read_peak_megabytes", lambda: calls.append("peak"))
    monkeypatch.setattr(step_cost, "_race", lambda *_: (1.0, calls.append("rival")))
    beside = {"task": f"{__name__}:start_rival", "differs": "does nothing"}
    monkeypatch.setattr(step_cost, "import_task", lambda name: start_rival)
    row = measure_step_cost(make_point(cases_folder, "one_solve") | {"beside": beside})
    assert calls == ["peak", "rival"] and row["ms"] == 1.0 and row["baseline"] == "does nothing"


def test_a_rival_takes_turns_with_ours(cases_folder, monkeypatch) -> None:
    monkeypatch.setattr(step_cost, "_MOST_STEPS", 3)
    problem = step_cost.build_point(make_point(cases_folder, "one_solve"))
    ours, rival = step_cost._race(problem.prepare(), problem, start_rival(problem))
    assert 0 <= rival < ours


def test_order_two_is_compared_with_as_many_nodes_of_order_one() -> None:
    common = {"case": "bar", "error": None, "nodes": 425, "ns_per_tet": 1.0, "linear_iterations": 4, "setup_s": 0.1}
    common |= {"peak_MB": None, "bound_ms": 0.1, "baseline_ms": None, "iterations": 1}
    rows = [
        common | {"method": "order_two", "tets": 192, "ms": 3.0},
        common | {"method": "one_solve", "tets": 1536, "ms": 2.0},
    ]
    expected = "order_two, 425 nodes: 1.50 x one_solve with as many (192 and 1536 tets)"
    assert format_costs(rows, [])[3:] == [expected]
    assert len(format_costs([rows[0] | {"nodes": 426}, rows[1]], [])) == 3


def test_wrong_input_and_no_measured_point_are_errors(cases_folder, tmp_path) -> None:
    with pytest.raises(CaseError, match="--method 'quick': is not one of linear, one_solve"):
        study_scaling([load_case(cases_folder / "bar.toml")], tmp_path, methods=["quick"])
    arguments = ["study", "scaling", str(cases_folder / "bar.toml"), "--out", str(tmp_path), "--method", "linear"]
    assert main([*arguments, "--cells", "2by8"]) == 2
    assert main([*arguments, "--cells", "0x1x1"]) == 4


def test_rivals_have_a_table_of_their_own() -> None:
    rivals = [
        Rival("other", "m:f", "other, a step", "#000000", "another law"),
        Rival("plain", "m:g", "plain", "#000000", "no kernels", beside=("linear",)),
    ]
    row = {"case": "bar", "method": "other", "version": "4", "cells": [1, 1, 1], "error": None}
    row |= {"tets": 6, "ms": 3.0, "ns_per_tet": 1.0, "setup_s": 0.1, "ours_ms": 1.5}
    lines = format_costs([{"method": "linear", "cells": None, "error": "broke"}, row], rivals)
    assert lines[0].endswith("bound ms   plain")
    assert lines[1] == "linear     None: broke" and lines[2].startswith("other programs")
    assert lines[3].startswith("other 4") and lines[3].endswith("1.500 (2.0 x)")
    assert lines[4] == "other: another law" and len(lines) == 5
