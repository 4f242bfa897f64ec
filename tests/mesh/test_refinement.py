"""Red refinement: exact volumes, faces that meet, old nodes, parents, curved shapes, and shapes that stay good."""

import numpy as np
import pytest

from pipeline.errors import MeshError
from pipeline.mesh.quadratic import make_quadratic_mesh, raise_order
from pipeline.mesh.refinement import list_parents, refine_mesh
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh, measure_quality
from pipeline.mesh.surface import find_boundary_faces
from tests.bodies import BOXES

REGULAR = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
RNG = np.random.default_rng(3)
ORDERS = pytest.mark.parametrize("order", [1, 2])
MESHES = pytest.mark.parametrize("name", BOXES)


def make_mesh(name, order):
    return BOXES[name] if order == 1 else raise_order(BOXES[name])


def bend(X):
    """A smooth map of the boxes with a Jacobian of about one everywhere: cells become curved."""
    return X + 0.1 * np.sin(X[:, ::-1])


def find_corners(mesh):
    return mesh.cells[:, : mesh.dimension + 1]


@ORDERS
@MESHES
def test_children_fill_their_parents_and_meet_face_to_face(name, order):
    mesh = make_mesh(name, order)
    fine, d = refine_mesh(mesh), mesh.dimension
    assert type(fine) is type(mesh) and fine.order == order
    assert len(fine.cells) == 2**d * len(mesh.cells)
    assert np.array_equal(fine.points[: len(mesh.points)], mesh.points)
    volumes = fine.rest_volumes.reshape(-1, 2**d)
    assert np.allclose(volumes, mesh.rest_volumes[:, None] / 2**d, rtol=1e-13, atol=0)
    faces, _ = find_boundary_faces(fine)
    coarse, _ = find_boundary_faces(mesh)
    assert len(faces) == 2 ** (d - 1) * len(coarse)  # an inner face without its twin would count as boundary
    assert len(np.unique(fine.cells)) == len(fine.points)


@ORDERS
@MESHES
def test_the_parent_of_a_child_contains_its_center(name, order):
    mesh = make_mesh(name, order)
    fine = refine_mesh(mesh)
    parents = list_parents(len(fine.cells), mesh.dimension)
    corners = mesh.points[find_corners(mesh)[parents]]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    centers = fine.points[find_corners(fine)].mean(axis=1)
    weights = np.linalg.solve(edges, (centers - corners[:, 0])[:, :, None])[:, :, 0]
    assert (weights > 0.1).all() and (weights.sum(axis=1) < 0.9).all()


@pytest.mark.parametrize("count", [7, 12])
def test_a_number_that_is_no_multiple_has_no_parents(count):
    with pytest.raises(MeshError, match=f"{count} cells are not a refined mesh; a multiple of 8 is needed"):
        list_parents(count, 3)


@MESHES
def test_curved_cells_keep_their_shape(name):
    """Children are pieces of the parent's map: volumes sum exactly, and points of the parent are theirs."""
    straight = raise_order(BOXES[name])
    mesh = make_quadratic_mesh(bend(straight.points), straight.cells)
    assert not mesh.is_straight
    d, fine = mesh.dimension, refine_mesh(mesh)
    sums = fine.rest_volumes.reshape(-1, 2**d).sum(axis=1)
    assert np.allclose(sums, mesh.rest_volumes, rtol=1e-13, atol=0)
    # the map of a parent, evaluated at the nodes that its children have in the straight mesh
    flat = refine_mesh(straight)
    parents = np.repeat(np.arange(len(mesh.cells)), 2**d)
    for cell in range(0, len(mesh.cells), 5):
        nodes = np.unique(fine.cells[parents == cell])
        corners = straight.points[straight.cells[cell, : d + 1]]
        xi = np.linalg.solve((corners[1:] - corners[0]).T, (flat.points[nodes] - corners[0]).T).T
        wanted = mesh.kind.evaluate(xi) @ mesh.points[mesh.cells[cell]]
        assert np.abs(fine.points[nodes] - wanted).max() < 1e-14


