r"""Compiled kernels for triangles with the corotational or the linear law; see laws.py and element.py for numpy.

Names and arguments are those of tetrahedron.py, frame_error.py and tangent.py. In the plane the formulas are short
enough to write out cell by cell: with F = [[a, b], [c, d]] the polar rotation is that of the vector (a + d, c - b).
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels import GRAM_SCHMIDT, POLAR

_NULL = 1e-14  # as in rotation.py: below this part of F the vector is rounding, and the rotation the identity


@njit(cache=True, error_model="numpy", nogil=True)
def _gradient(x, cells, G, e):
    """Return the four entries of F = sum_a (x_a - x_0) (x) grad N_a."""
    i, j, k = cells[e, 0], cells[e, 1], cells[e, 2]
    x1, y1, x2, y2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[k, 0] - x[i, 0], x[k, 1] - x[i, 1]
    return (
        x1 * G[e, 0, 0] + x2 * G[e, 1, 0],
        x1 * G[e, 0, 1] + x2 * G[e, 1, 1],
        y1 * G[e, 0, 0] + y2 * G[e, 1, 0],
        y1 * G[e, 0, 1] + y2 * G[e, 1, 1],
    )


@njit(cache=True, error_model="numpy", nogil=True)
def find_polar(F):
    """Return cosine and sine of the rotation closest to F."""
    a, b, c, d = F
    cosine, sine = a + d, c - b
    length = np.hypot(cosine, sine)
    if not length > _NULL * max(max(abs(a), abs(b)), max(abs(c), abs(d))):
        return 1.0, 0.0
    return cosine / length, sine / length


@njit(cache=True, error_model="numpy", nogil=True)
def find_rotation(rotation, F):
    """Return cosine and sine of the rotation POLAR, GRAM_SCHMIDT or IDENTITY of F."""
    if rotation == POLAR:
        return find_polar(F)
    a, b, c, d = F
    length = np.hypot(a, c)  # of the first column, whose direction Gram-Schmidt keeps
    if rotation != GRAM_SCHMIDT or not length > _NULL**2 * max(abs(b), abs(d)):
        return 1.0, 0.0
    return a / length, c / length


@njit(cache=True, error_model="numpy", nogil=True)
def compute_stress(F, R, mu, lam):
    """Return the four entries of P = R (2 mu eps + lam tr(eps) I), eps = sym(R^T F) - I, and the energy density W."""
    (a, b, c, d), (cosine, sine) = F, R
    eps00, eps11 = cosine * a + sine * c - 1.0, cosine * d - sine * b - 1.0
    eps01 = 0.5 * (cosine * b + sine * d - sine * a + cosine * c)
    pressure = lam * (eps00 + eps11)
    s00, s11, s01 = 2 * mu * eps00 + pressure, 2 * mu * eps11 + pressure, 2 * mu * eps01
    W = 0.5 * (s00 * eps00 + s11 * eps11 + 2 * s01 * eps01)
    return cosine * s00 - sine * s01, cosine * s01 - sine * s11, sine * s00 + cosine * s01, sine * s01 + cosine * s11, W


@njit(cache=True, error_model="numpy", nogil=True)
def load_rotation(R, e):
    """Return cosine and sine of R[e]."""
    return R[e, 0, 0], R[e, 1, 0]


@njit(cache=True, error_model="numpy", nogil=True)
def store_rotation(R, e, rotation):
    """Write the rotation of a cosine and a sine into R[e]."""
    cosine, sine = rotation
    R[e, 0, 0], R[e, 0, 1], R[e, 1, 0], R[e, 1, 1] = cosine, -sine, sine, cosine


@njit(cache=True, error_model="numpy", nogil=True)
def energy(x, cells, G, V, mu, lam, rotation):
    """Return sum V W(F)."""
    total, last = 0.0, len(mu) - 1
    for e in range(len(cells)):
        F = _gradient(x, cells, G, e)
        m, n = mu[min(e, last)], lam[min(e, last)]
        total += V[e] * compute_stress(F, find_rotation(rotation, F), m, n)[4]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_force(cell, G, volume, P, f):
    """Add -V P grad N_a to the forces at the cell's corners, which sum to zero."""
    p00, p01, p10, p11, _ = P
    for a in range(2):
        x, y = volume * (p00 * G[a, 0] + p01 * G[a, 1]), volume * (p10 * G[a, 0] + p11 * G[a, 1])
        f[cell[a + 1], 0] -= x
        f[cell[a + 1], 1] -= y
        f[cell[0], 0] += x
        f[cell[0], 1] += y


