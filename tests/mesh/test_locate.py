"""Points are found in the cell around them, and the weights of its nodes rebuild any field that the cell can hold."""

import numpy as np
import pytest

from pipeline.errors import MeshError
from pipeline.mesh.locate import locate_points
from pipeline.mesh.shapes import box, rectangle


@pytest.mark.parametrize("mesh", [box((2.0, 3.0, 1.0), (2, 3, 1)), rectangle((2.0, 3.0), (4, 5))], ids=["3D", "2D"])
def test_weights_in_simplices_rebuild_the_point(mesh):
    d = mesh.dimension
    inside = np.random.default_rng(0).uniform(0, 1, (300, d)) * mesh.points.max(axis=0)
    points = np.concatenate([inside, mesh.points, mesh.centers])
    cells, weights = locate_points(mesh, points)
    assert weights.min() >= -1e-9 and weights.sum(axis=1) == pytest.approx(1)
    rebuilt = np.einsum("pk,pkd->pd", weights, mesh.points[mesh.cells[cells]])
    assert rebuilt == pytest.approx(points, abs=1e-13)
    assert cells[-len(mesh.centers) :].tolist() == list(range(len(mesh.cells)))


def test_points_outside_have_no_weights():
    mesh = box((2.0, 3.0, 1.0), (2, 3, 1))
    strange = [[2.0 + 1e-6, 1, 0.5], [-1, -1, -1], [np.nan, 1, 0.5], [np.inf, 1, 0.5], [1e300, 0, 0]]
    cells, weights = locate_points(mesh, np.array([*strange, [1, 1, 0.5]]))
    assert np.isnan(weights[:-1]).all() and np.isfinite(weights[-1]).all()
    assert cells[:-1].tolist() == [0] * len(strange)
    assert locate_points(mesh, np.empty((0, 3)))[1].shape == (0, 4)
    with pytest.raises(MeshError, match=r"\(p, 3\), not \(1, 2\)"):
        locate_points(mesh, np.zeros((1, 2)))


def test_boxes_of_very_different_sizes_are_all_searched():
    mesh = rectangle((1.0, 1.0), (1, 1))
    fine = rectangle((1e-3, 1e-3), (30, 30))
    points = np.concatenate([mesh.points, fine.points + np.array([2.0, 0.0])])
    cells = np.concatenate([mesh.cells, fine.cells + len(mesh.points)])
    both = type(mesh)(points, cells)
    found, weights = locate_points(both, both.centers)
    assert found.tolist() == list(range(len(cells))) and np.isfinite(weights).all()
