"""Compiled: rotations of deformation gradients; see polar_by_svd and gram_schmidt in fem/rotation.py for numpy.

Arithmetic that is the same for every cell runs over LANES cells at once, entries first: F[3 i + j, lane]. The compiler
vectorizes such loops; cells that lose digits in them are computed again, one by one.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels import GRAM_SCHMIDT, POLAR

LANES = 32
# Newton on the quartic starts above its largest root and falls monotonically; near a double root it slows down, and
# the eigenvector's cofactors lose their digits: below this part of their natural size Jacobi's sweeps decide.
_SEPARATED = 1e-5
_NEWTON = 30
_SWEEPS = 20  # 4 x 4 needs about 5
_NULL = 1e-14  # as in rotation.py
_PLAIN = 1e-16  # a column that keeps less of its square is computed again, more carefully


@njit(cache=True, error_model="numpy", nogil=True)
def _quartics(F, C):
    """Write 1/|F| and c1, c0 of det(N - x I) = x^4 - 2 x^2 + c1 x + c0 per lane into C (3, LANES); F is scaled to 1.

    tr(R^T F) = q . N q for the symmetric, traceless N of Horn, so the best quaternion q belongs to the largest root.
    """
    for l in range(LANES):
        square = 0.0
        for k in range(9):
            square += F[k, l] * F[k, l]
        scale = 1.0 / np.sqrt(square)
        xx, xy, xz = F[0, l] * scale, F[1, l] * scale, F[2, l] * scale
        yx, yy, yz = F[3, l] * scale, F[4, l] * scale, F[5, l] * scale
        zx, zy, zz = F[6, l] * scale, F[7, l] * scale, F[8, l] * scale
        n00, n11, n22, n33 = xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy
        n01, n02, n03 = zy - yz, xz - zx, yx - xy
        n12, n13, n23 = xy + yx, xz + zx, yz + zy
        det = xx * (yy * zz - yz * zy) - xy * (yx * zz - yz * zx) + xz * (yx * zy - yy * zx)
        # det N from the 2 x 2 minors of its first two rows (b) and of its last two (a)
        a01, a02, a03 = n02 * n13 - n12 * n03, n02 * n23 - n22 * n03, n02 * n33 - n23 * n03
        a12, a13, a23 = n12 * n23 - n22 * n13, n12 * n33 - n23 * n13, n22 * n33 - n23 * n23
        b01, b02, b03 = n00 * n11 - n01 * n01, n00 * n12 - n02 * n01, n00 * n13 - n03 * n01
        b12, b13, b23 = n01 * n12 - n02 * n11, n01 * n13 - n03 * n11, n02 * n13 - n03 * n12
        C[0, l] = scale
        C[1, l] = -8.0 * det
        C[2, l] = b01 * a23 - b02 * a13 + b03 * a12 + b12 * a03 - b13 * a02 + b23 * a01


@njit(cache=True, error_model="numpy", nogil=True)
def _largest_roots(C, root):
    """Write the largest root of each lane's quartic into root (LANES,): at most sqrt(3), reached if F is a rotation."""
    for l in range(LANES):
        root[l] = 1.7320508075688772
    for _ in range(_NEWTON):
        moving = 0
        for l in range(LANES):
            x = root[l]
            x2 = x * x
            value = (x2 - 2.0) * x2 + C[1, l] * x + C[2, l]
            slope = (4.0 * x2 - 4.0) * x + C[1, l]
            step = value / slope if slope > 0.0 else 0.0
            step = step if step > 1e-15 * x else 0.0  # a converged lane stays as it is, whatever the others need
            root[l] = x - step
            moving += 1 if step > 0.0 else 0
        if moving == 0:
            break


