"""Compiled products of symmetric matrices with nodal vectors; the plain equation is BlockPattern.matrix in assembly.py.

The stored blocks are those on and below the diagonal; `nodes` names the node of every row, `columns` that of every
block's column, so that vectors are in the order of the nodes.
"""

from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def multiply(indptr, columns, nodes, A, x, y):
    """Write y_i = sum_j A_ij x_j into y (n, d): each stored block below the diagonal serves A_ij and A_ji = A_ij^T."""
    if A.shape[1] == 3:
        _multiply_in_space(indptr, columns, nodes, A, x, y)
        return
    d = A.shape[1]
    y[:] = 0.0
    for row in range(len(indptr) - 1):
        i = nodes[row]
        for k in range(indptr[row], indptr[row + 1]):
            j = columns[k]
            for a in range(d):
                for b in range(d):
                    y[i, a] += A[k, a, b] * x[j, b]
                    if i != j:
                        y[j, b] += A[k, a, b] * x[i, a]


@njit(cache=True, error_model="numpy", nogil=True)
def multiply_difference(indptr, columns, nodes, A, X, x, y):
    """Write y = A (X - x) into y (n, d)."""
    if A.shape[1] == 3:
        _multiply_difference_in_space(indptr, columns, nodes, A, X, x, y)
        return
    d = A.shape[1]
    y[:] = 0.0
    for row in range(len(indptr) - 1):
        i = nodes[row]
        for k in range(indptr[row], indptr[row + 1]):
            j = columns[k]
            for a in range(d):
                for b in range(d):
                    y[i, a] += A[k, a, b] * (X[j, b] - x[j, b])
                    if i != j:
                        y[j, b] += A[k, a, b] * (X[i, a] - x[i, a])


@njit(cache=True, error_model="numpy", nogil=True)
def multiply_scalars(indptr, columns, nodes, m, x, y):
    """Write the product of a symmetric matrix of numbers with x (n, d) into y."""
    y[:] = 0.0
    for row in range(len(indptr) - 1):
        i = nodes[row]
        last = indptr[row + 1] - 1
        for a in range(x.shape[1]):
            y[i, a] += m[last] * x[i, a]
        for k in range(indptr[row], last):
            j = columns[k]
            for a in range(x.shape[1]):
                y[i, a] += m[k] * x[j, a]
                y[j, a] += m[k] * x[i, a]


@njit(cache=True, error_model="numpy", nogil=True)
def _multiply_in_space(indptr, columns, nodes, A, x, y):
    """Write the product for d = 3; written out, it runs at the speed at which A is read."""
    for row in range(len(indptr) - 1):
        i = nodes[row]
        last = indptr[row + 1] - 1
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        y0 = y1 = y2 = 0.0
        for k in range(indptr[row], last):
            j = columns[k]
            B = A[k]
            z0, z1, z2 = x[j, 0], x[j, 1], x[j, 2]
            y0 += B[0, 0] * z0 + B[0, 1] * z1 + B[0, 2] * z2
            y1 += B[1, 0] * z0 + B[1, 1] * z1 + B[1, 2] * z2
            y2 += B[2, 0] * z0 + B[2, 1] * z1 + B[2, 2] * z2
            y[j, 0] += B[0, 0] * x0 + B[1, 0] * x1 + B[2, 0] * x2
            y[j, 1] += B[0, 1] * x0 + B[1, 1] * x1 + B[2, 1] * x2
            y[j, 2] += B[0, 2] * x0 + B[1, 2] * x1 + B[2, 2] * x2
        B = A[last]
        y[i, 0] = y0 + B[0, 0] * x0 + B[0, 1] * x1 + B[0, 2] * x2
        y[i, 1] = y1 + B[1, 0] * x0 + B[1, 1] * x1 + B[1, 2] * x2
        y[i, 2] = y2 + B[2, 0] * x0 + B[2, 1] * x1 + B[2, 2] * x2


@njit(cache=True, error_model="numpy", nogil=True)
def _multiply_difference_in_space(indptr, columns, nodes, A, X, x, y):
    """Write the product with X - x for d = 3, as above."""
    for row in range(len(indptr) - 1):
        i = nodes[row]
        last = indptr[row + 1] - 1
        x0, x1, x2 = X[i, 0] - x[i, 0], X[i, 1] - x[i, 1], X[i, 2] - x[i, 2]
        y0 = y1 = y2 = 0.0
        for k in range(indptr[row], last):
            j = columns[k]
            B = A[k]
            z0, z1, z2 = X[j, 0] - x[j, 0], X[j, 1] - x[j, 1], X[j, 2] - x[j, 2]
            y0 += B[0, 0] * z0 + B[0, 1] * z1 + B[0, 2] * z2
            y1 += B[1, 0] * z0 + B[1, 1] * z1 + B[1, 2] * z2
            y2 += B[2, 0] * z0 + B[2, 1] * z1 + B[2, 2] * z2
            y[j, 0] += B[0, 0] * x0 + B[1, 0] * x1 + B[2, 0] * x2
            y[j, 1] += B[0, 1] * x0 + B[1, 1] * x1 + B[2, 1] * x2
            y[j, 2] += B[0, 2] * x0 + B[1, 2] * x1 + B[2, 2] * x2
        B = A[last]
        y[i, 0] = y0 + B[0, 0] * x0 + B[0, 1] * x1 + B[0, 2] * x2
        y[i, 1] = y1 + B[1, 0] * x0 + B[1, 1] * x1 + B[1, 2] * x2
        y[i, 2] = y2 + B[2, 0] * x0 + B[2, 1] * x1 + B[2, 2] * x2
