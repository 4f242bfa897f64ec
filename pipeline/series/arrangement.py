"""Where a file has the nodes and cells of a mesh: solvers may write them in another order from frame to frame.

Cells are matched by ids if the file has them, else by rest positions; a cell is not its place in the connectivity.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Fields, Floats, Ints
from pipeline.formats.grid import CellArray, Grid

# names of ids that stay with a node or a cell, in lower case and without signs
_NODE_IDS = ("globalnodeid", "globalnodeids", "globalpointids", "nodeid", "nodeids", "nodeid", "vtkoriginalpointids",
             "pedigreenodeid", "pedigreenodeids", "pedigreeids", "localtoglobalmap", "pointid", "pointids")  # fmt: skip
_CELL_IDS = ("globalelementid", "globalelementids", "globalcellid", "globalcellids", "elementid", "elementids",
             "elemid", "cellid", "cellids", "vtkoriginalcellids", "pedigreeelementid", "pedigreeelementids",
             "pedigreeids", "localtoglobalmap")  # fmt: skip
_APART = 1e-6  # of the body's size: positions that are this close are one; single precision leaves a few 1e-7


class Arrangement(NamedTuple):
    """The points (n,) and cells (e,) of a file that are the nodes and cells of the mesh; None if they are equal."""

    nodes: Ints | None = None
    cells: Ints | None = None

    def select_nodes(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the mesh's nodes, given those of a file's points."""
        return values if self.nodes is None else values[self.nodes]

    def select_cells(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the mesh's cells, given those of a file's cells."""
        return values if self.cells is None else values[self.cells]


def have_same_cells(a: Grid, b: Grid) -> bool:
    """Return whether two grids have equal cells and the same number of points."""
    if all(one is other for one, other in zip(a.cells, b.cells, strict=True)):  # equal text is decoded only once
        return a.count == b.count
    return a.count == b.count and _have_equal_arrays(a.cells, b.cells)


def _have_equal_arrays(a: CellArray, b: CellArray) -> bool:
    """Return whether two lists of cells are equal: polygons of other lengths, or other faces of polyhedra, are not."""
    arrays: list[tuple[NDArray[Any], NDArray[Any]]] = [
        (a.types, b.types), (a.offsets, b.offsets), (a.connectivity, b.connectivity)
    ]  # fmt: skip
    if (a.faces is None) != (b.faces is None):
        return False
    arrays += [] if a.faces is None or b.faces is None else [*zip(a.faces, b.faces, strict=True)]
    return all(np.array_equal(one, other) for one, other in arrays)


def keep_ids(grid: Grid) -> Grid:
    """Return the points and cells of a grid with no other fields than the ids of its nodes and cells."""
    nodes, cells = _find_ids(grid.point_data, _NODE_IDS), _find_ids(grid.cell_data, _CELL_IDS)
    return Grid(
        grid.points, grid.count, grid.types, grid.offsets, grid.connectivity, nodes, cells, {}, grid.faces, grid.parts,
        grid.part_names,
    )  # fmt: skip


def arrange_frame(
    grid: Grid, first: Grid, base: Arrangement, find_rest: Callable[[], Floats | None]
) -> Arrangement | None:
    """Return where a frame has the nodes and cells of the mesh, None if it does not have them.

    `base` is the arrangement of the first frame; `first` is that frame with its ids (see keep_ids), and rest positions
    as its points; `find_rest` returns the rest positions of the frame's points (n, 3), None if they are not known.
    """
    same = have_same_cells(grid, first)
    for name in first.cell_data:
        order = _find_places(first.cell_data[name], grid.cell_data.get(name))
        if order is None:
            continue
        if same and _is_identity(order):
            return base
        if (points := _follow_cells(grid, first, order)) is not None:
            return _compose(points, order, base)
    for name in first.point_data:
        points = _find_places(first.point_data[name], grid.point_data.get(name))
        if points is None:
            continue
        if same and _is_identity(points):
            return base
        if (order := _match_cells(grid, first, points)) is not None:
            return _compose(points, order, base)
    if same:
        return base
    rest = find_rest()
    return None if rest is None else _match_positions(grid, first, base, rest)


def match_points(points: Floats, others: Floats) -> Ints | None:
    """Return the place of each point (n, 3) among as many others, by position; None if they are not the same."""
    from scipy.spatial import KDTree

    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if points.shape != others.shape or not (np.isfinite(points).all() and np.isfinite(others).all()):
        return None
    distance, nearest = map(np.asarray, KDTree(others).query(points, distance_upper_bound=_APART * size))
    return nearest.astype(np.int64) if np.isfinite(distance).all() else None


def match_meshes(
    first: CellArray, points: Floats, others: CellArray, other_points: Floats, size: float
) -> Arrangement | None:
    """Return where other cells at rest points (m, 3) have the nodes and cells of a mesh, by positions; None if not.

    Points closer than a millionth of `size` are one place; cells are matched by the places of their corners. Points
    that lie on one another (each cell may have its own) are matched within their cells.
    """
    from scipy.spatial import KDTree

    if len(first.types) != len(others.types) or len(first.connectivity) != len(others.connectivity):
        return None
    distance, nearest = map(np.asarray, KDTree(points).query(other_points, distance_upper_bound=_APART * size))
    used = np.zeros(len(other_points), dtype=bool)
    used[others.connectivity] = True
    if not np.isfinite(distance[used]).all():
        return None
    places = _label_places(points, _APART * size)
    labels = places[np.where(np.isfinite(distance), nearest, 0)]
    order = _find_equal_rows(_sort_corners(first, places), _sort_corners(others, labels))
    if order is None:
        return None
    nodes = np.full(len(points), -1)
    sizes = np.diff(first.offsets)
    for size_here in np.unique(sizes):
        cells = np.flatnonzero(sizes == size_here)
        mine = first.connectivity[first.offsets[cells][:, None] + np.arange(size_here)]
        theirs = others.connectivity[others.offsets[order[cells]][:, None] + np.arange(size_here)]
        rows = np.arange(len(cells))[:, None]
        nodes[mine[rows, np.argsort(places[mine], axis=1)]] = theirs[rows, np.argsort(labels[theirs], axis=1)]
    return Arrangement(nodes, order) if (nodes[first.connectivity] >= 0).all() else None


def _is_identity(order: Ints) -> bool:
    return np.array_equal(order, np.arange(len(order)))


def _compose(points: Ints, cells: Ints, base: Arrangement) -> Arrangement:
    """Return the arrangement of the mesh, given where a frame has the points and cells of the first frame."""
    return Arrangement(base.select_nodes(points), base.select_cells(cells))


def _follow_cells(grid: Grid, first: Grid, order: Ints) -> Ints | None:
    """Return the place of each point of the first frame, given those of its cells; None if corners contradict."""
    sizes = np.diff(first.offsets)
    if not np.array_equal(first.types, grid.types[order]) or not np.array_equal(sizes, np.diff(grid.offsets)[order]):
        return None
    shifts = np.repeat(grid.offsets[:-1][order] - first.offsets[:-1], sizes)
    corners = grid.connectivity[np.arange(len(first.connectivity)) + shifts]
    places = np.zeros(first.count, dtype=np.int64)
    places[first.connectivity] = corners
    x = grid.points
    apart = np.abs(x[places[first.connectivity]] - x[corners])  # a node has one position, whichever cell names it
    return places if not (apart > _APART * np.ptp(x, axis=0).max()).any() else None


def _match_cells(grid: Grid, first: Grid, points: Ints) -> Ints | None:
    """Return the place of each cell of the first frame, given those of its points; None if a cell is missing."""
    if len(first.types) != len(grid.types) or len(first.connectivity) != len(grid.connectivity):
        return None
    return _find_equal_rows(_sort_corners(first.cells, points), _sort_corners(grid.cells, np.arange(grid.count)))


def _match_positions(grid: Grid, first: Grid, base: Arrangement, rest: Floats) -> Arrangement | None:
    size = float(np.linalg.norm(np.ptp(first.points, axis=0)))
    match = match_meshes(first.cells, first.points, grid.cells, rest, size)
    if match is None or match.nodes is None or match.cells is None:
        return None
    return _compose(match.nodes, match.cells, base)


def _label_places(points: Floats, tolerance: float) -> Ints:
    """Return the same number for points that lie on one another."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    pairs = KDTree(points).query_pairs(tolerance, output_type="ndarray")
    n = len(points)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _sort_corners(cells: CellArray, labels: Ints) -> Ints:
    """Return the labels of each cell's corners in increasing order, padded with -1, after its number of corners."""
    sizes = np.diff(cells.offsets)
    out = np.full((len(sizes), int(sizes.max())), -1, dtype=np.int64)
    out[np.arange(out.shape[1]) < sizes[:, None]] = labels[cells.connectivity]
    out.sort(axis=1)
    return np.column_stack([sizes, out])


def _find_equal_rows(rows: Ints, others: Ints) -> Ints | None:
    """Return the place of each row among the others; None if they are not the same rows."""
    if rows.shape != others.shape:
        return None
    order, other_order = np.lexsort(rows.T[::-1]), np.lexsort(others.T[::-1])
    if not np.array_equal(rows[order], others[other_order]):
        return None
    out = np.empty(len(rows), dtype=np.int64)
    out[order] = other_order
    return out


def _find_ids(fields: Fields, names: tuple[str, ...]) -> Mapping[str, NDArray[Any]]:
    """Return the fields that are ids: whole numbers, each once."""
    ids = {}
    for name in fields:
        if "".join(filter(str.isalnum, name.lower())) in names:
            values = np.asarray(fields[name]).reshape(-1)
            if values.dtype.kind in "iu" and len(np.unique(values)) == len(values) > 1:
                ids[name] = values
    return ids


def _find_places(ids: NDArray[Any], field: NDArray[Any] | None) -> Ints | None:
    """Return the place of each id in a field of ids, None unless all of them are there, once."""
    if field is None or len(field := np.asarray(field).reshape(-1)) != len(ids):
        return None
    order = np.argsort(field, kind="stable")
    places = order[np.minimum(np.searchsorted(field, ids, sorter=order), len(field) - 1)]
    return places.astype(np.int64) if np.array_equal(field[places], ids) else None
