"""The cell around a point of the body at rest, and the shares of its nodes in a field at that point."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.formats.cell_kinds import TYPES
from pipeline.formats.grid import CellArray
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.candidates import iterate_candidates
from pipeline.mesh.fans import cut_fans
from pipeline.mesh.natural_coordinates import invert_map
from pipeline.mesh.shape_functions import find_kind
from pipeline.mesh.simplex import Mesh

_ON_A_FACE = 1e-9  # of the body's size, and of natural coordinates: rounding can put surface points outside
_ROUNDINGS = 16  # of the largest coordinate, in the position and in the nodes of a cell
_OFF_A_SURFACE = 0.05  # of the cell's size: points of a curved surface are beside its cells
_OVERSHOOT = 0.25  # of the box of the nodes: a curved cell can reach beyond them


class LocatedPairs(NamedTuple):
    """Points in cells, q pairs: the weights of the nodes (q, k), and how far inside; negative outside.

    `depth` is in natural coordinates, from the nearest face; `distance` is that from a surface, of the cell's size.
    """

    weights: Floats
    depth: Floats
    distance: Floats


Locate = Callable[[Floats, Ints], LocatedPairs]  # points (q, d) and cells (q,)


def locate_points(mesh: BodyMesh, points: Floats) -> tuple[Ints, Floats]:
    """Return the cell (p,) around each rest point (p, d), and the weights (p, k) of the nodes of that cell.

    A field of nodes has the value sum_a weight_a field_a at the point, with the nodes in the order of the cell; k is
    the largest number of nodes of a cell, and weights beyond those of a cell are 0. They are the shape functions of the
    cell; polygons and polyhedra are cut into simplices around their middle. Outside all cells, and at points that are
    not finite, the weights are NaN and the cell is 0. On a face, the cell that comes first is taken unless rounding
    favors another. A point beside a surface in space belongs to it up to 5 % of the cell's size. Raises MeshError if
    the points have too few coordinates.
    """
    d = mesh.points.shape[1]
    if points.ndim != 2 or points.shape[1] < d:
        raise MeshError(f"points to locate are (p, {d}), not {points.shape}")
    points = np.asarray(points[:, :d], dtype=np.float64)
    locate, low, high = _prepare(mesh)
    cells = np.zeros(len(points), dtype=np.int64)
    weights = np.full((len(points), int(np.diff(mesh.cell_array.offsets).max())), np.nan)
    tolerance = _find_tolerance(mesh)
    for where, near in iterate_candidates(low, high, points):
        found = locate(points[where], near)
        inside = np.flatnonzero((found.depth >= -tolerance[near]) & (found.distance <= _OFF_A_SURFACE))
        order = inside[np.lexsort((near[inside], -found.depth[inside], found.distance[inside], where[inside]))]
        best = order[np.unique(where[order], return_index=True)[1]]  # the nearest and deepest of each point
        cells[where[best]], weights[where[best]] = near[best], found.weights[best]
    return cells, weights


def _find_tolerance(mesh: BodyMesh) -> Floats:
    """Return the natural coordinates by which a point on a face can be outside each cell (e,).

    Far from the origin coordinates are rounded, and small cells feel it.
    """
    size = mesh.rest_volumes ** (1 / mesh.dimension)
    return np.asarray(_ON_A_FACE + _ROUNDINGS * np.finfo(float).eps * np.abs(mesh.points).max() / size)


def _prepare(mesh: BodyMesh) -> tuple[Locate, Floats, Floats]:
    """Return the function that locates points in cells, and the boxes of the cells: lowest and highest corners."""
    slack = _ON_A_FACE * mesh.size
    if isinstance(mesh, Mesh):
        corners = mesh.points[mesh.cells]
        return _locate_in_simplices(mesh), corners.min(axis=1) - slack, corners.max(axis=1) + slack
    cells = mesh.cell_array
    starts, positions = cells.offsets[:-1], mesh.points[cells.connectivity]
    low, high = np.minimum.reduceat(positions, starts), np.maximum.reduceat(positions, starts)
    margin = slack + _find_overshoot(cells)[:, None] * (high - low)
    if mesh.points.shape[1] > mesh.dimension:
        margin += _OFF_A_SURFACE * np.linalg.norm(high - low, axis=1, keepdims=True)
    return _locate_in_any(mesh), low - margin, high + margin


def _find_overshoot(cells: CellArray) -> Floats:
    """Return the part of its box by which each cell can reach beyond it (e,)."""
    groups, of_cell = _group_cells(cells)
    parts = [0.0 if TYPES[kind].faceted or find_kind(kind, count).order == 1 else _OVERSHOOT for kind, count in groups]
    return np.array(parts)[of_cell]


def _group_cells(cells: CellArray) -> tuple[list[tuple[int, int]], Ints]:
    """Return the kinds of cells, each a VTK type and a number of nodes, and the kind of each cell (e,)."""
    rows = np.column_stack([cells.types.astype(np.int64), np.diff(cells.offsets)])
    groups, of_cell = np.unique(rows, axis=0, return_inverse=True)
    return [(kind, count) for kind, count in groups.tolist()], of_cell.reshape(-1).astype(np.int64)


def _locate_in_simplices(mesh: Mesh) -> Locate:
    def locate(points: Floats, cells: Ints) -> LocatedPairs:
        first = mesh.points[mesh.cells[cells, 0]]
        shares = np.einsum("qad,qd->qa", mesh.shape_gradients[cells], points - first)
        shares[:, 0] += 1
        return LocatedPairs(shares, shares.min(axis=1), np.zeros(len(points)))

    return locate


def _locate_in_any(mesh: BodyMesh) -> Locate:
    array = mesh.cell_array
    groups, of_cell = _group_cells(array)
    width = int(np.diff(array.offsets).max())
    faceted = any(TYPES[kind].faceted for kind, _ in groups)
    fans = cut_fans(mesh) if faceted else None

    def locate(points: Floats, cells: Ints) -> LocatedPairs:
        out = LocatedPairs(np.zeros((len(points), width)), np.full(len(points), -np.inf), np.zeros(len(points)))
        for number, (kind, count) in enumerate(groups):
            chosen = np.flatnonzero(of_cell[cells] == number)
            if not chosen.size:
                continue
            nodes = array.connectivity[array.offsets[cells[chosen], None] + np.arange(count)]
            if TYPES[kind].faceted and fans is not None:
                found = LocatedPairs(*fans.locate(points[chosen], cells[chosen], nodes))
            else:
                found = LocatedPairs(*invert_map(find_kind(kind, count), mesh.points[nodes], points[chosen]))
            out.weights[chosen, :count], out.depth[chosen], out.distance[chosen] = found
        return out

    return locate
