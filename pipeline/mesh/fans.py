"""Polygons and polyhedra cut into simplices around their middle, for cells that have no shape functions.

The middle of a cell and that of a face are the means of their points, and so are the values of a field there: linear
fields are exact.
"""

from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.formats.grid import CellArray
from pipeline.mesh.body_mesh import BodyMesh

_POLYGON, _POLYHEDRON, _PRISMS = 7, 42, {15: 5, 16: 6}


class CellFans(NamedTuple):
    """The simplices of all polygons and polyhedra: (middle of the cell[, middle of a face], a, b), sorted by cell.

    `starts` (e + 1) are the first simplex of each cell and one more; `faces` are padded with -1: the nodes (s, f) of
    the face of each simplex, none in polygons.
    """

    starts: Ints
    edges: Ints
    faces: Ints
    corners: Floats

    def locate(self, points: Floats, cells: Ints, nodes: Ints) -> tuple[Floats, Floats, Floats]:
        """Return weights (q, k), depth and distance of points (q, d) in cells (q,) with nodes (q, k)."""
        counts = np.diff(self.starts)[cells]
        pair = np.repeat(np.arange(len(cells)), counts)
        simplex = np.arange(len(pair)) + np.repeat(self.starts[cells] - np.cumsum(counts) + counts, counts)
        shares, distance = _find_shares(self.corners[simplex], points[pair])
        depth = shares.min(axis=1)
        depth[~np.isfinite(depth)] = -np.inf
        order = np.lexsort((-depth, pair))
        best = order[np.unique(pair[order], return_index=True)[1]]
        return self._weigh(simplex[best], shares[best], nodes), depth[best], distance[best]

    def _weigh(self, simplex: Ints, shares: Floats, nodes: Ints) -> Floats:
        """Return the weights of the nodes (q, k) of each cell, given the shares of the corners of its simplex."""
        weights = np.repeat(shares[:, :1] / nodes.shape[1], nodes.shape[1], axis=1)
        for k in range(2):
            weights += shares[:, -2 + k, None] * (nodes == self.edges[simplex, k, None])
        if shares.shape[1] == 4:
            around = self.faces[simplex]
            share = shares[:, 1] / (around >= 0).sum(axis=1)
            for k in range(around.shape[1]):
                weights += share[:, None] * (nodes == around[:, k, None])
        return weights


def _find_shares(corners: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return barycentric coordinates (q, d + 1) of points in simplices (q, d + 1, n), and distances from surfaces."""
    D = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    gap = points - corners[:, 0]
    with np.errstate(all="ignore"):
        normal = np.einsum("qda,qdb->qab", D, D)
        flat = ~(np.linalg.det(normal) > 0)
        normal[flat] = np.eye(D.shape[2])
        xi = np.linalg.solve(normal, np.einsum("qda,qd->qa", D, gap)[:, :, None])[:, :, 0]
        xi += np.linalg.solve(normal, np.einsum("qda,qd->qa", D, gap - np.einsum("qda,qa->qd", D, xi))[:, :, None])[
            :, :, 0
        ]
        off = np.linalg.norm(gap - np.einsum("qda,qa->qd", D, xi), axis=1) / np.linalg.norm(D, axis=(1, 2))
    xi[flat] = np.nan
    distance = np.zeros(len(points)) if D.shape[1] == D.shape[2] else off
    return np.column_stack([1 - xi.sum(axis=1), xi]), distance


def cut_fans(mesh: BodyMesh) -> CellFans:
    """Return the simplices of the polygons or polyhedra of a mesh; other cells have none."""
    cells = mesh.cell_array
    counts = np.diff(cells.offsets)
    centers = np.add.reduceat(mesh.points[cells.connectivity], cells.offsets[:-1]) / counts[:, None]
    owners, edges, faces = _list_edges(cells)
    order = np.argsort(owners, kind="stable")
    owners, edges, faces = owners[order], edges[order], faces[order]
    corners = [centers[owners]]
    if mesh.dimension == 3:
        present = faces >= 0
        middle = np.where(present[:, :, None], mesh.points[faces], 0).sum(axis=1) / present.sum(axis=1)[:, None]
        corners.append(middle)
    corners += [mesh.points[edges[:, 0]], mesh.points[edges[:, 1]]]
    starts = np.concatenate([[0], np.cumsum(np.bincount(owners, minlength=len(cells.types)))]).astype(np.int64)
    return CellFans(starts, edges, faces, np.stack(corners, axis=1))


def _list_edges(cells: CellArray) -> tuple[Ints, Ints, Ints]:
    """Return the edges around all faces: the cell (s,), both nodes (s, 2), and the nodes of the face (s, f)."""
    rings, owners = list[Ints](), list[int]()
    for cell in np.flatnonzero(np.isin(cells.types, (_POLYGON, _POLYHEDRON, *_PRISMS))).tolist():
        nodes = cells.connectivity[cells.offsets[cell] : cells.offsets[cell + 1]]
        found = _list_rings(cells, cell, nodes)
        rings += found
        owners += [cell] * len(found)
    lengths = np.array([len(ring) for ring in rings])
    padded = np.full((len(rings), int(lengths.max())), -1, dtype=np.int64)
    for row, ring in enumerate(rings):
        padded[row, : len(ring)] = ring
    first = np.concatenate(rings)
    second = np.concatenate([np.roll(ring, -1) for ring in rings])
    return np.repeat(np.array(owners), lengths), np.column_stack([first, second]), np.repeat(padded, lengths, axis=0)


def _list_rings(cells: CellArray, cell: int, nodes: Ints) -> list[Ints]:
    """Return the nodes around each face of a polyhedron or prism, or around a polygon."""
    kind = int(cells.types[cell])
    if kind == _POLYGON:
        return [nodes]
    if kind in _PRISMS:
        n = _PRISMS[kind]
        sides = [nodes[[k, (k + 1) % n, n + (k + 1) % n, n + k]] for k in range(n)]
        return [nodes[:n], nodes[n:], *sides]
    if cells.faces is None:
        return []
    first, last = cells.faces.cell_offsets[cell : cell + 2].tolist()
    offsets, connectivity = cells.faces.offsets, cells.faces.connectivity
    return [connectivity[offsets[face] : offsets[face + 1]] for face in range(first, last)]
