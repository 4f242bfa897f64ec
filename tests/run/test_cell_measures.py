"""Measures of cells of any kind: affine and curved maps, inverted cells, NaN, mixtures, surfaces, polyhedra."""

import numpy as np
import pytest
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

from pipeline.errors import MeshError
from pipeline.fem.rotation import angle, polar_by_svd
from pipeline.formats.cell_kinds import HEXAGONAL_PRISM, PENTAGONAL_PRISM, POLYGON, POLYHEDRON, ROWS, TYPES
from pipeline.formats.grid import CellArray, PolyhedronFaces
from pipeline.mesh.cell_mesh import CellMesh, measure_volumes
from pipeline.mesh.quadrature import find_quadrature, find_samples
from pipeline.mesh.shape_functions import CellKind, find_kind
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh
from pipeline.run.cell_measures import measure_any_cells
from pipeline.run.frame import Frame
from pipeline.run.measures import CellMeasures, measure, measure_cells

KINDS = [(row.number, count) for row in ROWS for count in row.kinds]
SOLIDS = [pair for pair in KINDS if TYPES[pair[0]].dimension == 3]
PLANAR = [pair for pair in KINDS if TYPES[pair[0]].dimension == 2]
TURN = np.array([0.3, 0.5, 0.7])
HEXAHEDRON_FACES = np.array([[0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2], [0, 3, 2, 1], [4, 5, 6, 7]])


def list_ids(kinds: list[tuple[int, int]]) -> list[str]:
    return [f"{TYPES[number].name} {count}" for number, count in kinds]


def rotate(vector: np.ndarray) -> np.ndarray:
    """Rodrigues' rotation about a vector by its length."""
    length = np.linalg.norm(vector)
    x, y, z = vector / length
    W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(length) * W + (1 - np.cos(length)) * W @ W


def place_nodes(kind: CellKind) -> np.ndarray:
    """The nodes of a straight cell: those of pyramids lie in a collapsed cube."""
    nodes = kind.nodes.copy()
    if kind.shape == "pyramid":
        nodes[:, :2] = 0.5 + (nodes[:, :2] - 0.5) * (1 - nodes[:, 2:])
    return nodes


def make_cells(number: int, count: int, m: int = 37, noise: float = 0.01) -> tuple[np.ndarray, CellArray]:
    """Separate cells of one kind with curved faces."""
    kind, rng = find_kind(number, count), np.random.default_rng(number)
    nodes = place_nodes(kind)
    points = nodes + noise / kind.order**2 * rng.normal(size=(m, *nodes.shape))
    array = CellArray(np.full(m, number, np.uint8), np.arange(m + 1) * count, np.arange(m * count))
    return points.reshape(m * count, -1), array


