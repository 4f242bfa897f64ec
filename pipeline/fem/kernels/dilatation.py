"""Compiled kernels for the dilatation of groups of simplices of order 1 (fem/dilatation.py), in the plane and in space.

With g_a = sum w R grad N_a over the cells of a group, V theta = sum_a g_a . x_a - d V: its energy is lam V theta^2 / 2,
its forces are -lam theta g_a and its stiffness is lam / V g (x) g.
"""

from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def sum_gradients(cells, gradients, weights, R, labels, places, g):
    """Write g (groups, m, d) of cells with the gradients (e, k, d), weights (e,) and rotations R (e, d, d)."""
    g[:] = 0.0
    k, d = gradients.shape[1:]
    for c in range(len(cells)):
        group = g[labels[c]]
        for a in range(k):
            row = group[places[c, a]]
            for i in range(d):
                total = 0.0
                for j in range(d):
                    total += R[c, i, j] * gradients[c, a, j]
                row[i] += weights[c] * total


@njit(cache=True, error_model="numpy", nogil=True)
def find_dilatations(x, nodes, volumes, g, theta):
    """Write theta (groups,) of the nodes (groups, m) at x (n, d)."""
    m, d = g.shape[1:]
    for n in range(len(nodes)):
        total = 0.0
        for a in range(m):
            for i in range(d):
                total += g[n, a, i] * x[nodes[n, a], i]
        theta[n] = total / volumes[n] - d


@njit(cache=True, error_model="numpy", nogil=True)
def add_forces(nodes, factors, g, f):
    """Add -factor g_a, with the factors lam theta (groups,), to the forces f (n, d)."""
    m, d = g.shape[1:]
    for n in range(len(nodes)):
        for a in range(m):
            for i in range(d):
                f[nodes[n, a], i] -= factors[n] * g[n, a, i]


@njit(cache=True, error_model="numpy", nogil=True)
def add_stiffness(corners, pairs, factors, g, A):
    """Add factor g_a (x) g_b, with the factors lam / V (groups,), to the blocks (a, b <= a) of A (blocks, d, d).

    The nodes of a group are taken in the order `corners` (groups, m), that of their rows.
    """
    m, d = g.shape[1:]
    for n in range(len(corners)):
        k = 0
        for a in range(m):
            left = g[n, corners[n, a]]
            for b in range(a + 1):
                right = g[n, corners[n, b]]
                block = A[pairs[n, k]]
                k += 1
                for i in range(d):
                    for j in range(d):
                        block[i, j] += factors[n] * left[i] * right[j]
