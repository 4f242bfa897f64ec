"""Compiled: what the exact tangent of the corotational law has beyond the frozen one; laws.py says it in numpy.

    dF : dP = … + sum_i (mu + c / A_i) (q_i . a)^2,   a = axial(R^T dF - dF^T R),   (A_i, q_i) of A = tr(S) I - S

For dF = du (x) grad N_b, up to its sign, q . a = R (q x grad N_b) . du. Numba notices changes of this file, not of
kernels.py, whose functions are compiled into these: `make clean` after one.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels import LANES, _gradients, _lanes, _polar, jacobi


@njit(cache=True, error_model="numpy", nogil=True)
def _stretch(F, R, lane, S):
    """Write sym(R^T F) of a lane into S (3, 3)."""
    for i in range(3):
        for j in range(3):
            S[i, j] = R[i, lane] * F[j, lane] + R[3 + i, lane] * F[3 + j, lane] + R[6 + i, lane] * F[6 + j, lane]
    S[0, 1] = S[1, 0] = 0.5 * (S[0, 1] + S[1, 0])
    S[0, 2] = S[2, 0] = 0.5 * (S[0, 2] + S[2, 0])
    S[1, 2] = S[2, 1] = 0.5 * (S[1, 2] + S[2, 1])


@njit(cache=True, error_model="numpy", nogil=True)
def _turned_gradients(G, R, lane, q0, q1, q2, w):
    """Write R (q x grad N_b) of the four corners into w (4, 3); they sum to zero."""
    for b in range(3):
        g0, g1, g2 = G[3 * b, lane], G[3 * b + 1, lane], G[3 * b + 2, lane]
        t0, t1, t2 = q1 * g2 - q2 * g1, q2 * g0 - q0 * g2, q0 * g1 - q1 * g0
        for i in range(3):
            w[b + 1, i] = R[3 * i, lane] * t0 + R[3 * i + 1, lane] * t1 + R[3 * i + 2, lane] * t2
    for i in range(3):
        w[0, i] = -(w[1, i] + w[2, i] + w[3, i])


@njit(cache=True, error_model="numpy", nogil=True)
def add_turning(x, cells, G, V, mu, lam, pairs, scale, crease, projected, A):
    """Add scale times the term above to A (blocks, 3, 3); negative factors are left out if projected."""
    F, R, _, _, root, good, C = _lanes()
    S, Q, w = np.empty((3, 3)), np.empty((3, 3)), np.empty((4, 3))
    for first in range(0, len(V), LANES):
        count = min(LANES, len(V) - first)
        _gradients(x, cells, G[first // LANES], first, R, F)
        _polar(F, count, R, root, good, C)
        for l in range(count):
            e = first + l
            _stretch(F, R, l, S)
            trace = S[0, 0] + S[1, 1] + S[2, 2]
            c = lam * (trace - 3.0) - 2.0 * mu
            jacobi(S, Q)
            for m in range(3):
                factor = mu + c / max(trace - S[m, m], max(abs(c) / (crease * mu), 2.2250738585072014e-308))
                if projected and factor <= 0.0:
                    continue
                _turned_gradients(G[first // LANES], R, l, Q[0, m], Q[1, m], Q[2, m], w)
                _add_square(scale * V[e] * factor, w, pairs[e], A)


@njit(cache=True, error_model="numpy", nogil=True)
def _add_square(factor, w, blocks, A):
    """Add factor w_a w_b^T to the ten blocks (a, b <= a) of a cell."""
    k = 0
    for a in range(4):
        for b in range(a + 1):
            block = A[blocks[k]]
            k += 1
            for i in range(3):
                for j in range(3):
                    block[i, j] += factor * w[a, i] * w[b, j]