def make_hexahedra(n: int, noise: float = 0.07) -> tuple[np.ndarray, np.ndarray]:
    """Points and hexahedra of a cube of n^3 cells whose points were moved."""
    grid = np.indices((n + 1,) * 3).reshape(3, -1).T / n
    numbers = np.arange((n + 1) ** 3).reshape((n + 1,) * 3)
    corners = [(i, j, k) for k in (0, 1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    cells = np.stack([numbers[i : n + i, j : n + j, k : n + k] for i, j, k in corners], axis=-1).reshape(-1, 8)
    return grid + noise / n * np.random.default_rng(2).normal(size=grid.shape), cells


def make_polyhedra(cells: np.ndarray, *, mixed_up: bool = True) -> CellArray:
    """The same hexahedra as polyhedra, with half of the faces turned inward if mixed up."""
    faces, m = cells[:, HEXAHEDRON_FACES].reshape(-1, 4).copy(), len(cells)
    flip = np.random.default_rng(3).random(len(faces)) < (0.5 if mixed_up else 0)
    faces[flip] = faces[flip][:, ::-1]
    stored = PolyhedronFaces(faces.ravel(), np.arange(len(faces) + 1) * 4, np.arange(m + 1) * 6)
    return CellArray(np.full(m, POLYHEDRON, np.uint8), np.arange(m + 1) * 8, cells.ravel(), stored)


def make_array(number: int, cells: np.ndarray) -> CellArray:
    m, count = cells.shape
    return CellArray(np.full(m, number, np.uint8), np.arange(m + 1) * count, cells.ravel())


def join(*arrays: CellArray) -> CellArray:
    """The cells of several arrays over the same points."""
    counts = np.concatenate([np.diff(array.offsets) for array in arrays])
    return CellArray(
        np.concatenate([array.types for array in arrays]),
        np.concatenate([[0], np.cumsum(counts)]),
        np.concatenate([array.connectivity for array in arrays]),
    )


def measure_by_numpy(mesh: CellMesh, x: np.ndarray) -> CellMeasures:
    """The same by the textbook's equations, for cells of one kind with as many axes as points have."""
    kind = mesh.blocks[0].kind
    at, weights = find_samples(kind)
    slopes = kind.differentiate(at)
    J0, J = (np.einsum("mai,qad->mqid", p[mesh.blocks[0].connectivity], slopes) for p in (mesh.points, x))
    F = J @ np.linalg.inv(J0)
    dets, det0 = np.linalg.det(F), np.linalg.det(J0)
    mean = np.einsum("mq,mqij->mij", weights * det0, F) / (weights * det0).sum(axis=1)[:, None, None]
    volumes = (weights * np.linalg.det(J)).sum(axis=1)
    return CellMeasures(volumes, dets.min(axis=1), dets.max(axis=1), angle(polar_by_svd(mean)))


@pytest.mark.parametrize(("number", "count"), SOLIDS, ids=list_ids(SOLIDS))
def test_affine_maps_of_solids_are_exact(number: int, count: int) -> None:
    points, array = make_cells(number, count)
    mesh = CellMesh(points, array, 3)
    stretch = np.array([[1.2, 0.1, 0], [0.1, 0.9, 0.2], [0, 0.2, 1.1]])
    for R, angle_ in ((np.eye(3), 0.0), (rotate(TURN), np.linalg.norm(TURN))):
        volumes, low, high, angles = measure_cells(mesh, points @ (R @ stretch).T + [3, -2, 5])
        ratio = volumes / mesh.rest_volumes
        assert ratio == pytest.approx(np.full(37, np.linalg.det(stretch)), rel=1e-12)
        assert low == pytest.approx(ratio, rel=1e-12) and high == pytest.approx(ratio, rel=1e-12)
        assert angles == pytest.approx(np.full(37, angle_), abs=1e-12)
    assert mesh.notes == () and mesh.node_volumes.sum() == pytest.approx(mesh.rest_volumes.sum(), rel=1e-13)


@pytest.mark.parametrize(("number", "count"), PLANAR, ids=list_ids(PLANAR))
def test_affine_maps_in_any_plane_are_exact(number: int, count: int) -> None:
    points, array = make_cells(number, count)
    stretch, plane = np.array([[1.2, 0.1], [0.1, 0.9]]), rotate(np.array([1.0, -0.4, 0.2]))[:2]
    R = rotate(np.array([0, 0, -0.7]))[:2, :2]
    moved = points @ (R @ stretch).T + [3, -2]
    for mesh, x in (
        (CellMesh(points, array, 2), moved),
        (CellMesh(points @ plane + 1, array, 2, plane), moved @ plane + 5),
        (CellMesh(points @ plane, array, 2), moved @ plane),
    ):
        volumes, low, high, angles = measure_cells(mesh, x)
        ratio = volumes / mesh.rest_volumes
        assert ratio == pytest.approx(np.full(37, np.linalg.det(stretch)), rel=1e-12)
        assert low == pytest.approx(ratio, rel=1e-12) and high == pytest.approx(ratio, rel=1e-12)
        assert angles == pytest.approx(np.full(37, 0.7), abs=1e-12)
        assert mesh.is_surface == (mesh.points.shape[1] == 3 and mesh.plane is None)


@pytest.mark.parametrize(("number", "count"), PLANAR, ids=list_ids(PLANAR))
def test_curved_surfaces_keep_areas_and_angles_under_rotation(number: int, count: int) -> None:
    points, array = make_cells(number, count)
    points = np.column_stack([points, 0.05 * np.random.default_rng(0).normal(size=len(points))])
    mesh = CellMesh(points, array, 2)
    volumes, low, high, angles = measure_cells(mesh, 1.1 * points @ rotate(TURN).T)
    for ratio in (volumes / mesh.rest_volumes, low, high):
        assert ratio == pytest.approx(np.full(37, 1.21), rel=1e-12)
    assert angles == pytest.approx(np.full(37, np.linalg.norm(TURN)), abs=1e-12)
    turned_over = measure_cells(mesh, points * [1, 1, -1])  # a surface has no sides: it cannot be inverted
    assert turned_over.volumes == pytest.approx(mesh.rest_volumes, rel=1e-12) and (turned_over.ratio_min > 0).all()


@pytest.mark.parametrize(("number", "count"), KINDS, ids=list_ids(KINDS))
@pytest.mark.parametrize("shake", [0.03, 0.5], ids=["strained", "some inverted"])
def test_kernels_agree_with_numpy(number: int, count: int, shake: float) -> None:
    points, array = make_cells(number, count)
    d = points.shape[1]
    mesh = CellMesh(points, array, d)
    x = points @ rotate(TURN)[:d, :d] + shake * np.random.default_rng(9).normal(size=points.shape)
    ours, expected = measure_cells(mesh, x), measure_by_numpy(mesh, x)
    ratio = ours.volumes / mesh.rest_volumes
    assert (ours.ratio_min <= ratio).all() and (ratio <= ours.ratio_max).all()
    scale = np.abs(expected.ratio_max - expected.ratio_min).max() + 1
    assert ours.volumes == pytest.approx(expected.volumes, abs=1e-13 * max(1, np.abs(expected.volumes).max()))
    assert ours.ratio_min == pytest.approx(expected.ratio_min, abs=1e-11 * scale)
    assert ours.ratio_max == pytest.approx(expected.ratio_max, abs=1e-11 * scale)
    assert ours.angles == pytest.approx(expected.angles, abs=1e-8)


@pytest.mark.parametrize(("number", "count"), KINDS, ids=list_ids(KINDS))
def test_the_mean_of_f_is_exact(number: int, count: int) -> None:
    """A quadrature of a higher degree gives the same mean, and the divergence theorem too: it is linear in x."""
    points, array = make_cells(number, count, m=5, noise=0.03)
    d = points.shape[1]
    mesh, kind = CellMesh(points, array, d), find_kind(number, count)
    x = points + 0.2 * np.random.default_rng(3).normal(size=points.shape)
    cells = mesh.blocks[0].connectivity
    at, weights = find_quadrature(kind, "nodes")
    J0, J = (np.einsum("mai,qad->mqid", p[cells], kind.differentiate(at)) for p in (points, x))
    dets = weights * np.linalg.det(J0)
    expected = np.einsum("mq,mqij->mij", dets, J @ np.linalg.inv(J0)) / dets.sum(axis=1)[:, None, None]
    F = np.einsum("mai,maj->mij", x[cells], mesh.rest_blocks[0].gradients)
    np.testing.assert_allclose(F, expected, atol=1e-11 * np.abs(expected).max())


def test_cells_inverted_inside_are_found_though_their_volume_is_positive() -> None:
    for number, count, node in ((24, 10, 4), (25, 20, 8), (12, 8, 6), (26, 15, 6), (27, 13, 5), (29, 27, 26)):
        points, array = make_cells(number, count, m=1, noise=0)
        mesh = CellMesh(points, array, 3)
        x = points.copy()
        # the middle of an edge closer to its end than a quarter, the center too close to a side, a corner pushed in
        x[node] += {26: [0.6, 0, 0], 6: [-0.9, -0.9, -0.9]}.get(node if number in (12, 29) else 0, [-0.3, 0, 0])
        found = measure_cells(mesh, x)
        assert found.volumes[0] > 0 > found.ratio_min[0], TYPES[number].name
        values = measure(Frame(0, 0.0, mesh, x))
        assert values["inverted_count"] == 1 and values["volume_ratio"][0] > 0
        assert values["volume_ratio_min"][0] == found.ratio_min[0]


def test_nan_stays_in_its_cells() -> None:
    points, cells = make_hexahedra(3)
    tetrahedra = box([1.0, 1.0, 1.0], [3, 3, 3])
    for mesh in (
        CellMesh(points, make_array(12, cells), 3),
        CellMesh(points, make_polyhedra(cells), 3),
        CellMesh(tetrahedra.points, tetrahedra.cell_array, 3),
        tetrahedra,
    ):
        x = 1.1 * mesh.points
        x[0, 1] = np.nan
        owner = np.repeat(np.arange(len(mesh.rest_volumes)), np.diff(mesh.cell_array.offsets))
        touched = np.isin(np.arange(len(mesh.rest_volumes)), owner[mesh.cell_array.connectivity == 0])
        assert 0 < touched.sum() < len(touched)
        for values in measure_cells(mesh, x):
            assert np.isnan(values[touched]).all() and np.isfinite(values[~touched]).all()
        assert all(np.isnan(values).all() for values in measure_cells(mesh, np.full_like(x, np.nan)))


def test_linear_simplices_among_other_cells_have_the_same_bits() -> None:
    rng = np.random.default_rng(4)
    for even, other in ((box([1.0, 2.0, 1.5], [3, 4, 3]), 14), (rectangle([1.0, 2.0], [5, 7]), 9)):
        plain = Mesh(even.points + 0.03 * rng.normal(size=even.points.shape), even.cells)
        d = plain.dimension
        extra = plain.cells[:1, [0, 1, 2, 3, 3]] if d == 3 else plain.cells[:1, [0, 1, 2, 2]]
        more = {14: np.array([[0, 1, 2, 3, 4]]), 9: np.array([[0, 1, 2, 3]])}[other] + len(plain.points)
        shape = find_kind(other, extra.shape[1])
        points = np.concatenate([plain.points, place_nodes(shape)])
        number = {3: 71, 2: 69}[d]  # linear Lagrange cells are simplices too
        array = join(make_array(number, plain.cells), make_array(other, more), plain.cell_array)
        mesh = CellMesh(points, array, d)
        x = points + 0.1 * rng.normal(size=points.shape)
        expected, found = measure_cells(plain, x[: len(plain.points)]), measure_cells(mesh, x)
        for theirs, ours in zip(expected, found, strict=True):
            assert np.array_equal(ours[: len(plain.cells)], theirs)
            assert np.array_equal(ours[-len(plain.cells) :], theirs)
        assert np.array_equal(mesh.rest_volumes[: len(plain.cells)], plain.rest_volumes)


def test_a_mixed_mesh_fills_its_box() -> None:
    """A hexahedron, a pyramid on it, two wedges, tetrahedra, polyhedra: volumes and node volumes add up."""
    points, cells = make_hexahedra(2, noise=0)
    center = cells[0].tolist()
    wedges = [[*center[:2], center[2], *center[4:6], center[6]], [center[0], *center[2:4], center[4], *center[6:]]]
    array = join(make_array(13, np.array(wedges)), make_array(12, cells[1:]))
    mesh = CellMesh(points, array, 3)
    assert mesh.rest_volumes == pytest.approx([1 / 16] * 2 + [1 / 8] * 7, rel=1e-13)
    assert mesh.node_volumes.sum() == pytest.approx(1, rel=1e-13)
    frame = Frame(0, 0.0, mesh, 2 * points + 1)
    values = measure(frame)
    assert values["total_volume"] == pytest.approx(8, rel=1e-13) and values["volume_drift"] == pytest.approx(7)
    assert values["center_of_mass"] == pytest.approx(np.full(3, 2.0), rel=1e-13)


def test_polyhedra_have_the_volumes_of_the_same_hexahedra() -> None:
    points, cells = make_hexahedra(5)
    hexahedra, polyhedra = CellMesh(points, make_array(12, cells), 3), CellMesh(points, make_polyhedra(cells), 3)
    assert polyhedra.rest_volumes == pytest.approx(hexahedra.rest_volumes, rel=1e-12)
    assert "least-squares" in polyhedra.notes[0] and "125 polyhedra" in polyhedra.notes[0]
    x = points + 0.03 * np.random.default_rng(0).normal(size=points.shape)
    ours, theirs = measure_cells(polyhedra, x), measure_cells(hexahedra, x)
    assert ours.volumes == pytest.approx(theirs.volumes, rel=1e-12)
    assert np.degrees(np.abs(ours.angles - theirs.angles)).max() < 3  # a fit to points, not a mean over the volume
    stretch = np.diag([1.2, 0.9, 1.1])
    volumes, low, high, angles = measure_cells(polyhedra, points @ (rotate(TURN) @ stretch).T + 5)
    for ratio in (volumes / polyhedra.rest_volumes, low, high):
        assert ratio == pytest.approx(np.full(125, np.linalg.det(stretch)), rel=1e-12)
    assert angles == pytest.approx(np.full(125, np.linalg.norm(TURN)), abs=1e-12)
    assert polyhedra.node_volumes.sum() == pytest.approx(1, rel=0.05)
    assert polyhedra.node_volumes.sum() == pytest.approx(polyhedra.rest_volumes.sum(), rel=1e-13)
    mirrored = measure_cells(polyhedra, points * [-1, 1, 1])
    assert (mirrored.ratio_max < 0).all() and mirrored.volumes == pytest.approx(-polyhedra.rest_volumes, rel=1e-12)


def test_a_polyhedron_that_is_inverted_at_one_corner_is_found() -> None:
    points, cells = make_hexahedra(1, noise=0)
    mesh = CellMesh(points, make_polyhedra(cells), 3)
    x = points.copy()
    x[cells[0, 6]] = [0.1, 0.1, 0.1]
    found = measure_cells(mesh, x)
    assert found.volumes[0] > 0 > found.ratio_min[0]


@pytest.mark.parametrize(("number", "sides"), [(PENTAGONAL_PRISM, 5), (HEXAGONAL_PRISM, 6)])
def test_prisms_and_polygons_have_their_volumes(number: int, sides: int) -> None:
    turns = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(turns), np.sin(turns)])
    area = sides / 2 * np.sin(2 * np.pi / sides)
    prism = np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (0.0, 2.0)])
    mesh = CellMesh(prism, make_array(number, np.arange(2 * sides)[None]), 3)
    assert mesh.rest_volumes == pytest.approx([2 * area], rel=1e-13)
    found = measure_cells(mesh, 1.1 * prism @ rotate(TURN).T)
    assert found.volumes / mesh.rest_volumes == pytest.approx([1.331])
    assert found.angles == pytest.approx([np.linalg.norm(TURN)])
    flat = make_array(POLYGON, np.arange(sides)[None])
    plane = rotate(np.array([0.4, 0.1, 0]))[:2]
    for points, rows in ((ring, None), (ring @ plane, plane), (ring @ plane, None)):
        mesh = CellMesh(points, flat, 2, rows)
        assert mesh.rest_volumes == pytest.approx([area], rel=1e-13)
        assert mesh.node_volumes == pytest.approx(np.full(sides, area / sides), rel=1e-13)
        found = measure_cells(mesh, 1.2 * points)
        assert [v[0] for v in found] == pytest.approx([1.44 * area, 1.44, 1.44, 0], abs=1e-12)
    turned = measure_cells(mesh, ring @ plane @ rotate(TURN).T)
    assert turned.angles == pytest.approx([np.linalg.norm(TURN)], rel=1e-12)


