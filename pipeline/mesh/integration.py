r"""Integration over the cells of a mesh: sums over points, with the gradients of the shape functions there.

int f dV = sum_q w_q f(xi_q),   w_q = (weight of the rule) det J0,   grad N_a = J0^-T dN_a/dxi,   J0 = dX/dxi
"""

from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.mesh.quadrature import Quadrature
from pipeline.mesh.shape_functions import CellKind


class Integration(NamedTuple):
    """Of every cell: w_q (e, q) [m3; m2 in the plane], and grad N_a at the points (e, q, k, d) [1/m]."""

    weights: Floats
    gradients: Floats


def integrate_cells(points: Floats, cells: Ints, kind: CellKind, rule: Quadrature) -> Integration:
    """Return the integration of cells (e, k) of one kind; a negative weight shows a map that is folded there."""
    derivatives = kind.differentiate(rule.points)
    X = np.swapaxes(points[cells] - points[cells[:, :1]], 1, 2)
    J = X[:, None] @ derivatives  # (e, q, d, d)
    with np.errstate(divide="ignore", invalid="ignore"):
        det = np.linalg.det(J)
        inverse = np.linalg.inv(np.where((det != 0)[..., None, None], J, np.eye(kind.dimension)))
    return Integration(det * rule.weights, derivatives @ inverse)


def integrate_products(points: Floats, cells: Ints, kind: CellKind, rule: Quadrature) -> Floats:
    """Return int N_a N_b dV (e, k, k) [m3; m2 in the plane] of cells (e, k) of one kind."""
    weights, _ = integrate_cells(points, cells, kind, rule)
    N = kind.evaluate(rule.points)
    products = (N[:, :, None] * N[:, None, :]).reshape(len(N), -1)
    return (weights @ products).reshape(len(cells), len(kind.nodes), len(kind.nodes))
