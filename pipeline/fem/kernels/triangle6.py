r"""Compiled kernels for triangles of order 2 with the corotational or the linear law; see laws.py and element.py.

Names and arguments are those of tetrahedron10.py, stresses those of triangle.py. `weights` (e, q) are w_q, and
G (e, q, 5, 2) the gradients at the points of all nodes but the first. Rotations are one per point, or one per cell if
there are only e of them.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels import POLAR
from pipeline.fem.kernels.triangle import (
    compute_stress,
    find_polar,
    find_rotation,
    find_rotation_factor,
    load_rotation,
    square_distance,
    store_rotation,
)

NODES = 6


@njit(cache=True, error_model="numpy", nogil=True)
def _gradient(x, cell, G):
    """Return the four entries of F = sum_a (x_a - x_0) (x) grad N_a at one point."""
    x0, y0 = x[cell[0], 0], x[cell[0], 1]
    a = b = c = d = 0.0
    for n in range(NODES - 1):
        dx, dy, g0, g1 = x[cell[n + 1], 0] - x0, x[cell[n + 1], 1] - y0, G[n, 0], G[n, 1]
        a, b, c, d = a + dx * g0, b + dx * g1, c + dy * g0, d + dy * g1
    return a, b, c, d


@njit(cache=True, error_model="numpy", nogil=True)
def _find_rotation(F, rotation, has_rotations, Rs, site):
    """Return cosine and sine of the rotation Rs[site] if has_rotations, else of that of F."""
    return load_rotation(Rs, site) if has_rotations else find_rotation(rotation, F)


@njit(cache=True, error_model="numpy", nogil=True)
def _average_dilatation(x, cell, G, weights, rotation, has_rotations, Rs, first, stride):
    """Return the mean over a cell of tr(R^T F - I); its sites are `first` and those `stride` further on."""
    volume = total = 0.0
    for l in range(len(weights)):
        F = _gradient(x, cell, G[l])
        R = _find_rotation(F, rotation, has_rotations, Rs, first + l * stride)
        volume, total = volume + weights[l], total + weights[l] * _measure_dilatation(F, R)
    return total / volume


@njit(cache=True, error_model="numpy", nogil=True)
def _measure_dilatation(F, R):
    """Return tr(R^T F - I)."""
    return R[0] * (F[0] + F[3]) + R[1] * (F[2] - F[1]) - 2.0


@njit(cache=True, error_model="numpy", nogil=True)
def _compute_stress(F, R, mu, lam, is_mean, theta):
    """Return the four entries of P and W, with the mean dilatation theta if is_mean."""
    if not is_mean:
        return compute_stress(F, R, mu, lam)
    p00, p01, p10, p11, W = compute_stress(F, R, mu, 0.0)
    p, (cosine, sine) = lam * theta, R
    return p00 + p * cosine, p01 - p * sine, p10 + p * sine, p11 + p * cosine, W + 0.5 * p * theta


@njit(cache=True, error_model="numpy", nogil=True)
def energy(x, cells, G, weights, mu, lam, is_mean, rotation, has_rotations, Rs):
    """Return sum w W(F), with the rotations Rs (s, 2, 2) if has_rotations, else those of x."""
    total, theta, (e, q), last = 0.0, 0.0, weights.shape, len(mu) - 1
    for n in range(e):
        first, stride = (n, 0) if len(Rs) == e else (n * q, 1)
        if is_mean:
            theta = _average_dilatation(x, cells[n], G[n], weights[n], rotation, has_rotations, Rs, first, stride)
        for l in range(q):
            F = _gradient(x, cells[n], G[n, l])
            R = _find_rotation(F, rotation, has_rotations, Rs, first + l * stride)
            total += weights[n, l] * _compute_stress(F, R, mu[min(n, last)], lam[min(n, last)], is_mean, theta)[4]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_force(cell, G, weight, P, f):
    """Add -w P grad N_a of one point to the forces at the cell's nodes, which sum to zero."""
    p00, p01, p10, p11, _ = P
    last0 = last1 = 0.0
    for a in range(NODES - 1):
        x, y = weight * (p00 * G[a, 0] + p01 * G[a, 1]), weight * (p10 * G[a, 0] + p11 * G[a, 1])
        f[cell[a + 1], 0] -= x
        f[cell[a + 1], 1] -= y
        last0, last1 = last0 + x, last1 + y
    f[cell[0], 0] += last0
    f[cell[0], 1] += last1