def test_bodies_that_leave_their_plane_are_not_measured_in_it() -> None:
    points, array = make_cells(9, 4)
    plane = rotate(np.array([1.0, -0.4, 0.2]))[:2]
    mesh = CellMesh(points @ plane, array, 2, plane)
    with pytest.raises(MeshError, match=r"leave the plane of the body by 0.1 m.*as a surface in space"):
        measure_cells(mesh, mesh.points + 0.1 * points[:, :1] / np.ptp(points[:, 0]) * np.cross(*plane))
    assert measure_cells(mesh, mesh.points + np.cross(*plane)).ratio_min == pytest.approx(np.ones(37), rel=1e-12)
    x = mesh.points.copy()
    x[0] = np.nan
    assert np.isnan(measure_cells(mesh, x).volumes).sum() == 1


def test_a_polygon_that_is_not_convex_has_its_area() -> None:
    ring = np.array([[0, 0], [2, 0], [2, 2], [1, 0.2], [0, 2.0]])
    for points in (ring, np.column_stack([ring, 0.3 * ring[:, 0]])):
        mesh = CellMesh(points, make_array(POLYGON, np.arange(5)[None]), 2)
        slope = 1 if points.shape[1] == 2 else np.hypot(1, 0.3)
        assert mesh.rest_volumes == pytest.approx([2.2 * slope], rel=1e-13)


