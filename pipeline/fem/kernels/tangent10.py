"""Compiled: the difference between the exact and the frozen tangent in tetrahedra of order 2; see tangent.py.

Numba does not notice changes in the modules that are compiled into this file: `make clean`.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.rotation import LANES, allocate_lanes, find_polar_rotations
from pipeline.fem.kernels.tangent import find_rotation_factors, measure_stretch
from pipeline.fem.kernels.tetrahedron10 import NODES, WIDTH, average_dilatations, compute_gradients


@njit(cache=True, error_model="numpy", nogil=True)
def _cross_gradients(G, R, lane, w):
    """Write R (q x grad N_b) of a point into w (3, WIDTH): q = e_0, e_1, e_2, entry 3 b + i; nodes sum to zero."""
    for i in range(3):
        r0, r1, r2 = R[3 * i, lane], R[3 * i + 1, lane], R[3 * i + 2, lane]
        w[0, i] = w[1, i] = w[2, i] = 0.0
        for b in range(NODES - 1):
            g0, g1, g2 = G[3 * b, lane], G[3 * b + 1, lane], G[3 * b + 2, lane]
            k = 3 * b + 3 + i
            w[0, k], w[1, k], w[2, k] = r2 * g1 - r1 * g2, r0 * g2 - r2 * g0, r1 * g0 - r0 * g1
            for m in range(3):
                w[m, i] -= w[m, k]


@njit(cache=True, error_model="numpy", nogil=True)
def _add_squares(factor, H, w, T):
    """Add factor w^T H w to the blocks of T (30, WIDTH) on and below the diagonal, three rows at once."""
    w0, w1, w2 = w[0], w[1], w[2]
    h00, h01, h02 = factor * H[0, 0], factor * H[0, 1], factor * H[0, 2]
    h11, h12, h22 = factor * H[1, 1], factor * H[1, 2], factor * H[2, 2]
    for r in range(0, 3 * NODES, 3):
        u0, u1, u2 = w0[r], w1[r], w2[r]
        a0, a1, a2 = u0 * h00 + u1 * h01 + u2 * h02, u0 * h01 + u1 * h11 + u2 * h12, u0 * h02 + u1 * h12 + u2 * h22
        u0, u1, u2 = w0[r + 1], w1[r + 1], w2[r + 1]
        b0, b1, b2 = u0 * h00 + u1 * h01 + u2 * h02, u0 * h01 + u1 * h11 + u2 * h12, u0 * h02 + u1 * h12 + u2 * h22
        u0, u1, u2 = w0[r + 2], w1[r + 2], w2[r + 2]
        c0, c1, c2 = u0 * h00 + u1 * h01 + u2 * h02, u0 * h01 + u1 * h11 + u2 * h12, u0 * h02 + u1 * h12 + u2 * h22
        for c in range((r + 10) // 8 * 8):
            T[r, c] += a0 * w0[c] + a1 * w1[c] + a2 * w2[c]
            T[r + 1, c] += b0 * w0[c] + b1 * w1[c] + b2 * w2[c]
            T[r + 2, c] += c0 * w0[c] + c1 * w1[c] + c2 * w2[c]


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter(T, blocks, A):
    """Add T (30, WIDTH) to the 55 blocks (a, b <= a) of a cell."""
    k = 0
    for a in range(NODES):
        for b in range(a + 1):
            block = A[blocks[k]]
            k += 1
            for i in range(3):
                for j in range(3):
                    block[i, j] += T[3 * a + i, 3 * b + j]


@njit(cache=True, error_model="numpy", nogil=True)
def add_rotation_stiffness(x, cells, G, weights, mu, lam, is_mean, pairs, scale, crease, projected, A):
    """Add scale times the term of tangent.py to A (blocks, 3, 3); `projected` leaves out negative factors."""
    F, R, _, theta, root, good, C = allocate_lanes()
    D, (e, q) = np.zeros((3 * (NODES - 1), LANES)), weights.shape
    S, Q, H = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    w, T = np.zeros((3, WIDTH)), np.zeros((3 * NODES, WIDTH))
    for first in range(0, e * q, LANES):
        count = min(LANES, e * q - first)
        compute_gradients(x, cells, G[first // LANES], first, q, D, F)
        find_polar_rotations(F, count, R, root, good, C)
        row = min(first // LANES, len(mu) - 1)
        if is_mean:
            average_dilatations(F, R, weights, first, count, theta)
        for l in range(count):
            n, point = (first + l) // q, (first + l) % q
            dilatation = measure_stretch(F, R, l, S) - 3.0
            if is_mean:
                dilatation = theta[l]
            m = mu[row, l]
            find_rotation_factors(S, m, lam[row, l] * dilatation - 2.0 * m, crease, projected, Q, H)
            _cross_gradients(G[first // LANES], R, l, w)
            if point == 0:
                T[:] = 0.0
            _add_squares(scale * weights[n, point], H, w, T)
            if point == q - 1:
                _scatter(T, pairs[n], A)
