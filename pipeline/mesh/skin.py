"""The skin of a body: the triangles that draw it, on points that are weighted sums of its nodes.

Solids are drawn by the faces that belong to only one cell, planar bodies and surfaces by their cells. Faces are
compared by their corners: the quadrilateral of a hexahedron and the two triangles of tetrahedra beside it stay both.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from pipeline.arrays import Floats, Ints
from pipeline.formats.cell_kinds import HEXAGONAL_PRISM, PENTAGONAL_PRISM, POLYGON, POLYHEDRON
from pipeline.formats.grid import CellArray
from pipeline.mesh.blocks import KindBlock, select_faceted, split_blocks
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.shape_functions import CellKind
from pipeline.mesh.simplex import Mesh
from pipeline.mesh.surface import find_boundary_faces

Hashes = NDArray[np.uint64]

# the corners of each face, ordered so that its normal points out of a positively oriented cell
_FACES = {
    "triangle": ((0, 1, 2),),
    "quad": ((0, 1, 2, 3),),
    "tetrahedron": ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)),
    "hexahedron": ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
}
# parts of a curved edge of order 1 to 3, and of order 4, in bodies of at most so many curved faces; else the coarsest
_PARTS, _COARSEST = ((200, (6, 8)), (20_000, (3, 4))), (2, 2)
_PRISMS = {PENTAGONAL_PRISM: 5, HEXAGONAL_PRISM: 6}
_NOTHING = 1e-9  # a weight this small is rounding of zero


@dataclass(frozen=True, eq=False, repr=False)
class Skin:
    """Triangles (f, 3) on s points, the cell behind each (f,), and lines (k, 2) around the faces of cells.

    The points are the nodes of these numbers (s,) or, if some lie within curved faces, `weights` (s, n) times nodes.
    """

    triangles: Ints
    owners: Ints
    lines: Ints
    nodes: Ints
    weights: csr_array | None = None

    def __repr__(self) -> str:
        return f"<Skin of {len(self.triangles)} triangles>"

    @property
    def count(self) -> int:
        """Return the number of points."""
        return len(self.nodes) if self.weights is None else int(self.weights.shape[0])

    def place(self, x: Floats) -> Floats:
        """Return the points (s, d) of the skin, given the nodes (n, d)."""
        return x[self.nodes] if self.weights is None else np.asarray(self.weights @ x)


class FaceGroup(NamedTuple):
    """Faces of m cells that are divided alike: keys of their corners, cells, nodes (m, k), weights (p, k) of p points.

    `triangles` (t, 3) and `outline` (l, 2) are numbers of these points. Those of order 2 and more are curved.
    """

    keys: Hashes
    owners: Ints
    nodes: Ints
    weights: Floats
    triangles: Ints
    outline: Ints
    is_curved: bool = False


def find_skin(mesh: BodyMesh, joined: Ints | None = None) -> Skin:
    """Return the skin of a body; that of linear simplices has its boundary faces in their order.

    `joined` (n,) are the nodes that stand for others at the same place, if cells have points of their own: faces
    between such cells are not drawn.
    """
    if isinstance(mesh, Mesh):
        if joined is not None:
            mesh = Mesh(mesh.points, joined[mesh.cells], mesh.name)
        every = (mesh.cells, np.arange(len(mesh.cells), dtype=np.int64))
        faces, owners = every if mesh.dimension == 2 else find_boundary_faces(mesh)
        nodes, local = np.unique(faces, return_inverse=True)
        triangles = local.reshape(faces.shape).astype(np.int64, copy=False)
        return Skin(triangles, owners, _list_sides(triangles), nodes)
    cells = mesh.cell_array if joined is None else _renumber_nodes(mesh.cell_array, joined)
    groups = _list_groups(cells, mesh.dimension, _COARSEST)
    curved = sum(len(group.owners) for group in groups if group.is_curved)
    parts = next((parts for most, parts in _PARTS if curved <= most), _COARSEST)
    if curved and parts != _COARSEST:
        groups = _list_groups(cells, mesh.dimension, parts)
    return _join_groups(groups, len(mesh.points))


def _list_groups(cells: CellArray, dimension: int, parts: tuple[int, int]) -> list[FaceGroup]:
    """Return the faces that are drawn: all of planar cells, those on the boundary of solids."""
    groups = [group for group in _iterate_groups(cells, parts) if len(group.owners)]
    return _keep_boundary(groups) if dimension == 3 else groups


def _renumber_nodes(cells: CellArray, numbers: Ints) -> CellArray:
    """Return cells of nodes with other numbers (n,)."""
    faces = cells.faces
    faces = None if faces is None else faces._replace(connectivity=numbers[faces.connectivity])
    return cells._replace(connectivity=numbers[cells.connectivity], faces=faces)


def _list_sides(triangles: Ints) -> Ints:
    """Return the sides (k, 2) of triangles, each once."""
    return np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)


def _iterate_groups(cells: CellArray, parts: tuple[int, int] = _COARSEST) -> Iterator[FaceGroup]:
    """Yield the faces of all cells."""
    for block in split_blocks(cells):
        for corners in _FACES[block.kind.shape]:
            yield _divide_face(block, corners, parts)
    faceted = select_faceted(cells)
    for owners, rings in _iterate_rings(cells, faceted):
        yield _divide_rings(owners, rings)


def _divide_face(block: KindBlock, corners: tuple[int, ...], parts: tuple[int, int]) -> FaceGroup:
    """Return the faces at these corners of a block's cells."""
    kind = block.kind
    order = kind.order
    sides = 1 if order == 1 else parts[order > 3]
    places, triangles, outline = _divide_triangle(sides) if len(corners) == 3 else _divide_square(sides)
    weights = kind.evaluate(_find_reference_points(kind, corners, places))
    weights[np.abs(weights) < _NOTHING] = 0
    chosen = np.flatnonzero((weights != 0).any(axis=0))
    keys = _hash_corners(block.connectivity[:, kind.corners[list(corners)]])
    return FaceGroup(
        keys, block.cells, block.connectivity[:, chosen], weights[:, chosen], triangles, outline, order > 1
    )