def test_polyhedra_that_are_not_closed_are_refused() -> None:
    points, cells = make_hexahedra(2, noise=0)
    array = make_polyhedra(cells)
    faces = array.faces
    assert faces is not None
    opened = PolyhedronFaces(faces.connectivity, faces.offsets, np.r_[faces.cell_offsets[:-1], 47])
    with pytest.raises(MeshError, match=r"cell 7: the edge \d+-\d+ belongs to 1 of its faces, not to 2"):
        CellMesh(points, array._replace(faces=opened), 3)
    with pytest.raises(MeshError, match="a polyhedron without a list of its faces"):
        CellMesh(points, array._replace(faces=None), 3)
    with pytest.raises(MeshError, match=r"a prism .type 15. has 10 nodes, not 8"):
        CellMesh(points, make_array(PENTAGONAL_PRISM, cells), 3)


def test_meshes_that_cannot_be_measured_are_refused() -> None:
    points, cells = make_hexahedra(2, noise=0)
    array = make_array(12, cells)
    inverted = array._replace(connectivity=np.r_[cells[:-1].ravel(), cells[-1, [1, 0, 3, 2, 5, 4, 7, 6]]])
    with pytest.raises(MeshError, match=r"bar: 1 inverted or flat cells, first 7 \(hexahedron\) with volume -0.125"):
        CellMesh(points, inverted, 3, name="bar")
    with pytest.raises(MeshError, match="8 inverted or flat"):
        CellMesh(points * [1, 1, 0], array, 3)
    with pytest.raises(MeshError, match="not finite"):
        CellMesh(np.where(points == points[3], np.nan, points), array, 3)
    with pytest.raises(MeshError, match="names node 27 of 27"):
        CellMesh(points, array._replace(connectivity=array.connectivity + 1), 3)
    with pytest.raises(MeshError, match=r"cell 0 \(hexahedron\) is not of dimension 2"):
        CellMesh(points, array, 2)
    outside = make_polyhedra(cells)
    assert outside.faces is not None
    faces = outside.faces._replace(connectivity=outside.faces.connectivity + 1)
    with pytest.raises(MeshError, match="names node 27 of 27"):
        CellMesh(points, outside._replace(faces=faces), 3)
    with pytest.raises(MeshError, match="no cells"):
        CellMesh(points, CellArray(np.zeros(0, np.uint8), np.zeros(1, np.int64), np.zeros(0, np.int64)), 3)
    with pytest.raises(MeshError, match="Bezier"):
        CellMesh(points, make_array(79, cells), 3)
    assert measure_volumes(points, inverted, 3) == pytest.approx([1 / 8] * 7 + [-1 / 8], rel=1e-13)


