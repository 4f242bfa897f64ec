"""The places of nodes in reference cells, in the order that VTK numbers them.

Places are integers from 0 to n along each axis for a cell of order n: VTK numbers corners first, then the nodes within
edges, within faces, and inside, each of these as a smaller cell of its own.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from pipeline.arrays import Ints

Place = tuple[int, ...]

_SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]
_CUBE = [(*corner, k) for k in (0, 1) for corner in _SQUARE]
_TRIANGLE = [(0, 0), (1, 0), (0, 1)]
_PRISM = [(*corner, k) for k in (0, 1) for corner in _TRIANGLE]
_TETRAHEDRON = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
# edges run from their first to their second corner; those of squares and cubes along the axes
_SQUARE_EDGES = [(0, 1), (1, 2), (3, 2), (0, 3)]
_CUBE_EDGES = [*_SQUARE_EDGES, *((a + 4, b + 4) for a, b in _SQUARE_EDGES), (0, 4), (1, 5), (2, 6), (3, 7)]
_TRIANGLE_EDGES = [(0, 1), (1, 2), (2, 0)]
_PRISM_EDGES = [*_TRIANGLE_EDGES, *((a + 3, b + 3) for a, b in _TRIANGLE_EDGES), (0, 3), (1, 4), (2, 5)]
_TETRAHEDRON_EDGES = [*_TRIANGLE_EDGES, (0, 3), (1, 3), (2, 3)]
# by dimension: the corners at the ends of each side of a triangle or tetrahedron
SIMPLEX_EDGES = {2: np.array(_TRIANGLE_EDGES), 3: np.array(_TETRAHEDRON_EDGES)}
# by the number of nodes of a triangle or tetrahedron: its order and dimension
SIMPLEX_DEGREES = {3: (1, 2), 6: (2, 2), 4: (1, 3), 10: (2, 3)}
# faces: a corner, and the two corners to which their nodes run, the first of them fastest
_CUBE_FACES = [(0, 3, 4), (1, 2, 5), (0, 1, 4), (3, 2, 7), (0, 1, 3), (4, 5, 7)]
_PRISM_QUADS = [(0, 1, 3), (1, 2, 4), (2, 0, 5)]
_TETRAHEDRON_FACES = [(0, 1, 3), (2, 3, 1), (0, 3, 2), (0, 2, 1)]


def place_in_cube(n: int, dimension: int) -> Ints:
    """Return the places (k, d) of the (n + 1)^d nodes of a quadrilateral or hexahedron of order n."""
    corners, edges = (_SQUARE, _SQUARE_EDGES) if dimension == 2 else (_CUBE, _CUBE_EDGES)
    faces = [(0, 1, 3)] if dimension == 2 else _CUBE_FACES
    places = [tuple(n * i for i in corner) for corner in corners]
    places += _fill_edges(corners, edges, n)
    for face in faces:
        places += _combine(corners, face, [(i, j) for j in range(1, n) for i in range(1, n)], n)
    if dimension == 3:
        places += [(i, j, k) for k in range(1, n) for j in range(1, n) for i in range(1, n)]
    return np.array(places, dtype=np.int64)


def place_in_simplex(n: int, dimension: int) -> Ints:
    """Return the places (k, d) of the nodes of a triangle or tetrahedron of order n: their sums do not exceed n."""
    if n == 0:
        return np.zeros((1, dimension), dtype=np.int64)
    corners, edges = (_TRIANGLE, _TRIANGLE_EDGES) if dimension == 2 else (_TETRAHEDRON, _TETRAHEDRON_EDGES)
    places = [tuple(n * i for i in corner) for corner in corners]
    places += _fill_edges(corners, edges, n)
    if dimension == 2:
        return np.array(places + _fill_triangle(corners, (0, 1, 2), n), dtype=np.int64)
    for face in _TETRAHEDRON_FACES:
        places += _fill_triangle(corners, face, n)
    if n > 3:
        places += [tuple(int(i) + 1 for i in place) for place in place_in_simplex(n - 4, 3)]
    return np.array(places, dtype=np.int64)


def place_in_wedge(n: int) -> Ints:
    """Return the places (k, 3) of the nodes of a wedge of order n."""
    places = [tuple(n * i for i in corner) for corner in _PRISM]
    places += _fill_edges(_PRISM, _PRISM_EDGES, n)
    places += _fill_triangle(_PRISM, (0, 1, 2), n) + _fill_triangle(_PRISM, (3, 4, 5), n)
    for face in _PRISM_QUADS:
        places += _combine(_PRISM, face, [(i, j) for j in range(1, n) for i in range(1, n)], n)
    inside = _fill_triangle(_TRIANGLE, (0, 1, 2), n)
    return np.array(places + [(*place, k) for k in range(1, n) for place in inside], dtype=np.int64)


def turn_nodes(cells: Ints, corners: Ints) -> Ints:
    """Return cells of order 2 (e, k) with their corners in another order (e, d + 1), and their sides accordingly."""
    d = corners.shape[1] - 1
    places = (corners[:, :, None] == cells[:, None, : d + 1]).argmax(axis=2)
    number = np.zeros((d + 1, d + 1), dtype=np.int64)  # of the side between two corners
    a, b = SIMPLEX_EDGES[d].T
    number[a, b] = number[b, a] = d + 1 + np.arange(len(a))
    sides = number[places[:, a], places[:, b]]
    return np.concatenate([corners, np.take_along_axis(cells, sides, axis=1)], axis=1)


def _fill_edges(corners: Sequence[Place], edges: Iterable[tuple[int, int]], n: int) -> list[Place]:
    """Return the places within edges, edge by edge."""
    return [
        tuple(a * (n - m) + b * m for a, b in zip(corners[first], corners[second], strict=True))
        for first, second in edges
        for m in range(1, n)
    ]


def _fill_triangle(corners: Sequence[Place], face: tuple[int, int, int], n: int) -> list[Place]:
    """Return the places within a triangular face: a triangle of order n - 3."""
    if n < 3:
        return []
    inside = [(int(i) + 1, int(j) + 1) for i, j in place_in_simplex(n - 3, 2)]
    return _combine(corners, face, inside, n)


def _combine(corners: Sequence[Place], face: tuple[int, int, int], steps: Iterable[Place], n: int) -> list[Place]:
    """Return the places that lie i and j steps from a face's first corner toward its second and third."""
    origin, toward, across = (np.array(corners[corner]) for corner in face)
    return [tuple(int(m) for m in n * origin + i * (toward - origin) + j * (across - origin)) for i, j in steps]
