"""The skin of bodies: boundary faces of every kind of cell, curved faces divided, weights on nodes, outlines."""

import numpy as np
import pytest

from pipeline.formats.cell_kinds import TYPES
from pipeline.formats.grid import CellArray, PolyhedronFaces
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.cell_text import describe_cells
from pipeline.mesh.shape_functions import make_kind
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.skin import find_skin
from pipeline.mesh.surface import find_boundary_faces

KINDS = [(number, count, name) for number, row in TYPES.items() for count, name in row.kinds.items()]


def make_cells(*blocks, faces=None) -> CellArray:
    """Cells of several VTK types: (type, nodes of each cell)."""
    types = np.concatenate([np.full(len(cells), kind, dtype=np.uint8) for kind, cells in blocks])
    sizes = np.concatenate([[len(cell) for cell in cells] for _, cells in blocks])
    nodes = np.concatenate([np.asarray(cell) for _, cells in blocks for cell in cells])
    return CellArray(types, np.concatenate([[0], np.cumsum(sizes)]), nodes, faces)


def find_area(points, triangles) -> float:
    a, b, c = np.moveaxis(np.pad(points, [(0, 0), (0, 3 - points.shape[1])])[triangles], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def find_volume(points, triangles) -> float:
    a, b, c = np.moveaxis((points - points.mean(axis=0))[triangles], 1, 0)
    return float(np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("mesh", [box((2.0, 3.0, 1.0), (2, 3, 1)), rectangle((2.0, 1.0), (3, 2))], ids=["3D", "2D"])
def test_simplices_are_drawn_by_their_boundary_faces_in_order(mesh):
    skin = find_skin(mesh)
    faces, owners = (mesh.cells, np.arange(len(mesh.cells))) if mesh.dimension == 2 else find_boundary_faces(mesh)
    assert skin.weights is None
    assert np.array_equal(skin.nodes[skin.triangles], faces) and np.array_equal(skin.owners, owners)
    assert np.array_equal(skin.place(mesh.points), mesh.points[skin.nodes])


@pytest.mark.parametrize(("number", "count", "name"), KINDS, ids=[f"{number}-{count}" for number, count, _ in KINDS])
def test_a_cell_of_every_kind_is_closed_and_outward(number, count, name):
    """An affine image of the reference cell; reference coordinates of pyramids are collapsed."""
    kind = make_kind(name)
    nodes = kind.nodes.copy()
    if kind.shape == "pyramid":
        nodes[:, :2] = 0.5 + (nodes[:, :2] - 0.5) * (1 - nodes[:, 2:])
    points = nodes @ np.diag([2.0, 3.0, 0.5][: kind.dimension]) + 0.1
    mesh = CellMesh(points, make_cells((number, [np.arange(count)])), kind.dimension)
    skin = find_skin(mesh)
    place = skin.place(points)
    assert set(skin.owners) == {0}
    if kind.dimension == 2:
        assert find_area(place, skin.triangles) == pytest.approx(mesh.rest_volumes[0], rel=1e-12)
    else:
        assert find_volume(place, skin.triangles) == pytest.approx(mesh.rest_volumes[0], rel=1e-12)
        sides = np.sort(skin.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()  # closed
    # the outline follows the edges of the reference cell
    corners = {"triangle": 3, "quad": 4, "tetrahedron": 6, "hexahedron": 12, "wedge": 9, "pyramid": 8}[kind.shape]
    assert len(skin.lines) % corners == 0 and len(skin.lines) // corners == (
        1 if kind.order == 1 else 8 if kind.order == 4 else 6
    )


def test_a_curved_face_is_followed():
    """A ten-node tetrahedron with the middles of a face's edges on a sphere."""
    nodes = make_kind("tetrahedron 2").nodes
    points = nodes.copy()
    rounded = np.flatnonzero(np.isclose(nodes.sum(axis=1), 1))  # the face opposite to the origin
    points[rounded] /= np.linalg.norm(points[rounded], axis=1, keepdims=True)
    mesh = CellMesh(points, make_cells((24, [np.arange(10)])), 3)
    skin = find_skin(mesh)
    bulge = mesh.rest_volumes[0] - 1 / 6  # beyond the flat face between the corners
    assert bulge > 0.27
    # chords of a sixth of the edge miss a 36th of it
    missed = mesh.rest_volumes[0] - find_volume(skin.place(points), skin.triangles)
    assert missed == pytest.approx(bulge / 36, rel=0.2)


def test_quads_beside_triangles_stay_and_faces_alike_vanish():
    """Two hexahedra share a face; a quadrilateral beside two triangles of tetrahedra is drawn, and they are."""
    points = np.array([[i, j, k] for i in range(3) for j in range(2) for k in range(2)], dtype=float)
    number = {tuple(p): a for a, p in enumerate(points.astype(int).tolist())}
    corner = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    hexes = [[number[i + x, j, k] for i, j, k in corner] for x in (0, 1)]
    mesh = CellMesh(points, make_cells((12, hexes)), 3)
    skin = find_skin(mesh)
    assert len(skin.triangles) == 20 and find_area(skin.place(points), skin.triangles) == pytest.approx(10)
    # as polyhedra: the same faces, and a polyhedron beside a hexahedron shares its face
    tops = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    around = np.array([[hexes[1][a] for a in face] for face in tops])
    faces = PolyhedronFaces(around.ravel(), np.arange(0, 25, 4), np.array([0, 0, 6]))
    cells = make_cells((12, hexes[:1]), (42, hexes[1:]), faces=faces)
    from pipeline.mesh.skin import _iterate_groups, _join_groups, _keep_boundary

    skin = _join_groups(_keep_boundary(list(_iterate_groups(cells))), len(points))
    assert len(skin.triangles) == 20 and find_area(skin.place(points), skin.triangles) == pytest.approx(10)
    # the right box as tetrahedra: the two triangles and the quadrilateral on the plane x = 1 are different faces
    cube = np.array(hexes[1])
    tets = [[0, 1, 3, 4], [1, 2, 3, 6], [1, 6, 4, 5], [3, 4, 6, 7], [1, 3, 4, 6]]
    mixed = CellMesh(points, make_cells((12, hexes[:1]), (10, [cube[t] for t in tets])), 3)
    assert len(find_skin(mixed).triangles) == 24
    assert describe_cells([mixed]) == "5 tetrahedra and 1 hexahedron"


def test_a_polygon_is_divided_around_its_middle():
    angles = 2 * np.pi * np.arange(6) / 6
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    from pipeline.mesh.skin import _iterate_groups, _join_groups

    cells = make_cells((7, [np.arange(6)]))
    skin = _join_groups(list(_iterate_groups(cells)), 6)
    place = skin.place(points)
    assert len(place) == 7 and len(skin.triangles) == 6 and len(skin.lines) == 6
    assert find_area(place, skin.triangles) == pytest.approx(1.5 * np.sqrt(3))


def test_points_without_data_stay_without():
    points = make_kind("hexahedron serendipity").nodes.copy()
    mesh = CellMesh(points, make_cells((25, [np.arange(20)])), 3)
    skin = find_skin(mesh)
    x = points.copy()
    x[0] = np.nan
    lost = np.isnan(skin.place(x)).any(axis=1)
    assert 0 < lost.sum() < len(lost)  # only those that the node moves


def test_many_curved_faces_are_divided_less(monkeypatch):
    points = make_kind("hexahedron 2").nodes
    mesh = CellMesh(points, make_cells((29, [np.arange(27)])), 3)
    assert len(find_skin(mesh).triangles) == 6 * 2 * 6**2
    for most, parts in (((5, 20_000), 3), ((4, 5), 2)):
        limits = tuple(zip(most, ((6, 8), (3, 4)), strict=True))
        monkeypatch.setattr("pipeline.mesh.skin._PARTS", limits)
        assert len(find_skin(mesh).triangles) == 6 * 2 * parts**2


@pytest.mark.parametrize(
    ("counts", "text"),
    [
        ([(10, 1)], "1 tetrahedron"),
        ([(10, 12345)], "12 345 tetrahedra"),
        ([(10, 192), (12, 4)], "192 tetrahedra and 4 hexahedra"),
        ([(13, 2), (14, 3), (25, 1)], "3 pyramids, 2 wedges and 1 quadratic hexahedron"),
    ],
)
def test_cells_in_words(counts, text):
    class Bare:
        cell_array = make_cells(*((kind, [range(_COUNTS[kind])] * n) for kind, n in counts))

    assert describe_cells([Bare]) == text
    assert describe_cells([Bare, Bare]) == text


_COUNTS = {10: 4, 12: 8, 13: 6, 14: 5, 25: 20}
