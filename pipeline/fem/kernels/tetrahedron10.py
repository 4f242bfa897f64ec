"""Compiled kernels for tetrahedra of order 2 with the corotational or the linear law, on one thread.

Names and arguments are those of tetrahedron.py, whose stresses they use, but lanes are integration points: LANES at
once, q per cell, where `weights` (e, q) are w_q and G (blocks, 27, LANES) their gradients: entry 3 a + j is component j
at node a + 1. q is 4 or 8, so that no cell is split between blocks of lanes.

Rotations are one per point, or one per cell if there are only e of them. `is_mean` replaces the dilatation of points by
the mean over their cell (fem/body.py).
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.rotation import (
    LANES,
    allocate_lanes,
    find_rotations,
    polar_rotations,
    store_lanes,
)
from pipeline.fem.kernels.tetrahedron import compute_stresses

NODES = 10
_ENTRIES = 3 * (NODES - 1)
WIDTH = 32  # room for 3 NODES columns in whole vectors


@njit(cache=True, error_model="numpy", nogil=True)
def compute_gradients(x, cells, G, first, q, D, F):
    """Write F = sum_a (x_a - x_0) (x) grad N_a of LANES points from `first` on into F (9, LANES).

    The differences D (27, LANES) are scratch.
    """
    for c in range(LANES // q):
        cell = cells[first // q + c]
        x0, x1, x2 = x[cell[0], 0], x[cell[0], 1], x[cell[0], 2]
        for a in range(NODES - 1):
            n = cell[a + 1]
            d0, d1, d2 = x[n, 0] - x0, x[n, 1] - x1, x[n, 2] - x2
            for l in range(c * q, (c + 1) * q):
                D[3 * a, l], D[3 * a + 1, l], D[3 * a + 2, l] = d0, d1, d2
    F[:] = 0.0
    for a in range(NODES - 1):
        for i in range(3):
            for j in range(3):
                for l in range(LANES):
                    F[3 * i + j, l] += D[3 * a + i, l] * G[3 * a + j, l]


@njit(cache=True, error_model="numpy", nogil=True)
def average_dilatations(F, R, weights, first, count, theta):
    """Write the means over cells of tr(R^T F - I) into theta (LANES,) at each of their points."""
    q = weights.shape[1]
    for c in range(count // q):
        volume = total = 0.0
        for l in range(c * q, (c + 1) * q):
            w, trace = weights[first // q + c, l - c * q], -3.0
            for k in range(9):
                trace += R[k, l] * F[k, l]
            volume, total = volume + w, total + w * trace
        for l in range(c * q, (c + 1) * q):
            theta[l] = total / volume


@njit(cache=True, error_model="numpy", nogil=True)
def _compute_stresses(F, R, weights, first, count, mu, lam, is_mean, theta, P, W):
    """Write P and W of LANES points, with the mean dilatation theta (LANES,), which is written, if is_mean."""
    if not is_mean:
        compute_stresses(F, R, mu, lam, P, W)
        return
    theta[:] = 0.0
    compute_stresses(F, R, mu, theta, P, W)  # without the part of lam
    average_dilatations(F, R, weights, first, count, theta)
    for k in range(9):
        for l in range(LANES):
            P[k, l] += lam[l] * theta[l] * R[k, l]
    for l in range(LANES):
        W[l] += 0.5 * lam[l] * theta[l] * theta[l]


@njit(cache=True, error_model="numpy", nogil=True)
def _set_rotations(has_rotations, Rs, weights, first, count, rotation, F, R, root, good, C):
    """Write the rotations of `count` points into R (9, LANES): those of F, or Rs (s, 3, 3) of points or of cells."""
    if not has_rotations:
        find_rotations(rotation, F, count, R, root, good, C)
        return
    e, q = weights.shape
    points = q if len(Rs) == e else 1  # of each of Rs
    for l in range(count):
        site = Rs[(first + l) // points]
        for i in range(3):
            for j in range(3):
                R[3 * i + j, l] = site[i, j]


@njit(cache=True, error_model="numpy", nogil=True)
def energy(x, cells, G, weights, mu, lam, is_mean, rotation, has_rotations, Rs):
    """Return sum w W(F), with the rotations Rs (s, 3, 3) if has_rotations, else those of x."""
    F, R, P, W, root, good, C = allocate_lanes()
    D, (e, q), total = np.zeros((_ENTRIES, LANES)), weights.shape, 0.0
    for first in range(0, e * q, LANES):
        count = min(LANES, e * q - first)
        compute_gradients(x, cells, G[first // LANES], first, q, D, F)
        _set_rotations(has_rotations, Rs, weights, first, count, rotation, F, R, root, good, C)
        row = min(first // LANES, len(mu) - 1)
        _compute_stresses(F, R, weights, first, count, mu[row], lam[row], is_mean, D[0], P, W)
        for l in range(count):
            p = first + l
            total += weights[p // q, p % q] * W[l]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_forces(cells, G, weights, P, first, count, D, f):
    """Add -w P grad N_a to the forces at the nodes of `count` points, whose sum over each cell is zero."""
    q = weights.shape[1]
    for l in range(count):
        w = weights[(first + l) // q, (first + l) % q]
        for k in range(9):
            P[k, l] *= w
    for a in range(NODES - 1):
        for i in range(3):
            for l in range(LANES):
                D[3 * a + i, l] = (
                    P[3 * i, l] * G[3 * a, l] + P[3 * i + 1, l] * G[3 * a + 1, l] + P[3 * i + 2, l] * G[3 * a + 2, l]
                )
    for c in range(count // q):
        cell = cells[first // q + c]
        for i in range(3):
            last = 0.0
            for a in range(NODES - 1):
                total = 0.0
                for l in range(c * q, (c + 1) * q):
                    total += D[3 * a + i, l]
                f[cell[a + 1], i] -= total
                last += total
            f[cell[0], i] += last


@njit(cache=True, error_model="numpy", nogil=True)
def force(x, cells, G, weights, mu, lam, is_mean, rotation, has_rotations, Rs, f):
    """Write f_a = -sum w P grad N_a into f (n, 3), with the rotations Rs (s, 3, 3) if has_rotations."""
    f[:] = 0.0
    F, R, P, W, root, good, C = allocate_lanes()
    D, (e, q) = np.zeros((_ENTRIES, LANES)), weights.shape
    for first in range(0, e * q, LANES):
        count = min(LANES, e * q - first)
        compute_gradients(x, cells, G[first // LANES], first, q, D, F)
        _set_rotations(has_rotations, Rs, weights, first, count, rotation, F, R, root, good, C)
        row = min(first // LANES, len(mu) - 1)
        _compute_stresses(F, R, weights, first, count, mu[row], lam[row], is_mean, D[0], P, W)
        _scatter_forces(cells, G[first // LANES], weights, P, first, count, D, f)


@njit(cache=True, error_model="numpy", nogil=True)
def _rotate_gradients(G, R, D, g):
    """Write R grad N_a of every point into g (LANES, WIDTH): entry 3 a + i; those of the first node close the sum."""
    for a in range(NODES - 1):
        for i in range(3):
            for l in range(LANES):
                D[3 * a + i, l] = (
                    R[3 * i, l] * G[3 * a, l] + R[3 * i + 1, l] * G[3 * a + 1, l] + R[3 * i + 2, l] * G[3 * a + 2, l]
                )
    for l in range(LANES):
        for i in range(3):
            total = 0.0
            for a in range(NODES - 1):
                g[l, 3 * a + 3 + i] = D[3 * a + i, l]
                total += D[3 * a + i, l]
            g[l, i] = -total


@njit(cache=True, error_model="numpy", nogil=True)
def _multiply_gradients(g, weights, first, T):
    """Write sum w g_a (x) g_b, b <= a, into T (30, WIDTH): g (LANES, WIDTH) at the points of a cell from `first` on.

    Four points and three rows at once, and whole vectors of columns, take half the time of plain loops.
    """
    for p in range(0, len(weights), 4):
        h0, h1, h2, h3 = g[first + p], g[first + p + 1], g[first + p + 2], g[first + p + 3]
        w0, w1, w2, w3 = weights[p], weights[p + 1], weights[p + 2], weights[p + 3]
        for r in range(0, 3 * NODES, 3):
            a0, a1, a2, a3 = w0 * h0[r], w1 * h1[r], w2 * h2[r], w3 * h3[r]
            b0, b1, b2, b3 = w0 * h0[r + 1], w1 * h1[r + 1], w2 * h2[r + 1], w3 * h3[r + 1]
            c0, c1, c2, c3 = w0 * h0[r + 2], w1 * h1[r + 2], w2 * h2[r + 2], w3 * h3[r + 2]
            columns = (r + 10) // 8 * 8
            if p == 0:
                for c in range(columns):
                    T[r, c] = a0 * h0[c] + a1 * h1[c] + a2 * h2[c] + a3 * h3[c]
                    T[r + 1, c] = b0 * h0[c] + b1 * h1[c] + b2 * h2[c] + b3 * h3[c]
                    T[r + 2, c] = c0 * h0[c] + c1 * h1[c] + c2 * h2[c] + c3 * h3[c]
            else:
                for c in range(columns):
                    T[r, c] += a0 * h0[c] + a1 * h1[c] + a2 * h2[c] + a3 * h3[c]
                    T[r + 1, c] += b0 * h0[c] + b1 * h1[c] + b2 * h2[c] + b3 * h3[c]
                    T[r + 2, c] += c0 * h0[c] + c1 * h1[c] + c2 * h2[c] + c3 * h3[c]


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_stiffness(T, mu, lam, blocks, A):
    """Add mu tr(T_ab) I + mu T_ab^T + lam T_ab to the blocks (a, b <= a) of a cell."""
    k, both = 0, lam + mu
    for i in range(0, 3 * NODES, 3):
        for j in range(0, i + 3, 3):
            block = A[blocks[k]]
            k += 1
            t00, t01, t02 = T[i, j], T[i, j + 1], T[i, j + 2]
            t10, t11, t12 = T[i + 1, j], T[i + 1, j + 1], T[i + 1, j + 2]
            t20, t21, t22 = T[i + 2, j], T[i + 2, j + 1], T[i + 2, j + 2]
            dot = mu * (t00 + t11 + t22)
            block[0, 0] += dot + both * t00
            block[0, 1] += lam * t01 + mu * t10
            block[0, 2] += lam * t02 + mu * t20
            block[1, 0] += lam * t10 + mu * t01
            block[1, 1] += dot + both * t11
            block[1, 2] += lam * t12 + mu * t21
            block[2, 0] += lam * t20 + mu * t02
            block[2, 1] += lam * t21 + mu * t12
            block[2, 2] += dot + both * t22


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_mean_stiffness(g, weights, first, lam, blocks, total, A):
    """Add lam/V G_a (x) G_b to the blocks (a, b <= a) of a cell, G_a = sum w g_a; `total` (WIDTH,) is scratch."""
    total[:] = 0.0
    volume = 0.0
    for l in range(len(weights)):
        volume += weights[l]
        for c in range(3 * NODES):
            total[c] += weights[l] * g[first + l, c]
    k = 0
    for a in range(NODES):
        for b in range(a + 1):
            block = A[blocks[k]]
            k += 1
            for m in range(3):
                for n in range(3):
                    block[m, n] += lam / volume * total[3 * a + m] * total[3 * b + n]


@njit(cache=True, error_model="numpy", nogil=True)
def linearize(x, cells, G, weights, mu, lam, is_mean, rotation, pairs, scale, has_rotations, Rs, f, A):
    """Write the forces into f (n, 3) and add scale times the frozen stiffness to A (blocks, 3, 3).

    The rotations are Rs (s, 3, 3) if has_rotations, else those of x.
    """
    f[:] = 0.0
    F, R, P, W, root, good, C = allocate_lanes()
    D, (e, q) = np.zeros((_ENTRIES, LANES)), weights.shape
    g, T = np.zeros((LANES, WIDTH)), np.zeros((3 * NODES, WIDTH))
    for first in range(0, e * q, LANES):
        count = min(LANES, e * q - first)
        compute_gradients(x, cells, G[first // LANES], first, q, D, F)
        _set_rotations(has_rotations, Rs, weights, first, count, rotation, F, R, root, good, C)
        row = min(first // LANES, len(mu) - 1)
        _compute_stresses(F, R, weights, first, count, mu[row], lam[row], is_mean, D[0], P, W)
        _scatter_forces(cells, G[first // LANES], weights, P, first, count, D, f)
        _rotate_gradients(G[first // LANES], R, D, g)
        for c in range(count // q):
            n = first // q + c
            m_scaled, l_scaled = scale * mu[row, c * q], scale * lam[row, c * q]
            _multiply_gradients(g, weights[n], c * q, T)
            _scatter_stiffness(T, m_scaled, 0.0 if is_mean else l_scaled, pairs[n], A)
            if is_mean:
                _scatter_mean_stiffness(g, weights[n], c * q, l_scaled, pairs[n], T[0], A)


@njit(cache=True, error_model="numpy", nogil=True)
def rotations(x, cells, G, q, rotation, R):
    """Write the rotation of every point's F into R (e q, 3, 3); return the smallest trace.

    With the mean gradients of cells and q = 1 these are the rotations of cells.
    """
    F, Q, _, _, root, good, C = allocate_lanes()
    D, least = np.zeros((_ENTRIES, LANES)), 3.0
    for first in range(0, len(R), LANES):
        count = min(LANES, len(R) - first)
        compute_gradients(x, cells, G[first // LANES], first, q, D, F)
        find_rotations(rotation, F, count, Q, root, good, C)
        store_lanes(Q, first, count, R)
        for l in range(count):
            least = min(least, Q[0, l] + Q[4, l] + Q[8, l])
    return least


@njit(cache=True, error_model="numpy", nogil=True)
def nodal_rotations(x, cells, G, weights, R):
    """Write into R (n, 3, 3) the polar rotation of each node's sum of w F."""
    R[:] = 0.0
    F, D, total = np.zeros((9, LANES)), np.zeros((_ENTRIES, LANES)), np.zeros(9)
    e, q = weights.shape
    for first in range(0, e * q, LANES):
        compute_gradients(x, cells, G[first // LANES], first, q, D, F)
        for c in range(min(LANES, e * q - first) // q):
            n = first // q + c
            total[:] = 0.0
            for l in range(q):
                for k in range(9):
                    total[k] += weights[n, l] * F[k, c * q + l]
            for a in range(NODES):
                node = R[cells[n, a]]
                for i in range(3):
                    for j in range(3):
                        node[i, j] += total[3 * i + j]
    polar_rotations(R, R)
