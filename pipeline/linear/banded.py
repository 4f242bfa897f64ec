"""Cholesky factors of bands by LAPACK: no fill-in to find, only dense arithmetic; the fastest on small meshes."""

from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs, spbtrf

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.linear.band import Band
from pipeline.linear.solver import NodalRotations, SystemSettings
from pipeline.linear.work import Work

AnyFactor = TypeVar("AnyFactor")
# single precision can lose the term that keeps a matrix definite: the mass of a free, stiff body in long steps
_SHIFTS = (0.0, 1e-6, 1e-5, 1e-4)


def factor_band(band: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor of a lower band (width, size), overwriting it; raises SolveError if there is none."""
    factor, info = (spbtrf if band.dtype == np.float32 else dpbtrf)(band, lower=1, overwrite_ab=1)
    if info:
        raise SolveError(f"the system's matrix is not positive definite (row {info} of its band)")
    return np.asarray(factor)


def factor_in_single(band: Band, values: Floats) -> np.ndarray:
    """Return an approximate Cholesky factor in single precision; raises SolveError if there is none."""

    def factor_shifted(shift: float) -> np.ndarray:
        matrix = band.fill(values, np.empty((band.size, band.width), dtype=np.float32))
        matrix[0] *= 1 + shift
        return factor_band(matrix)

    return factor_with_shift(factor_shifted)


def factor_with_shift(factor: Callable[[float], AnyFactor]) -> AnyFactor:
    """Return the factor of a matrix whose diagonal is enlarged by the smallest of _SHIFTS that makes it definite.

    Raises SolveError if none does: the matrix is far from positive definite.
    """
    for shift in _SHIFTS[:-1]:
        with suppress(SolveError):
            return factor(shift)
    return factor(_SHIFTS[-1])


class BandedCholesky:
    """A factor of the band for every new matrix, which must be positive definite."""

    def __init__(self, systems: SystemSettings) -> None:
        self._band = systems.band
        self._storage = np.empty((self._band.size, self._band.width))
        n, d = systems.pattern.nodes, systems.pattern.dimension
        self._y = np.empty((n, d))
        # the kernel is compiled or loaded here, not in a timed step
        self._band.fill(np.zeros((systems.pattern.blocks, d, d)), self._storage)

    def update(self, values: Floats, write_rotations: NodalRotations) -> Work:
        """Factor the matrix; raises SolveError if it is not positive definite."""
        self._factor = factor_band(self._band.fill(values, self._storage))
        return Work(factorizations=1)

    def solve(self, b: Floats, x: Floats) -> Work:
        """Write the solution by substitution into x (n, d)."""
        b.take(self._band.order, 0, self._y, "clip")
        dpbtrs(self._factor, self._y.reshape(-1), lower=1, overwrite_b=1)
        self._y.take(self._band.place, 0, x, "clip")
        return Work(solves=1)
