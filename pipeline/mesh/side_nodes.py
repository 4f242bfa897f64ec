"""The nodes in the sides of quadratic simplices, brought into VTK's order; programs number them differently."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.mesh.node_order import SIMPLEX_EDGES

_ROUNDING = 1e-9
CORNERS = {6: 3, 10: 4}  # by the number of nodes


def sort_side_nodes(points: Floats, cells: Ints) -> Ints:
    """Return quadratic simplices (e, 6 or 10) whose corners come first, with the nodes of sides in VTK's order.

    All cells are numbered alike: the order is the one whose nodes are nearest to the middles of their sides. Raises
    MeshError for a cell that another order fits better.
    """
    corners = CORNERS[cells.shape[1]]
    ends = points[cells[:, SIMPLEX_EDGES[corners - 1]]]
    middles, nodes = ends.mean(axis=2), points[cells[:, corners:]]
    with np.errstate(all="ignore"):  # points that are not finite are refused elsewhere
        apart = np.linalg.norm(nodes[:, :, None] - middles[:, None], axis=3)  # (e, node, side)
        size = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).max(axis=1)
        cost = (apart / size[:, None, None]).sum(axis=0)
    if not np.isfinite(cost).all():
        return cells
    node, side = linear_sum_assignment(cost)
    order = node[np.argsort(side)]
    _check_sides(apart[:, order])
    return np.concatenate([cells[:, :corners], cells[:, corners + order]], axis=1)


def _check_sides(apart: Floats) -> None:
    """Raise MeshError for a cell two of whose nodes fit each other's sides better; distances (e, node, side)."""
    own = np.einsum("ess->es", apart)
    swapped = apart + np.swapaxes(apart, 1, 2)
    lost = np.flatnonzero((swapped < (1 - _ROUNDING) * (own[:, :, None] + own[:, None])).any(axis=(1, 2)))
    if lost.size:
        raise MeshError(
            f"{lost.size} quadratic cells have nodes that fit each other's sides better, first {lost[0]}: their nodes "
            "are numbered in no common order, or they are folded; take mesh.order = 1, or mesh them again"
        )


def turn_cells(cells: Ints, corners: Ints) -> Ints:
    """Return quadratic cells (e, k) with their corners in another order (e, d + 1), and their sides accordingly."""
    d = corners.shape[1] - 1
    places = (corners[:, :, None] == cells[:, None, : d + 1]).argmax(axis=2)
    number = np.zeros((d + 1, d + 1), dtype=np.int64)  # of the side between two corners
    a, b = SIMPLEX_EDGES[d].T
    number[a, b] = number[b, a] = d + 1 + np.arange(len(a))
    sides = number[places[:, a], places[:, b]]
    return np.concatenate([corners, np.take_along_axis(cells, sides, axis=1)], axis=1)
