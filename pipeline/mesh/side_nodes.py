"""The nodes on the sides of quadratic simplices from files and arrays: which side each of them lies on.

Programs number them in different orders, the same in all cells of a file. Their places decide it: of all orders, the
one with the smallest sum of distances to the middles of sides. Cells that it does not fit are refused.
"""

from collections.abc import Iterator

import numpy as np
from scipy.optimize import linear_sum_assignment

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.mesh.node_order import SIMPLEX_DEGREES, SIMPLEX_EDGES

_CLEARLY = 0.1  # of a cell's longest side: opposite sides of flat cells may lie closer to each other
_ROUNDING = 1e-9  # relative: an order that is better by no more than this does not replace the given one
_REMEDY = "write the nodes of all cells in one order, or take mesh.order = 1"


def arrange_sides(points: Floats, cells: Ints) -> tuple[Ints, list[str]]:
    """Return cells (e, 6 or 10) with the nodes of sides in the order of SIMPLEX_EDGES, and notes on the change.

    Raises MeshError for a node that lies near another side, or far away, and for neighbors with different nodes on a
    common side. All node numbers must exist.
    """
    _, d = SIMPLEX_DEGREES[cells.shape[1]]
    order = find_side_order(points, cells)
    arranged = np.concatenate([cells[:, : d + 1], cells[:, d + 1 + order]], axis=1)
    _check_places(points, arranged)
    _check_neighbors(arranged)
    if (order == np.arange(len(order))).all():
        return arranged, []
    numbers = " ".join(str(d + 1 + k) for k in order.tolist())
    return arranged, [f"nodes on sides were put in VTK's order by their places: {numbers} (counted from 0)"]


def find_side_order(points: Floats, cells: Ints) -> Ints:
    """Return which node on a side (s,) of every cell belongs to each of SIMPLEX_EDGES; all node numbers must exist.

    Cells whose points are not finite are left out.
    """
    cells = cells[np.isfinite(points[cells]).all(axis=(1, 2))]
    cost = np.array([distances.sum(axis=0) for distances in _measure_distances(points, cells)])
    if not np.isfinite(cost).all():
        return np.arange(len(cost))
    _, order = linear_sum_assignment(cost)
    is_best = np.trace(cost) <= (1 + _ROUNDING) * cost[np.arange(len(cost)), order].sum()
    return np.arange(len(cost)) if is_best else np.asarray(order, dtype=np.int64)


def measure_bend(points: Floats, cells: Ints) -> float:
    """Return the largest distance of a node from the middle of its side, as a share of the side's length."""
    _, d = SIMPLEX_DEGREES[cells.shape[1]]
    order = find_side_order(points, cells)
    bend = 0.0
    for (a, b), node in zip(SIMPLEX_EDGES[d].tolist(), (d + 1 + order).tolist(), strict=True):
        ends, middle = points[cells[:, [a, b]]], points[cells[:, node]]
        with np.errstate(all="ignore"):  # sides of length zero are refused elsewhere
            length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
            share = np.linalg.norm(middle - ends.mean(axis=1), axis=1) / length
        bend = max(bend, float(share[np.isfinite(share)].max(initial=0.0)))
    return bend


def _measure_distances(points: Floats, cells: Ints) -> Iterator[Floats]:
    """Yield for each side the distances (e, s) of all nodes on sides to its middle, as shares of the longest side."""
    _, d = SIMPLEX_DEGREES[cells.shape[1]]
    ends, nodes = points[cells[:, SIMPLEX_EDGES[d]]], points[cells[:, d + 1 :]]
    with np.errstate(all="ignore"):  # points that are too far away are refused elsewhere
        longest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).max(axis=1)
    longest[longest == 0] = 1.0  # cells without size are refused elsewhere
    for side in range(ends.shape[1]):
        with np.errstate(all="ignore"):
            distances = np.linalg.norm(nodes - ends[:, side].mean(axis=1)[:, None], axis=2) / longest[:, None]
        yield distances


def _check_places(points: Floats, cells: Ints) -> None:
    """Raise MeshError if a node lies clearly nearer to another side, or farther away than its cell is long."""
    _, d = SIMPLEX_DEGREES[cells.shape[1]]
    shape = len(cells), cells.shape[1] - d - 1
    own, nearest = np.empty(shape), np.full(shape, np.inf)
    for side, distances in enumerate(_measure_distances(points, cells)):
        own[:, side] = distances[:, side]
        distances[:, side] = np.inf
        nearest = np.minimum(nearest, distances)
    for bad, text in ((own > 1, "farther away than it is long"), (own > nearest + _CLEARLY, "nearer to another one")):
        wrong = np.flatnonzero(bad.any(axis=1))
        if wrong.size:
            c = int(wrong[0])
            side = int(bad[c].argmax())
            a, b = cells[c, SIMPLEX_EDGES[d][side]].tolist()
            raise MeshError(
                f"{wrong.size} cells have a node that does not lie on its side, but {text}; first cell {c}: node "
                f"{cells[c, d + 1 + side]} on the side from {a} to {b} (counted from 0); {_REMEDY}"
            )


def _check_neighbors(cells: Ints) -> None:
    """Raise MeshError unless every side has one node in all cells, and every such node one side."""
    _, d = SIMPLEX_DEGREES[cells.shape[1]]
    ends = np.sort(cells[:, SIMPLEX_EDGES[d]], axis=2).reshape(-1, 2)
    sides = ends[:, 0] * (int(cells.max()) + 1) + ends[:, 1]
    nodes = cells[:, d + 1 :].ravel()
    for keys, values in ((sides, nodes), (nodes, sides)):
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
        wrong = np.flatnonzero(values != values[first[inverse]])
        if wrong.size:
            i, j = int(wrong[0]), int(first[inverse[wrong[0]]])
            texts = [f"cell {k // (len(nodes) // len(cells))} has node {nodes[k]} from {ends[k][0]} to {ends[k][1]}"
                     for k in (j, i)]  # fmt: skip
            raise MeshError(f"neighbors do not share the nodes on their sides: {', '.join(texts)}; {_REMEDY}")
    if np.isin(nodes, cells[:, : d + 1]).any():
        wrong = np.flatnonzero(np.isin(cells[:, d + 1 :], cells[:, : d + 1]).any(axis=1))
        raise MeshError(f"{wrong.size} cells have corners of cells as nodes on sides, first cell {wrong[0]}; {_REMEDY}")
