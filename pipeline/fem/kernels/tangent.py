"""Compiled: the difference between the exact and the frozen tangent of the corotational law; see laws.py for numpy.

    dF : dP = … + a . H a,   a = axial(R^T dF - dF^T R),   H = mu I + c A^-1,   A = tr(S) I - S

The factors mu + c / A_i are bounded; `projected` leaves out negative ones. For dF = du (x) grad N_b, up to its sign,
q . a = R (q x grad N_b) . du for every q.

Numba does not notice changes in rotation.py and tetrahedron.py, which are compiled into this file: `make clean`.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.rotation import LANES, allocate_lanes, find_polar_rotations, jacobi
from pipeline.fem.kernels.tetrahedron import compute_gradients


@njit(cache=True, error_model="numpy", nogil=True)
def measure_stretch(F, R, lane, A):
    """Write A = tr(S) I - S, S = sym(R^T F), of a lane into A (3, 3); return tr(S)."""
    for i in range(3):
        for j in range(3):
            A[i, j] = R[i, lane] * F[j, lane] + R[3 + i, lane] * F[3 + j, lane] + R[6 + i, lane] * F[6 + j, lane]
    A[0, 1] = A[1, 0] = 0.5 * (A[0, 1] + A[1, 0])
    A[0, 2] = A[2, 0] = 0.5 * (A[0, 2] + A[2, 0])
    A[1, 2] = A[2, 1] = 0.5 * (A[1, 2] + A[2, 1])
    trace = A[0, 0] + A[1, 1] + A[2, 2]
    for i in range(3):
        for j in range(3):
            A[i, j] = (trace if i == j else 0.0) - A[i, j]
    return trace


@njit(cache=True, error_model="numpy", nogil=True)
def _is_above(A, least):
    """Return whether all eigenvalues of the symmetric A (3, 3) are above `least`, by the minors of A - least I."""
    a, b, c = A[0, 0] - least, A[1, 1] - least, A[2, 2] - least
    d, e, f = A[0, 1], A[0, 2], A[1, 2]
    return a > 0.0 and a * b - d * d > 0.0 and a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e) > 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def find_rotation_factors(A, mu, c, crease, projected, Q, H):
    """Write H (3, 3) for A, which is overwritten; Q is scratch."""
    least = max(abs(c) / (crease * mu), 2.2250738585072014e-308)
    if _is_above(A, max(least, -c / mu) if projected else least):  # no factor to bound or leave out
        a, b, d = A[1, 1] * A[2, 2] - A[1, 2] ** 2, A[0, 0] * A[2, 2] - A[0, 2] ** 2, A[0, 0] * A[1, 1] - A[0, 1] ** 2
        e, f = A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2], A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
        g = A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
        s = c / (A[0, 0] * a + A[0, 1] * e + A[0, 2] * f)
        H[0, 0], H[1, 1], H[2, 2] = mu + s * a, mu + s * b, mu + s * d
        H[0, 1], H[0, 2], H[1, 2] = s * e, s * f, s * g
        H[1, 0], H[2, 0], H[2, 1] = s * e, s * f, s * g
        return
    jacobi(A, Q)
    H[:] = 0.0
    for m in range(3):
        factor = mu + c / max(A[m, m], least)
        if not (projected and factor <= 0.0):
            for i in range(3):
                for j in range(3):
                    H[i, j] += factor * Q[i, m] * Q[j, m]


@njit(cache=True, error_model="numpy", nogil=True)
def _cross_gradients(G, R, lane, w):
    """Write R (q x grad N_b) into w (4, 3, 3): corners b, components, q = e_0, e_1, e_2; corners sum to zero."""
    for i in range(3):
        r0, r1, r2 = R[3 * i, lane], R[3 * i + 1, lane], R[3 * i + 2, lane]
        for b in range(3):
            g0, g1, g2 = G[3 * b, lane], G[3 * b + 1, lane], G[3 * b + 2, lane]
            w[b + 1, i, 0], w[b + 1, i, 1], w[b + 1, i, 2] = r2 * g1 - r1 * g2, r0 * g2 - r2 * g0, r1 * g0 - r0 * g1
        for m in range(3):
            w[0, i, m] = -(w[1, i, m] + w[2, i, m] + w[3, i, m])


@njit(cache=True, error_model="numpy", nogil=True)
def add_rotation_stiffness(x, cells, G, V, mu, lam, pairs, scale, crease, projected, A):
    """Add scale times the term above to A (blocks, 3, 3); `projected` leaves out negative factors."""
    F, R, _, _, root, good, C = allocate_lanes()
    S, Q, H, w = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((4, 3, 3))
    for first in range(0, len(V), LANES):
        count = min(LANES, len(V) - first)
        compute_gradients(x, cells, G[first // LANES], first, R, F)
        find_polar_rotations(F, count, R, root, good, C)
        row = min(first // LANES, len(mu) - 1)
        for l in range(count):
            trace, m = measure_stretch(F, R, l, S), mu[row, l]
            find_rotation_factors(S, m, lam[row, l] * (trace - 3.0) - 2.0 * m, crease, projected, Q, H)
            _cross_gradients(G[first // LANES], R, l, w)
            _add_squares(scale * V[first + l], H, w, pairs[first + l], A)


@njit(cache=True, error_model="numpy", nogil=True)
def _add_squares(factor, H, w, blocks, A):
    """Add factor w_a H w_b^T to the ten blocks (a, b <= a) of a cell."""
    k = 0
    for a in range(4):
        for b in range(a + 1):
            block = A[blocks[k]]
            k += 1
            for i in range(3):
                h0 = factor * (w[a, i, 0] * H[0, 0] + w[a, i, 1] * H[1, 0] + w[a, i, 2] * H[2, 0])
                h1 = factor * (w[a, i, 0] * H[0, 1] + w[a, i, 1] * H[1, 1] + w[a, i, 2] * H[2, 1])
                h2 = factor * (w[a, i, 0] * H[0, 2] + w[a, i, 1] * H[1, 2] + w[a, i, 2] * H[2, 2])
                for j in range(3):
                    block[i, j] += h0 * w[b, j, 0] + h1 * w[b, j, 1] + h2 * w[b, j, 2]
