"""Compiled: volumes and rotation angles of tetrahedra in one pass; see mesh/simplex.py and fem/rotation.py for numpy.

Numba does not notice changes in rotation.py and tetrahedron.py, which are compiled into this file: `make clean`.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.rotation import LANES, allocate_lanes, find_polar_rotations
from pipeline.fem.kernels.tetrahedron import compute_gradients


@njit(cache=True, error_model="numpy", nogil=True)
def measure_cells(x, cells, G, volumes, angles):
    """Write det D / 6, D = (x_1 - x_0, x_2 - x_0, x_3 - x_0), and the angle of F's polar rotation of every cell.

    G (e, 4, 3) are the gradients of all corners; 2 sin and 2 cos of the angle are |axial(R - R^T)| and tr R - 1.
    """
    F, R, D, _, root, good, C = allocate_lanes()
    corners, g = np.zeros((LANES, 4), np.int64), np.zeros((9, LANES))
    for first in range(0, len(cells), LANES):
        count = min(LANES, len(cells) - first)
        for l in range(count):
            for a in range(4):
                corners[l, a] = cells[first + l, a]
            for k in range(9):
                g[k, l] = G[first + l, 1 + k // 3, k % 3]
        compute_gradients(x, corners, g, 0, D, F)
        find_polar_rotations(F, count, R, root, good, C)
        for l in range(count):
            # D[3 i + k] is component i of edge k; the order of signed_volumes gives the same bits
            six = D[0, l] * (D[4, l] * D[8, l] - D[5, l] * D[7, l])
            six -= D[1, l] * (D[3, l] * D[8, l] - D[5, l] * D[6, l])
            six += D[2, l] * (D[3, l] * D[7, l] - D[4, l] * D[6, l])
            volumes[first + l] = six / 6.0
            a0, a1, a2 = R[7, l] - R[5, l], R[2, l] - R[6, l], R[3, l] - R[1, l]
            sine, cosine = np.sqrt(a0 * a0 + a1 * a1 + a2 * a2), R[0, l] + R[4, l] + R[8, l] - 1.0
            angles[first + l] = np.arctan2(sine, cosine) + 0.0 * volumes[first + l]  # NaN if a position is
