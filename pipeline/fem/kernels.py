"""Compiled kernels for tetrahedra under the corotational law with polar rotations, one thread.

Each does in one pass over the cells what the numpy lines beside it in rotation.py, laws.py and element.py do in many;
tests hold the two together. Compiled once a machine (cached beside this file), not once a run.
"""

import numpy as np
from numba import njit

# Newton on the quartic starts above its largest root and falls monotonically; near a double root it slows down, and
# the eigenvector's cofactors lose their digits: below this part of their natural size Jacobi's sweeps decide.
_SEPARATED = 1e-5
_NEWTON = 30
_SWEEPS = 20  # 4 x 4 needs about 5


@njit(cache=True, error_model="numpy", nogil=True)
def _largest_root(c2, c1, c0, start):
    """Return the largest root of x^4 + c2 x^2 + c1 x + c0, from above."""
    x = start
    for _ in range(_NEWTON):
        x2 = x * x
        value = (x2 + c2) * x2 + c1 * x + c0
        slope = (4.0 * x2 + 2.0 * c2) * x + c1
        if slope <= 0.0:
            break
        step = value / slope
        x -= step
        if step <= 1e-15 * x:
            break
    return x


@njit(cache=True, error_model="numpy", nogil=True)
def polar_rotation(F, R):
    """Write the closest rotation to F (3, 3) into R: Horn's quaternion, the eigenvector of the largest eigenvalue.

    tr(R^T F) = q . N q for the symmetric, traceless N below, so the best q belongs to its largest eigenvalue, a root
    of x^4 - 2 |F|^2 x^2 - 8 det F x + det N. 1 ulp of the root costs 1/gap ulps of q, which _SEPARATED bounds.
    """
    largest = np.abs(F).max()
    if not (largest > 0.0) or not np.isfinite(largest):
        R[:] = np.eye(3)
        return
    xx, xy, xz = F[0, 0] / largest, F[0, 1] / largest, F[0, 2] / largest
    yx, yy, yz = F[1, 0] / largest, F[1, 1] / largest, F[1, 2] / largest
    zx, zy, zz = F[2, 0] / largest, F[2, 1] / largest, F[2, 2] / largest
    n00, n11, n22, n33 = xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy
    n01, n02, n03 = zy - yz, xz - zx, yx - xy
    n12, n13, n23 = xy + yx, xz + zx, yz + zy
    square = xx * xx + xy * xy + xz * xz + yx * yx + yy * yy + yz * yz + zx * zx + zy * zy + zz * zz
    det = xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx) + xz * (yx * zy - yy * zx)
    # det N from the 2 x 2 minors of its first two rows (b) and of its last two (a)
    a01, a02, a03 = n02 * n13 - n12 * n03, n02 * n23 - n22 * n03, n02 * n33 - n23 * n03
    a12, a13, a23 = n12 * n23 - n22 * n13, n12 * n33 - n23 * n13, n22 * n33 - n23 * n23
    b01, b02, b03 = n00 * n11 - n01 * n01, n00 * n12 - n02 * n01, n00 * n13 - n03 * n01
    b12, b13, b23 = n01 * n12 - n02 * n11, n01 * n13 - n03 * n11, n02 * n13 - n03 * n12
    c0 = b01 * a23 - b02 * a13 + b03 * a12 + b12 * a03 - b13 * a02 + b23 * a01
    root = _largest_root(-2.0 * square, -8.0 * det, c0, np.sqrt(3.0 * square))
    if not _null_rotation(n00 - root, n11 - root, n22 - root, n33 - root, n01, n02, n03, n12, n13, n23, root, R):
        _jacobi_rotation(n00, n11, n22, n33, n01, n02, n03, n12, n13, n23, R)