def test_straight_cells_of_order_2_stay_straight_and_equal_the_promoted_children():
    mesh = BOXES["alternating"]
    fine, other = refine_mesh(raise_order(mesh)), refine_mesh(mesh)
    assert fine.is_straight
    assert np.array_equal(fine.points[find_corners(fine)], other.points[other.cells])


def refine_repeatedly(mesh, times):
    for _ in range(times):
        mesh = refine_mesh(mesh)
    return mesh


def test_triangles_keep_their_shape():
    fine = refine_repeatedly(rectangle((2.0, 1.0), (1, 1)), 4)
    assert measure_quality(fine) == pytest.approx(measure_quality(rectangle((2.0, 1.0), (1, 1)))[0], rel=1e-12)


def test_the_tetrahedra_of_a_cut_cube_keep_their_shape():
    """Along the right diagonal, the children of Kuhn's tetrahedra are Kuhn's tetrahedra of half the size."""
    mesh = box((1.0, 1.0, 1.0), (1, 1, 1))
    fine = refine_repeatedly(mesh, 3)
    assert measure_quality(fine) == pytest.approx(measure_quality(mesh)[0], rel=1e-12)


def test_a_regular_tetrahedron_has_children_of_one_other_shape():
    """Four are regular, four are quarters of an octahedron: quality 3 r / R with r = 3 V / A and R = 1."""
    mesh = Mesh(REGULAR, np.array([[0, 1, 2, 3]]))
    edge = np.sqrt(2.0)  # of the octahedron, whose corners have distance 1 from its center
    volume = edge**3 * np.sqrt(2) / 12
    area = edge**2 * (2 * np.sqrt(3) / 4 + 2 / 2)  # two outer triangles, two halves of squares
    quarter = 3 * (3 * volume / area) / 1.0
    quality = np.sort(measure_quality(refine_mesh(mesh)))
    assert quality[:4] == pytest.approx(quarter, rel=1e-12)
    assert quality[4:] == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("kind", ["random", "needles", "slivers"])
def test_no_number_of_refinements_makes_shapes_worse_than_the_first(kind):
    scale = {"random": [1, 1, 1], "needles": [1, 1, 8], "slivers": [1, 1, 0.05]}[kind]
    X = RNG.standard_normal((40, 4, 3)) * scale
    negative = np.linalg.det(X[:, 1:] - X[:, :1]) < 0
    X[negative] = X[negative][:, [1, 0, 2, 3]]
    first = mesh = Mesh(X.reshape(-1, 3), np.arange(160).reshape(40, 4))
    worst = []
    for _ in range(4):
        fine = refine_mesh(mesh)
        worst.append(measure_quality(fine).reshape(40, -1).min(axis=1))
        mesh = fine
    for later in worst[1:]:
        assert (later >= worst[0] * (1 - 1e-6)).all()
    once, several = refine_mesh(first), refine_mesh(first, 4)
    bound = measure_quality(once).reshape(40, -1).min(axis=1)
    for cell, values in enumerate(measure_quality(several).reshape(40, -1)):
        shapes = np.sort(values)[np.append(True, np.diff(np.sort(values)) > 1e-7 * values.max())]
        assert len(shapes) <= 3
        assert shapes[0] >= bound[cell] * (1 - 1e-6)


@ORDERS
def test_several_generations_at_once_keep_old_nodes_and_the_order_of_cells(order):
    mesh = make_mesh("alternating", order)
    fine, steps = refine_mesh(mesh, 2), refine_mesh(refine_mesh(mesh))
    assert len(fine.cells) == len(steps.cells) == 64 * len(mesh.cells)
    assert np.array_equal(fine.points[: len(mesh.points)], mesh.points)
    assert fine.rest_volumes.reshape(-1, 64).sum(axis=1) == pytest.approx(mesh.rest_volumes, rel=1e-13)


def test_the_nodes_of_a_side_are_the_same_in_all_cells_that_share_it():
    straight = raise_order(BOXES["tetrahedra"])
    fine = refine_mesh(refine_mesh(make_quadratic_mesh(bend(straight.points), straight.cells)))
    rounded = np.unique(np.round(fine.points, 9), axis=0)
    assert len(rounded) == len(fine.points)
