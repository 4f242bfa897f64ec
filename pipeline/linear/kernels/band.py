"""Compiled: entries of a block matrix written into a band; the positions are those of Band in linear/band.py."""

from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def fill_band(values, stored, target, band):
    """Write values[stored] to band[target], both flat, and zero elsewhere."""
    band[:] = 0.0
    for k in range(len(stored)):
        band[target[k]] = values[stored[k]]
