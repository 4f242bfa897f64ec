"""The cost of a step against the size of the mesh: every row has its numbers, and a point that fails is a row."""

import json

import pytest

from pipeline import load_case
from pipeline.cli import main
from pipeline.errors import CaseError
from pipeline.studies.cost import METHODS, measured
from pipeline.studies.scaling import scaling

NUMBERS = ("tets", "nodes", "dt", "ms", "ns_per_tet", "setup_s", "peak_MB", "bytes", "bound_ms")


@pytest.mark.slow
def test_every_method_has_a_row_with_its_numbers(cases_folder, tmp_path, capsys) -> None:
    arguments = ["study", "scaling", str(cases_folder / "bar_as_printed.toml"), "--cells", "1x3x1", "--quiet"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    said = json.loads((tmp_path / "bench.json").read_text())
    assert [row["method"] for row in said["rows"]] == list(METHODS)
    for row in said["rows"]:
        assert row["error"] is None and row["tets"] == 18 and all(row[name] > 0 for name in NUMBERS)
        assert (row["baseline_ms"] is not None) == (row["method"] == "one_solve")
    assert (tmp_path / "scaling.png").stat().st_size > 10_000
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) >= 1 + len(METHODS) and " x)" in lines[2]


def test_a_point_says_what_it_solved_with(cases_folder) -> None:
    point = {"case": str(cases_folder / "bar_as_printed.toml"), "variant": "polar", "rtol": 1e-6, "baseline": False}
    row = measured(point | {"method": "one_solve", "cells": [1, 3, 1]})
    assert row["linear_solver"] == ["banded"] and row["solves"] == 1 and row["linear_iterations"] == 0
    assert row["ns_per_tet"] == pytest.approx(1e6 * row["ms"] / 18)


def test_wrong_input_is_an_error_and_nothing_measured_too(cases_folder, tmp_path) -> None:
    with pytest.raises(CaseError, match="--method quick: is not one of linear, one_solve"):
        scaling([load_case(cases_folder / "bar.toml")], tmp_path, methods=["quick"])
    arguments = ["study", "scaling", str(cases_folder / "bar.toml"), "--out", str(tmp_path), "--method", "linear"]
    assert main([*arguments, "--cells", "2by8"]) == 2
    assert main([*arguments, "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert main([*arguments, "--cells", "0x1x1"]) == 4