@njit(cache=True, error_model="numpy", nogil=True)
def _null_rotation(m00, m11, m22, m33, m01, m02, m03, m12, m13, m23, root, R):
    """Write the rotation of the null vector of the symmetric 4 x 4 matrix m into R; False where it is ill defined.

    The adjugate of a matrix of rank three is q q^T times a number: the row of its largest diagonal entry is q.
    """
    a02, a03 = m02 * m23 - m22 * m03, m02 * m33 - m23 * m03
    a12, a13, a23 = m12 * m23 - m22 * m13, m12 * m33 - m23 * m13, m22 * m33 - m23 * m23
    b01, b02, b03 = m00 * m11 - m01 * m01, m00 * m12 - m02 * m01, m00 * m13 - m03 * m01
    b12, b13, b23 = m01 * m12 - m02 * m11, m01 * m13 - m03 * m11, m02 * m13 - m03 * m12
    d0, d1 = m11 * a23 - m12 * a13 + m13 * a12, m00 * a23 - m02 * a03 + m03 * a02
    d2, d3 = m03 * b13 - m13 * b03 + m33 * b01, m02 * b12 - m12 * b02 + m22 * b01
    best = max(abs(d0), abs(d1), abs(d2), abs(d3))
    if not best > _SEPARATED * root * root * root:
        return False
    q01, q23 = m02 * a13 - m01 * a23 - m03 * a12, m12 * b03 - m02 * b13 - m23 * b01
    q02, q03 = m13 * b23 - m23 * b13 + m33 * b12, m22 * b13 - m12 * b23 - m23 * b12
    q12, q13 = m23 * b03 - m03 * b23 - m33 * b02, m02 * b23 - m22 * b03 + m23 * b02
    if best == abs(d0):
        w, x, y, z = d0, q01, q02, q03
    elif best == abs(d1):
        w, x, y, z = q01, d1, q12, q13
    elif best == abs(d2):
        w, x, y, z = q02, q12, d2, q23
    else:
        w, x, y, z = q03, q13, q23, d3
    _quaternion_rotation(w, x, y, z, R)
    return True


@njit(cache=True, error_model="numpy", nogil=True)
def _quaternion_rotation(w, x, y, z, R):
    """Write the rotation of the quaternion (w, x, y, z), of any length, into R."""
    r = 1.0 / np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * r, x * r, y * r, z * r
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True, error_model="numpy", nogil=True)
def _jacobi_rotation(n00, n11, n22, n33, n01, n02, n03, n12, n13, n23, R):
    """Write the rotation of an eigenvector of the largest eigenvalue of N into R, by Jacobi's sweeps.

    For the few N whose largest eigenvalue is all but double: any vector of its space is as good, and this finds one.
    """
    A = np.array([[n00, n01, n02, n03], [n01, n11, n12, n13], [n02, n12, n22, n23], [n03, n13, n23, n33]])
    Q = np.eye(4)
    for _ in range(_SWEEPS):
        off = 0.0
        for p in range(3):
            for q in range(p + 1, 4):
                off = max(off, abs(A[p, q]))
                if A[p, q] == 0.0:
                    continue
                tau = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
                t = (1.0 if tau >= 0.0 else -1.0) / (abs(tau) + np.sqrt(1.0 + tau * tau))
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for k in range(4):
                    A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
                for k in range(4):
                    A[k, p], A[k, q] = c * A[k, p] - s * A[k, q], s * A[k, p] + c * A[k, q]
                    Q[k, p], Q[k, q] = c * Q[k, p] - s * Q[k, q], s * Q[k, p] + c * Q[k, q]
        if off < 1e-16:
            break
    best = 0
    for k in range(1, 4):
        if A[k, k] > A[best, best]:
            best = k
    _quaternion_rotation(Q[0, best], Q[1, best], Q[2, best], Q[3, best], R)


@njit(cache=True, error_model="numpy", nogil=True)
def polar_rotations(F):
    """Return the closest rotation to each F (e, 3, 3)."""
    R = np.empty_like(F)
    for e in range(len(F)):
        polar_rotation(F[e], R[e])
    return R


@njit(cache=True, error_model="numpy", nogil=True)
def _gradient(x, cell, G, F):
    """Write F = sum_a x_a (x) grad N_a of one cell into F (3, 3)."""
    for i in range(3):
        for j in range(3):
            F[i, j] = (
                x[cell[0], i] * G[0, j] + x[cell[1], i] * G[1, j] + x[cell[2], i] * G[2, j] + x[cell[3], i] * G[3, j]
            )


@njit(cache=True, error_model="numpy", nogil=True)
def _rotated_stress(F, R, mu, lam, T):
    """Write T = 2 mu e + lam tr(e) I into T (3, 3), e = sym(R^T F) - I; return tr(e T) / 2, the energy density."""
    for i in range(3):
        for j in range(3):
            T[i, j] = R[0, i] * F[0, j] + R[1, i] * F[1, j] + R[2, i] * F[2, j]
    e00, e11, e22 = T[0, 0] - 1.0, T[1, 1] - 1.0, T[2, 2] - 1.0
    e01, e02, e12 = (T[0, 1] + T[1, 0]) / 2, (T[0, 2] + T[2, 0]) / 2, (T[1, 2] + T[2, 1]) / 2
    pressure = lam * (e00 + e11 + e22)
    T[0, 0], T[1, 1], T[2, 2] = 2 * mu * e00 + pressure, 2 * mu * e11 + pressure, 2 * mu * e22 + pressure
    T[0, 1] = T[1, 0] = 2 * mu * e01
    T[0, 2] = T[2, 0] = 2 * mu * e02
    T[1, 2] = T[2, 1] = 2 * mu * e12
    squares = e00 * e00 + e11 * e11 + e22 * e22 + 2 * (e01 * e01 + e02 * e02 + e12 * e12)
    return mu * squares + pressure * (e00 + e11 + e22) / 2


