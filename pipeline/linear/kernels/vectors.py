"""Compiled vector work of conjugate gradients on nodal vectors (n, d): one pass over memory each, nothing allocated."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def dot(a, b):
    """Return a . b."""
    total = 0.0
    for i in range(len(a)):
        for k in range(a.shape[1]):
            total += a[i, k] * b[i, k]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def subtract(b, Ax, r):
    """Write b - A x into r and return |r|."""
    total = 0.0
    for i in range(len(b)):
        for k in range(b.shape[1]):
            r[i, k] = b[i, k] - Ax[i, k]
            total += r[i, k] * r[i, k]
    return np.sqrt(total)


@njit(cache=True, error_model="numpy", nogil=True)
def descend(step, p, Ap, x, r):
    """Add step p to x, subtract step A p from r, and return |r|."""
    total = 0.0
    for i in range(len(x)):
        for k in range(x.shape[1]):
            x[i, k] += step * p[i, k]
            r[i, k] -= step * Ap[i, k]
            total += r[i, k] * r[i, k]
    return np.sqrt(total)


@njit(cache=True, error_model="numpy", nogil=True)
def invert_blocks(A, chosen, D):
    """Write the inverses of A[chosen], blocks of 2 x 2 or 3 x 3, into D; return whether none is singular."""
    for n in range(len(chosen)):
        B, C = A[chosen[n]], D[n]
        if A.shape[1] == 2:
            C[0, 0], C[0, 1], C[1, 0], C[1, 1] = B[1, 1], -B[0, 1], -B[1, 0], B[0, 0]
        else:
            for i in range(3):
                for j in range(3):  # C_ij is the cofactor of B_ji
                    a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
                    C[i, j] = B[a, c] * B[b, d] - B[a, d] * B[b, c]
        det = 0.0
        for j in range(A.shape[1]):
            det += B[0, j] * C[j, 0]
        if det == 0.0:
            return False
        for i in range(A.shape[1]):
            for j in range(A.shape[1]):
                C[i, j] /= det
    return True


@njit(cache=True, error_model="numpy", nogil=True)
def apply_blocks(D, r, Ap, z):
    """Write D_n r_n into z (n, d) for every node n; return z . r and z . A p."""
    d = r.shape[1]
    zr = zAp = 0.0
    for n in range(len(r)):
        for i in range(d):
            value = 0.0
            for j in range(d):
                value += D[n, i, j] * r[n, j]
            z[n, i] = value
            zr += value * r[n, i]
            zAp += value * Ap[n, i]
    return zr, zAp


@njit(cache=True, error_model="numpy", nogil=True)
def rotate_back(Q, r, order, size, y):
    """Write Q^T r / size into y (n d,) in single precision, with its nodes in the given order."""
    d = r.shape[1]
    for k in range(len(order)):
        n = order[k]
        for i in range(d):
            value = 0.0
            for j in range(d):
                value += Q[n, j, i] * r[n, j]
            y[d * k + i] = value / size


@njit(cache=True, error_model="numpy", nogil=True)
def rotate_forth(Q, y, order, size, r, Ap, z):
    """Write size Q y into z (n, d); return z . r and z . A p."""
    d = r.shape[1]
    zr = zAp = 0.0
    for k in range(len(order)):
        n = order[k]
        for i in range(d):
            value = 0.0
            for j in range(d):
                value += Q[n, i, j] * y[d * k + j]
            value *= size
            z[n, i] = value
            zr += value * r[n, i]
            zAp += value * Ap[n, i]
    return zr, zAp


@njit(cache=True, error_model="numpy", nogil=True)
def follow(z, beta, p):
    """Write z + beta p into p."""
    for i in range(len(p)):
        for k in range(p.shape[1]):
            p[i, k] = z[i, k] + beta * p[i, k]
