"""Compiled: measures of polyhedra and polygons; see mesh/rest_facets.py for the equations.

Cells have any number of nodes, so that they come one by one; only their rotations are found LANES at once.
"""

import numpy as np
from numba import njit

from pipeline.fem.kernels.cells import store_angles
from pipeline.fem.kernels.rotation import LANES, allocate_lanes, find_polar_rotations


@njit(cache=True, error_model="numpy", nogil=True)
def _average(x, origin, nodes, first, last, mean):
    """Write the mean position of nodes, relative to a node, into mean (c,)."""
    mean[:] = 0.0
    for a in range(first, last):
        for i in range(len(mean)):
            mean[i] += x[nodes[a], i] - x[origin, i]
    for i in range(len(mean)):
        mean[i] /= last - first


@njit(cache=True, error_model="numpy", nogil=True)
def _fit(x, origin, center, nodes, first, last, gradients, F):
    """Write the least-squares F = sum_a (x_a - o) (x) G_a into F (c, c)."""
    F[:] = 0.0
    for a in range(first, last):
        for i in range(len(center)):
            u = x[nodes[a], i] - x[origin, i] - center[i]
            for j in range(len(center)):
                F[i, j] += u * gradients[a, j]


@njit(cache=True, error_model="numpy", nogil=True)
def _extend(ratio, least, largest):
    """Return the extremes with one more value; NaN, of a flat piece, leaves them."""
    return (ratio if ratio < least else least), (ratio if ratio > largest else largest)


@njit(cache=True, error_model="numpy", nogil=True)
def _cross(a, b, n):
    """Write a x b into n."""
    n[0], n[1], n[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, error_model="numpy", nogil=True)
def _edge(x, origin, center, corners, first, last, k, a, b):
    """Write the positions of corner k of a face and of the next one, relative to the center, into a and b (c,)."""
    following = first if k + 1 == last else k + 1
    for i in range(len(center)):
        a[i] = x[corners[k], i] - x[origin, i] - center[i]
        b[i] = x[corners[following], i] - x[origin, i] - center[i]


@njit(cache=True, error_model="numpy", nogil=True)
def measure_polyhedra(
    x, cells, starts, nodes, face_starts, corner_starts, corners, inverse, gradients, volumes, low, high, angles
):
    """Write the measures of polyhedra into places `cells` of the outputs; x (n, 3), the rest as in RestFacets."""
    lanes, R, _, total, root, good, C = allocate_lanes()
    center, middle, a, b, n, F = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for batch in range(0, len(cells), LANES):
        count = min(LANES, len(cells) - batch)
        for l in range(count):
            c = batch + l
            origin = nodes[starts[c]]
            _average(x, origin, nodes, starts[c], starts[c + 1], center)
            volume, least, largest = 0.0, np.inf, -np.inf
            for f in range(face_starts[c], face_starts[c + 1]):
                first, last = corner_starts[f], corner_starts[f + 1]
                _average(x, origin, corners, first, last, middle)
                for k in range(first, last):
                    _edge(x, origin, center, corners, first, last, k, a, b)
                    _cross(a, b, n)
                    piece = 0.0
                    for i in range(3):
                        piece += (middle[i] - center[i]) * n[i] / 6.0
                    ratio = piece * inverse[k]
                    volume += piece
                    least, largest = _extend(ratio, least, largest)
            total[l], cell = volume, cells[c]
            volumes[cell], low[cell], high[cell] = volume, least + 0.0 * volume, largest + 0.0 * volume
            _fit(x, origin, center, nodes, starts[c], starts[c + 1], gradients, F)
            for k in range(9):
                lanes[k, l] = F[k // 3, k % 3]
        find_polar_rotations(lanes, count, R, root, good, C)
        store_angles(cells, batch, count, total, R, angles)


@njit(cache=True, error_model="numpy", nogil=True)
def measure_planar_polygons(x, cells, starts, nodes, inverse, gradients, volumes, low, high, angles):
    """Write the measures of polygons in the plane into places `cells` of the outputs; x (n, 2)."""
    center, a, b, F = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros((2, 2))
    for c in range(len(cells)):
        origin, first, last = nodes[starts[c]], starts[c], starts[c + 1]
        _average(x, origin, nodes, first, last, center)
        volume, least, largest = 0.0, np.inf, -np.inf
        for k in range(first, last):
            _edge(x, origin, center, nodes, first, last, k, a, b)
            piece = 0.5 * (a[0] * b[1] - a[1] * b[0])
            ratio = piece * inverse[k]
            volume += piece
            least, largest = _extend(ratio, least, largest)
        _fit(x, origin, center, nodes, first, last, gradients, F)
        cell, lost = cells[c], 0.0 * volume
        volumes[cell], low[cell], high[cell] = volume, least + lost, largest + lost
        angles[cell] = abs(np.arctan2(F[1, 0] - F[0, 1], F[0, 0] + F[1, 1])) + lost


@njit(cache=True, error_model="numpy", nogil=True)
def measure_polygons_in_space(x, cells, starts, nodes, inverse, gradients, normals, volumes, low, high, angles):
    """Write the measures of polygons in space into places `cells` of the outputs; x (n, 3)."""
    lanes, R, _, total, root, good, C = allocate_lanes()
    center, a, b, n, whole, F = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for batch in range(0, len(cells), LANES):
        count = min(LANES, len(cells) - batch)
        for l in range(count):
            c = batch + l
            origin, first, last = nodes[starts[c]], starts[c], starts[c + 1]
            _average(x, origin, nodes, first, last, center)
            whole[:] = 0.0
            for k in range(first, last):
                _edge(x, origin, center, nodes, first, last, k, a, b)
                _cross(a, b, n)
                for i in range(3):
                    whole[i] += n[i]
            volume, least, largest = 0.0, np.inf, -np.inf
            for k in range(first, last):
                _edge(x, origin, center, nodes, first, last, k, a, b)
                _cross(a, b, n)
                piece = 0.5 * np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
                piece = -piece if n[0] * whole[0] + n[1] * whole[1] + n[2] * whole[2] < 0.0 else piece
                ratio = piece * inverse[k]
                volume += piece
                least, largest = _extend(ratio, least, largest)
            total[l], cell = volume, cells[c]
            volumes[cell], low[cell], high[cell] = volume, least + 0.0 * volume, largest + 0.0 * volume
            _fit(x, origin, center, nodes, first, last, gradients, F)
            length = np.sqrt(whole[0] * whole[0] + whole[1] * whole[1] + whole[2] * whole[2])
            scale = 1.0 / length if length > 0.0 else 0.0
            for k in range(9):
                lanes[k, l] = F[k // 3, k % 3] + whole[k // 3] * scale * normals[c, k % 3]
        find_polar_rotations(lanes, count, R, root, good, C)
        store_angles(cells, batch, count, total, R, angles)
