"""Mirrored cells: those that only their numbering mirrors, and those that are folded into their neighbors.

Two cells of a valid body lie on different sides of the face that they share, however their corners are numbered. Some
programs number corners in increasing order (legacy FEniCS, scikit-fem), so that half of the signed volumes are
negative. A cell that is really inverted lies on the same side of a face as its neighbor.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.mesh.simplex import signed_volumes


def find_mirrored_cells(points: Floats, cells: Ints) -> NDArray[np.bool_]:
    """Return the mask (e,) of the simplices that must be reoriented, given points (n, d) and cells (e, d + 1).

    All cells, if all of at least two have negative volumes; else those of negative volume that share faces and lie on
    the other side of each from its second cell. A cell without neighbors is left alone: nothing tells its sides apart.
    Points that coincide count as one.
    """
    negative = signed_volumes(points, cells) < 0
    if not negative.any() or (negative.all() and len(cells) > 1):
        return negative
    owners, others, folded = _compare_sides(points, cells)
    has_neighbor, is_folded = np.zeros((2, len(cells)), dtype=bool)
    for side in (owners, others):
        has_neighbor[side] = True
        is_folded[side[folded]] = True
    return negative & has_neighbor & ~is_folded


def swap_corners(cells: Ints, mask: NDArray[np.bool_]) -> Ints:
    """Return the simplices (e, d + 1), those of the mask with their last two corners exchanged."""
    swapped = cells.copy()
    swapped[mask, -2], swapped[mask, -1] = cells[mask, -1], cells[mask, -2]
    return swapped


def _compare_sides(points: Floats, cells: Ints) -> tuple[Ints, Ints, NDArray[np.bool_]]:
    """Return the two cells of each shared face (f,), and whether they lie on the same side of it."""
    corners = cells.shape[1]
    _, first, node = np.unique(points, axis=0, return_index=True, return_inverse=True)
    joined = first[node.ravel()][cells]
    faces = np.concatenate([np.sort(np.delete(joined, i, axis=1), axis=1) for i in range(corners)])
    opposite = joined.T.ravel()
    owner = np.tile(np.arange(len(cells)), corners)
    order = np.lexsort(faces.T)
    same = (np.diff(faces[order], axis=0) == 0).all(axis=1)
    a, b = order[:-1][same], order[1:][same]
    sides = [signed_volumes(points, np.column_stack([faces[a], opposite[end]])) for end in (a, b)]
    return owner[a], owner[b], sides[0] * sides[1] > 0