@njit(cache=True, error_model="numpy", nogil=True)
def _null_rotations(F, C, root, R, good):
    """Write the rotations of the null vectors of N - root I into R (9, LANES), and into good whether they are defined.

    The adjugate of a matrix of rank three is a multiple of q q^T: the row of its largest diagonal entry is q.
    1 ulp of the root costs 1/gap ulps of q, which _SEPARATED bounds.
    """
    for l in range(LANES):
        scale, x = C[0, l], root[l]
        xx, xy, xz = F[0, l] * scale, F[1, l] * scale, F[2, l] * scale
        yx, yy, yz = F[3, l] * scale, F[4, l] * scale, F[5, l] * scale
        zx, zy, zz = F[6, l] * scale, F[7, l] * scale, F[8, l] * scale
        m00, m11, m22, m33 = xx + yy + zz - x, xx - yy - zz - x, yy - xx - zz - x, zz - xx - yy - x
        m01, m02, m03 = zy - yz, xz - zx, yx - xy
        m12, m13, m23 = xy + yx, xz + zx, yz + zy
        a02, a03 = m02 * m23 - m22 * m03, m02 * m33 - m23 * m03
        a12, a13, a23 = m12 * m23 - m22 * m13, m12 * m33 - m23 * m13, m22 * m33 - m23 * m23
        b01, b02, b03 = m00 * m11 - m01 * m01, m00 * m12 - m02 * m01, m00 * m13 - m03 * m01
        b12, b13, b23 = m01 * m12 - m02 * m11, m01 * m13 - m03 * m11, m02 * m13 - m03 * m12
        d0, d1 = m11 * a23 - m12 * a13 + m13 * a12, m00 * a23 - m02 * a03 + m03 * a02
        d2, d3 = m03 * b13 - m13 * b03 + m33 * b01, m02 * b12 - m12 * b02 + m22 * b01
        q01, q23 = m02 * a13 - m01 * a23 - m03 * a12, m12 * b03 - m02 * b13 - m23 * b01
        q02, q03 = m13 * b23 - m23 * b13 + m33 * b12, m22 * b13 - m12 * b23 - m23 * b12
        q12, q13 = m23 * b03 - m03 * b23 - m33 * b02, m02 * b23 - m22 * b03 + m23 * b02
        # written as selections, not branches, so that the compiler can vectorize them
        best, w, i, j, k = abs(d0), d0, q01, q02, q03
        c = abs(d1) > best
        best, w, i, j, k = abs(d1) if c else best, q01 if c else w, d1 if c else i, q12 if c else j, q13 if c else k
        c = abs(d2) > best
        best, w, i, j, k = abs(d2) if c else best, q02 if c else w, q12 if c else i, d2 if c else j, q23 if c else k
        c = abs(d3) > best
        best, w, i, j, k = abs(d3) if c else best, q03 if c else w, q13 if c else i, q23 if c else j, d3 if c else k
        good[l] = 1.0 if best > _SEPARATED * x * x * x else 0.0
        r = 2.0 / (w * w + i * i + j * j + k * k)
        R[0, l], R[1, l], R[2, l] = 1.0 - r * (j * j + k * k), r * (i * j - w * k), r * (i * k + w * j)
        R[3, l], R[4, l], R[5, l] = r * (i * j + w * k), 1.0 - r * (i * i + k * k), r * (j * k - w * i)
        R[6, l], R[7, l], R[8, l] = r * (i * k - w * j), r * (j * k + w * i), 1.0 - r * (i * i + j * j)


@njit(cache=True, error_model="numpy", nogil=True)
def _quaternion_rotation(w, x, y, z, R, lane):
    """Write the rotation of the quaternion (w, x, y, z), of any length, into a lane of R."""
    r = 1.0 / np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * r, x * r, y * r, z * r
    R[0, lane], R[1, lane], R[2, lane] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[3, lane], R[4, lane], R[5, lane] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[6, lane], R[7, lane], R[8, lane] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@njit(cache=True, error_model="numpy", nogil=True)
def jacobi(A, Q):
    """Diagonalize the symmetric A (k, k) in place: eigenvalues on its diagonal, eigenvectors in the columns of Q."""
    size = 0.0  # written out, as elsewhere: numpy's functions take seconds to compile
    for p in range(len(A)):
        for q in range(len(A)):
            Q[p, q] = 1.0 if p == q else 0.0
            size = max(size, abs(A[p, q]))
    for _ in range(_SWEEPS):
        off = 0.0
        for p in range(len(A) - 1):
            for q in range(p + 1, len(A)):
                off = max(off, abs(A[p, q]))
                if A[p, q] == 0.0:
                    continue
                tau = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
                t = (1.0 if tau >= 0.0 else -1.0) / (abs(tau) + np.sqrt(1.0 + tau * tau))
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for k in range(len(A)):
                    A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
                for k in range(len(A)):
                    A[k, p], A[k, q] = c * A[k, p] - s * A[k, q], s * A[k, p] + c * A[k, q]
                    Q[k, p], Q[k, q] = c * Q[k, p] - s * Q[k, q], s * Q[k, p] + c * Q[k, q]
        if off <= 1e-17 * size:
            break


