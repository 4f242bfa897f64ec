r"""The natural coordinates xi of a point in a cell: x(xi) = sum_a N_a(xi) x_a is solved by Newton's method.

For linear simplices one step is exact. On surfaces x(xi) - p is made orthogonal to the surface (Gauss and Newton).
"""

import numpy as np

from pipeline.arrays import Floats
from pipeline.mesh.shape_functions import CellKind

_ITERATIONS = 30
_CONVERGED = 1e-11  # of natural coordinates: the step after the last one would be the square of that
_BEYOND = 1.0  # natural coordinates from -1 to 2: polynomials of high order explode farther out
_DAMPING = 1e-14  # of the largest diagonal entry: at the top of a pyramid two directions are undetermined
_ACCEPTED = 1e-8  # of the cell's size: a root, not a minimum of the distance


def invert_map(kind: CellKind, nodes: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Return weights (q, k), depth and distance of points (q, d) in cells of one kind with these nodes (q, k, d).

    See LocatedPairs. The depth is -inf if no natural coordinates were found: the point is far outside.
    """
    size = np.linalg.norm(np.ptp(nodes, axis=1), axis=1)
    xi, depth = np.empty((len(points), kind.dimension)), np.full(len(points), -np.inf)
    distance = np.full(len(points), np.inf)
    center, left = kind.nodes[kind.corners].mean(axis=0), np.arange(len(points))
    for start in ("center", "nearest node"):
        first = np.tile(center, (len(left), 1))
        if start == "nearest node":  # pulled inside: the map is singular at some nodes
            nearest = ((nodes[left] - points[left, None]) ** 2).sum(axis=2).argmin(axis=1)
            first += 0.8 * (kind.nodes[nearest] - first)
        xi[left], converged = _iterate(kind, nodes[left], points[left], first)
        gap = points[left] - np.einsum("qk,qkd->qd", kind.evaluate(xi[left]), nodes[left])
        distance[left] = np.linalg.norm(gap, axis=1) / size[left]
        if nodes.shape[2] == kind.dimension:
            converged &= distance[left] < _ACCEPTED
        depth[left[converged]] = _measure_depth(kind, xi[left[converged]])
        left = left[~converged]
        if not left.size or kind.is_linear_simplex:
            break
    if nodes.shape[2] == kind.dimension:
        distance[:] = 0
    return kind.evaluate(xi), depth, distance


def _iterate(kind: CellKind, nodes: Floats, points: Floats, start: Floats) -> tuple[Floats, np.ndarray]:
    """Return the natural coordinates (q, dimension) after Newton's method, and whether it converged (q,)."""
    xi, active = start.copy(), np.arange(len(points))
    converged = np.zeros(len(points), dtype=np.bool_)
    for _ in range(_ITERATIONS):
        gap = points[active] - np.einsum("qk,qkd->qd", kind.evaluate(xi[active]), nodes[active])
        J = np.einsum("qkd,qke->qde", nodes[active], kind.differentiate(xi[active]))
        normal = np.einsum("qde,qdf->qef", J, J)
        largest = np.einsum("qee->qe", normal).max(axis=1)
        normal += (_DAMPING * largest + np.finfo(float).tiny)[:, None, None] * np.eye(kind.dimension)
        step = np.linalg.solve(normal, np.einsum("qde,qd->qe", J, gap)[:, :, None])[:, :, 0]
        moved = np.clip(xi[active] + step, -_BEYOND, 1 + _BEYOND)
        change = np.abs(moved - xi[active]).max(axis=1)
        xi[active] = moved
        done = change < _CONVERGED
        converged[active[done]] = True
        active = active[~done]
        if not active.size:
            break
    return xi, converged


def _measure_depth(kind: CellKind, xi: Floats) -> Floats:
    """Return the distance from the nearest face in natural coordinates (q,), negative outside."""
    if kind.shape in ("triangle", "tetrahedron"):
        return np.minimum(xi.min(axis=1), 1 - xi.sum(axis=1))
    if kind.shape == "wedge":
        flat = np.minimum(xi[:, :2].min(axis=1), 1 - xi[:, :2].sum(axis=1))
        return np.minimum(flat, np.minimum(xi[:, 2], 1 - xi[:, 2]))
    sides = np.minimum(xi, 1 - xi)
    if kind.shape == "pyramid":  # its coordinates are collapsed: at the top the first two say nothing
        sides[:, :2] *= (1 - xi[:, 2:]).clip(0)
    return np.asarray(sides.min(axis=1))