def _find_reference_points(kind: CellKind, corners: tuple[int, ...], places: Floats) -> Floats:
    """Return reference coordinates of points given by weights (p, c) of the corners of a face."""
    at = kind.nodes[kind.corners[list(corners)]]
    if kind.shape != "pyramid" or len(corners) == 4:
        return np.asarray(places @ at)
    # collapsed coordinates: across, only the corners of the base count; at the apex any place is right
    base = places[:, :2].sum(axis=1)
    shares = np.where(base[:, None] > 0, places[:, :2] / np.where(base > 0, base, 1)[:, None], 0.5)
    return np.column_stack([shares @ at[:2, :2], places @ at[:, 2]])


def _divide_triangle(sides: int) -> tuple[Floats, Ints, Ints]:
    """Return points of a triangle as weights (p, 3) of its corners, triangles between them, and its outline."""
    grid = [(i, j) for j in range(sides + 1) for i in range(sides + 1 - j)]
    number = {place: k for k, place in enumerate(grid)}
    triangles = []
    for i, j in grid:
        if i + j < sides:
            triangles.append((number[i, j], number[i + 1, j], number[i, j + 1]))
        if i + j < sides - 1:
            triangles.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    around = [(i, 0) for i in range(sides)] + [(sides - j, j) for j in range(sides)]
    around += [(0, sides - j) for j in range(sides)]
    places = np.array([(sides - i - j, i, j) for i, j in grid]) / sides
    return places, np.array(triangles, dtype=np.int64), _close([number[place] for place in around])


def _divide_square(sides: int) -> tuple[Floats, Ints, Ints]:
    """Return points of a quadrilateral as weights (p, 4) of its corners, triangles between them, and its outline."""
    n = sides + 1
    triangles = []
    for a in (j * n + i for j in range(sides) for i in range(sides)):
        triangles += [(a, a + 1, a + n + 1), (a, a + n + 1, a + n)]
    around = [*range(sides), *(j * n + sides for j in range(sides))]
    around += [*(sides * n + i for i in range(sides, 0, -1)), *(j * n for j in range(sides, 0, -1))]
    s, t = (axis.ravel() / sides for axis in np.meshgrid(np.arange(n), np.arange(n)))
    places = np.column_stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])
    return places, np.array(triangles, dtype=np.int64), _close(around)


def _close(around: list[int]) -> Ints:
    """Return the sides (k, 2) of a closed line through points."""
    return np.array([*pairwise(around), (around[-1], around[0])], dtype=np.int64)


def _divide_rings(owners: Ints, rings: Ints) -> FaceGroup:
    """Return polygons (m, k): triangles and quadrilaterals are split as ever, others around the mean of their nodes."""
    k = rings.shape[1]
    around = _close(list(range(k)))
    weights, triangles = np.eye(k), np.array([(0, 1, 2), (0, 2, 3)][: k - 2], dtype=np.int64)
    if k > 4:
        weights = np.vstack([weights, np.full((1, k), 1 / k)])
        triangles = np.column_stack([np.full(k, k), around]).astype(np.int64)
    return FaceGroup(_hash_corners(rings), owners, rings, weights, triangles, around)


