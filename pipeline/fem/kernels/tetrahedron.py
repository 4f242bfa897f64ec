"""Compiled kernels for tetrahedra with the corotational or the linear law, on one thread.

Each does, in one pass over the cells, the work of laws.py, element.py and assembly.py in numpy; tests compare both.
Compiled once per machine (cached beside this file), not once per run. `rotation` is POLAR, GRAM_SCHMIDT or, for the
linear law, IDENTITY.

LANES cells are computed at once, entries first, as in rotation.py, which computes their rotations; gathering from nodes
and scattering to them goes cell by cell. mu and lam are (1, LANES) if all cells have one material, else they have a
row for each block of LANES cells.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.rotation import (
    LANES,
    allocate_lanes,
    find_rotations,
    load_lanes,
    polar_rotations,
    store_lanes,
)


@njit(cache=True, error_model="numpy", nogil=True)
def compute_gradients(x, cells, G, first, D, F):
    """Write F = sum_a (x_a - x_0) (x) grad N_a of LANES cells from `first` on into F (9, LANES).

    G (9, LANES) are their gradients: entry 3 a + j is component j at corner a + 1; the differences D are scratch.
    """
    for l in range(LANES):
        n0, n1, n2, n3 = cells[first + l, 0], cells[first + l, 1], cells[first + l, 2], cells[first + l, 3]
        for i in range(3):
            x0 = x[n0, i]
            D[3 * i, l], D[3 * i + 1, l], D[3 * i + 2, l] = x[n1, i] - x0, x[n2, i] - x0, x[n3, i] - x0
    for i in range(3):
        for j in range(3):
            for l in range(LANES):
                F[3 * i + j, l] = D[3 * i, l] * G[j, l] + D[3 * i + 1, l] * G[3 + j, l] + D[3 * i + 2, l] * G[6 + j, l]


@njit(cache=True, error_model="numpy", nogil=True)
def compute_stresses(F, R, mu, lam, P, W):
    """Write P = R (2 mu eps + lam tr(eps) I), eps = sym(R^T F) - I, and the energy densities W."""
    for l in range(LANES):
        eps00 = R[0, l] * F[0, l] + R[3, l] * F[3, l] + R[6, l] * F[6, l] - 1.0
        eps11 = R[1, l] * F[1, l] + R[4, l] * F[4, l] + R[7, l] * F[7, l] - 1.0
        eps22 = R[2, l] * F[2, l] + R[5, l] * F[5, l] + R[8, l] * F[8, l] - 1.0
        t01 = R[0, l] * F[1, l] + R[3, l] * F[4, l] + R[6, l] * F[7, l]
        t02 = R[0, l] * F[2, l] + R[3, l] * F[5, l] + R[6, l] * F[8, l]
        t12 = R[1, l] * F[2, l] + R[4, l] * F[5, l] + R[7, l] * F[8, l]
        t10 = R[1, l] * F[0, l] + R[4, l] * F[3, l] + R[7, l] * F[6, l]
        t20 = R[2, l] * F[0, l] + R[5, l] * F[3, l] + R[8, l] * F[6, l]
        t21 = R[2, l] * F[1, l] + R[5, l] * F[4, l] + R[8, l] * F[7, l]
        m, pressure = mu[l], lam[l] * (eps00 + eps11 + eps22)
        s00, s11, s22 = 2 * m * eps00 + pressure, 2 * m * eps11 + pressure, 2 * m * eps22 + pressure
        s01, s02, s12 = m * (t01 + t10), m * (t02 + t20), m * (t12 + t21)
        W[l] = 0.5 * (
            s00 * eps00 + s11 * eps11 + s22 * eps22 + s01 * (t01 + t10) + s02 * (t02 + t20) + s12 * (t12 + t21)
        )
        for i in range(0, 9, 3):
            r0, r1, r2 = R[i, l], R[i + 1, l], R[i + 2, l]
            P[i, l] = r0 * s00 + r1 * s01 + r2 * s02
            P[i + 1, l] = r0 * s01 + r1 * s11 + r2 * s12
            P[i + 2, l] = r0 * s02 + r1 * s12 + r2 * s22


@njit(cache=True, error_model="numpy", nogil=True)
def energy(x, cells, G, V, mu, lam, rotation):
    """Return sum V W(F)."""
    F, R, P, W, root, good, C = allocate_lanes()
    total = 0.0
    for first in range(0, len(V), LANES):
        count = min(LANES, len(V) - first)
        compute_gradients(x, cells, G[first // LANES], first, P, F)
        find_rotations(rotation, F, count, R, root, good, C)
        row = min(first // LANES, len(mu) - 1)
        compute_stresses(F, R, mu[row], lam[row], P, W)
        for l in range(count):
            total += V[first + l] * W[l]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_force(cell, G, volume, P, lane, f):
    """Add -V P grad N_a to the forces at the cell's corners, which sum to zero; G is (9, LANES)."""
    last0 = last1 = last2 = 0.0
    for a in range(3):
        g0, g1, g2 = G[3 * a, lane], G[3 * a + 1, lane], G[3 * a + 2, lane]
        p0 = volume * (P[0, lane] * g0 + P[1, lane] * g1 + P[2, lane] * g2)
        p1 = volume * (P[3, lane] * g0 + P[4, lane] * g1 + P[5, lane] * g2)
        p2 = volume * (P[6, lane] * g0 + P[7, lane] * g1 + P[8, lane] * g2)
        node = cell[a + 1]
        f[node, 0] -= p0
        f[node, 1] -= p1
        f[node, 2] -= p2
        last0, last1, last2 = last0 + p0, last1 + p1, last2 + p2
    f[cell[0], 0] += last0
    f[cell[0], 1] += last1
    f[cell[0], 2] += last2