@njit(cache=True, error_model="numpy", nogil=True)
def energy(x, cells, G, V, mu, lam):
    """Return sum V W(F) with the polar rotations."""
    F, R, T = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    total = 0.0
    for e in range(len(cells)):
        _gradient(x, cells[e], G[e], F)
        polar_rotation(F, R)
        total += V[e] * _rotated_stress(F, R, mu, lam, T)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def force(x, cells, G, V, mu, lam, f):
    """Write f_a = -sum V P grad N_a into f (n, 3), P = R T with the polar rotations."""
    f[:] = 0.0
    F, R, T = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for e in range(len(cells)):
        _gradient(x, cells[e], G[e], F)
        polar_rotation(F, R)
        _rotated_stress(F, R, mu, lam, T)
        _scatter_force(cells[e], G[e], V[e], R, T, f)


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_force(cell, G, volume, R, T, f):
    """Add -V R T grad N_a to the forces of the cell's corners; they sum to zero."""
    last0 = last1 = last2 = 0.0
    for a in range(1, 4):
        t0 = T[0, 0] * G[a, 0] + T[0, 1] * G[a, 1] + T[0, 2] * G[a, 2]
        t1 = T[1, 0] * G[a, 0] + T[1, 1] * G[a, 1] + T[1, 2] * G[a, 2]
        t2 = T[2, 0] * G[a, 0] + T[2, 1] * G[a, 1] + T[2, 2] * G[a, 2]
        p0 = volume * (R[0, 0] * t0 + R[0, 1] * t1 + R[0, 2] * t2)
        p1 = volume * (R[1, 0] * t0 + R[1, 1] * t1 + R[1, 2] * t2)
        p2 = volume * (R[2, 0] * t0 + R[2, 1] * t1 + R[2, 2] * t2)
        f[cell[a], 0] -= p0
        f[cell[a], 1] -= p1
        f[cell[a], 2] -= p2
        last0, last1, last2 = last0 + p0, last1 + p1, last2 + p2
    f[cell[0], 0] += last0
    f[cell[0], 1] += last1
    f[cell[0], 2] += last2


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_stiffness(G, volume, R, mu, lam, pairs, K):
    """Add V (mu (G_a . G_b) I + mu g_b g_a^T + lam g_a g_b^T), g = R G, to the blocks named by pairs (4, 4)."""
    g = np.empty((4, 3))
    for a in range(4):
        for i in range(3):
            g[a, i] = R[i, 0] * G[a, 0] + R[i, 1] * G[a, 1] + R[i, 2] * G[a, 2]
    vm, vl = volume * mu, volume * lam
    for a in range(4):
        for b in range(a, 4):
            block, mirror = K[pairs[a, b]], K[pairs[b, a]]
            dot = vm * (G[a, 0] * G[b, 0] + G[a, 1] * G[b, 1] + G[a, 2] * G[b, 2])
            for i in range(3):
                for k in range(3):
                    value = vm * g[b, i] * g[a, k] + vl * g[a, i] * g[b, k]
                    if i == k:
                        value += dot
                    block[i, k] += value
                    if a != b:
                        mirror[k, i] += value


@njit(cache=True, error_model="numpy", nogil=True)
def linearise(x, cells, G, V, mu, lam, pairs, given, R, f, K):
    """Write forces f (n, 3) and blocks K (blocks, 3, 3), frozen tangent; R (e, 3, 3) is read if given, else written."""
    f[:] = 0.0
    K[:] = 0.0
    F, T = np.empty((3, 3)), np.empty((3, 3))
    for e in range(len(cells)):
        _gradient(x, cells[e], G[e], F)
        if not given:
            polar_rotation(F, R[e])
        _rotated_stress(F, R[e], mu, lam, T)
        _scatter_force(cells[e], G[e], V[e], R[e], T, f)
        _scatter_stiffness(G[e], V[e], R[e], mu, lam, pairs[e], K)


@njit(cache=True, error_model="numpy", nogil=True)
def nodal_rotations(x, cells, G, V, sums, R):
    """Write into R (n, 3, 3) the polar rotation of each node's sum of V F, held in sums (n, 3, 3)."""
    sums[:] = 0.0
    F = np.empty((3, 3))
    for e in range(len(cells)):
        _gradient(x, cells[e], G[e], F)
        for a in range(4):
            node = sums[cells[e, a]]
            for i in range(3):
                for j in range(3):
                    node[i, j] += V[e] * F[i, j]
    for n in range(len(sums)):
        polar_rotation(sums[n], R[n])
