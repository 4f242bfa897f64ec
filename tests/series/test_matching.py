"""Series whose files list the same nodes and cells in other orders: matched by ids or rest positions, or not at all."""

import numpy as np
import pytest
import pyvista

from pipeline import read_series
from pipeline.mesh.shapes import box
from pipeline.run.measures import measure
from pipeline.series.matching import match_cells

RNG = np.random.default_rng(5)
TETRAHEDRA = box([2.0, 1.0, 1.0], [3, 2, 2])
GRADIENTS = [np.eye(3), np.array([[1.2, 0.1, 0], [0, 0.9, 0.2], [0, 0, 1.1]]), np.diag([1.5, 1.0, 0.7])]


def move(points, F):
    """Positions of a motion that is not affine, so that every cell has a ratio of its own."""
    x = points @ F.T
    x[:, 0] += 0.05 * (F[0, 0] - 1) * points[:, 0] ** 2
    return x


def write(folder, points, cells, *, cell_type=10, orders=None, ids=None, displaced=True):
    """Write three frames; `orders` (points, cells) renumber each; `ids` adds ids of "nodes" or "cells"."""
    folder.mkdir()
    for k, F in enumerate(GRADIENTS):
        order, cell_order = (np.arange(len(points)), np.arange(len(cells))) if orders is None else orders[k]
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        rest, moved = points[order], move(points, F)[order]
        grid = pyvista.UnstructuredGrid({cell_type: place[cells[cell_order]]}, rest if displaced else moved)
        if displaced:
            grid.point_data["displacement"] = moved - rest
        if ids == "nodes":
            grid.point_data["GlobalNodeId"] = order + 1
        if ids == "cells":
            grid.cell_data["GlobalElementId"] = cell_order + 1
        grid.save(folder / f"f_{k}.vtu")
    return read_series(folder / "f_*.vtu")


def shuffle(points, cells):
    return [(RNG.permutation(len(points)), RNG.permutation(len(cells))) for _ in GRADIENTS]


def list_ratios(series):
    return np.array([measure(frame)["volume_ratio"] for frame in series])


def separate(points, cells):
    """Every cell with points of its own."""
    return points[cells].reshape(-1, 3), np.arange(cells.size).reshape(cells.shape)


BODIES = {
    "tetrahedra": (TETRAHEDRA.points, TETRAHEDRA.cells, 10),
    "own points": (*separate(TETRAHEDRA.points, TETRAHEDRA.cells), 10),
}


@pytest.mark.parametrize("body", BODIES)
def test_frames_in_other_orders_have_the_same_ratios(tmp_path, body):
    points, cells, kind = BODIES[body]
    expected = list_ratios(write(tmp_path / "plain", points, cells, cell_type=kind))
    orders = [(np.arange(len(points)), np.arange(len(cells))), *shuffle(points, cells)[1:]]
    shuffled = write(tmp_path / "shuffled", points, cells, cell_type=kind, orders=orders)
    np.testing.assert_allclose(list_ratios(shuffled), expected, rtol=1e-12)


@pytest.mark.parametrize("ids", ["nodes", "cells"])
def test_moving_points_are_followed_by_ids(tmp_path, ids):
    points, cells, _ = BODIES["tetrahedra"]
    orders = [(np.arange(len(points)), np.arange(len(cells))), *shuffle(points, cells)[1:]]
    expected = list_ratios(write(tmp_path / "plain", points, cells, displaced=False))
    shuffled = write(tmp_path / "shuffled", points, cells, orders=orders, ids=ids, displaced=False)
    np.testing.assert_allclose(list_ratios(shuffled), expected, rtol=1e-12)


def test_cells_of_equal_connectivity_are_followed_by_ids(tmp_path):
    points, cells, _ = BODIES["own points"]
    orders = []
    for cell_order in (np.arange(len(cells)), RNG.permutation(len(cells)), np.roll(np.arange(len(cells)), 7)):
        orders.append((cells[cell_order].ravel(), cell_order))
    expected = list_ratios(write(tmp_path / "plain", points, cells, displaced=False))
    series = write(tmp_path / "rolled", points, cells, orders=orders, ids="cells", displaced=False)
    np.testing.assert_allclose(list_ratios(series), expected, rtol=1e-12)


def test_moving_points_without_ids_in_another_order_have_no_cells(tmp_path):
    points, cells, _ = BODIES["tetrahedra"]
    series = write(tmp_path / "s", points, cells, orders=shuffle(points, cells), displaced=False)
    assert np.isnan(list_ratios(series)[1:]).all()
    assert all("topology changes" in frame.fault for frame in list(series)[1:])
    volume = measure(series.read_frame(2))["total_volume"]
    plain = write(tmp_path / "plain", points, cells, displaced=False)
    assert volume == pytest.approx(float(measure(plain.read_frame(2))["total_volume"]), rel=1e-12)


@pytest.mark.parametrize("body", BODIES)
def test_the_same_mesh_in_another_order_is_matched(tmp_path, body):
    points, cells, kind = BODIES[body]
    first = write(tmp_path / "first", points, cells, cell_type=kind)
    order = shuffle(points, cells)[0]
    other = write(tmp_path / "other", points, cells, cell_type=kind, orders=[order] * 3)
    matched = match_cells(first, other)
    assert matched is not None and match_cells(first, first) is first
    np.testing.assert_allclose(list_ratios(matched), list_ratios(first), rtol=1e-12)
    np.testing.assert_allclose(matched.read_positions(2), first.read_positions(2), atol=1e-12)


def test_other_meshes_are_not_matched(tmp_path):
    points, cells, _ = BODIES["tetrahedra"]
    first = write(tmp_path / "first", points, cells)
    assert match_cells(first, write(tmp_path / "larger", 1000 * points, cells)) is None
    assert match_cells(first, write(tmp_path / "part", points[:, [1, 0, 2]] * [1, 1, -1], cells)) is None
    finer = box([2.0, 1.0, 1.0], [4, 2, 2])
    assert match_cells(first, write(tmp_path / "finer", finer.points, finer.cells)) is None
    own_points, own_cells = separate(points, cells)
    assert (
        match_cells(
            write(tmp_path / "own", own_points, own_cells), write(tmp_path / "scaled", 1.1 * own_points, own_cells)
        )
        is None
    )