def test_hexahedra_with_nodes_that_coincide_are_measured_elsewhere() -> None:
    points, cells = make_hexahedra(1, noise=0)
    collapsed = make_array(12, cells[:, [0, 1, 2, 2, 4, 5, 6, 6]])  # a wedge, as some programs write it
    mesh = CellMesh(points, collapsed, 3)
    assert mesh.rest_volumes == pytest.approx([0.5], rel=1e-13) and "coincide at rest (first 0)" in mesh.notes[0]
    found = measure_cells(mesh, points * [1.5, 1, 1])
    assert [v[0] for v in found] == pytest.approx([0.75, 1.5, 1.5, 0], abs=1e-12)


def test_cells_that_are_folded_at_rest_are_noted() -> None:
    points, array = make_cells(24, 10, m=3, noise=0)
    points[14, 0] -= 0.3
    mesh = CellMesh(points, array, 3)
    assert mesh.notes[0].startswith("1 cells are folded at rest (first 1)")
    found = measure_cells(mesh, 1.1 * points)
    assert found.ratio_min == pytest.approx(np.full(3, 1.331), rel=1e-10)


def test_bodies_far_from_the_origin_keep_their_digits() -> None:
    points, cells = make_hexahedra(3)
    for array in (make_array(12, cells), make_polyhedra(cells)):
        near, far = CellMesh(points, array, 3), CellMesh(points + 1e6, array, 3)
        assert far.rest_volumes == pytest.approx(near.rest_volumes, rel=1e-8)
        found = measure_cells(far, 1.1 * points + 1e6)
        assert found.ratio_min == pytest.approx(np.full(27, 1.331), rel=1e-7) and found.angles.max() < 1e-7


