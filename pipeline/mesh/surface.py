"""The boundary of a simplex mesh of order 1 or 2: the faces that belong to only one cell."""

from functools import cache

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.node_order import SIMPLEX_EDGES
from pipeline.mesh.quadrature import find_quadrature
from pipeline.mesh.shape_functions import make_kind

# the face opposite vertex a, ordered so that its normal points out of a positively oriented cell
_OUTWARD = {2: np.array([[1, 2], [2, 0], [0, 1]]), 3: np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])}


def find_boundary_faces(mesh: ElementMesh) -> tuple[Ints, Ints]:
    """Return the boundary faces (f, k), oriented outward, and the cell of each (f,).

    The d corners come first; the nodes of its sides follow if the order is 2, as in VTK's quadratic edge and triangle.
    """
    d, n = mesh.dimension, len(mesh.points)
    faces = mesh.cells[:, _OUTWARD[d]].reshape(-1, d)
    nodes = np.sort(faces, axis=1)
    order = np.lexsort((nodes[:, -1], nodes[:, 0] * n + nodes[:, -2]))  # five times as fast as np.unique of rows
    differs = np.ones(len(order) + 1, dtype=bool)
    differs[1:-1] = (np.diff(nodes[order], axis=0) != 0).any(axis=1)
    chosen = np.sort(order[differs[1:] & differs[:-1]])  # faces that differ from both neighbors in that order
    cells = chosen // (d + 1)
    if mesh.order == 1:
        return faces[chosen], cells
    local = _list_face_nodes(d)[chosen % (d + 1)]
    return np.take_along_axis(mesh.cells[cells], local, axis=1), cells


@cache
def _list_face_nodes(d: int) -> Ints:
    """Return the nodes (d + 1, k) of the faces of a quadratic simplex, corners first."""
    sides = {frozenset(ends): d + 1 + i for i, ends in enumerate(SIMPLEX_EDGES[d].tolist())}
    own = [(0, 1)] if d == 2 else SIMPLEX_EDGES[2].tolist()
    rows = [[*face, *(sides[frozenset((face[a], face[b]))] for a, b in own)] for face in _OUTWARD[d].tolist()]
    return np.array(rows)


def outward_areas(points: Floats, faces: Ints) -> Floats:
    """Return n A of every linear face (f, d): its outward normal times its area [m2; m in the plane]."""
    corners = points[faces]
    side = corners[:, 1] - corners[:, 0]
    if faces.shape[1] == 2:
        return np.stack([side[:, 1], -side[:, 0]], axis=-1)
    return np.asarray(np.cross(side, corners[:, 2] - corners[:, 0]) / 2)


def integrate_normals(points: Floats, faces: Ints, factor: float = 1.0) -> Floats:
    """Return factor * int N_a n dA (f, k, d) of faces (f, k) of order 1 or 2, exact for curved ones too."""
    k, d = faces.shape[1], points.shape[1]
    if k == d:
        return np.repeat((factor * outward_areas(points, faces) / d)[:, None], k, axis=1)
    if d == 2:
        at, weights = np.polynomial.legendre.leggauss(3)
        at, weights = (at + 1) / 2, weights / 2
    else:
        at, weights = find_quadrature(make_kind("triangle 2"), "nodes")
    N, normals = _find_normals(points, faces, at)
    return factor * np.einsum("qa,q,fqc->fac", N, weights, normals)


def integrate_areas(points: Floats, faces: Ints) -> Floats:
    """Return int N_a dA (f, k) of faces (f, k) of order 1 or 2: exact if they are flat, with straight sides.

    The area of a curved face has no closed form: a rule of degree 11 is used, with 36 points (6 in the plane).
    """
    k, d = faces.shape[1], points.shape[1]
    if k == d:
        areas = np.linalg.norm(outward_areas(points, faces), axis=1)
        return np.repeat((areas / d)[:, None], k, axis=1)
    at, weights = np.polynomial.legendre.leggauss(6)
    at, weights = (at + 1) / 2, weights / 2
    if d == 3:  # a square, of which one side shrinks to a corner
        first, second = np.repeat(at, 6), np.tile(at, 6)
        weights = np.repeat(weights, 6) * np.tile(weights, 6) * (1 - first)
        at = np.stack([first, second * (1 - first)], axis=1)
    N, normals = _find_normals(points, faces, at)
    return np.einsum("qa,q,fq->fa", N, weights, np.linalg.norm(normals, axis=-1))


def _find_normals(points: Floats, faces: Ints, at: Floats) -> tuple[Floats, Floats]:
    """Return N (q, k) and n dA/d(r, s) (f, q, d) of quadratic faces at natural coordinates."""
    if points.shape[1] == 2:
        N = np.stack([(1 - at) * (1 - 2 * at), at * (2 * at - 1), 4 * at * (1 - at)], axis=1)
        slopes = np.stack([4 * at - 3, 4 * at - 1, 4 - 8 * at], axis=1)
        tangent = np.einsum("qa,fac->fqc", slopes, points[faces])
        return N, np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    kind = make_kind("triangle 2")
    first, second = np.einsum("qaj,fac->jfqc", kind.differentiate(at), points[faces])
    return kind.evaluate(at), np.cross(first, second)


def measure_distance(mesh: ElementMesh, point: Floats) -> float:
    """Return the distance of a point (d,) from the boundary [m]; curved faces count as those of their corners."""
    faces, _ = find_boundary_faces(mesh)
    corners = mesh.points[faces[:, : mesh.dimension]]
    distance = np.inf
    for a, b in [(0, 1)] if mesh.dimension == 2 else [(0, 1), (1, 2), (2, 0)]:
        side, arm = corners[:, b] - corners[:, a], point - corners[:, a]
        part = np.clip((side * arm).sum(axis=1) / (side**2).sum(axis=1), 0, 1)
        distance = min(distance, float(np.linalg.norm(arm - part[:, None] * side, axis=1).min()))
    if mesh.dimension == 3:
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        sides, arms = np.roll(corners, -1, axis=1) - corners, point - corners
        inside = (np.einsum("fac,fc->fa", np.cross(sides, arms), normals) >= 0).all(axis=1)
        heights = np.abs((arms[:, 0] * normals).sum(axis=1))[inside]
        distance = min(distance, float(heights.min(initial=np.inf)))
    return distance