@njit(cache=True, error_model="numpy", nogil=True)
def _jacobi_rotation(F, R, lane):
    """Write the closest rotation to one lane of F into that of R, by Jacobi's sweeps on N.

    For the few N whose largest eigenvalue is nearly double: any vector of its eigenspace will do. The
    rotation is the identity if F is zero or not finite.
    """
    largest, finite = 0.0, 0.0
    for k in range(9):
        largest, finite = max(largest, abs(F[k, lane])), finite + 0.0 * F[k, lane]
    if largest == 0.0 or finite != 0.0:
        _quaternion_rotation(1.0, 0.0, 0.0, 0.0, R, lane)
        return
    xx, xy, xz = F[0, lane] / largest, F[1, lane] / largest, F[2, lane] / largest
    yx, yy, yz = F[3, lane] / largest, F[4, lane] / largest, F[5, lane] / largest
    zx, zy, zz = F[6, lane] / largest, F[7, lane] / largest, F[8, lane] / largest
    N, Q = np.empty((4, 4)), np.empty((4, 4))
    N[0, 0], N[1, 1], N[2, 2], N[3, 3] = xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy
    N[0, 1] = N[1, 0] = zy - yz
    N[0, 2] = N[2, 0] = xz - zx
    N[0, 3] = N[3, 0] = yx - xy
    N[1, 2] = N[2, 1] = xy + yx
    N[1, 3] = N[3, 1] = xz + zx
    N[2, 3] = N[3, 2] = yz + zy
    jacobi(N, Q)
    best = 0
    for k in range(1, 4):
        best = k if N[k, k] > N[best, best] else best
    _quaternion_rotation(Q[0, best], Q[1, best], Q[2, best], Q[3, best], R, lane)


@njit(cache=True, error_model="numpy", nogil=True)
def find_polar_rotations(F, count, R, root, good, C):
    """Write the closest rotations to the first `count` lanes of F (9, LANES) into R; the rest is scratch."""
    _quartics(F, C)
    _largest_roots(C, root)
    _null_rotations(F, C, root, R, good)
    for l in range(count):
        if good[l] == 0.0:
            _jacobi_rotation(F, R, l)


@njit(cache=True, error_model="numpy", nogil=True)
def _orthonormal_columns(F, R, good):
    """Write the Gram-Schmidt rotations of F (9, LANES) into R, and into good whether both columns are long enough."""
    for l in range(LANES):
        largest = 0.0
        for k in range(9):
            largest = max(largest, abs(F[k, l]))
        a0, a1, a2 = F[0, l] / largest, F[3, l] / largest, F[6, l] / largest
        b0, b1, b2 = F[1, l] / largest, F[4, l] / largest, F[7, l] / largest
        aa, bb = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2
        r = np.sqrt(aa)
        a0, a1, a2 = a0 / r, a1 / r, a2 / r
        dot = a0 * b0 + a1 * b1 + a2 * b2
        b0, b1, b2 = b0 - dot * a0, b1 - dot * a1, b2 - dot * a2
        left = b0 * b0 + b1 * b1 + b2 * b2
        good[l] = 1.0 if aa > _PLAIN and left > _PLAIN * max(bb, _PLAIN) else 0.0
        r = np.sqrt(left)
        b0, b1, b2 = b0 / r, b1 / r, b2 / r
        dot = a0 * b0 + a1 * b1 + a2 * b2  # once more: one pass leaves an error of eps |b| / |across|
        b0, b1, b2 = b0 - dot * a0, b1 - dot * a1, b2 - dot * a2
        r = np.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
        b0, b1, b2 = b0 / r, b1 / r, b2 / r
        R[0, l], R[1, l], R[2, l] = a0, b0, a1 * b2 - a2 * b1
        R[3, l], R[4, l], R[5, l] = a1, b1, a2 * b0 - a0 * b2
        R[6, l], R[7, l], R[8, l] = a2, b2, a0 * b1 - a1 * b0