@njit(cache=True, error_model="numpy", nogil=True)
def force(x, cells, G, V, mu, lam, rotation, f):
    """Write f_a = -sum V P grad N_a into f (n, 3)."""
    f[:] = 0.0
    F, R, P, W, root, good, C = allocate_lanes()
    for first in range(0, len(V), LANES):
        count = min(LANES, len(V) - first)
        compute_gradients(x, cells, G[first // LANES], first, P, F)
        find_rotations(rotation, F, count, R, root, good, C)
        row = min(first // LANES, len(mu) - 1)
        compute_stresses(F, R, mu[row], lam[row], P, W)
        for l in range(count):
            _scatter_force(cells[first + l], G[first // LANES], V[first + l], P, l, f)


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_stiffness(G, vm, vl, R, lane, blocks, g, A):
    """Add vm (G_a . G_b) I + vm g_b g_a^T + vl g_a g_b^T, g = R G, to the ten blocks (a, b <= a) of a cell."""
    for i in range(3):
        r0, r1, r2 = R[3 * i, lane], R[3 * i + 1, lane], R[3 * i + 2, lane]
        for a in range(3):
            g[a + 1, i] = r0 * G[3 * a, lane] + r1 * G[3 * a + 1, lane] + r2 * G[3 * a + 2, lane]
        g[0, i] = -(g[1, i] + g[2, i] + g[3, i])
    k = 0
    for a in range(4):
        m0, m1, m2 = vm * g[a, 0], vm * g[a, 1], vm * g[a, 2]
        l0, l1, l2 = vl * g[a, 0], vl * g[a, 1], vl * g[a, 2]
        for b in range(a + 1):
            b0, b1, b2 = g[b, 0], g[b, 1], g[b, 2]
            dot = m0 * b0 + m1 * b1 + m2 * b2
            block = A[blocks[k]]
            k += 1
            block[0, 0] += dot + (m0 + l0) * b0
            block[0, 1] += b0 * m1 + l0 * b1
            block[0, 2] += b0 * m2 + l0 * b2
            block[1, 0] += b1 * m0 + l1 * b0
            block[1, 1] += dot + (m1 + l1) * b1
            block[1, 2] += b1 * m2 + l1 * b2
            block[2, 0] += b2 * m0 + l2 * b0
            block[2, 1] += b2 * m1 + l2 * b1
            block[2, 2] += dot + (m2 + l2) * b2


@njit(cache=True, error_model="numpy", nogil=True)
def linearize(x, cells, G, V, mu, lam, rotation, pairs, scale, has_rotations, Rs, f, A):
    """Write the forces into f (n, 3) and add scale times the frozen stiffness to A (blocks, 3, 3).

    The rotations are Rs (e, 3, 3) if has_rotations, else those of x.
    """
    f[:] = 0.0
    F, R, P, W, root, good, C = allocate_lanes()
    g = np.empty((4, 3))
    for first in range(0, len(V), LANES):
        count = min(LANES, len(V) - first)
        compute_gradients(x, cells, G[first // LANES], first, P, F)
        if has_rotations:
            load_lanes(Rs, first, count, R)
        else:
            find_rotations(rotation, F, count, R, root, good, C)
        row = min(first // LANES, len(mu) - 1)
        compute_stresses(F, R, mu[row], lam[row], P, W)
        for l in range(count):
            e = first + l
            _scatter_force(cells[e], G[first // LANES], V[e], P, l, f)
            vm, vl = scale * V[e] * mu[row, l], scale * V[e] * lam[row, l]
            _scatter_stiffness(G[first // LANES], vm, vl, R, l, pairs[e], g, A)


@njit(cache=True, error_model="numpy", nogil=True)
def rotations(x, cells, G, rotation, R):
    """Write the rotation of every cell's F into R (e, 3, 3); return the smallest trace."""
    F, Q, _, _, root, good, C = allocate_lanes()
    least = 3.0
    for first in range(0, len(R), LANES):
        count = min(LANES, len(R) - first)
        compute_gradients(x, cells, G[first // LANES], first, Q, F)
        find_rotations(rotation, F, count, Q, root, good, C)
        store_lanes(Q, first, count, R)
        for l in range(count):
            least = min(least, Q[0, l] + Q[4, l] + Q[8, l])
    return least


@njit(cache=True, error_model="numpy", nogil=True)
def nodal_rotations(x, cells, G, V, R):
    """Write into R (n, 3, 3) the polar rotation of each node's sum of V F."""
    R[:] = 0.0
    F, D = np.zeros((9, LANES)), np.zeros((9, LANES))
    for first in range(0, len(V), LANES):
        count = min(LANES, len(V) - first)
        compute_gradients(x, cells, G[first // LANES], first, D, F)
        for l in range(count):
            e = first + l
            for a in range(4):
                node = R[cells[e, a]]
                for i in range(3):
                    for j in range(3):
                        node[i, j] += V[e] * F[3 * i + j, l]
    polar_rotations(R, R)