@njit(cache=True, error_model="numpy", nogil=True)
def force(x, cells, G, V, mu, lam, rotation, f):
    """Write f_a = -sum V P grad N_a into f (n, 2)."""
    f[:] = 0.0
    last = len(mu) - 1
    for e in range(len(cells)):
        F = _gradient(x, cells, G, e)
        m, n = mu[min(e, last)], lam[min(e, last)]
        _scatter_force(cells[e], G[e], V[e], compute_stress(F, find_rotation(rotation, F), m, n), f)


@njit(cache=True, error_model="numpy", nogil=True)
def linearize(x, cells, G, V, mu, lam, rotation, pairs, scale, has_rotations, Rs, f, A):
    """Write the forces into f (n, 2) and add scale times the frozen stiffness to A (blocks, 2, 2).

    A cell adds V mu ((G_a . G_b) I + g_b g_a^T) + V lam g_a g_b^T, g = R G, to the block (a, b <= a). The rotations
    are Rs (e, 2, 2) if has_rotations, else those of x.
    """
    f[:] = 0.0
    g, last = np.empty((3, 2)), len(mu) - 1
    for e in range(len(cells)):
        F = _gradient(x, cells, G, e)
        R = load_rotation(Rs, e) if has_rotations else find_rotation(rotation, F)
        m, n = mu[min(e, last)], lam[min(e, last)]
        _scatter_force(cells[e], G[e], V[e], compute_stress(F, R, m, n), f)
        _rotate_gradients(G[e], R[0], R[1], g)
        vm, vl, k = scale * V[e] * m, scale * V[e] * n, 0
        for a in range(3):
            for b in range(a + 1):
                block = A[pairs[e, k]]
                k += 1
                dot = vm * (g[a, 0] * g[b, 0] + g[a, 1] * g[b, 1])
                for i in range(2):
                    block[i, i] += dot
                    for j in range(2):
                        block[i, j] += vm * g[b, i] * g[a, j] + vl * g[a, i] * g[b, j]


@njit(cache=True, error_model="numpy", nogil=True)
def _rotate_gradients(G, cosine, sine, g):
    """Write R G of the three corners into g (3, 2); they sum to zero."""
    for a in range(2):
        g[a + 1, 0] = cosine * G[a, 0] - sine * G[a, 1]
        g[a + 1, 1] = sine * G[a, 0] + cosine * G[a, 1]
    g[0, 0], g[0, 1] = -(g[1, 0] + g[2, 0]), -(g[1, 1] + g[2, 1])


@njit(cache=True, error_model="numpy", nogil=True)
def find_rotation_factor(trace, mu, c, crease):
    """Return mu + c / tr S, bounded near the crease."""
    return mu + c / max(trace, max(abs(c) / (crease * mu), 2.2250738585072014e-308))


@njit(cache=True, error_model="numpy", nogil=True)
def add_rotation_stiffness(x, cells, G, V, mu, lam, pairs, scale, crease, projected, A):
    """Add scale times the difference between the exact and the frozen tangent to A; `projected` omits negative factors.

    It is (mu + c / tr S) w_a w_b^T, w_a = R B grad N_a with the quarter turn B, c = lam (tr S - 2) - 2 mu.
    """
    w, last = np.empty((3, 2)), len(mu) - 1
    for e in range(len(cells)):
        F = _gradient(x, cells, G, e)
        cosine, sine = find_polar(F)
        trace = cosine * (F[0] + F[3]) + sine * (F[2] - F[1])
        m = mu[min(e, last)]
        factor = find_rotation_factor(trace, m, lam[min(e, last)] * (trace - 2.0) - 2.0 * m, crease)
        if projected and factor <= 0.0:
            continue
        _rotate_gradients(G[e], -sine, cosine, w)
        k = 0
        for a in range(3):
            for b in range(a + 1):
                for i in range(2):
                    for j in range(2):
                        A[pairs[e, k], i, j] += scale * V[e] * factor * w[a, i] * w[b, j]
                k += 1