# VTK's own volumes

LINEAR = [(8, 4), (9, 4), (5, 3), (10, 4), (11, 8), (12, 8), (13, 6), (14, 5)]


def measure_by_vtk(points: np.ndarray, array: CellArray) -> np.ndarray:
    """Areas or volumes of cells by vtkCellSizeFilter."""
    grid, cells = vtk.vtkUnstructuredGrid(), vtk.vtkCellArray()
    stored = vtk.vtkPoints()
    stored.SetData(numpy_to_vtk(np.pad(points, [(0, 0), (0, 3 - points.shape[1])]), deep=True))
    grid.SetPoints(stored)
    kinds = numpy_to_vtk(array.types, deep=True, array_type=vtk.VTK_UNSIGNED_CHAR)
    offsets, connectivity = (numpy_to_vtk(a.astype(np.int64), deep=True, array_type=vtk.VTK_ID_TYPE)
                             for a in (array.offsets, array.connectivity))  # fmt: skip
    cells.SetData(offsets, connectivity)
    grid.SetCells(kinds, cells)
    size = vtk.vtkCellSizeFilter()
    size.SetInputData(grid)
    size.Update()
    name = {2: "Area", 3: "Volume"}[TYPES[int(array.types[0])].dimension]
    return vtk_to_numpy(size.GetOutput().GetCellData().GetArray(name))


