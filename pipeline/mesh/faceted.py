"""Cells that have faces in place of shape functions: polyhedra, prisms of five and six sides, and polygons.

Files list the faces of a polyhedron in any direction. Here they all point outward: two faces run along their common
edge in opposite directions, and the volume is positive at rest.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.formats.cell_kinds import HEXAGONAL_PRISM, PENTAGONAL_PRISM, POLYGON, POLYHEDRON
from pipeline.formats.grid import CellArray

_PRISM_SIDES = {PENTAGONAL_PRISM: 5, HEXAGONAL_PRISM: 6}
_Faces = tuple[list[Ints], list[Ints], list[Ints]]  # cell of each face, number of corners of each face, corners


@dataclass(frozen=True, eq=False, repr=False)
class FacetedCells:
    """Faceted cells of one dimension, numbers `cells` (m,): the rows of their points, and of the corners of faces.

    Cell i has the distinct nodes nodes[starts[i] : starts[i + 1]] and the faces face_starts[i] to face_starts[i + 1];
    face f has the corners corners[corner_starts[f] : corner_starts[f + 1]]. A polygon is its own face.
    """

    dimension: int
    cells: Ints
    starts: Ints
    nodes: Ints
    face_starts: Ints
    corner_starts: Ints
    corners: Ints

    @property
    def edges(self) -> tuple[Ints, Ints, Ints]:
        """Return the next corner in the face, the face, and the cell of each corner."""
        counts = np.diff(self.corner_starts)
        face = np.repeat(np.arange(len(counts)), counts)
        following = np.arange(1, len(self.corners) + 1)
        following[self.corner_starts[1:] - 1] = self.corner_starts[:-1]
        cell = np.repeat(np.arange(len(self.cells)), np.diff(self.face_starts))[face]
        return self.corners[following], face, cell


def collect_faceted(points: Floats, cell_array: CellArray, dimension: int, name: str) -> FacetedCells | None:
    """Return the polygons or the polyhedra and prisms of a mesh, with faces that point outward at points (n, c).

    None if there are none. Raises MeshError for faces that do not enclose a volume.
    """
    if dimension == 2:
        return _collect_polygons(cell_array, name)
    types = cell_array.types
    if not np.isin(types, [POLYHEDRON, *_PRISM_SIDES]).any():
        return None
    owner, sizes, corners = (np.concatenate(part) for part in _list_faces(cell_array, name))
    order = np.argsort(owner, kind="stable")
    starts = np.concatenate([[0], np.cumsum(sizes)])[:-1]
    places = _spread(starts[order], sizes[order])
    first = np.flatnonzero(np.append(True, np.diff(owner[order]) > 0))
    cells = owner[order][first]
    keys = np.sort(np.repeat(owner[order], sizes[order]) * len(points) + corners[places])
    cell_of_node, nodes = np.divmod(keys[np.append(True, np.diff(keys) > 0)], len(points))
    faceted = FacetedCells(
        dimension=3,
        cells=cells.astype(np.int64),
        starts=np.searchsorted(cell_of_node, np.append(cells, len(types))).astype(np.int64),
        nodes=nodes.astype(np.int64),
        face_starts=np.append(first, len(order)).astype(np.int64),
        corner_starts=np.concatenate([[0], np.cumsum(sizes[order])]).astype(np.int64),
        corners=corners[places].astype(np.int64),
    )
    return _turn_outward(points, faceted, name)


def _collect_polygons(cell_array: CellArray, name: str) -> FacetedCells | None:
    """Return the polygons."""
    cells = np.flatnonzero(cell_array.types == POLYGON).astype(np.int64)
    if not len(cells):
        return None
    counts = np.diff(cell_array.offsets)[cells]
    if counts.min() < 3:
        raise MeshError(f"{name}: cell {cells[counts.argmin()]}: a polygon of {counts.min()} nodes; remove it")
    nodes = cell_array.connectivity[_spread(cell_array.offsets[cells], counts)].astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return FacetedCells(2, cells, starts, nodes, np.arange(len(cells) + 1, dtype=np.int64), starts, nodes)


def _list_faces(cell_array: CellArray, name: str) -> _Faces:
    """Return cell, size and corners of every face of polyhedra and prisms."""
    owner, sizes, corners = _list_polyhedra(cell_array, name)
    counts = np.diff(cell_array.offsets)
    for number, sides in _PRISM_SIDES.items():
        cells = np.flatnonzero(cell_array.types == number)
        if not len(cells):
            continue
        if (counts[cells] != 2 * sides).any():
            raise MeshError(f"{name}: a prism (type {number}) has {2 * sides} nodes, not {counts[cells].max()}")
        nodes = cell_array.connectivity[cell_array.offsets[cells][:, None] + np.arange(2 * sides)]
        ring = np.arange(sides)
        for face in (ring[::-1], ring + sides, *_list_sides(sides)):
            owner.append(cells)
            sizes.append(np.full(len(cells), len(face), dtype=np.int64))
            corners.append(nodes[:, face].ravel())
    return owner, sizes, corners


def _list_sides(sides: int) -> list[Ints]:
    """Return the quadrilateral faces of a prism of that many sides."""
    ring = [*range(sides), 0]
    return [np.array([a, b, b + sides, a + sides], dtype=np.int64) for a, b in pairwise(ring)]


def _list_polyhedra(cell_array: CellArray, name: str) -> _Faces:
    """Return cell, size and corners of every face of polyhedra."""
    cells, faces = np.flatnonzero(cell_array.types == POLYHEDRON), cell_array.faces
    if not len(cells):
        return [], [], []
    if faces is None:
        raise MeshError(f"{name}: cell {cells[0]}: a polyhedron without a list of its faces; write the faces too")
    counts = np.diff(faces.cell_offsets)[cells]
    if counts.min() < 4:
        raise MeshError(f"{name}: cell {cells[counts.argmin()]}: a polyhedron of {counts.min()} faces; remove it")
    numbers = _spread(faces.cell_offsets[cells], counts)
    sizes = np.diff(faces.offsets)[numbers]
    if sizes.min() < 3:
        bad = np.repeat(cells, counts)[sizes.argmin()]
        raise MeshError(f"{name}: cell {bad}: a polyhedron with a face of {sizes.min()} nodes; remove the face")
    corners = faces.connectivity[_spread(faces.offsets[numbers], sizes)]
    return [np.repeat(cells, counts)], [sizes], [corners]


def _spread(starts: Ints, counts: Ints) -> Ints:
    """Return the places start, start + 1, … of every row, joined."""
    ends = np.cumsum(counts)
    return np.asarray(np.repeat(starts - (ends - counts), counts) + np.arange(ends[-1] if len(ends) else 0))


def _turn_outward(points: Floats, faceted: FacetedCells, name: str) -> FacetedCells:
    """Return the polyhedra with all faces turned outward."""
    reverse = _find_reversed_faces(faceted, name)
    faceted = _reverse_faces(faceted, reverse)
    b, face, cell = faceted.edges
    origin = points[faceted.corners[faceted.corner_starts[faceted.face_starts[:-1]]]]
    A, B = points[faceted.corners] - origin[cell], points[b] - origin[cell]
    sizes = np.diff(faceted.corner_starts)
    center = np.column_stack([np.bincount(face, axis, minlength=len(sizes)) for axis in A.T]) / sizes[:, None]
    six = np.bincount(cell, (center[face] * np.cross(A, B)).sum(axis=1), minlength=len(faceted.cells))
    return _reverse_faces(faceted, np.repeat(six < 0, np.diff(faceted.face_starts)))


def _reverse_faces(faceted: FacetedCells, which: np.ndarray) -> FacetedCells:
    """Return the cells with the corners of the faces of a mask (f,) in reverse order."""
    if not which.any():
        return faceted
    sizes, starts = np.diff(faceted.corner_starts), faceted.corner_starts[:-1]
    place = np.arange(len(faceted.corners))
    mirrored = np.repeat(2 * starts + sizes - 1, sizes) - place
    corners = faceted.corners[np.where(np.repeat(which, sizes), mirrored, place)]
    return FacetedCells(**{**vars(faceted), "corners": corners})


def _find_reversed_faces(faceted: FacetedCells, name: str) -> np.ndarray:
    """Return the mask (f,) of faces that run along edges in the same direction as the first face of their cell allows.

    Raises MeshError if an edge of a cell does not belong to exactly two of its faces.
    """
    b, face, cell = faceted.edges
    a = faceted.corners
    low, high, forward = np.minimum(a, b), np.maximum(a, b), a < b
    order = np.lexsort((high, low, cell))
    key = np.column_stack([cell, low, high])[order]
    first = np.flatnonzero(np.concatenate([[True], (np.diff(key, axis=0) != 0).any(axis=1)]))
    times = np.diff(np.append(first, len(key)))
    if (times != 2).any():
        bad = first[np.flatnonzero(times != 2)[0]]
        raise MeshError(
            f"{name}: cell {faceted.cells[key[bad, 0]]}: the edge {key[bad, 1]}-{key[bad, 2]} belongs to "
            f"{times[times != 2][0]} of its faces, not to 2: its faces enclose no volume; remove the cell"
        )
    one, two = order[first], order[first + 1]
    f, g, against = face[one], face[two], forward[one] == forward[two]
    sign = np.zeros(len(faceted.corner_starts) - 1, dtype=np.int64)
    sign[faceted.face_starts[:-1]] = 1  # 0 is unknown
    while (sign == 0).any():
        before = (sign == 0).sum()
        for here, there in ((f, g), (g, f)):
            new = (sign[here] != 0) & (sign[there] == 0)
            sign[there[new]] = np.where(against[new], -sign[here[new]], sign[here[new]])
        if (sign == 0).sum() == before:
            lost = int(np.searchsorted(faceted.face_starts, np.flatnonzero(sign == 0)[0], side="right")) - 1
            raise MeshError(f"{name}: cell {faceted.cells[lost]}: its faces are not connected; split the cell")
    return sign < 0
