"""Points are found in the cell around them, and the weights of its nodes rebuild any field that the cell can hold."""

from types import SimpleNamespace

import numpy as np
import pytest
import pyvista

from pipeline.errors import MeshError
from pipeline.formats.cell_kinds import TYPES
from pipeline.formats.grid import CellArray, PolyhedronFaces
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.locate import locate_points
from pipeline.mesh.shape_functions import find_kind
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


def test_nodes_far_from_the_origin_are_inside():
    near = box((1.0, 1.0, 1.0), (10, 10, 10))
    mesh = type(near)(near.points + 1e7, near.cells)
    cells, weights = locate_points(mesh, mesh.points)
    assert np.isfinite(weights).all()
    assert np.einsum("pk,pkd->pd", weights, mesh.points[mesh.cells[cells]]) == pytest.approx(mesh.points, abs=1e-7)


def test_boxes_of_very_different_sizes_are_all_searched():
    mesh = rectangle((1.0, 1.0), (1, 1))
    fine = rectangle((1e-3, 1e-3), (30, 30))
    points = np.concatenate([mesh.points, fine.points + np.array([2.0, 0.0])])
    cells = np.concatenate([mesh.cells, fine.cells + len(mesh.points)])
    both = type(mesh)(points, cells)
    found, weights = locate_points(both, both.centers)
    assert found.tolist() == list(range(len(cells))) and np.isfinite(weights).all()


# Cells of any kind


def list_kinds():
    return [(row.number, count) for row in TYPES.values() for count in sorted(row.kinds)]


def place_nodes(kind):
    """The nodes of the reference cell in space; the coordinates of pyramids are collapsed."""
    if kind.shape != "pyramid":
        return kind.nodes
    height = kind.nodes[:, 2:]
    return np.column_stack([0.5 + (kind.nodes[:, :2] - 0.5) * (1 - height), height])


def draw_natural(kind, rng, count=100):
    points = rng.uniform(0.001, 0.999, (20 * count, kind.dimension))
    if kind.shape in ("triangle", "tetrahedron"):
        points = points[points.sum(axis=1) < 0.999]
    if kind.shape == "wedge":
        points = points[points[:, :2].sum(axis=1) < 0.999]
    return points[:count]


def make_one(cell_type, points, dimension, faces=None):
    count = len(points)
    cells = CellArray(np.array([cell_type], dtype=np.uint8), np.array([0, count]), np.arange(count), faces)
    if TYPES[cell_type].faceted:  # only these are needed
        return SimpleNamespace(points=points, cell_array=cells, dimension=dimension, size=1.0, rest_volumes=np.ones(1))
    return CellMesh(points, cells, dimension)


@pytest.mark.parametrize(("cell_type", "count"), list_kinds())
def test_the_map_of_a_curved_cell_is_inverted(cell_type, count):
    """Points made from natural coordinates get the shape functions there; points beside the cell get none."""
    kind, rng = find_kind(cell_type, count), np.random.default_rng(cell_type + count)
    nodes = place_nodes(kind)
    nodes = nodes + (0.03 if kind.order < 3 and count != 19 else 0.01) * rng.normal(size=nodes.shape)
    natural = draw_natural(kind, rng)
    for points in [nodes] if kind.dimension == 3 else [nodes, np.column_stack([nodes, 0.1 * nodes[:, 0] ** 2])]:
        mesh = make_one(cell_type, points, kind.dimension)
        asked = kind.evaluate(natural) @ points
        cells, weights = locate_points(mesh, asked)
        assert (cells == 0).all() and weights @ points == pytest.approx(asked, abs=1e-12)
        assert weights == pytest.approx(kind.evaluate(natural), abs=1e-9)
        assert locate_points(mesh, points)[1] @ points == pytest.approx(points, abs=1e-8)
        away = points.mean(axis=0) + 2 * (asked - points.mean(axis=0)) / np.linalg.norm(
            asked - points.mean(axis=0), axis=1, keepdims=True
        )
        assert np.isnan(locate_points(mesh, away)[1]).all()


def test_a_mixed_mesh_agrees_with_vtk():
    """Twisted hexahedra, tetrahedra, wedges and pyramids: VTK's probe gives the same values of a nodal field."""
    hexahedra = pyvista.ImageData(dimensions=(4, 3, 3)).cast_to_structured_grid().cast_to_unstructured_grid()
    blocks = [hexahedra, hexahedra.translate((5, 0, 0)).triangulate()]
    for k, make in enumerate((pyvista.examples.cells.Wedge, pyvista.examples.cells.Pyramid)):
        blocks.append(make().translate((10 + 5 * k, 0, 0)))
    grid = pyvista.merge(blocks, merge_points=False)
    points = np.array(grid.points, dtype=float)
    points[:, 0] += 0.1 * np.sin(points[:, 1] + points[:, 2])
    grid.points, grid.point_data["f"] = points, points @ [1.0, 2.0, 3.0] + points[:, 0] * points[:, 1]
    cells = CellArray(grid.celltypes.astype(np.uint8), np.array(grid.cell_offsets), np.array(grid.cell_connectivity))
    mesh = CellMesh(points, orient(points, cells), 3)
    asked = np.random.default_rng(1).uniform(points.min(axis=0), points.max(axis=0), (3000, 3))
    found, weights = locate_points(mesh, asked)
    theirs = pyvista.PolyData(asked).sample(grid)
    inside = np.isfinite(weights[:, 0])
    assert 300 < inside.sum() < 2000
    assert (inside == (theirs.point_data["vtkValidPointMask"] == 1)).mean() > 0.998  # VTK's tolerance is another
    both = inside & (theirs.point_data["vtkValidPointMask"] == 1)
    assert gather(mesh, found, weights, grid.point_data["f"])[both] == pytest.approx(theirs["f"][both], abs=5e-3)
    assert gather(mesh, found, weights, points)[inside] == pytest.approx(asked[inside], abs=1e-11)


