"""Corrects a mesh from a file, with a note each time, and refuses defects whose meaning only its author knows.

Corrected, because the shape stays the same: cells listed twice (gmsh writes a cell once for each of its physical
groups), nodes without cells (centers of arcs; nodes of dropped boundary cells), and cells that only their numbering
mirrors (orientation.py). Refused: coincident nodes, where the body may be meant to hold together or to come apart; and
inverted cells, because they overlap their neighbors.
"""

import numpy as np
from scipy.spatial import cKDTree

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.mesh.node_order import SIMPLEX_DEGREES, turn_nodes
from pipeline.mesh.orientation import find_mirrored_cells, swap_corners
from pipeline.mesh.simplex import CELL_NAMES

PLANAR = 1e-6  # of the size: rounding to single precision leaves a few 1e-7 of it
_NEAREST = 1e-7  # of the size: rounding to eight digits takes coincident nodes that far apart


def check_connectivity(points: Floats, cells: Ints) -> None:
    """Raise MeshError if a cell names a node that does not exist."""
    bad = np.flatnonzero(((cells < 0) | (cells >= len(points))).any(axis=1))
    if bad.size:
        wrong = cells[bad[0]][(cells[bad[0]] < 0) | (cells[bad[0]] >= len(points))][0]
        raise MeshError(f"cell {bad[0]} names node {wrong} of {len(points)} (counted from 0)")


def drop_repeated_cells(cells: Ints) -> tuple[Ints, Ints, list[str]]:
    """Return the cells without repetitions, in order, the place of each given cell (e,), and a note if any went."""
    _, first, inverse = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_inverse=True)
    removed = len(cells) - len(first)
    if not removed:
        return cells, np.arange(len(cells)), []
    kept = np.sort(first)
    return (
        cells[kept],
        np.searchsorted(kept, first[inverse.ravel()]),
        [f"{removed} cells were listed twice and count once"],
    )


def drop_unused_nodes(points: Floats, cells: Ints) -> tuple[Floats, Ints, list[str]]:
    """Return points and cells without unused nodes, and a note if there were any; the others keep their order."""
    used = np.zeros(len(points), dtype=bool)
    used[cells] = True
    unused = np.flatnonzero(~used)
    if not unused.size:
        return points, cells, []
    _, d = SIMPLEX_DEGREES[cells.shape[1]]
    note = (
        f"{unused.size} nodes that belong to no {CELL_NAMES[d]} were removed, first {unused[0]}; "
        f"node numbers in the case and in the results count the remaining {used.sum()} from 0, in the file's order"
    )
    return points[used], (np.cumsum(used) - 1)[cells], [note]


def check_points(points: Floats, body: Ints | None = None) -> None:
    """Raise MeshError for a point that is not finite or lies exactly on another of the same body (n,)."""
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise MeshError(f"{bad.size} points are not finite, first {bad[0]}: {points[bad[0]].tolist()}")
    places = points if body is None else np.column_stack([points, body])
    _, first, inverse = np.unique(places, axis=0, return_index=True, return_inverse=True)
    original = first[inverse.ravel()]
    twice = np.flatnonzero(original != np.arange(len(points)))
    if twice.size:
        raise MeshError(
            f"{twice.size} nodes lie exactly on others, first {twice[0]} on {original[twice[0]]} at "
            f"{points[twice[0]].tolist()}: the body would come apart there; merge them (gmsh: Coherence Mesh; "
            "pyvista: grid.clean()), or move the parts slightly apart if that is intended"
        )


def check_distances(points: Floats, body: Ints | None = None) -> None:
    """Raise MeshError if a node (n, d) lies almost on another of the same body (n,): rounding took them apart."""
    reach = _NEAREST * float(np.ptp(points, axis=0).max(initial=0.0))
    found = cKDTree(points).query(points, k=2, distance_upper_bound=reach)
    distances, others = np.asarray(found[0]), np.asarray(found[1])
    near = np.flatnonzero(np.isfinite(distances[:, 1]))
    partner = others[near, 1]
    partner[partner == near] = others[near, 0][partner == near]
    if body is not None:
        same = body[near] == body[partner]
        near, partner = near[same], partner[same]
    if near.size:
        a, b = int(near[0]), int(partner[0])
        raise MeshError(
            f"{near.size} nodes lie within {_NEAREST:g} of the body's size of others, first {a}, "
            f"{np.linalg.norm(points[a] - points[b]):.2g} from {b}: the body would come apart there; merge them "
            "(gmsh: Coherence Mesh with Geometry.Tolerance; pyvista: grid.clean(tolerance=...)), or move the parts "
            "farther apart"
        )


def orient_cells(points: Floats, cells: Ints) -> tuple[Ints, list[str]]:
    """Return the cells of order 1 or 2, those that only their numbering mirrors reoriented, and a note if any were."""
    corners = cells[:, : points.shape[1] + 1]
    mirrored = find_mirrored_cells(points, corners)
    count = int(mirrored.sum())
    if not count:
        return cells, []
    name = CELL_NAMES[points.shape[1]]
    if count == len(cells):
        note = f"all {count} {name} cells were mirrored and have been reoriented"
    else:
        note = (
            f"{count} of {len(cells)} {name} cells were mirrored by their numbering and have been reoriented: no cell "
            "lies on the same side of a face as its neighbor"
        )
    corners = swap_corners(corners, mirrored)
    return (turn_nodes(cells, corners) if cells.shape[1] > corners.shape[1] else corners), [note]
