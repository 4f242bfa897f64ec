"""The numbers of a problem before it is solved, on meshes of order 2."""

import numpy as np
import pytest

from pipeline import build, load_case
from pipeline.problem import check
from pipeline.problem.check import check_problem, format_check
from tests.bodies import PLANAR, build_problem, case_document


def build_order_two(folder, *, planar: bool = False, **mesh: object):
    sections = PLANAR if planar else {}
    of_mesh = dict(case_document(**sections)["mesh"])  # type: ignore[call-overload]  # a table
    return build_problem(folder, **{**sections, "mesh": {**of_mesh, "order": 2, **mesh}})


@pytest.mark.parametrize("planar", [False, True], ids=["tetrahedra", "triangles"])
def test_counts_volumes_and_quality_are_those_of_the_corners_mesh(tmp_path, planar):
    two = check_problem(build_order_two(tmp_path, planar=planar))
    one = check_problem(build_order_two(tmp_path, planar=planar, order=1))
    assert (two.nodes, two.held) == ((65, 5) if planar else (63, 9)) and two.held > one.held
    for key in ("cells", "components", "total_volume", "largest_volume", "worst_quality", "worst_cell", "mass"):
        assert getattr(two, key) == pytest.approx(getattr(one, key), rel=1e-12), key
    assert 0.3 * one.omega_1 < two.omega_1 < one.omega_1  # a body of linear simplices is too stiff
    assert 0 < two.explicit_bound <= two.explicit_limit < one.explicit_limit


def test_the_lines_name_the_order_and_the_rest_is_as_before(tmp_path):
    problem = build_order_two(tmp_path)
    lines = format_check(check_problem(problem), problem)
    assert lines[:2] == ["nodes        63, of which 9 are held", "tetrahedra   18 of order 2 in 1 component"]
    assert [line.split()[0] for line in lines[2:]] == [
        "volume", "quality", "mass", "load", "omega_1", "omega_1", "damping", "phase", "explicit"
    ]  # fmt: skip
    assert "nan" not in " ".join(lines)


def test_large_bodies_are_told_by_their_nodes(tmp_path, monkeypatch):
    monkeypatch.setattr(check, "_MODE_LIMIT", 18 * 8 - 1)
    problem = build_order_two(tmp_path)
    numbers = check_problem(problem)
    assert np.isnan(numbers.omega_1) and np.isnan(numbers.explicit_limit)
    lines = format_check(numbers, problem)
    assert "stable below a step not computed for so many cells" in lines[-1] and "nan" not in " ".join(lines)
    assert np.isfinite(check_problem(build_order_two(tmp_path, order=1)).omega_1)


def test_the_lowest_frequency_of_few_cells_is_that_of_a_fine_mesh(cases_folder):
    """The bar's first bending mode: 192 cells of order 2, and 79 872 of order 1 with 8.42 rad/s from above."""
    case = load_case(cases_folder / "bar.toml", overrides={"mesh.order": 2}).variant("polar")
    assert check_problem(build(case)).omega_1 == pytest.approx(8.37, rel=0.01)
