"""Meshes of order 2: volumes, faces, masses and errors, straight and curved."""

import itertools
import math

import numpy as np
import pytest

from pipeline.errors import MeshError
from pipeline.mesh.cell_mesh import measure_volumes
from pipeline.mesh.quadratic import QuadraticMesh, make_quadratic_mesh, raise_order
from pipeline.mesh.quadrature import find_stress_quadrature
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.skin import find_skin
from pipeline.mesh.surface import find_boundary_faces, integrate_normals
from tests.bodies import BOXES, QUADRATIC, make_rotation

MESHES = pytest.mark.parametrize("mesh", QUADRATIC.values(), ids=QUADRATIC)
RNG = np.random.default_rng(17)


@pytest.mark.parametrize("plain", BOXES.values(), ids=BOXES)
def test_raising_the_order_keeps_nodes_cells_and_volumes(plain) -> None:
    mesh = raise_order(plain)
    n, k = plain.points.shape[0], plain.dimension + 1
    assert np.array_equal(mesh.points[:n], plain.points) and np.array_equal(mesh.cells[:, :k], plain.cells)
    assert mesh.order == 2 and mesh.is_straight and len(np.unique(mesh.cells)) == len(mesh.points)
    assert len(np.unique(mesh.points.round(12), axis=0)) == len(mesh.points)  # one node per side
    assert mesh.rest_volumes == pytest.approx(plain.rest_volumes, rel=1e-13)
    assert mesh.integration.weights.sum(axis=1) == pytest.approx(plain.rest_volumes, rel=1e-13)


@MESHES
def test_integrals_of_gradients_are_those_of_normals_over_the_boundary(mesh: QuadraticMesh) -> None:
    """int grad N_a dV = int N_a n dA, node by node: both quadratures are exact, also for curved cells and faces."""
    weights, gradients = mesh.integration
    inside, outside = np.zeros_like(mesh.points), np.zeros_like(mesh.points)
    np.add.at(inside, mesh.cells, np.einsum("eq,eqad->ead", weights, gradients))
    faces, _ = find_boundary_faces(mesh)
    np.add.at(outside, faces, integrate_normals(mesh.points, faces))
    assert np.abs(outside).max() > 0.1
    np.testing.assert_allclose(inside, outside, atol=1e-13)
    # the volume by the divergence theorem: int x . n dA = d V
    assert (outside * mesh.points).sum() == pytest.approx(mesh.dimension * mesh.rest_volumes.sum(), rel=1e-12)


@MESHES
def test_volumes_of_moved_cells_are_exact(mesh: QuadraticMesh) -> None:
    """By the divergence theorem over the boundary of all cells, under a quadratic map and random nodes."""
    for x in (mesh.points + 0.05 * RNG.normal(size=mesh.points.shape), mesh.points**2 + mesh.points):
        faces, _ = find_boundary_faces(mesh)
        outward = np.zeros_like(x)
        np.add.at(outward, faces, integrate_normals(x, faces))
        volume = (outward * x).sum() / mesh.dimension
        found = measure_volumes(x, mesh.cell_array, mesh.dimension)
        assert found.sum() == pytest.approx(volume, rel=1e-12)


@MESHES
def test_masses_are_positive_and_have_the_weight_and_the_moments_of_the_body(mesh: QuadraticMesh) -> None:
    V, N = mesh.rest_volumes, mesh.shape_products
    assert N.sum(axis=(1, 2)) == pytest.approx(V, rel=1e-13)
    assert (np.linalg.eigvalsh(N) > 0).all()
    shares = mesh.lumped_shares
    assert (shares > 0).all() and shares.sum(axis=1) == pytest.approx(V, rel=1e-13)
    assert mesh.lumped_volumes.sum() == pytest.approx(V.sum(), rel=1e-13)
    # int N_a dV, which loads use, is the row sum; it is negative at corners of straight tetrahedra
    assert mesh.node_volumes == pytest.approx(np.bincount(mesh.cells.ravel(), N.sum(axis=2).ravel()), abs=1e-13)
    first = mesh.node_volumes @ mesh.points
    assert np.bincount(mesh.cells.ravel(), N.sum(axis=2).ravel()) @ mesh.points == pytest.approx(first, rel=1e-12)
    if mesh.is_straight:
        center = np.einsum("e,ed->d", V, mesh.points[mesh.cells[:, : mesh.dimension + 1]].mean(axis=1))
        assert first == pytest.approx(center, rel=1e-12)
        assert mesh.lumped_volumes @ mesh.points == pytest.approx(center, rel=1e-12)


