"""Compiled parts of multigrid: grouping nodes, and the work of a cycle on a level, each in one pass over memory.

A level's matrix has the layout of BlockPattern, lower blocks only, with the inverses of the diagonal blocks in their
place. Block sizes are constants of the compiled code, so that it unrolls their loops.
"""

from functools import cache

import numpy as np
from numba import njit

# sums may be reordered into vector instructions; the order is the same every time
_FAST = {"contract", "reassoc", "nsz"}


@njit(cache=True, error_model="numpy", nogil=True)
def group_nodes(indptr, indices, group):
    """Write the group of every node of a symmetric graph into group and return their number.

    A node and its neighbors form a group if none of them has one yet; the other nodes join a neighbor's group.
    """
    n = len(indptr) - 1
    group[:] = -1
    count = 0
    for i in range(n):
        free = True
        for k in range(indptr[i], indptr[i + 1]):
            free = free and group[indices[k]] < 0
        if free:
            group[i] = count
            for k in range(indptr[i], indptr[i + 1]):
                group[indices[k]] = count
            count += 1
    for i in range(n):
        if group[i] < 0:
            for k in range(indptr[i], indptr[i + 1]):
                if group[indices[k]] >= 0:
                    group[i] = -2 - group[indices[k]]  # negative, so that no other node joins through i
                    break
    for i in range(n):
        if group[i] < 0:
            group[i] = -2 - group[i]
    return count


@cache
def compile_sweep(d):
    """Return a Gauss-Seidel sweep for blocks d x d."""

    @njit(cache=True, error_model="numpy", nogil=True, fastmath=_FAST)
    def sweep(indptr, indices, A, r, x, residual, back):
        """Write x_i = D_i^-1 (r_i - sum over j < i of A_ij x_j + residual_i) into x (n, d), node by node.

        `residual` (n, d) starts as zero; each node i subtracts A_ji x_i from it for all j < i. A sweep from the last
        node back corrects x. A sweep from the first node on sets x to (D + L)^-1 r, whatever it was, and the
        residual to r - A x.
        """
        n = len(indptr) - 1
        a, b = np.empty(d, np.float32), np.empty(d, np.float32)
        residual[:] = 0.0
        for step in range(n):
            i = n - 1 - step if back else step
            first, last = indptr[i], indptr[i + 1] - 1
            for p in range(d):
                a[p] = r[i, p] + residual[i, p]
            for k in range(first, last):
                j = indices[k]
                for p in range(d):
                    for q in range(d):
                        a[p] -= A[k, p, q] * x[j, q]
            for p in range(d):
                value = np.float32(0.0)
                for q in range(d):
                    value += A[last, p, q] * a[q]
                x[i, p] = b[p] = value
            for k in range(first, last):
                j = indices[k]
                for q in range(d):
                    value = residual[j, q]
                    for p in range(d):
                        value -= A[k, p, q] * b[p]
                    residual[j, q] = value

    return sweep


@cache
def compile_transfers(d, m):
    """Return restriction and prolongation for compressed rows of blocks d x m."""

    @njit(cache=True, error_model="numpy", nogil=True, fastmath=_FAST)
    def restrict(indptr, indices, P, fine, coarse):
        """Write P^T fine into coarse (groups, m)."""
        coarse[:] = 0.0
        for i in range(len(indptr) - 1):
            for k in range(indptr[i], indptr[i + 1]):
                j = indices[k]
                for q in range(m):
                    value = coarse[j, q]
                    for p in range(d):
                        value += P[k, p, q] * fine[i, p]
                    coarse[j, q] = value

    @njit(cache=True, error_model="numpy", nogil=True, fastmath=_FAST)
    def prolong(indptr, indices, P, coarse, fine):
        """Add P coarse to fine (n, d)."""
        for i in range(len(indptr) - 1):
            for k in range(indptr[i], indptr[i + 1]):
                j = indices[k]
                for p in range(d):
                    value = fine[i, p]
                    for q in range(m):
                        value += P[k, p, q] * coarse[j, q]
                    fine[i, p] = value

    return restrict, prolong
