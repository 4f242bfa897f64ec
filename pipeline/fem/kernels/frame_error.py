"""Compiled: the error of the rotations that a solve used; see fem/frame_error.py for numpy.

Numba does not notice changes in rotation.py and tetrahedron.py, which are compiled into this file: `make clean`.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.rotation import LANES, allocate_lanes, find_polar_rotations, load_lanes, store_lanes
from pipeline.fem.kernels.tetrahedron import compute_gradients, compute_stresses


@njit(cache=True, error_model="numpy", nogil=True)
def compare_rotations(R, U, P, Q, count, worst):
    """Update the smallest tr(U^T R), largest |P - Q|^2 and smallest tr R in worst (4,) by `count` lanes.

    Its last number is NaN if a stress is not finite.
    """
    least, largest, own, finite = worst[0], worst[1], worst[2], worst[3]
    for l in range(count):
        trace = apart = 0.0
        for k in range(9):
            trace += R[k, l] * U[k, l]
            apart += (P[k, l] - Q[k, l]) ** 2
        least, largest, own = min(least, trace), max(largest, apart), min(own, R[0, l] + R[4, l] + R[8, l])
        finite += 0.0 * apart
    worst[0], worst[1], worst[2], worst[3] = least, largest, own, finite


@njit(cache=True, error_model="numpy", nogil=True)
def measure_frame_error(x, cells, G, mu, lam, used, reached):
    """Write the polar rotations R into reached (e, 3, 3); return three numbers over all cells.

    They are the smallest tr(U^T R), the largest |P(F,R) - P(F,U)| and the smallest tr R; traces are NaN if x has NaN.
    U are the rotations `used` (e, 3, 3), or identities if `used` is empty.
    """
    F, R, P, W, root, good, C = allocate_lanes()
    U, Q = np.zeros((9, LANES)), np.zeros((9, LANES))
    U[0], U[4], U[8] = 1.0, 1.0, 1.0
    worst = np.zeros(4)
    worst[0], worst[2] = 3.0, 3.0
    for first in range(0, len(reached), LANES):
        count = min(LANES, len(reached) - first)
        compute_gradients(x, cells, G[first // LANES], first, P, F)
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
def accumulate_bounds(F, tangents, strains):
    """Update the largest bound on tan^2(angle / 2) and |F - I|^2 in every lane; see bound_frame_error."""
    for l in range(LANES):
        a0, a1, a2 = F[7, l] - F[5, l], F[2, l] - F[6, l], F[3, l] - F[1, l]
        axial = a0 * a0 + a1 * a1 + a2 * a2
        trace = F[0, l] + F[4, l] + F[8, l]
        square = 0.0
        for k in range(9):
            square += F[k, l] * F[k, l]
        symmetric = square - 0.5 * axial  # |S|^2
        others = 2.0 / 3.0 * trace - np.sqrt(max(2.0 / 3.0 * (symmetric - trace * trace / 3.0), 0.0))
        t2 = axial / (4.0 * others * others) if others > 0.0 else np.inf
        tangents[l] = max(tangents[l], t2)
        strains[l] = max(strains[l], square - 2.0 * trace + 3.0)  # |F - I|^2


@njit(cache=True, error_model="numpy", nogil=True)
def bound_stress(tangents, strains, mu, lam):
    """Return the bounds of bound_frame_error from those of all lanes."""
    t2, h2 = 0.0, 0.0
    for l in range(LANES):
        t2, h2 = max(t2, tangents[l]), max(h2, strains[l])
    t, h = np.sqrt(t2), np.sqrt(h2)
    apart = 4.0 * mu * (np.sqrt(2.0) * t * t + t * h)
    apart += 2.0 * lam * (np.sqrt(6.0) * t * h + np.sqrt(3.0) * t * t * (2.0 + np.sqrt(2.0) * h))
    return t, apart


@njit(cache=True, error_model="numpy", nogil=True)
def bound_frame_error(x, cells, G, mu, lam):
    """Return upper bounds on tan(angle / 2) and |P(F,R) - P(F,I)| over all cells, without computing R.

    With S = sym F, the axial vector a of F - F^T, and s the largest eigenvalue of S, which is at most
    tr S/3 + sqrt(2/3) |dev S|, Horn's equations give tan(angle / 2) <= |a| / (2 (tr S - s)) =: t.
    With E = R^T F - I, |E| <= |F - I| =: h, and

        |P(F,R) - P(F,I)| <= 4 mu (sqrt2 t^2 + t h) + 2 lam (sqrt6 t h + sqrt3 t^2 (2 + sqrt2 h)).
    """
    F, D = np.zeros((9, LANES)), np.zeros((9, LANES))
    tangents, strains = np.zeros(LANES), np.zeros(LANES)
    for first in range(0, len(cells), LANES):
        compute_gradients(x, cells, G[first // LANES], first, D, F)
        accumulate_bounds(F, tangents, strains)
    return bound_stress(tangents, strains, np.max(mu), np.max(lam))