def orient(points, cells):
    """The tetrahedra that VTK made, with positive volumes."""
    connectivity = cells.connectivity.copy()
    for k in np.flatnonzero(cells.types == 10):
        corners = connectivity[cells.offsets[k] : cells.offsets[k + 1]]
        if np.linalg.det(points[corners[1:]] - points[corners[0]]) < 0:
            corners[2:] = corners[[3, 2]]
    return cells._replace(connectivity=connectivity)


def gather(mesh, cells, weights, values):
    """The values at located points, cell by cell: the plain sum over its nodes."""
    array, out = mesh.cell_array, np.full((len(cells), *values.shape[1:]), np.nan)
    for i, cell in enumerate(cells.tolist()):
        nodes = array.connectivity[array.offsets[cell] : array.offsets[cell + 1]]
        out[i] = weights[i, : len(nodes)] @ values[nodes]
        assert np.isnan(weights[i, 0]) or (weights[i, len(nodes) :] == 0).all()
    return out


# Cells without shape functions


def make_prism(n):
    """Points and faces of a prism over a regular polygon, as VTK orders them: bottom, then top."""
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.concatenate([np.column_stack([ring, np.full(n, z)]) for z in (0.0, 1.0)])
    sides = [[k, (k + 1) % n, n + (k + 1) % n, n + k] for k in range(n)]
    return points, [list(range(n))[::-1], list(range(n, 2 * n)), *sides]


def list_faces(faces):
    return PolyhedronFaces(
        np.concatenate(faces), np.cumsum([0, *map(len, faces)]), np.array([0, len(faces)], dtype=np.int64)
    )


def test_linear_fields_in_a_polygon_are_exact():
    angle = 2 * np.pi * np.arange(7) / 7
    points = np.column_stack([np.cos(angle) * [1, 1, 1.3, 1, 0.8, 1, 1], np.sin(angle)])
    mesh = make_one(7, points, 2)
    asked = 0.4 * np.random.default_rng(0).uniform(-1, 1, (200, 2))
    assert locate_points(mesh, asked)[1] @ points == pytest.approx(asked, abs=1e-14)
    assert locate_points(mesh, points)[1] == pytest.approx(np.eye(7), abs=1e-12)
    assert np.isnan(locate_points(mesh, 1.31 * points)[1]).all()


@pytest.mark.parametrize(("cell_type", "n"), [(15, 5), (16, 6), (42, 5), (42, 8)])
def test_linear_fields_in_prisms_and_polyhedra_are_exact(cell_type, n):
    points, faces = make_prism(n)
    points = points + 0.02 * np.random.default_rng(n).normal(size=points.shape)
    mesh = make_one(cell_type, points, 3, list_faces(faces) if cell_type == 42 else None)
    asked = np.random.default_rng(0).uniform([-0.5, -0.5, 0.1], [0.5, 0.5, 0.9], (200, 3))
    weights = locate_points(mesh, asked)[1]
    assert weights @ points == pytest.approx(asked, abs=1e-14) and weights.min() > -1e-9
    assert locate_points(mesh, points)[1] == pytest.approx(np.eye(2 * n), abs=1e-12)
    assert np.isnan(locate_points(mesh, asked + [0, 0, 2.0])[1]).all()  # noqa: RUF005


# Surfaces and planes in space


def test_points_beside_a_surface_belong_to_the_nearest_cell():
    flat = rectangle((1.0, 1.0), (4, 4))
    lift = np.column_stack([flat.points, np.zeros(len(flat.points))])
    both = np.concatenate([lift, lift + [0, 0, 1.0]])  # noqa: RUF005
    cells = np.concatenate([flat.cells, flat.cells + len(lift)])
    array = CellArray(np.full(len(cells), 5, dtype=np.uint8), np.arange(0, 3 * len(cells) + 1, 3), cells.reshape(-1))
    mesh = CellMesh(both, array, 2)
    asked = np.column_stack([flat.centers, np.full(len(flat.centers), 1.001)])
    found, weights = locate_points(mesh, asked)
    assert found.tolist() == list(range(len(flat.cells), 2 * len(flat.cells)))
    assert gather(mesh, found, weights, both) == pytest.approx(asked - [0, 0, 0.001], abs=1e-12)
    assert np.isnan(locate_points(mesh, asked - [0, 0, 0.5])[1]).all()
