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
        N = np.stack([(1 - at) * (1 - 2 * at), at * (2 * at - 1), 4 * at * (1 - at)], axis=1)
        slopes = np.stack([4 * at - 3, 4 * at - 1, 4 - 8 * at], axis=1)
        tangent = np.einsum("qa,fac->fqc", slopes, points[faces])
        normals = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    else:
        kind = make_kind("triangle 2")
        at, weights = find_quadrature(kind, "nodes")
        N, derivatives = kind.evaluate(at), kind.differentiate(at)
        first, second = np.einsum("qaj,fac->jfqc", derivatives, points[faces])
        normals = np.cross(first, second)
    return factor * np.einsum("qa,q,fqc->fac", N, weights, normals)
