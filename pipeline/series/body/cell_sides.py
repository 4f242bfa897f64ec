"""Whether a cell is only numbered mirrored, or folded into its neighbors: decided by the sides of shared faces.

Two cells of a valid body lie on different sides of the face that they share, however their corners are numbered. Some
programs number corners in increasing order (legacy FEniCS, scikit-fem), so that half of the signed volumes are
negative.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.formats.cell_kinds import POLYGON
from pipeline.formats.grid import CellArray
from pipeline.mesh.blocks import split_blocks

_SQUARE_FACES = ((0, 1), (1, 2), (2, 3), (3, 0))
_FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": _SQUARE_FACES,
    "tetrahedron": ((0, 1, 2), (0, 1, 3), (1, 2, 3), (0, 2, 3)),
    "hexahedron": ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "wedge": ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
_THIN = 1e-7  # of a face's length: a center that is nearer to the face lies on no side of it


class Sides(NamedTuple):
    """Masks of cells (e,): `mirrored` by their numbering only, `folded` into a neighbor, `overlapping` one."""

    mirrored: NDArray[np.bool_]
    folded: NDArray[np.bool_]
    overlapping: NDArray[np.bool_]


def compare_sides(points: Floats, cells: CellArray, volumes: Floats) -> Sides:
    """Return how cells of signed volumes (e,) lie beside their neighbors, given points (n, d).

    A negative cell is folded if it lies on the same side of a face as its neighbor, else it is only numbered mirrored.
    Without neighbors, nothing tells the sides of a cell apart: it is mirrored if no cell of the mesh is positive.
    """
    negative = volumes < 0
    a, b, same_side = _find_shared_faces(points, cells)
    alone, overlapping = np.ones(len(volumes), dtype=bool), np.zeros(len(volumes), dtype=bool)
    for side in (a, b):
        alone[side] = False
        overlapping[side[same_side]] = True
    settled = negative & ~overlapping
    return Sides(settled & (negative.all() | ~alone), negative & (overlapping | (alone & ~negative.all())), overlapping)


def _find_shared_faces(points: Floats, cells: CellArray) -> tuple[Ints, Ints, NDArray[np.bool_]]:
    """Return the two cells of every face that just two share, and whether they lie on the same side of it."""
    joined = join_coincident(points)
    keys, owners, corners = _list_faces(cells, joined)
    if not len(keys):
        nothing = np.zeros(0, dtype=np.int64)
        return nothing, nothing, np.zeros(0, dtype=bool)
    order = np.lexsort(keys.T)
    sorted_keys = keys[order]
    same = (sorted_keys[1:] == sorted_keys[:-1]).all(axis=1)
    i, j = order[:-1][same], order[1:][same]
    centers = _find_corner_means(points, cells)
    origin, normal = _find_normals(points, corners[i])
    area = np.linalg.norm(normal, axis=1)
    least = _THIN * (area if points.shape[1] == 2 else np.sqrt(area)) * area
    sides = [((centers[owners[k]] - origin) * normal).sum(axis=1) for k in (i, j)]
    clear = (np.abs(sides[0]) > least) & (np.abs(sides[1]) > least)
    return owners[i], owners[j], clear & (sides[0] * sides[1] > 0)


def join_coincident(points: Floats) -> Ints:
    """Return the first point at the place of every point: equal to nine digits of the body's size."""
    step = 1e-9 * max(float(np.ptp(points, axis=0).max(initial=0.0)), 1e-300)
    places = np.round((points - points.min(axis=0)) / step)
    order = np.lexsort(places.T)  # stable, so that the first of equal points comes first; faster than np.unique of rows
    starts = np.concatenate([[True], (np.diff(places[order], axis=0) != 0).any(axis=1)])
    joined = np.empty(len(points), dtype=np.int64)
    joined[order] = order[np.flatnonzero(starts)[np.cumsum(starts) - 1]]
    return joined


def _list_faces(cells: CellArray, joined: Ints) -> tuple[Ints, Ints, Ints]:
    """Return sorted corners (f, 4) of every face, filled with -1, its cell (f,), and its corners in order (f, 4)."""
    keys, owners, corners = [np.zeros((0, 4), np.int64)], [np.zeros(0, np.int64)], [np.zeros((0, 4), np.int64)]
    for block in split_blocks(cells):
        own = block.connectivity[:, block.kind.corners]
        for face in _FACES[block.kind.shape]:
            nodes = np.full((len(own), 4), -1, dtype=np.int64)
            nodes[:, : len(face)] = own[:, list(face)]
            corners.append(nodes)
            keys.append(np.sort(np.where(nodes < 0, -1, joined[nodes]), axis=1))
            owners.append(block.cells)
    for cell in np.flatnonzero(cells.types == POLYGON).tolist():
        own = cells.connectivity[cells.offsets[cell] : cells.offsets[cell + 1]]
        nodes = np.full((len(own), 4), -1, dtype=np.int64)
        nodes[:, 0], nodes[:, 1] = own, np.roll(own, -1)
        corners.append(nodes)
        keys.append(np.sort(np.where(nodes < 0, -1, joined[nodes]), axis=1))
        owners.append(np.full(len(own), cell))
    return np.concatenate(keys), np.concatenate(owners), np.concatenate(corners)


def _find_corner_means(points: Floats, cells: CellArray) -> Floats:
    """Return the mean (e, d) of the corners of every cell that has shape functions, and of polygons."""
    centers = np.zeros((len(cells.types), points.shape[1]))
    for cell in np.flatnonzero(cells.types == POLYGON).tolist():
        centers[cell] = points[cells.connectivity[cells.offsets[cell] : cells.offsets[cell + 1]]].mean(axis=0)
    for block in split_blocks(cells):
        centers[block.cells] = points[block.connectivity[:, block.kind.corners]].mean(axis=1)
    return centers


def _find_normals(points: Floats, corners: Ints) -> tuple[Floats, Floats]:
    """Return a point on every face and its normal (f, d), of any length; corners are (f, 4), filled with -1."""
    first, second, third = (points[corners[:, k]] for k in range(3))
    if points.shape[1] == 2:
        side = second - first
        return first, np.column_stack([side[:, 1], -side[:, 0]])
    fourth = np.where((corners[:, 3] < 0)[:, None], first, points[corners[:, 3]])
    # the vector area of a quadrilateral is half of the cross product of its diagonals
    return (first + second + third + fourth) / 4, np.cross(third - first, fourth - second)
