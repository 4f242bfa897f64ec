r"""Volumes of faceted cells, and what their measures need of the rest state.

Every face is fanned about the mean m of its corners: a polyhedron with the mean o of its points consists of the
tetrahedra (o, m, a, b) of all edges a b of all faces, a polygon of the triangles (m, a, b). Their signed sum is the
volume. Faces of four corners are the bilinear ones of hexahedra: both have the same volume.

    V = sum (m - o) . (a - o) x (b - o) / 6,   G_a = M^-1 (X_a - O),   M = sum_a (X_a - O) (x) (X_a - O)

F = sum_a (x_a - o) (x) G_a is the least-squares fit to the points; det F is sampled in each tetrahedron or triangle,
where the map is linear.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.mesh.faceted import FacetedCells

_DEGENERATE = 1e-3  # of the largest piece: flatter ones turn over long before the cell does


@dataclass(frozen=True, eq=False, repr=False)
class RestFacets:
    """Faceted cells with their rest state: volumes (m,), 1 over the volume of each piece (corners of faces,).

    `inverse` is NaN for flat pieces, which are left out. `gradients` (nodes, c) are G_a; `normals` (m, 3) are those of
    surfaces in space, else empty.
    """

    faceted: FacetedCells
    volumes: Floats
    inverse: Floats
    gradients: Floats
    normals: Floats


def measure_pieces(points: Floats, faceted: FacetedCells) -> Floats:
    """Return the signed volume of the piece at every corner of every face at points (n, c).

    Areas of surfaces in space are negative if the piece's normal is opposite to that of the whole polygon.
    """
    b, face, cell = faceted.edges
    o = _average(points[faceted.nodes], faceted.starts)
    A, B = points[faceted.corners] - o[cell], points[b] - o[cell]
    if faceted.dimension == 3:
        m = _average(A, faceted.corner_starts)[face]
        return np.asarray(np.einsum("ec,ec->e", m, np.cross(A, B)) / 6)
    if points.shape[1] == 2:
        return np.asarray((A[:, 0] * B[:, 1] - A[:, 1] * B[:, 0]) / 2)
    n = np.cross(A, B)
    whole = find_normals(points, faceted)[cell]
    return np.asarray(np.copysign(np.linalg.norm(n, axis=1), (n * whole).sum(axis=1)) / 2)


def measure_facets(points: Floats, faceted: FacetedCells) -> Floats:
    """Return the signed volumes (m,); areas of surfaces in space are positive."""
    return _sum_pieces(measure_pieces(points, faceted), faceted)


def find_normals(points: Floats, faceted: FacetedCells) -> Floats:
    """Return the unit normal (m, 3) of the vector area of each polygon in space; zero if it has none."""
    b, _, cell = faceted.edges
    o = _average(points[faceted.nodes], faceted.starts)
    n = np.cross(points[faceted.corners] - o[cell], points[b] - o[cell])
    total = np.column_stack([np.bincount(cell, axis, minlength=len(faceted.cells)) for axis in n.T])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0, length, 1.0))


def prepare_facets(points: Floats, faceted: FacetedCells) -> RestFacets:
    """Return the rest state of faceted cells at points (n, c)."""
    pieces, cell = measure_pieces(points, faceted), faceted.edges[2]
    scale = np.zeros(len(faceted.cells))
    np.maximum.at(scale, cell, np.abs(pieces))
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(np.abs(pieces) > _DEGENERATE * scale[cell], 1 / pieces, np.nan)
    counts = np.diff(faceted.starts)
    owner = np.repeat(np.arange(len(counts)), counts)
    X = points[faceted.nodes] - _average(points[faceted.nodes], faceted.starts)[owner]
    surface = points.shape[1] > faceted.dimension
    normals = find_normals(points, faceted) if surface else np.zeros((0, 3))
    M = np.add.reduceat(X[:, :, None] * X[:, None, :], faceted.starts[:-1], axis=0)
    if surface:  # the fit is that of the tangent plane: X has no part along N, and M is completed along it
        X = X - (X * normals[owner]).sum(axis=1, keepdims=True) * normals[owner]
        M = np.add.reduceat(X[:, :, None] * X[:, None, :], faceted.starts[:-1], axis=0)
        M += np.trace(M, axis1=1, axis2=2)[:, None, None] * normals[:, :, None] * normals[:, None, :]
    inverse_M = np.linalg.pinv(M, hermitian=True)  # a cell that is flat up to rounding has a singular M
    gradients = np.einsum("aij,aj->ai", inverse_M[owner], X)
    return RestFacets(faceted, _sum_pieces(pieces, faceted), inverse, np.ascontiguousarray(gradients), normals)


def share_among_corners(points: Floats, faceted: FacetedCells, count: int) -> Floats:
    """Return the integral over all cells (count,) of each node's function, linear in the pieces."""
    pieces, (b, face, cell) = measure_pieces(points, faceted), faceted.edges
    share = pieces / (faceted.dimension + 1)
    total = np.bincount(faceted.corners, share, minlength=count) + np.bincount(b, share, minlength=count)
    sizes, counts = np.diff(faceted.corner_starts), np.diff(faceted.starts)
    if faceted.dimension == 3:
        of_face = np.bincount(face, share, minlength=len(sizes)) / sizes
        total += np.bincount(faceted.corners, of_face[face], minlength=count)
    of_cell = np.bincount(cell, share, minlength=len(counts)) / counts
    total += np.bincount(faceted.nodes, np.repeat(of_cell, counts), minlength=count)
    return np.asarray(total, dtype=np.float64)


def _sum_pieces(pieces: Floats, faceted: FacetedCells) -> Floats:
    """Return the sum of the pieces of each cell (m,)."""
    return np.bincount(faceted.edges[2], pieces, minlength=len(faceted.cells)).astype(np.float64, copy=False)


def _average(rows: Floats, starts: np.ndarray) -> Floats:
    """Return the mean of each group of rows."""
    return np.asarray(np.add.reduceat(rows, starts[:-1], axis=0) / np.diff(starts)[:, None])
