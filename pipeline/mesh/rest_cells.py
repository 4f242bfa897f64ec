r"""What the measures of curved cells need of the rest state: volumes, dets at samples, and mean gradients.

    J0 = dX/dxi,  V0 = sum_q w_q det J0(xi_q),  G_a = (1 / V0) sum_q w_q cof(J0) dN_a/dxi

so that F at a sample is J J0^-1, det F = det J / det J0, and the volume-weighted mean of F is sum_a x_a (x) G_a: both
integrands are polynomials that the quadrature integrates exactly.

For surfaces in space det J0 is |T_1 x T_2|, and F = sum_a x_a (x) G_a + n (x) N with the unit normals n and N.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.mesh.blocks import KindBlock
from pipeline.mesh.quadrature import Quadrature, find_quadrature, find_samples
from pipeline.mesh.simplex import compute_shape_gradients

_AT_A_TIME = 2048  # cells: intermediate arrays stay small
_DEGENERATE = 1e-9  # of the mean det: below it F is noise, as at corners where nodes of a cell coincide


@dataclass(frozen=True, eq=False, repr=False)
class RestBlock:
    """A block with its rest state: signed `volumes` (m,), and at the p samples 1 / det J0 `inverse` (m, p).

    `inverse` is NaN at degenerate samples, which are left out. `gradients` (m, k, c) are G_a; `normals` (m, p, 3) are
    w det J0 N / V0 of surfaces in space, else empty.
    """

    block: KindBlock
    samples: Quadrature
    derivatives: Floats  # (p, k, dimension)
    volumes: Floats
    inverse: Floats
    gradients: Floats
    normals: Floats

    @property
    def connectivity(self) -> Ints:
        """Return the nodes of the cells (m, k)."""
        return self.block.connectivity

    @property
    def folded_cells(self) -> Ints:
        """Return the places in the block of cells whose map is folded at rest: det J0 changes its sign."""
        return np.flatnonzero((self.inverse * self.volumes[:, None] < 0).any(axis=1))

    @property
    def degenerate_cells(self) -> Ints:
        """Return the places in the block of cells that have degenerate samples."""
        return np.flatnonzero(np.isnan(self.inverse).any(axis=1))


def measure_block(points: Floats, block: KindBlock, purpose: str = "volume") -> Floats:
    """Return the volumes (m,) of a block by its exact quadrature; signed unless these are surfaces in space."""
    points_, weights = find_quadrature(block.kind, purpose)
    derivatives, total = block.kind.differentiate(points_), np.empty(len(block.cells))
    for part, X in _iterate_parts(points, block):
        total[part] = _compute_dets(_compute_jacobians(X, derivatives)) @ weights
    return total


def share_among_nodes(points: Floats, block: KindBlock) -> Floats:
    """Return the integral of every shape function over every cell of a block (m, k)."""
    surface = points.shape[1] > block.kind.dimension
    at, weights = find_quadrature(block.kind, "surface" if surface else "nodes")
    derivatives, shares = block.kind.differentiate(at), np.empty(block.connectivity.shape)
    values = block.kind.evaluate(at) * weights[:, None]
    for part, X in _iterate_parts(points, block):
        shares[part] = _compute_dets(_compute_jacobians(X, derivatives)) @ values
    return shares


def prepare_block(points: Floats, block: KindBlock) -> RestBlock:
    """Return the rest state of a block at points (n, c); cells of dimension 2 in space are surfaces."""
    m, (k, d), c = len(block.cells), block.kind.nodes.shape, points.shape[1]
    samples = find_samples(block.kind, "surface" if c > d else "volume")
    derivatives = block.kind.differentiate(samples.points)
    volumes, inverse = np.empty(m), np.empty((m, len(samples.weights)))
    gradients, normals = np.empty((m, k, c)), np.zeros((m, len(samples.weights) if c > d else 0, 3))
    for part, X in _iterate_parts(points, block):
        J = _compute_jacobians(X, derivatives)
        dets = _compute_dets(J)
        volume = volumes[part] = dets @ samples.weights
        scale = np.abs(dets).max(axis=1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse[part] = np.where(np.abs(dets) > _DEGENERATE * scale, 1 / dets, np.nan)
            shares = samples.weights / volume[:, None]
        cofactors = shares[:, :, None, None] * _compute_cofactors(J, dets)
        flat = np.swapaxes(cofactors, 1, 2).reshape(len(X) * c, -1) @ np.swapaxes(derivatives, 1, 2).reshape(-1, k)
        gradients[part] = np.swapaxes(flat.reshape(len(X), c, k), 1, 2)
        if c > d:
            normals[part] = shares[:, :, None] * np.cross(J[..., 0], J[..., 1])
    if block.kind.is_linear_simplex and c == d:  # the same to rounding, but with the bits of a mesh of simplices
        gradients = compute_shape_gradients(points, block.connectivity)
    return RestBlock(block, samples, derivatives, volumes, inverse, gradients, normals)


def _iterate_parts(points: Floats, block: KindBlock) -> list[tuple[slice, Floats]]:
    """Return slices of the block and their nodes relative to the first one of each cell (…, k, c)."""
    parts = []
    for first in range(0, len(block.cells), _AT_A_TIME):
        part = slice(first, min(first + _AT_A_TIME, len(block.cells)))
        nodes = block.connectivity[part]
        parts.append((part, points[nodes] - points[nodes[:, :1]]))
    return parts


def _compute_jacobians(X: Floats, derivatives: Floats) -> Floats:
    """Return dX/dxi (m, q, c, d) of cells X (m, k, c)."""
    q, k, d = derivatives.shape
    flat = np.swapaxes(X, 1, 2).reshape(-1, k) @ np.swapaxes(derivatives, 0, 1).reshape(k, q * d)
    return np.ascontiguousarray(np.swapaxes(flat.reshape(len(X), X.shape[2], q, d), 1, 2))


def _compute_dets(J: Floats) -> Floats:
    """Return det J (m, q), or |t_1 x t_2| of surfaces in space."""
    if J.shape[-1] == 3:
        return np.asarray(np.einsum("mqc,mqc->mq", J[..., 0], np.cross(J[..., 1], J[..., 2])))
    if J.shape[-2] == 2:
        return np.asarray(J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0])
    return np.linalg.norm(np.cross(J[..., 0], J[..., 1]), axis=-1)


def _compute_cofactors(J: Floats, dets: Floats) -> Floats:
    """Return det J times the inverse transpose of J (m, q, c, d); of surfaces, that of the tangent plane."""
    if J.shape[-1] == 3:
        a, b, c = J[..., 0], J[..., 1], J[..., 2]
        return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)
    if J.shape[-2] == 2:
        a, b = J[..., 0], J[..., 1]
        columns = [np.stack([b[..., 1], -b[..., 0]], axis=-1), np.stack([-a[..., 1], a[..., 0]], axis=-1)]
        return np.stack(columns, axis=-1)
    a, b = J[..., 0], J[..., 1]
    aa, ab, bb = ((u * v).sum(axis=-1, keepdims=True) for u, v in ((a, a), (a, b), (b, b)))
    safe = np.where(dets > 0, dets, 1.0)[:, :, None]  # flat surfaces are refused afterwards
    return np.stack([(bb * a - ab * b) / safe, (aa * b - ab * a) / safe], axis=-1)