@njit(cache=True, error_model="numpy", nogil=True)
def _across(a, r, count):
    """Subtract the parts along the first `count` rows of r from a (3,); return the remaining length."""
    for k in range(count):
        dot = r[k, 0] * a[0] + r[k, 1] * a[1] + r[k, 2] * a[2]
        for i in range(3):
            a[i] -= dot * r[k, i]
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@njit(cache=True, error_model="numpy", nogil=True)
def _orthonormal_columns_of(F, R, lane):
    """Write the Gram-Schmidt rotation of one lane; a column that vanishes becomes the least parallel axis.

    The rotation is the identity if F is zero or not finite.
    """
    largest, finite = 0.0, 0.0
    for k in range(9):
        largest, finite = max(largest, abs(F[k, lane])), finite + 0.0 * F[k, lane]
    r, a = np.zeros((3, 3)), np.zeros(3)
    for j in range(2):
        for i in range(3):
            a[i] = F[3 * i + j, lane] / largest
        length = _across(a, r, 0)
        left = _across(a, r, j)
        if largest == 0.0 or finite != 0.0 or left <= _NULL * max(length, _NULL):
            least = 0
            for i in range(1, 3):
                least = i if abs(r[0, i]) < abs(r[0, least]) else least
            for i in range(3):
                a[i] = 1.0 if i == least else 0.0
            left = _across(a, r, j)
        for i in range(3):
            a[i] /= left
        left = _across(a, r, j)
        for i in range(3):
            r[j, i] = a[i] / left
    r[2, 0], r[2, 1] = r[0, 1] * r[1, 2] - r[0, 2] * r[1, 1], r[0, 2] * r[1, 0] - r[0, 0] * r[1, 2]
    r[2, 2] = r[0, 0] * r[1, 1] - r[0, 1] * r[1, 0]
    for i in range(3):
        R[3 * i, lane], R[3 * i + 1, lane], R[3 * i + 2, lane] = r[0, i], r[1, i], r[2, i]


@njit(cache=True, error_model="numpy", nogil=True)
def _gram_schmidt(F, count, R, good):
    """Write the Gram-Schmidt rotations of the first `count` lanes of F (9, LANES) into R; the rest is scratch."""
    _orthonormal_columns(F, R, good)
    for l in range(count):
        if good[l] == 0.0:
            _orthonormal_columns_of(F, R, l)


@njit(cache=True, error_model="numpy", nogil=True)
def find_rotations(rotation, F, count, R, root, good, C):
    """Write the rotations POLAR, GRAM_SCHMIDT or IDENTITY of `count` lanes of F into R; the rest is scratch."""
    if rotation == POLAR:
        find_polar_rotations(F, count, R, root, good, C)
    elif rotation == GRAM_SCHMIDT:
        _gram_schmidt(F, count, R, good)
    else:
        for k in range(9):
            for l in range(LANES):
                R[k, l] = 1.0 if k % 4 == 0 else 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def allocate_lanes():
    """Return buffers: F, R, P (9, LANES), W (LANES,), and root, good and C of find_polar_rotations."""
    F, R, P = np.zeros((9, LANES)), np.zeros((9, LANES)), np.zeros((9, LANES))
    return F, R, P, np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros((3, LANES))


@njit(cache=True, error_model="numpy", nogil=True)
def load_lanes(A, first, count, lanes):
    """Copy A[first : first + count] (…, 3, 3) into lanes (9, LANES)."""
    for l in range(count):
        for i in range(3):
            for j in range(3):
                lanes[3 * i + j, l] = A[first + l, i, j]


@njit(cache=True, error_model="numpy", nogil=True)
def store_lanes(lanes, first, count, A):
    """Copy lanes (9, LANES) into A[first : first + count] (…, 3, 3)."""
    for l in range(count):
        for i in range(3):
            for j in range(3):
                A[first + l, i, j] = lanes[3 * i + j, l]


@njit(cache=True, error_model="numpy", nogil=True)
def polar_rotations(A, R):
    """Write the closest rotation to each A (e, 3, 3) into R, which may be A itself."""
    F, Q, _, _, root, good, C = allocate_lanes()
    for first in range(0, len(A), LANES):
        count = min(LANES, len(A) - first)
        load_lanes(A, first, count, F)
        find_polar_rotations(F, count, Q, root, good, C)
        store_lanes(Q, first, count, R)
