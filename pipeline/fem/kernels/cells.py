r"""Compiled: measures of cells with shape functions; see mesh/rest_cells.py for the equations at rest.

    J(xi) = sum_a x_a (x) dN_a/dxi,   V = sum_q w_q det J(xi_q),   det F(xi_q) = det J(xi_q) / det J0(xi_q)

LANES cells are computed at once, entries first, as in rotation.py; positions are relative to each cell's first node,
so that a body far from the origin loses no more digits than its positions have. Numba does not notice changes in
rotation.py, which is compiled into this file: `make clean`.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.rotation import LANES, allocate_lanes, find_polar_rotations

MOST_NODES = 125  # of a cell: hexahedra of order 4


@njit(cache=True, error_model="numpy", nogil=True)
def _gather(x, connectivity, first, count, X):
    """Write the positions of the nodes of `count` cells, relative to the first node, into X (k, c, LANES)."""
    k, c = X.shape[:2]
    for l in range(count):
        origin = connectivity[first + l, 0]
        for a in range(1, k):
            node = connectivity[first + l, a]
            for i in range(c):
                X[a, i, l] = x[node, i] - x[origin, i]


@njit(cache=True, error_model="numpy", nogil=True)
def _accumulate_volume(X, D, J):
    """Write J = sum_a x_a (x) D_a into J (3, 3, LANES), D (k, 3); written out: a position is loaded once for all."""
    J[:] = 0.0
    for a in range(1, X.shape[0]):
        d0, d1, d2 = D[a, 0], D[a, 1], D[a, 2]
        for i in range(3):
            for l in range(LANES):
                x = X[a, i, l]
                J[i, 0, l] += x * d0
                J[i, 1, l] += x * d1
                J[i, 2, l] += x * d2


@njit(cache=True, error_model="numpy", nogil=True)
def _accumulate_area(X, D, J):
    """Do the same for cells of dimension 2: J (c, 2, LANES), D (k, 2)."""
    J[:] = 0.0
    for a in range(1, X.shape[0]):
        d0, d1 = D[a, 0], D[a, 1]
        for i in range(X.shape[1]):
            for l in range(LANES):
                x = X[a, i, l]
                J[i, 0, l] += x * d0
                J[i, 1, l] += x * d1


@njit(cache=True, error_model="numpy", nogil=True)
def _sample(dets, weight, inverse, first, count, q, total, low, high):
    """Add weighted dets (LANES,) to the total, and extend the extremes of det F at sample q; NaN leaves them."""
    for l in range(count):
        total[l] += weight * dets[l]
        ratio = dets[l] * inverse[first + l, q]
        low[l] = ratio if ratio < low[l] else low[l]
        high[l] = ratio if ratio > high[l] else high[l]


@njit(cache=True, error_model="numpy", nogil=True)
def _store(cells, first, count, total, low, high, volumes, ratio_min, ratio_max):
    """Write the results of the lanes; NaN of a volume spreads to the extremes."""
    for l in range(count):
        cell = cells[first + l]
        volumes[cell], lost = total[l], 0.0 * total[l]
        ratio_min[cell], ratio_max[cell] = low[l] + lost, high[l] + lost


@njit(cache=True, error_model="numpy", nogil=True)
def store_angles(cells, first, count, total, R, angles):
    """Write the angles of the rotations R (9, LANES): 2 sin and 2 cos are |axial(R - R^T)| and tr R - 1."""
    for l in range(count):
        a0, a1, a2 = R[7, l] - R[5, l], R[2, l] - R[6, l], R[3, l] - R[1, l]
        sine, cosine = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2), R[0, l] + R[4, l] + R[8, l] - 1.0
        angles[cells[first + l]] = np.arctan2(sine, cosine) + 0.0 * total[l]


@njit(cache=True, error_model="numpy", nogil=True)
def _average(X, gradients, first, count, F):
    """Write the mean of F, sum_a x_a (x) G_a, into F (9, LANES), in space."""
    k = X.shape[0]
    for l in range(count):
        for i in range(3):
            f0, f1, f2 = 0.0, 0.0, 0.0
            for a in range(1, k):
                x = X[a, i, l]
                f0 += x * gradients[first + l, a, 0]
                f1 += x * gradients[first + l, a, 1]
                f2 += x * gradients[first + l, a, 2]
            F[3 * i, l], F[3 * i + 1, l], F[3 * i + 2, l] = f0, f1, f2


@njit(cache=True, error_model="numpy", nogil=True)
def measure_solids(
    x, cells, connectivity, derivatives, weights, inverse, gradients, volumes, ratio_min, ratio_max, angles
):
    """Write the measures of solid cells into places `cells` of the outputs; x (n, 3), the rest as in RestBlock."""
    F, R, _, dets, root, good, C = allocate_lanes()
    X, J = np.zeros((MOST_NODES, 3, LANES))[: connectivity.shape[1]], np.zeros((3, 3, LANES))
    total, low, high = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for first in range(0, len(cells), LANES):
        count = min(LANES, len(cells) - first)
        _gather(x, connectivity, first, count, X)
        total[:], low[:], high[:] = 0.0, np.inf, -np.inf
        for q in range(len(weights)):
            _accumulate_volume(X, derivatives[q], J)
            for l in range(LANES):
                det = J[0, 0, l] * (J[1, 1, l] * J[2, 2, l] - J[1, 2, l] * J[2, 1, l])
                det -= J[0, 1, l] * (J[1, 0, l] * J[2, 2, l] - J[1, 2, l] * J[2, 0, l])
                dets[l] = det + J[0, 2, l] * (J[1, 0, l] * J[2, 1, l] - J[1, 1, l] * J[2, 0, l])
            _sample(dets, weights[q], inverse, first, count, q, total, low, high)
        _average(X, gradients, first, count, F)
        find_polar_rotations(F, count, R, root, good, C)
        _store(cells, first, count, total, low, high, volumes, ratio_min, ratio_max)
        store_angles(cells, first, count, total, R, angles)


@njit(cache=True, error_model="numpy", nogil=True)
def measure_planar(
    x, cells, connectivity, derivatives, weights, inverse, gradients, volumes, ratio_min, ratio_max, angles
):
    """Write the measures of planar cells into places `cells` of the outputs; x (n, 2), the rest as in RestBlock."""
    k, dets = connectivity.shape[1], np.zeros(LANES)
    X, J = np.zeros((MOST_NODES, 2, LANES))[:k], np.zeros((2, 2, LANES))
    total, low, high = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for first in range(0, len(cells), LANES):
        count = min(LANES, len(cells) - first)
        _gather(x, connectivity, first, count, X)
        total[:], low[:], high[:] = 0.0, np.inf, -np.inf
        for q in range(len(weights)):
            _accumulate_area(X, derivatives[q], J)
            for l in range(LANES):
                dets[l] = J[0, 0, l] * J[1, 1, l] - J[0, 1, l] * J[1, 0, l]
            _sample(dets, weights[q], inverse, first, count, q, total, low, high)
        _store(cells, first, count, total, low, high, volumes, ratio_min, ratio_max)
        for l in range(count):
            cosine, sine = 0.0, 0.0  # of the rotation closest to the mean of F, times a length
            for a in range(1, k):
                g0, g1 = gradients[first + l, a, 0], gradients[first + l, a, 1]
                cosine += X[a, 0, l] * g0 + X[a, 1, l] * g1
                sine += X[a, 1, l] * g0 - X[a, 0, l] * g1
            angles[cells[first + l]] = abs(np.arctan2(sine, cosine)) + 0.0 * total[l]


@njit(cache=True, error_model="numpy", nogil=True)
def measure_surfaces(
    x, cells, connectivity, derivatives, weights, inverse, gradients, normals, volumes, ratio_min, ratio_max, angles
):
    """Write the measures of surfaces in space into places `cells` of the outputs; x (n, 3), the rest as in RestBlock.

    The mean of F is that of the tangents plus the weighted mean of n (x) N.
    """
    F, R, normal, dets, root, good, C = allocate_lanes()
    X, J = np.zeros((MOST_NODES, 3, LANES))[: connectivity.shape[1]], np.zeros((3, 2, LANES))
    P = np.zeros((9, LANES))
    total, low, high = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for first in range(0, len(cells), LANES):
        count = min(LANES, len(cells) - first)
        _gather(x, connectivity, first, count, X)
        total[:], low[:], high[:], P[:] = 0.0, np.inf, -np.inf, 0.0
        for q in range(len(weights)):
            _accumulate_area(X, derivatives[q], J)
            for l in range(LANES):
                n0 = J[1, 0, l] * J[2, 1, l] - J[2, 0, l] * J[1, 1, l]
                n1 = J[2, 0, l] * J[0, 1, l] - J[0, 0, l] * J[2, 1, l]
                n2 = J[0, 0, l] * J[1, 1, l] - J[1, 0, l] * J[0, 1, l]
                area = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
                scale = 1.0 / area if area > 0.0 else 0.0
                dets[l], normal[0, l], normal[1, l], normal[2, l] = area, n0 * scale, n1 * scale, n2 * scale
            _sample(dets, weights[q], inverse, first, count, q, total, low, high)
            if weights[q] != 0.0:
                for l in range(count):
                    for i in range(3):
                        for j in range(3):
                            P[3 * i + j, l] += normal[i, l] * normals[first + l, q, j]
        _average(X, gradients, first, count, F)
        F += P
        find_polar_rotations(F, count, R, root, good, C)
        _store(cells, first, count, total, low, high, volumes, ratio_min, ratio_max)
        store_angles(cells, first, count, total, R, angles)
