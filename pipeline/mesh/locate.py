"""The cell around a point of the body at rest, and the shares of its nodes in a field at that point."""

from collections.abc import Callable

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.candidates import iterate_candidates
from pipeline.mesh.simplex import Mesh

_ON_A_FACE = 1e-9  # of the body's size, and of natural coordinates: rounding can put surface points outside
# points and cells (pairs) -> how far inside (q,), negative outside, and the weights of the cells' nodes (q, k)
Locate = Callable[[Floats, Ints], tuple[Floats, Floats]]


def locate_points(mesh: BodyMesh, points: Floats) -> tuple[Ints, Floats]:
    """Return the cell (p,) around each rest point (p, d), and the weights (p, k) of the nodes of that cell.

    A field of nodes has the value sum_a weight_a field_a at the point, with the nodes in the order of the cell; k is
    the largest number of nodes of a cell, and weights beyond those of a cell are 0. Outside all cells, and at points
    that are not finite, the weights are NaN and the cell is 0. On a face, the cell that comes first is taken unless
    rounding favors another. Raises MeshError if the points have too few coordinates.
    """
    d = mesh.points.shape[1]
    if points.ndim != 2 or points.shape[1] < d:
        raise MeshError(f"points to locate are (p, {d}), not {points.shape}")
    points = np.asarray(points[:, :d], dtype=np.float64)
    locate, low, high = _prepare(mesh)
    cells = np.zeros(len(points), dtype=np.int64)
    weights = np.full((len(points), int(np.diff(mesh.cell_array.offsets).max())), np.nan)
    for where, near in iterate_candidates(low, high, points):
        depth, shares = locate(points[where], near)
        order = np.lexsort((near, -depth, where))
        first = order[np.unique(where[order], return_index=True)[1]]  # the deepest of each point
        best = first[depth[first] >= -_ON_A_FACE]
        cells[where[best]], weights[where[best]] = near[best], shares[best]
    return cells, weights


def _prepare(mesh: BodyMesh) -> tuple[Locate, Floats, Floats]:
    """Return the function that locates points in cells, and the boxes of the cells: lowest and highest corners."""
    slack = _ON_A_FACE * mesh.size
    if isinstance(mesh, Mesh):
        corners = mesh.points[mesh.cells]
        return _locate_in_simplices(mesh), corners.min(axis=1) - slack, corners.max(axis=1) + slack
    raise NotImplementedError


def _locate_in_simplices(mesh: Mesh) -> Locate:
    def locate(points: Floats, cells: Ints) -> tuple[Floats, Floats]:
        first = mesh.points[mesh.cells[cells, 0]]
        shares = np.einsum("qad,qd->qa", mesh.shape_gradients[cells], points - first)
        shares[:, 0] += 1
        return shares.min(axis=1), shares

    return locate
