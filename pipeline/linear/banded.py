"""The band that reverse Cuthill-McKee leaves of a symmetric block pattern, and its Cholesky factor by LAPACK.

No fill-in to find and nothing but dense arithmetic: the fastest factor of small meshes.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs, spbtrf
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.linear.work import Work

AnyFactor = TypeVar("AnyFactor")
# single precision may lose what keeps a matrix definite: the mass of a free, stiff body in long steps
_SHIFTS = (0.0, 1e-6, 1e-5, 1e-4)


class Band:
    """The order of the nodes, and where every block entry of a pattern goes in LAPACK's lower band."""

    def __init__(self, pattern: BlockPattern) -> None:
        d, n = pattern.dimension, pattern.nodes
        i, j = pattern.rows, pattern.indices
        ones = np.ones(2 * len(i))
        graph = csr_array((ones, (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n, n))
        # as numpy takes indices: 32 bit ones would be copied at every solve
        self.order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.intp)
        self.place = place = np.argsort(self.order)
        axis = np.arange(d)
        row = d * place[i][:, None, None] + axis[:, None]
        column = d * place[j][:, None, None] + axis[None, :]
        # a block off the diagonal stands for its transpose too; of one on it the lower half is taken
        self._taken = np.flatnonzero(((i != j)[:, None, None] | (row >= column)).ravel())
        row, column = np.maximum(row, column), np.minimum(row, column)
        self.width, self.size = int((row - column).max()) + 1, d * n
        # entry (i, j) stands at [i - j, j]; column-major, as pbtrf wants it
        self._target = ((row - column) + self.width * column).ravel()[self._taken]

    @property
    def megabytes(self) -> float:
        """Return what a factor in double precision takes."""
        return self.size * self.width * 8e-6

    def fill(self, values: Floats, into: np.ndarray) -> np.ndarray:
        """Write the values (blocks, d, d) into a band (size, width) and return it as LAPACK's (width, size)."""
        from pipeline.linear.kernels.vectors import fill

        fill(values.reshape(-1), self._taken, self._target, into.reshape(-1))
        return into.T

    def preconditioner(self, values: Floats) -> np.ndarray:
        """Return about the Cholesky factor, in single precision; raises SolveError where there is none."""

        def with_shift(shift: float) -> np.ndarray:
            band = self.fill(values, np.empty((self.size, self.width), dtype=np.float32))
            band[0] *= 1 + shift
            return factor_band(band)

        return factor_with_shift(with_shift)


_BANDS: WeakKeyDictionary[BlockPattern, Band] = WeakKeyDictionary()


def band_of(pattern: BlockPattern) -> Band:
    """Return the band of a pattern, found once."""
    if pattern not in _BANDS:
        _BANDS[pattern] = Band(pattern)
    return _BANDS[pattern]


def factor_band(band: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor of a lower band (width, size), in its place; raises SolveError where there is none."""
    factor, info = (spbtrf if band.dtype == np.float32 else dpbtrf)(band, lower=1, overwrite_ab=1)
    if info:
        raise SolveError(f"the system's matrix is not positive definite (row {info} of its band)")
    return np.asarray(factor)


def factor_with_shift(factor: Callable[[float], AnyFactor]) -> AnyFactor:
    """Return the factor of a matrix whose diagonal is made larger by the first part of _SHIFTS that does.

    Raises SolveError where none does: the matrix is far from positive definite.
    """
    for shift in _SHIFTS[:-1]:
        with suppress(SolveError):
            return factor(shift)
    return factor(_SHIFTS[-1])


class BandedCholesky:
    """A factor of the band for every new matrix; positive definite ones only."""

    def __init__(self, pattern: BlockPattern, rtol: float = 0.0, rest: object = None) -> None:
        self._band = band_of(pattern)
        self._storage = np.empty((self._band.size, self._band.width))
        self._y = np.empty((pattern.nodes, pattern.dimension))
        d = pattern.dimension
        self._band.fill(np.zeros((pattern.blocks, d, d)), self._storage)  # the kernel is compiled, or loaded, here

    def update(self, values: Floats, frames: object = None) -> Work:
        """Factor the matrix; raises SolveError where it is not positive definite."""
        self._factor = factor_band(self._band.fill(values, self._storage))
        return Work(factorizations=1)

    def solve(self, b: Floats, x: Floats) -> Work:
        """Write the solution by substitution into x (n, d)."""
        b.take(self._band.order, 0, self._y, "clip")
        dpbtrs(self._factor, self._y.reshape(-1), lower=1, overwrite_b=1)
        self._y.take(self._band.place, 0, x, "clip")
        return Work(solves=1)