@njit(cache=True, error_model="numpy", nogil=True)
def rotations(x, cells, G, rotation, R):
    """Write the rotation of every cell's F into R (e, 2, 2); return the smallest trace."""
    least = 2.0
    for e in range(len(cells)):
        cosine_sine = find_rotation(rotation, _gradient(x, cells, G, e))
        store_rotation(R, e, cosine_sine)
        least = min(least, 2.0 * cosine_sine[0])
    return least


@njit(cache=True, error_model="numpy", nogil=True)
def nodal_rotations(x, cells, G, V, R):
    """Write into R (n, 2, 2) the polar rotation of each node's sum of V F."""
    R[:] = 0.0
    for e in range(len(cells)):
        F = _gradient(x, cells, G, e)
        for a in range(3):
            for k in range(4):
                R[cells[e, a], k // 2, k % 2] += V[e] * F[k]
    for n in range(len(R)):
        store_rotation(R, n, find_polar((R[n, 0, 0], R[n, 0, 1], R[n, 1, 0], R[n, 1, 1])))


@njit(cache=True, error_model="numpy", nogil=True)
def square_distance(F, R, U, mu, lam):
    """Return |P(F,R) - P(F,U)|^2."""
    P, Q = compute_stress(F, R, mu, lam), compute_stress(F, U, mu, lam)
    return (P[0] - Q[0]) ** 2 + (P[1] - Q[1]) ** 2 + (P[2] - Q[2]) ** 2 + (P[3] - Q[3]) ** 2


@njit(cache=True, error_model="numpy", nogil=True)
def measure_frame_error(x, cells, G, mu, lam, used, reached):
    """Write the polar rotations R into reached (e, 2, 2); return three numbers over all cells.

    They are the smallest tr(U^T R), the largest |P(F,R) - P(F,U)| and the smallest tr R; traces are NaN if x has NaN.
    U are the rotations `used` (e, 2, 2), or identities if `used` is empty.
    """
    least, largest, own, finite, last = 2.0, 0.0, 2.0, 0.0, len(mu) - 1
    for e in range(len(cells)):
        F = _gradient(x, cells, G, e)
        R = find_polar(F)
        U = load_rotation(used, e) if len(used) > 0 else (1.0, 0.0)
        least = min(least, 2.0 * (R[0] * U[0] + R[1] * U[1]))
        apart = square_distance(F, R, U, mu[min(e, last)], lam[min(e, last)])
        largest, own, finite = max(largest, apart), min(own, 2.0 * R[0]), finite + 0.0 * apart
        store_rotation(reached, e, R)
    return least + finite, np.sqrt(largest), own + finite


@njit(cache=True, error_model="numpy", nogil=True)
def bound_frame_error(x, cells, G, mu, lam):
    """Return the largest tan(angle / 2) and |P(F,R) - P(F,I)|, exact: in the plane R is cheap."""
    tangent, largest, finite, last = 0.0, 0.0, 0.0, len(mu) - 1
    for e in range(len(cells)):
        F = _gradient(x, cells, G, e)
        R = find_polar(F)
        tangent = max(tangent, abs(R[1]) / (1.0 + R[0]) if R[0] > -1.0 else np.inf)
        apart = square_distance(F, R, (1.0, 0.0), mu[min(e, last)], lam[min(e, last)])
        largest, finite = max(largest, apart), finite + 0.0 * apart
    return tangent + finite, np.sqrt(largest)