def _iterate_rings(cells: CellArray, chosen: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Yield cells (m,) and the nodes (m, k) around a face of each, for polygons, polyhedra and prisms."""
    types = cells.types[chosen]
    flat = [_list_polygons(cells, chosen[types == POLYGON]), _list_polyhedra(cells, chosen[types == POLYHEDRON])]
    for owners, starts, lengths, connectivity in flat:
        for k in np.unique(lengths):
            of_length = lengths == k
            yield owners[of_length], connectivity[starts[of_length][:, None] + np.arange(k)]
    for number, n in _PRISMS.items():
        prisms = chosen[types == number]
        nodes = cells.connectivity[cells.offsets[prisms][:, None] + np.arange(2 * n)]
        yield prisms, nodes[:, :n][:, ::-1]
        yield prisms, nodes[:, n:]
        for i in range(n):
            j = (i + 1) % n
            yield prisms, nodes[:, [i, j, n + j, n + i]]


def _list_polygons(cells: CellArray, chosen: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Return the cells, and the starts and lengths of their nodes in the connectivity, which comes last."""
    return chosen, cells.offsets[chosen], np.diff(cells.offsets)[chosen], cells.connectivity


def _list_polyhedra(cells: CellArray, chosen: Ints) -> tuple[Ints, Ints, Ints, Ints]:
    """Return the cell of every face, and the starts and lengths of its nodes in the connectivity, which comes last."""
    if cells.faces is None or not len(chosen):
        return chosen[:0], chosen[:0], chosen[:0], cells.connectivity
    counts = np.diff(cells.faces.cell_offsets)[chosen]
    first = np.repeat(cells.faces.cell_offsets[chosen] - np.cumsum(counts) + counts, counts)
    faces = first + np.arange(counts.sum())
    lengths = np.diff(cells.faces.offsets)[faces]
    return np.repeat(chosen, counts), cells.faces.offsets[faces], lengths, cells.faces.connectivity


def _mix(values: NDArray[np.integer]) -> Hashes:
    """Return the hash of every number (splitmix64): sums of hashes of different sets hardly ever agree."""
    z = values.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(z ^ (z >> np.uint64(31)))


def _hash_corners(corners: Ints) -> Hashes:
    """Return a key (m,) of the set of corners (m, k) of every face; collapsed corners count once."""
    in_order = np.sort(corners, axis=1)
    hashes = _mix(in_order)
    hashes[:, 1:][in_order[:, 1:] == in_order[:, :-1]] = 0
    return np.asarray(hashes.sum(axis=1, dtype=np.uint64))


def _keep_boundary(groups: list[FaceGroup]) -> list[FaceGroup]:
    """Return the faces whose key occurs once."""
    keys = np.concatenate([group.keys for group in groups])
    _, which, count = np.unique(keys, return_inverse=True, return_counts=True)
    single = count[which.ravel()] == 1
    ends = np.cumsum([len(group.keys) for group in groups])
    masks = [single[end - len(group.keys) : end] for group, end in zip(groups, ends, strict=True)]
    kept = [
        group._replace(keys=group.keys[mask], owners=group.owners[mask], nodes=group.nodes[mask])
        for group, mask in zip(groups, masks, strict=True)
    ]
    return [group for group in kept if len(group.owners)]


def _join_groups(groups: list[FaceGroup], node_count: int) -> Skin:
    """Return the skin of all faces, in which points of the same weights are one."""
    rows, nodes, weights, triangles, owners, lines, total = [], [], [], [], [], [], 0
    for group in groups:
        m, p = len(group.owners), len(group.weights)
        point, column = np.nonzero(group.weights)
        first = total + p * np.arange(m)
        rows.append((first[:, None] + point).ravel())
        nodes.append(group.nodes[:, column].ravel())
        weights.append(np.tile(group.weights[point, column], m))
        triangles.append((first[:, None, None] + group.triangles).reshape(-1, 3))
        lines.append((first[:, None, None] + group.outline).reshape(-1, 2))
        owners.append(np.repeat(group.owners, len(group.triangles)))
        total += m * p
    parts = (np.concatenate(rows), np.concatenate(nodes), np.concatenate(weights))
    matrix, same = _merge_rows(*parts, total, node_count)
    pairs = np.unique(np.sort(same[np.concatenate(lines)], axis=1), axis=0)
    corners, behind = same[np.concatenate(triangles)], np.concatenate(owners)
    plain = matrix.nnz == matrix.shape[0] and bool((matrix.data == 1).all())
    return Skin(corners, behind, pairs, matrix.indices.astype(np.int64), None if plain else matrix)


def _merge_rows(rows: Ints, nodes: Ints, weights: Floats, count: int, node_count: int) -> tuple[csr_array, Ints]:
    """Return the rows of weights that differ, and for each of `count` rows its place among them."""
    matrix = csr_array((weights, (rows, nodes)), shape=(count, node_count))
    hashes = _mix(matrix.indices + node_count * np.round(matrix.data / _NOTHING).astype(np.int64))
    row_hashes = np.add.reduceat(hashes, matrix.indptr[:-1])
    _, first, same = np.unique(row_hashes, return_index=True, return_inverse=True)
    order = np.argsort(first)  # in the order of the faces, not of hashes
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return csr_array(matrix[first[order]]), place[same.ravel()].astype(np.int64)
