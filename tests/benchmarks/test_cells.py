"""The benchmark of the kinds of cells prints a row for each."""

import pytest

from benchmarks.cells import main


def test_rows_have_small_errors_and_the_difference_of_vtk(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--cells", "300", "--only", "tetrahedron 2"]) == 0
    head, rule, *rows = capsys.readouterr().out.splitlines()
    assert head.startswith("| cells | VTK types") and rule.count("---") == head.count("|") - 1
    first = [cell.strip() for cell in rows[0].strip("|").split("|")]
    assert first[:5] == ["tetrahedron 2", "24, 71", "10", "8", "14"] and first[7] == "-8.0%"
    assert float(first[5]) < 1e-12 and float(first[6]) < 1e-12 and float(first[8].replace(",", "")) > 0
    assert len(rows) == 2
