"""Nodal forces against closed forms: tractions on flat and curved faces, forces at points, loads that vary."""

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.fem.loads import VaryingLoad, normal_traction, point_force, vector_traction
from pipeline.mesh.locate import locate_points
from pipeline.mesh.quadratic import raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.surface import find_boundary_faces, integrate_areas, measure_distance
from tests.bodies import BOXES, QUADRATIC

MESHES = BOXES | {f"{name} of order 2": mesh for name, mesh in QUADRATIC.items()}
CURVED = [QUADRATIC["curved tetrahedra"], QUADRATIC["curved triangles"]]
MESH = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
FORCE = np.array([3.0, -2.0, 5.0])


def make_sphere(n: int, d: int, order: int = 2) -> SimpleNamespace:
    """The points and the boundary faces of a cube or square of 2 m, moved onto the ball of radius 1 m."""
    mesh = box((2.0,) * 3, (n,) * 3) if d == 3 else rectangle((2.0,) * 2, (n,) * 2)
    mesh = mesh if order == 1 else raise_order(mesh)
    faces, _ = find_boundary_faces(mesh)
    points = mesh.points - 1
    points[faces] /= np.linalg.norm(points[faces], axis=-1, keepdims=True)
    return SimpleNamespace(points=points, faces=faces)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
def test_the_area_of_a_sphere_and_the_thrust_on_half_of_it(d, order):
    """A pressure p on a closed surface has no resultant; on a half it is p times the area of the cut."""
    errors = []
    for n in (4, 8):
        ball = make_sphere(n, d, order)
        whole = normal_traction(ball, ball.faces, -7.0)
        assert np.abs(whole.sum(axis=0)).max() < 1e-13 * np.abs(whole).sum()
        upper = ball.faces[(ball.points[ball.faces][:, :, -1] > -1e-12).all(axis=1)]
        thrust = normal_traction(ball, upper, -7.0).sum(axis=0)
        assert np.abs(thrust[:-1]).max() < 1e-13 * np.abs(thrust).max()
        cut, area = (np.pi, 4 * np.pi) if d == 3 else (2.0, 2 * np.pi)
        pull = vector_traction(ball, ball.faces, FORCE[:d]).sum(axis=0)
        errors.append([thrust[-1] / (-7.0 * cut) - 1, *(pull / (FORCE[:d] * area) - 1)])
    coarse, fine = np.abs(errors)
    if d == 2:
        assert (coarse[0], fine[0]) == pytest.approx((0.0, 0.0), abs=1e-14)  # the ends of the cut are nodes
        coarse, fine = coarse[1:], fine[1:]
    assert (fine < (0.05 if order == 1 else 5e-4)).all()
    assert (
        coarse / fine > (3 if order == 1 else 8)
    ).all()  # orders 2 and 4 in the size of faces, 3 at the cube's corners


@MESH
def test_a_vector_traction_has_the_resultant_of_its_surface(mesh):
    X, d = mesh.points, mesh.dimension
    faces, _ = find_boundary_faces(mesh)
    total, shares = vector_traction(mesh, faces, FORCE[:d]), integrate_areas(X, faces)
    assert total.sum(axis=0) == pytest.approx(FORCE[:d] * shares.sum(), rel=1e-13)
    area = 2 * (2 * 3 + 3 * 1 + 1 * 2) if d == 3 else 2 * (2 + 3)
    assert np.isclose(shares.sum(), area, rtol=1e-12) == (mesh not in CURVED)
    if mesh.order == 2 and mesh not in CURVED:  # corners get nothing of a flat triangle, a sixth of a straight edge
        part = 0.0 if d == 3 else 1 / 6
        assert np.abs(shares[:, :d] - part * shares.sum(axis=1, keepdims=True)).max() < 1e-15


@pytest.mark.parametrize("mesh", [mesh for mesh in MESHES.values() if mesh not in CURVED], ids=repr)
def test_a_vector_along_the_normal_is_a_normal_traction_on_flat_faces(mesh):
    faces, _ = find_boundary_faces(mesh)
    axis = mesh.dimension - 1
    end = faces[(mesh.points[faces][:, :, axis] == mesh.points[:, axis].max()).all(axis=1)]
    along = np.zeros(mesh.dimension)
    along[axis] = 4.0
    assert vector_traction(mesh, end, along) == pytest.approx(normal_traction(mesh, end, 4.0), abs=1e-13)


@MESH
def test_a_force_at_a_point_has_its_resultant_and_its_moment(mesh):
    rng, X, d = np.random.default_rng(0), mesh.points, mesh.dimension
    low, high = X.min(axis=0), X.max(axis=0)
    points = low + (0.1 + 0.8 * rng.random((20, d))) * (high - low)
    cells, weights = locate_points(mesh, points)
    for point, cell, shares in zip(points, cells, weights, strict=True):
        f = point_force(mesh, int(cell), shares, FORCE[:d])
        assert f.sum(axis=0) == pytest.approx(FORCE[:d], rel=1e-9)
        # the moment of all nodal forces, as the tensor of arm and force
        assert X.T @ f == pytest.approx(np.outer(point, FORCE[:d]), abs=1e-8)
        assert np.count_nonzero(np.abs(f).sum(axis=1)) <= mesh.cells.shape[1]


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ([1.0, 1.5, 1.5], 0.5),
        ([3.0, 1.0, 0.5], 1.0),
        ([-3.0, 1.0, -4.0], 5.0),
        ([5.0, 7.0, 1.0], 5.0),
        ([1.0, 1.0, 0.4], 0.4),
    ],
)
def test_the_distance_of_a_point_from_the_boundary(point, distance):
    assert measure_distance(BOXES["tetrahedra"], np.array(point)) == pytest.approx(distance, rel=1e-13)
    assert measure_distance(QUADRATIC["tetrahedra"], np.array(point)) == pytest.approx(distance, rel=1e-13)
    if point[2] == 1.0:
        assert measure_distance(BOXES["triangles"], np.array(point[:2])) == pytest.approx(distance, rel=1e-13)


def test_a_varying_load_is_evaluated_once_for_a_time():
    asked = []

    def factor(time):
        asked.append(time)
        return 2.0 * time

    f = np.array([[1.0, 2.0], [0.0, -1.0]])
    load = VaryingLoad([(factor, f), (lambda time: 1.0, f)], [lambda time: np.full((2, 2), time)])
    for time in (0.0, 0.1, 0.0, 0.1, 0.1, 0.2, 0.1):
        assert np.array_equal(load(time), 2 * time * f + f + time)
    assert asked == [0.0, 0.1, 0.2]
    first = load(0.1)
    before = first.copy()
    load(0.7)
    assert np.array_equal(first, before)  # an array that was returned does not change