@pytest.mark.parametrize(("number", "count"), LINEAR, ids=list_ids(LINEAR))
def test_volumes_of_linear_cells_with_flat_faces_are_those_of_vtk(number: int, count: int) -> None:
    points, array = make_cells(number, count, m=1, noise=0)
    if number not in (8, 11):  # pixels and voxels are boxes; a projective map keeps faces flat
        points = points / (1 + 0.3 * points[:, :1] + 0.2 * points[:, -1:])
    assert np.abs(measure_by_vtk(points, array)) == pytest.approx(
        measure_volumes(points, array, points.shape[1]), rel=1e-12
    )


def test_vtk_takes_curved_cells_for_straight_pieces() -> None:
    """A sixth of a ring of one quadratic cell: the documented difference between VTK's volumes and the exact ones."""
    for number, count in ((24, 10), (25, 20), (29, 27), (72, 27), (26, 15), (23, 8), (22, 6)):
        X = place_nodes(find_kind(number, count))
        radius, turn, d = 1 + X[:, 0], np.pi / 3 * X[:, 1], X.shape[1]
        points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), *X[:, 2:].T])
        array = make_array(number, np.arange(count)[None])
        ours, theirs = measure_volumes(points, array, d)[0], abs(measure_by_vtk(points, array)[0])
        print(TYPES[number].name, count, f"VTK's volume is {theirs / ours - 1:+.1%} of ours")
        assert 0.005 < abs(theirs / ours - 1) < 0.1
        if TYPES[number].name.endswith(("hexahedron", "quad")):
            assert ours == pytest.approx(np.pi / 2, rel=0.003)


