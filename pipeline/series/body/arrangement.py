"""Where a file has the nodes and cells of a mesh: in the same places, or in another order that ids or positions reveal.

A cell is not its place in the connectivity: programs that run in parallel write the same cells in another order after
a change of the partition. If every cell has points of its own, the connectivity is the same even then.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pipeline.arrays import Fields, Floats, Ints
from pipeline.formats.grid import CellArray, Grid
from pipeline.mesh.cell_mesh import find_centers
from pipeline.series.body.cell_arrays import select_array

_ANY = (
    "localtoglobalmap",
    "ids",
    "id",
    "globalids",
    "global_ids",
    "pedigreeids",
    "originalids",
    "gid",
    "gids",
    "_index",
)
POINT_IDS = (
    "globalnodeid", "globalnodeids", "globalpointids", "vtkoriginalpointids", "pedigreenodeid", "pedigreepointids",
    "nodeid", "node_id", "node_ids", "nodeids", "node_number", "nodenumber", "pointid", "point_id", "point_ids",
    "pointids", "vertexid", "vertex_ids", "vtkoriginalnodeids", "internal_node_ids", *_ANY,
)  # fmt: skip
CELL_IDS = (
    "globalelementid", "globalelementids", "globalcellids", "vtkoriginalcellids", "pedigreeelementid",
    "pedigreecellids", "elementid", "element_id", "element_ids", "elementids", "elem_ids", "elemid", "elem_id",
    "cellid", "cell_id", "cell_ids", "cellids", "elementnumber", "element_number", "internal_element_ids", *_ANY,
)  # fmt: skip
APART = 1e-6  # of the body's size: single precision leaves a few 1e-7


class Arrangement(NamedTuple):
    """The points (n,) and cells (e,) of a file that are the nodes and cells of the mesh; None if they are equal.

    `fault` says why a frame does not have them: all indices are -1 then.
    """

    nodes: Ints | None = None
    cells: Ints | None = None
    fault: str = ""

    def select_nodes(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the mesh's nodes, given those of a file's points; NaN if there is a fault."""
        return _select(values, self.nodes, missing=bool(self.fault))

    def select_cells(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the mesh's cells, given those of a file's cells; NaN if there is a fault."""
        return _select(values, self.cells, missing=bool(self.fault))


def _select(values: NDArray[Any], indices: Ints | None, *, missing: bool) -> NDArray[Any]:
    if indices is None:
        return values
    if missing:
        return np.full((len(indices), *values.shape[1:]), np.nan)
    return values[indices]


def make_missing(nodes: int, cells: int, fault: str) -> Arrangement:
    """Return the arrangement of a frame that has none of the mesh's nodes and cells."""
    return Arrangement(np.full(nodes, -1, dtype=np.int64), np.full(cells, -1, dtype=np.int64), fault)


def have_same_points(a: Grid, b: Grid) -> bool:
    """Return whether two grids have the same points, as far as cells tell: those of one are among those of the other.

    So it is if cells are deleted or added, and points stay.
    """
    if a.count != b.count or not len(a.types) or not len(b.types):
        return False
    fewer, more = (a, b) if len(a.types) <= len(b.types) else (b, a)
    same = np.arange(a.count)
    return _find_cells(more.cells, same, fewer.cells, same) is not None


@dataclass(frozen=True, eq=False)
class IdTable:
    """The ids of the mesh's nodes and cells, and the arrays that hold them; None if the files have none.

    `base` is the arrangement of the first frame, `raw` its measured cells with the points of that file, and `cells`
    the same cells with the nodes of the mesh.
    """

    point_name: str | None
    cell_name: str | None
    point_ids: Ints | None
    cell_ids: Ints | None
    base: Arrangement
    raw: CellArray
    cells: CellArray

    @property
    def names(self) -> str:
        """Return the names of the arrays, for notes."""
        return ", ".join(name for name in (self.point_name, self.cell_name) if name)

    def are_in_place(self, grid: Grid) -> bool:
        """Return whether a grid has the ids in the same places as the first one, or has no ids."""
        points = _read_ids(grid.point_data, self.point_name)
        cells = _read_ids(grid.cell_data, self.cell_name)
        pairs = ((points, self.point_ids, self.base.select_nodes), (cells, self.cell_ids, self.base.select_cells))
        return all(a is None or b is None or np.array_equal(select(a), b) for a, b, select in pairs)

    def rearrange(self, nodes: Ints, cells: Ints, arrangement: Arrangement, own: CellArray) -> "IdTable":
        """Return the table of a mesh with these nodes (n,) and cells (e,) of this one, in that order."""
        return replace(
            self, base=arrangement, cells=own,
            point_ids=None if self.point_ids is None else self.point_ids[nodes],
            cell_ids=None if self.cell_ids is None else self.cell_ids[cells], raw=select_array(self.raw, cells),
        )  # fmt: skip


def find_ids(grid: Grid, base: Arrangement, cells: CellArray, *, use: bool = True) -> IdTable:
    """Return the ids that number the nodes and `cells` of a mesh in its first frame: integers, each once."""
    chosen: list[tuple[str | None, Ints | None]] = []
    for fields, names, select in (
        (grid.point_data, POINT_IDS, base.select_nodes),
        (grid.cell_data, CELL_IDS, base.select_cells),
    ):
        chosen.append((None, None))
        for name in _sort_by_rank(fields, names) if use else ():
            ids = _read_ids(fields, name)
            if ids is not None and len(np.unique(own := select(ids))) == len(own):
                chosen[-1] = name, own
                break
    (point_name, point_ids), (cell_name, cell_ids) = chosen
    raw = grid.cells if base.cells is None else select_array(grid.cells, base.cells)
    return IdTable(point_name, cell_name, point_ids, cell_ids, base, raw, cells)


def _sort_by_rank(fields: Fields, names: tuple[str, ...]) -> list[str]:
    """Return the fields with one of these names, compared in lower case, in the order of the names."""
    return sorted((name for name in fields if name.lower() in names), key=lambda name: names.index(name.lower()))


def _read_ids(fields: Fields, name: str | None) -> Ints | None:
    """Return the integers of an array with one component, or None."""
    if name is None or name not in fields:
        return None
    values = np.asarray(fields[name])
    values = values[:, 0] if values.ndim == 2 and values.shape[1] == 1 else values
    if values.ndim != 1 or values.dtype.kind not in "iuf":
        return None
    if values.dtype.kind == "f" and not (np.isfinite(values).all() and np.array_equal(values, np.round(values))):
        return None
    return np.asarray(values, dtype=np.int64)


def match_by_ids(grid: Grid, table: IdTable) -> Arrangement | None:
    """Return where a grid has the nodes and cells of the mesh by their ids; None if ids do not tell it."""
    node_ids, element_ids = _read_ids(grid.point_data, table.point_name), _read_ids(grid.cell_data, table.cell_name)
    where_cells = _find_ids(element_ids, table.cell_ids)
    where_nodes = _find_ids(node_ids, table.point_ids)
    same_point = np.arange(grid.count)
    if where_nodes is not None and node_ids is not None:  # parts have copies of the points that they share
        _, first, inverse = np.unique(node_ids, return_index=True, return_inverse=True)
        same_point = first[inverse.ravel()]
    if where_cells is None and where_nodes is not None:
        where_cells = _find_cells(grid.cells, same_point, table.cells, where_nodes)
    if where_cells is None:
        return None
    if where_nodes is None:
        where_nodes = _follow_cells(grid, where_cells, table)
        if where_nodes is None:
            return None
    elif not np.array_equal(
        _sort_corners(select_array(grid.cells, where_cells), same_point), _sort_corners(table.cells, where_nodes)
    ):
        return None
    return Arrangement(where_nodes, where_cells)


def _find_ids(ids: Ints | None, wanted: Ints | None) -> Ints | None:
    """Return the first place of every wanted id, or None if one is missing."""
    if ids is None or wanted is None or not len(ids):
        return None
    values, first = np.unique(ids, return_index=True)
    place = np.clip(np.searchsorted(values, wanted), 0, len(values) - 1)
    return np.asarray(first[place], dtype=np.int64) if np.array_equal(values[place], wanted) else None


def _follow_cells(grid: Grid, where: Ints, table: IdTable) -> Ints | None:
    """Return the point of every node, given the place of every cell, whose corners keep their order; or None."""
    raw, own = table.raw, select_array(grid.cells, where)
    if not np.array_equal(own.offsets, raw.offsets) or not np.array_equal(own.types, raw.types):
        return None
    points = np.full(int(raw.connectivity.max()) + 1, -1, dtype=np.int64)
    points[raw.connectivity] = own.connectivity
    x = grid.points
    apart = np.abs(x[points[raw.connectivity]] - x[own.connectivity])  # a node has one place, whichever cell names it
    if (apart > APART * float(np.ptp(x, axis=0).max(initial=0.0))).any():
        return None
    nodes = table.base.nodes
    nodes = points if nodes is None else points[np.minimum(nodes, len(points) - 1)]
    return None if (nodes < 0).any() else nodes


def _find_cells(cells: CellArray, labels: Ints, wanted: CellArray, nodes: Ints) -> Ints | None:
    """Return the cell that has the points of each wanted cell; None if there is none."""
    theirs, mine = _sort_corners(cells, labels), _sort_corners(wanted, nodes)
    width = max(theirs.shape[1], mine.shape[1])
    rows = np.concatenate([np.pad(a, [(0, 0), (0, width - a.shape[1])], constant_values=-1) for a in (theirs, mine)])
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    found = first[inverse.ravel()[len(theirs) :]]
    return np.asarray(found, dtype=np.int64) if (found < len(theirs)).all() else None


def _sort_corners(cells: CellArray, labels: Ints) -> Ints:
    """Return the labels of each cell's corners in increasing order, padded with -1, after its type."""
    sizes = np.diff(cells.offsets)
    rows = np.full((len(sizes), int(sizes.max(initial=0))), -1, dtype=np.int64)
    rows[np.arange(rows.shape[1]) < sizes[:, None]] = labels[cells.connectivity]
    rows.sort(axis=1)
    return np.column_stack([cells.types.astype(np.int64), rows])


def match_by_positions(
    X: Floats, cells: CellArray, other: Floats, other_cells: CellArray, tolerance: float
) -> Arrangement | None:
    """Return where points `other` (m, c) and their cells are nodes X (n, c) and cells of a mesh at rest; or None.

    Cells match by their centers and the positions of their nodes, so that coincident points of different cells are
    told apart. `other` may hold more cells and points than the mesh (ghosts, cells of lower dimension).
    """
    if not len(other_cells.types) or not np.isfinite(other).all():
        return None
    where = _match_centers(
        find_centers(X, cells), cells.types, find_centers(other, other_cells), other_cells.types, tolerance
    )
    if where is None or not np.array_equal(np.diff(other_cells.offsets)[where], np.diff(cells.offsets)):
        return None
    nodes = np.full(len(X), -1, dtype=np.int64)
    sizes = np.diff(cells.offsets)
    for size in np.unique(sizes).tolist():
        group = np.flatnonzero(sizes == size)
        own = cells.connectivity[cells.offsets[group][:, None] + np.arange(size)]
        their = other_cells.connectivity[other_cells.offsets[where[group]][:, None] + np.arange(size)]
        apart = np.abs(X[own][:, :, None] - other[their][:, None]).max(axis=3)
        nearest = apart.argmin(axis=2)
        if not (np.take_along_axis(apart, nearest[:, :, None], axis=2) <= tolerance).all():
            return None
        nodes[own] = np.take_along_axis(their, nearest, axis=1)
    return None if (nodes < 0).any() else Arrangement(nodes, where)


def _match_centers(
    centers: Floats, types: NDArray[np.uint8], others: Floats, other_types: NDArray[np.uint8], tolerance: float
) -> Ints | None:
    """Return the cell of the same type at every center, each once; None if one has no partner."""
    where = np.full(len(centers), -1, dtype=np.int64)
    for kind in np.unique(types).tolist():
        own, their = np.flatnonzero(types == kind), np.flatnonzero(other_types == kind)
        if not len(their):
            return None
        distances, nearest = cKDTree(others[their]).query(centers[own], distance_upper_bound=max(4 * tolerance, 1e-300))
        if not np.isfinite(distances).all():
            return None
        where[own] = their[np.asarray(nearest, dtype=np.int64)]
    return where if len(np.unique(where)) == len(where) else None
