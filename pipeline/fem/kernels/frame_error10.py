"""Compiled: the error of the rotations that a solve of tetrahedra of order 2 used; see frame_error.py.

Rotations are at sites, q per cell: with the mean gradients of cells and q = 1, one per cell.

Numba does not notice changes in the modules that are compiled into this file: `make clean`.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.frame_error import accumulate_bounds, bound_stress, compare_rotations
from pipeline.fem.kernels.rotation import LANES, allocate_lanes, find_polar_rotations, load_lanes, store_lanes
from pipeline.fem.kernels.tetrahedron import compute_stresses
from pipeline.fem.kernels.tetrahedron10 import NODES, compute_gradients


@njit(cache=True, error_model="numpy", nogil=True)
def measure_frame_error(x, cells, G, q, mu, lam, used, reached):
    """Write the polar rotations R into reached (s, 3, 3); return the three numbers of frame_error.py over all sites."""
    F, R, P, W, root, good, C = allocate_lanes()
    U, Q, D = np.zeros((9, LANES)), np.zeros((9, LANES)), np.zeros((3 * (NODES - 1), LANES))
    U[0], U[4], U[8] = 1.0, 1.0, 1.0
    worst = np.zeros(4)
    worst[0], worst[2] = 3.0, 3.0
    for first in range(0, len(reached), LANES):
        count = min(LANES, len(reached) - first)
        compute_gradients(x, cells, G[first // LANES], first, q, D, F)
        find_polar_rotations(F, count, R, root, good, C)
        if len(used) > 0:
            load_lanes(used, first, count, U)
        row = min(first // LANES, len(mu) - 1)
        compute_stresses(F, R, mu[row], lam[row], P, W)
        compute_stresses(F, U, mu[row], lam[row], Q, W)
        compare_rotations(R, U, P, Q, count, worst)
        store_lanes(R, first, count, reached)
    return worst[0] + worst[3], np.sqrt(worst[1]), worst[2] + worst[3]


@njit(cache=True, error_model="numpy", nogil=True)
def bound_frame_error(x, cells, G, q, mu, lam):
    """Return the upper bounds of frame_error.py on tan(angle / 2) and |P(F,R) - P(F,I)| over all sites."""
    F, D = np.zeros((9, LANES)), np.zeros((3 * (NODES - 1), LANES))
    tangents, strains = np.zeros(LANES), np.zeros(LANES)
    for first in range(0, len(cells) * q, LANES):
        compute_gradients(x, cells, G[first // LANES], first, q, D, F)
        accumulate_bounds(F, tangents, strains)
    return bound_stress(tangents, strains, np.max(mu), np.max(lam))