def test_nothing_but_the_outputs_is_allocated_per_frame() -> None:
    import tracemalloc

    points, cells = make_hexahedra(24)
    mesh = CellMesh(points, make_array(12, cells), 3)
    measure_any_cells(mesh, points)
    tracemalloc.start()
    outputs = measure_any_cells(mesh, points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # the lanes of a kernel have room for the largest kind (96 kB), whatever the mesh; another output has 111 kB
    assert peak < 4 * outputs[0].nbytes + 150_000


def test_meshes_of_simplices_are_still_theirs() -> None:
    plain = box([1.0, 2.0, 1.5], [2, 2, 2])
    assert isinstance(plain, Mesh)
    plain = Mesh(plain.points + 0.05 * np.random.default_rng(2).normal(size=plain.points.shape), plain.cells)
    mesh = CellMesh(plain.points, plain.cell_array, 3)
    x = plain.points + 0.1 * np.random.default_rng(1).normal(size=plain.points.shape)
    for ours, theirs in zip(measure_cells(mesh, x), measure_cells(plain, x), strict=True):
        assert np.array_equal(ours, theirs)
    assert mesh.centers == pytest.approx(plain.centers) and mesh.size == plain.size
    assert mesh.node_volumes == pytest.approx(plain.node_volumes, rel=1e-13)


@pytest.mark.filterwarnings("error")
def test_damaged_cells_are_refused_or_measured_without_a_warning() -> None:
    """Faces and nodes exchanged at random, points that coincide, positions that are not finite."""
    rng, counts = np.random.default_rng(0), {"measured": 0, "refused": 0}
    start, cells = make_hexahedra(2)
    for n in range(240):
        points, array, d = start.copy(), make_polyhedra(cells), 3
        points[rng.integers(27)] = points[rng.integers(27)]
        if n % 3 == 0 and array.faces is not None:
            faces = [part.copy() for part in array.faces]
            part, last = faces[n % 9 // 3], (27, 193, 49)[n % 9 // 3]
            at = rng.integers(1, len(part) - 1)
            part[at] = rng.integers(last) if n % 9 == 0 else part[at] + rng.integers(-1, 2)
            array = array._replace(faces=PolyhedronFaces(*faces))
        elif n % 3 == 1:
            number, count = KINDS[rng.integers(len(KINDS))]
            (points, array), d = make_cells(number, count, m=5), TYPES[number].dimension
            connectivity = array.connectivity.copy()
            connectivity[rng.integers(len(connectivity), size=3)] = rng.integers(len(points), size=3)
            array = array._replace(connectivity=connectivity)
        try:
            mesh = CellMesh(points, array, d)
        except MeshError:
            counts["refused"] += 1
            continue
        x = mesh.points + 0.1 * rng.normal(size=mesh.points.shape)
        x[rng.integers(len(x))] = rng.choice([np.nan, np.inf, 1.0])
        found = measure_cells(mesh, x)
        known = ~np.isnan(found.volumes)
        assert (found.ratio_min[known] <= found.ratio_max[known]).all()
        assert mesh.node_volumes.sum() == pytest.approx(mesh.rest_volumes.sum(), rel=1e-9)
        counts["measured"] += 1
    assert min(counts.values()) > 30