@njit(cache=True, error_model="numpy", nogil=True)
def force(x, cells, G, weights, mu, lam, is_mean, rotation, has_rotations, Rs, f):
    """Write f_a = -sum w P grad N_a into f (n, 2), with the rotations Rs (s, 2, 2) if has_rotations."""
    f[:] = 0.0
    theta, (e, q), last = 0.0, weights.shape, len(mu) - 1
    for n in range(e):
        first, stride = (n, 0) if len(Rs) == e else (n * q, 1)
        if is_mean:
            theta = _average_dilatation(x, cells[n], G[n], weights[n], rotation, has_rotations, Rs, first, stride)
        for l in range(q):
            F = _gradient(x, cells[n], G[n, l])
            R = _find_rotation(F, rotation, has_rotations, Rs, first + l * stride)
            P = _compute_stress(F, R, mu[min(n, last)], lam[min(n, last)], is_mean, theta)
            _scatter_force(cells[n], G[n, l], weights[n, l], P, f)


@njit(cache=True, error_model="numpy", nogil=True)
def _rotate_gradients(G, cosine, sine, g):
    """Write R grad N_a of all nodes at one point into g (6, 2); they sum to zero."""
    g[0, 0] = g[0, 1] = 0.0
    for a in range(NODES - 1):
        g[a + 1, 0], g[a + 1, 1] = cosine * G[a, 0] - sine * G[a, 1], sine * G[a, 0] + cosine * G[a, 1]
        g[0, 0] -= g[a + 1, 0]
        g[0, 1] -= g[a + 1, 1]


@njit(cache=True, error_model="numpy", nogil=True)
def linearize(x, cells, G, weights, mu, lam, is_mean, rotation, pairs, scale, has_rotations, Rs, f, A):
    """Write the forces into f (n, 2) and add scale times the frozen stiffness to A (blocks, 2, 2).

    A point adds w mu ((G_a . G_b) I + g_b g_a^T) + w lam g_a g_b^T, g = R G, to the block (a, b <= a). The last term
    becomes lam/V (sum w g_a) (sum w g_b)^T if is_mean. The rotations are Rs (s, 2, 2) if has_rotations, else those
    of x.
    """
    f[:] = 0.0
    g, total, theta, (e, q) = np.empty((NODES, 2)), np.empty((NODES, 2)), 0.0, weights.shape
    for n in range(e):
        first, stride, volume = n, 0, 0.0
        mu_n, lam_n = mu[min(n, len(mu) - 1)], lam[min(n, len(mu) - 1)]
        if len(Rs) != e:
            first, stride = n * q, 1
        if is_mean:
            theta = _average_dilatation(x, cells[n], G[n], weights[n], rotation, has_rotations, Rs, first, stride)
            total[:] = 0.0
        for l in range(q):
            w, F = weights[n, l], _gradient(x, cells[n], G[n, l])
            R = _find_rotation(F, rotation, has_rotations, Rs, first + l * stride)
            _scatter_force(cells[n], G[n, l], w, _compute_stress(F, R, mu_n, lam_n, is_mean, theta), f)
            _rotate_gradients(G[n, l], R[0], R[1], g)
            _add_stiffness(g, scale * w * mu_n, 0.0 if is_mean else scale * w * lam_n, pairs[n], A)
            if is_mean:
                _add_scaled(w, g, total)
                volume += w
        if is_mean:
            _add_square(scale * lam_n / volume, total, pairs[n], A)


@njit(cache=True, error_model="numpy", nogil=True)
def _add_scaled(w, g, total):
    """Add w g to total (6, 2)."""
    for a in range(NODES):
        for i in range(2):
            total[a, i] += w * g[a, i]


@njit(cache=True, error_model="numpy", nogil=True)
def _add_stiffness(g, wm, wl, blocks, A):
    """Add the frozen stiffness of one point with the rotated gradients g (6, 2) to the 21 blocks of its cell."""
    k = 0
    for a in range(NODES):
        for b in range(a + 1):
            block = A[blocks[k]]
            k += 1
            dot = wm * (g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1])
            for i in range(2):
                block[i, i] += dot
                for j in range(2):
                    block[i, j] += wm * g[b, i] * g[a, j] + wl * g[a, i] * g[b, j]


