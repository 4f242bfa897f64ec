r"""What the measures of curved cells need of the rest state: volumes, dets at samples, and mean gradients.

    J0 = dX/dxi,  V0 = sum_q w_q det J0(xi_q),  G_a = (1 / V0) sum_q w_q cof(J0) dN_a/dxi

so that F at a sample is J J0^-1, det F = det J / det J0, and the volume-weighted mean of F is sum_a x_a (x) G_a: both
integrands are polynomials that the quadrature integrates exactly.

For surfaces in space det J0 is |T_1 x T_2|, and F = sum_a x_a (x) G_a + n (x) N with the unit normals n and N.
"""

from collections.abc import Iterator
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
        products = [shares * t @ derivatives[:, :, j] for j, t in enumerate(_compute_cofactors(J, dets))]
        gradients[part] = np.moveaxis(sum(products[1:], products[0]), 0, -1)
        if c > d:
            normals[part] = np.moveaxis(shares * _cross(J[0], J[1]), 0, -1)
    if block.kind.is_linear_simplex and c == d:  # the same to rounding, but with the bits of a mesh of simplices
        gradients = compute_shape_gradients(points, block.connectivity)
    return RestBlock(block, samples, derivatives, volumes, inverse, gradients, normals)


def _iterate_parts(points: Floats, block: KindBlock) -> Iterator[tuple[slice, Floats]]:
    """Yield slices of the block and their nodes relative to the first one of each cell, components first (c, …, k)."""
    by_component = np.ascontiguousarray(points.T)
    for first in range(0, len(block.cells), _AT_A_TIME):
        part = slice(first, min(first + _AT_A_TIME, len(block.cells)))
        nodes = block.connectivity[part]
        yield part, by_component[:, nodes] - by_component[:, nodes[:, :1]]


def _compute_jacobians(X: Floats, derivatives: Floats) -> Floats:
    """Return the tangents dX/dxi_j (d, c, m, q) of cells X (c, m, k)."""
    return np.stack([X @ derivatives[:, :, j].T for j in range(derivatives.shape[2])])


def _compute_dets(J: Floats) -> Floats:
    """Return det J (m, q), or |t_1 x t_2| of surfaces in space."""
    if len(J) == 3:
        return np.asarray((J[0] * _cross(J[1], J[2])).sum(axis=0))
    if J.shape[1] == 2:
        return np.asarray(J[0, 0] * J[1, 1] - J[1, 0] * J[0, 1])
    return np.asarray(np.sqrt((_cross(J[0], J[1]) ** 2).sum(axis=0)))


def _compute_cofactors(J: Floats, dets: Floats) -> list[Floats]:
    """Return the columns (c, m, q) of det J times the inverse transpose of J; of surfaces, in the tangent plane."""
    if len(J) == 3:
        return [_cross(J[1], J[2]), _cross(J[2], J[0]), _cross(J[0], J[1])]
    a, b = J
    if J.shape[1] == 2:
        return [np.stack([b[1], -b[0]]), np.stack([-a[1], a[0]])]
    aa, ab, bb = (a * a).sum(axis=0), (a * b).sum(axis=0), (b * b).sum(axis=0)
    safe = np.where(dets > 0, dets, 1.0)  # flat surfaces are refused afterwards
    return [(bb * a - ab * b) / safe, (aa * b - ab * a) / safe]


def _cross(a: Floats, b: Floats) -> Floats:
    """Return a x b, components first."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