def test_products_of_shape_functions_are_those_of_the_literature() -> None:
    """A straight tetrahedron: V/420 times 6 at corners, 32 on sides; HRZ shares 1/36 and 4/27; a triangle: V/180."""
    tetrahedron = make_quadratic_mesh(*make_one_cell(3))
    V, N = tetrahedron.rest_volumes[0], tetrahedron.shape_products[0]
    assert np.diag(N) * 420 / V == pytest.approx([6] * 4 + [32] * 6, rel=1e-12)
    assert N[0, 1] * 420 / V == pytest.approx(1, rel=1e-12) and N[0, 4] * 420 / V == pytest.approx(-4, rel=1e-12)
    assert N[0, 5] * 420 / V == pytest.approx(-6, rel=1e-12)  # the side opposite
    assert tetrahedron.lumped_shares[0] / V == pytest.approx([1 / 36] * 4 + [4 / 27] * 6, rel=1e-12)
    assert tetrahedron.node_volumes / V == pytest.approx([-1 / 20] * 4 + [1 / 5] * 6, rel=1e-12)
    triangle = make_quadratic_mesh(*make_one_cell(2))
    A, N = triangle.rest_volumes[0], triangle.shape_products[0]
    assert np.diag(N) * 180 / A == pytest.approx([6] * 3 + [32] * 3, rel=1e-12)
    assert triangle.lumped_shares[0] / A == pytest.approx([1 / 19] * 3 + [16 / 57] * 3, rel=1e-12)


def make_one_cell(d: int) -> tuple[np.ndarray, np.ndarray]:
    """The nodes of a cell in VTK's order, written out again."""
    corners = np.vstack([np.zeros(d), np.eye(d)]) @ make_rotation(d, [1, 2, 3], 1.0) * 1.7
    sides = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)][: 3 if d == 2 else 6]
    points = np.concatenate([corners, [(corners[a] + corners[b]) / 2 for a, b in sides]])
    return points, np.arange(len(points))[None]


@MESHES
def test_the_boundary_has_the_faces_of_the_corners_with_the_nodes_between_them(mesh: QuadraticMesh) -> None:
    faces, owners = find_boundary_faces(mesh)
    d = mesh.dimension
    plain = BOXES["tetrahedra" if d == 3 else "triangles"]
    wanted, behind = find_boundary_faces(plain)
    assert np.array_equal(faces[:, :d], wanted) and np.array_equal(owners, behind)
    straight = QUADRATIC["tetrahedra" if d == 3 else "triangles"].points
    pairs = [(0, 1)] if d == 2 else [(0, 1), (1, 2), (2, 0)]
    for node, (a, b) in enumerate(pairs, start=d):
        assert np.abs(straight[faces[:, node]] - (straight[faces[:, a]] + straight[faces[:, b]]) / 2).max() < 1e-15


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("share", [0.2, 1e-3, -0.3])
def test_a_folded_cell_is_refused_in_one_line(d: int, share: float) -> None:
    """A node nearer to an end than a quarter of its side folds the corner, where no point of stress may see it."""
    mesh = raise_order(rectangle([1.0, 1.0], [1, 1]) if d == 2 else box([1.0] * 3, [1] * 3))
    points = mesh.points.copy()
    a, b = points[mesh.cells[0, :2]]
    points[mesh.cells[0, d + 1]] = a + share * (b - a)
    with pytest.raises(MeshError, match=r"curved cells are folded, first \d+; move .* mesh\.order = 1") as caught:
        make_quadratic_mesh(points, mesh.cells)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("d", [2, 3])
def test_rules_for_stresses_are_exact_and_do_not_depend_on_the_order_of_corners(d: int) -> None:
    """Monomials of barycentric coordinates: int prod b_i^n_i = prod n_i! d! / (sum n_i + d)! of the volume."""
    for is_straight in (True, False):
        rule = find_stress_quadrature(d, is_straight=is_straight)
        b = np.column_stack([1 - rule.points.sum(axis=1), rule.points])
        assert (b > 0).all() and (rule.weights > 0).all()
        for powers in itertools.product(range(4), repeat=d + 1):
            if sum(powers) <= (2 if is_straight or d == 2 else 3):
                wanted = math.prod(map(math.factorial, powers)) / math.factorial(sum(powers) + d)
                assert rule.weights @ (b**powers).prod(axis=1) == pytest.approx(wanted, rel=1e-13)
        for order in itertools.permutations(range(d + 1)):
            assert np.abs(b[:, None, order] - b).max(axis=2).min(axis=1).max() < 1e-15


@pytest.mark.parametrize("d", [2, 3])
def test_inverted_cells_and_wrong_shapes_are_refused(d: int) -> None:
    points, cells = make_one_cell(d)
    with pytest.raises(MeshError):
        make_quadratic_mesh(points * ([-1.0] + [1.0] * (d - 1)), cells)
    with pytest.raises(MeshError, match="are not a mesh of quadratic simplices"):
        make_quadratic_mesh(points, cells[:, :-1])


@MESHES
def test_the_skin_of_a_bent_body_lies_on_its_curved_faces(mesh: QuadraticMesh) -> None:
    """Sides become lines of six parts; under a quadratic map all points of the skin of straight cells are exact."""
    skin = find_skin(mesh)
    n = len(find_boundary_faces(mesh)[0]) if mesh.dimension == 3 else len(mesh.cells)
    assert len(skin.triangles) == 36 * n
    rest = skin.place(mesh.points)
    if mesh.is_straight:
        bent = mesh.points + 0.1 * mesh.points[:, ::-1] ** 2
        np.testing.assert_allclose(skin.place(bent), rest + 0.1 * rest[:, ::-1] ** 2, atol=1e-13)
    sides = {
        frozenset(pair) for pair in itertools.chain(*(itertools.combinations(t, 2) for t in skin.triangles.tolist()))
    }
    assert all(frozenset(line) in sides for line in skin.lines.tolist())