@njit(cache=True, error_model="numpy", nogil=True)
def add_rotation_stiffness(x, cells, G, weights, mu, lam, is_mean, pairs, scale, crease, projected, A):
    """Add scale times the difference between the exact and the frozen tangent to A, as in triangle.py."""
    w, none, theta, (e, q) = np.empty((NODES, 2)), np.empty((0, 2, 2)), 0.0, weights.shape
    for n in range(e):
        mu_n, lam_n = mu[min(n, len(mu) - 1)], lam[min(n, len(mu) - 1)]
        if is_mean:
            theta = _average_dilatation(x, cells[n], G[n], weights[n], POLAR, False, none, 0, 0)
        for l in range(q):
            F = _gradient(x, cells[n], G[n, l])
            R = find_polar(F)
            own = _measure_dilatation(F, R)
            c = lam_n * (theta if is_mean else own) - 2.0 * mu_n
            factor = scale * weights[n, l] * find_rotation_factor(own + 2.0, mu_n, c, crease)
            if projected and factor <= 0.0:
                continue
            _rotate_gradients(G[n, l], -R[1], R[0], w)
            _add_square(factor, w, pairs[n], A)


@njit(cache=True, error_model="numpy", nogil=True)
def _add_square(factor, w, blocks, A):
    """Add factor w_a w_b^T to the 21 blocks (a, b <= a) of a cell."""
    k = 0
    for a in range(NODES):
        for b in range(a + 1):
            block = A[blocks[k]]
            k += 1
            for i in range(2):
                for j in range(2):
                    block[i, j] += factor * w[a, i] * w[b, j]


@njit(cache=True, error_model="numpy", nogil=True)
def rotations(x, cells, G, q, rotation, R):
    """Write the rotation of every point's F into R (e q, 2, 2); return the smallest trace.

    With the mean gradients of cells and q = 1 these are the rotations of cells.
    """
    least = 2.0
    for n in range(len(R) // q):
        for l in range(q):
            cosine_sine = find_rotation(rotation, _gradient(x, cells[n], G[n, l]))
            store_rotation(R, n * q + l, cosine_sine)
            least = min(least, 2.0 * cosine_sine[0])
    return least


@njit(cache=True, error_model="numpy", nogil=True)
def nodal_rotations(x, cells, G, weights, R):
    """Write into R (n, 2, 2) the polar rotation of each node's sum of w F."""
    R[:] = 0.0
    e, q = weights.shape
    for n in range(e):
        for l in range(q):
            F = _gradient(x, cells[n], G[n, l])
            for a in range(NODES):
                for k in range(4):
                    R[cells[n, a], k // 2, k % 2] += weights[n, l] * F[k]
    for n in range(len(R)):
        store_rotation(R, n, find_polar((R[n, 0, 0], R[n, 0, 1], R[n, 1, 0], R[n, 1, 1])))


@njit(cache=True, error_model="numpy", nogil=True)
def measure_frame_error(x, cells, G, q, mu, lam, used, reached):
    """Write the polar rotations at the sites, q per cell, into reached (s, 2, 2); return the numbers of triangle.py."""
    least, largest, own, finite, last = 2.0, 0.0, 2.0, 0.0, len(mu) - 1
    for n in range(len(reached) // q):
        for l in range(q):
            F = _gradient(x, cells[n], G[n, l])
            R = find_polar(F)
            U = load_rotation(used, n * q + l) if len(used) > 0 else (1.0, 0.0)
            least = min(least, 2.0 * (R[0] * U[0] + R[1] * U[1]))
            apart = square_distance(F, R, U, mu[min(n, last)], lam[min(n, last)])
            largest, own, finite = max(largest, apart), min(own, 2.0 * R[0]), finite + 0.0 * apart
            store_rotation(reached, n * q + l, R)
    return least + finite, np.sqrt(largest), own + finite


@njit(cache=True, error_model="numpy", nogil=True)
def bound_frame_error(x, cells, G, q, mu, lam):
    """Return the largest tan(angle / 2) and |P(F,R) - P(F,I)| at the sites, exact, as in triangle.py."""
    tangent, largest, finite, last = 0.0, 0.0, 0.0, len(mu) - 1
    for n in range(len(cells)):
        for l in range(q):
            F = _gradient(x, cells[n], G[n, l])
            R = find_polar(F)
            tangent = max(tangent, abs(R[1]) / (1.0 + R[0]) if R[0] > -1.0 else np.inf)
            apart = square_distance(F, R, (1.0, 0.0), mu[min(n, last)], lam[min(n, last)])
            largest, finite = max(largest, apart), finite + 0.0 * apart
    return tangent + finite, np.sqrt(largest)
