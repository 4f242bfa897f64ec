r"""Conjugate gradients with the factor of the rest state, rotated along with the body.

The systems of a motion, M + h^2 sum_e R K_e R^T, differ from the one at rest, A_0, mostly by rotations. So A_0 is
factored once, and Q A_0^-1 Q^T preconditions them all; Q is the block diagonal of the nodal rotations. On the thesis'
bar with 10 000 tetrahedra, to 1e-6, this takes 2 to 10 iterations, and up to 15 if it is thrown three times as hard.
No step factors anything. The factor is in single precision: it only preconditions.

For stiff steps of medium meshes; on small ones a banded factor in every step is faster. On large ones a multigrid cycle
of A_0, rotated the same way, replaces the factor: 12 to 16 iterations at a million tetrahedra instead of 3 to 10, but
each takes a sixth of the time, and so does the set-up. With cells stretched 1 : 3 : 9 the cycle needs 60.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from scipy.linalg.lapack import spbtrs

from pipeline.arrays import Floats, Singles
from pipeline.fem.assembly import BlockPattern
from pipeline.linear import pardiso
from pipeline.linear.band import Band
from pipeline.linear.banded import factor_in_single, factor_with_shift
from pipeline.linear.cg import ConjugateGradients
from pipeline.linear.multigrid import Cycle, make_rigid_modes
from pipeline.linear.solver import NodalRotations, SystemSettings
from pipeline.linear.superlu import factor_symmetric
from pipeline.linear.work import Work

# [MB] of the band in double precision: above the first, MKL's sparse factor is faster to read; above the second, any
_SMALL_BAND = 20.0
_LARGE_BAND = 60.0


@dataclass(frozen=True, eq=False)
class RestFactor:
    """Solves A_0 y = b in single precision, for flat vectors whose nodes are in `order`.

    `solve` may overwrite b, and the next call overwrites y.
    """

    name: str
    order: np.ndarray
    solve: Callable[[Singles], Singles]


def choose_rest_factor(band: Band) -> str:
    """Return how the rest state is factored: banded or, if it is large, by MKL, CHOLMOD (`fast` extra) or SuperLU."""
    if band.megabytes <= (_LARGE_BAND if pardiso.load_mkl() is None else _SMALL_BAND):
        return "banded"
    if pardiso.load_mkl() is not None:
        return "mkl"
    return "superlu" if find_spec("cholespy") is None else "cholmod"


def factor_rest(systems: SystemSettings) -> RestFactor:
    """Return the factor of the matrix at rest, of the kind that suits its size."""
    return FACTORS[choose_rest_factor(systems.band)](systems)


def _factor_banded(systems: SystemSettings) -> RestFactor:
    factor = factor_in_single(systems.band, systems.rest.assemble())
    return RestFactor("banded", systems.band.order, lambda b: spbtrs(factor, b, lower=1, overwrite_b=1)[0])


def _factor_by_mkl(systems: SystemSettings) -> RestFactor:
    pattern, values = systems.pattern, systems.rest.assemble()
    factor, diagonal = pardiso.PardisoFactor(pattern, np.float32), values[pattern.diagonal]

    def factor_shifted(shift: float) -> None:
        values[pattern.diagonal] = (1 + shift) * diagonal
        factor.update(values)

    factor_with_shift(factor_shifted)
    y = np.empty(factor.size, dtype=np.float32)
    return RestFactor("mkl", np.arange(pattern.nodes), lambda b: factor.solve(b, y))


def _factor_by_cholmod(systems: SystemSettings) -> RestFactor:
    from cholespy import CholeskySolverF, MatrixType

    matrix = systems.pattern.matrix(systems.rest.assemble()).tocoo()
    factor = CholeskySolverF(matrix.shape[0], matrix.row, matrix.col, matrix.data, MatrixType.COO)
    y = np.empty(matrix.shape[0], dtype=np.float32)

    def solve(b: Singles) -> Singles:
        factor.solve(b, y)
        return y

    return RestFactor("cholmod", np.arange(systems.pattern.nodes), solve)


def _factor_by_superlu(systems: SystemSettings) -> RestFactor:
    factor = factor_symmetric(systems.pattern.matrix(systems.rest.assemble()).tocsc())
    nodes = np.arange(systems.pattern.nodes)
    return RestFactor("superlu", nodes, lambda b: factor.solve(b.astype(np.float64)).astype(np.float32))


FACTORS: dict[str, Callable[[SystemSettings], RestFactor]] = {
    "banded": _factor_banded,
    "mkl": _factor_by_mkl,
    "cholmod": _factor_by_cholmod,
    "superlu": _factor_by_superlu,
}


class RotatedFactor:
    """Q A_0^-1 Q^T, with one factor, or an approximate one, for all matrices."""

    def __init__(self, pattern: BlockPattern, factor: RestFactor) -> None:
        self.factor = factor
        self._setup = Work(factorizations=1)
        n, d = pattern.nodes, pattern.dimension
        self._y = np.zeros(n * d, dtype=np.float32)
        self._Q = np.zeros((n, d, d))
        # kernels are compiled or loaded here, not in a timed step
        self.apply(np.zeros((n, d)), 0.0, np.zeros((n, d)), np.zeros((n, d)))

    def update(self, values: Floats, write_rotations: NodalRotations) -> Work:
        """Take the nodal rotations of the state that the matrix belongs to."""
        write_rotations(self._Q)
        work, self._setup = self._setup, Work()
        return work

    def apply(self, r: Floats, size: float, Ap: Floats, z: Floats) -> tuple[float, float]:
        """Write Q A_0^-1 Q^T r into z (n, d); return z . r and z . A p. Single precision has to hold only r / size."""
        from pipeline.linear.kernels import vectors as kernels

        size = size or 1.0
        kernels.rotate_back(self._Q, r, self.factor.order, size, self._y)
        y = self.factor.solve(self._y)
        result: tuple[float, float] = kernels.rotate_forth(self._Q, y, self.factor.order, size, r, Ap, z)
        return result


def make_warped_cg(systems: SystemSettings) -> ConjugateGradients:
    """Return conjugate gradients with the rotated factor of the rest state."""
    return ConjugateGradients(systems, RotatedFactor(systems.pattern, factor_rest(systems)))


def make_multigrid_cg(systems: SystemSettings) -> ConjugateGradients:
    """Return conjugate gradients with the rotated multigrid cycle of the rest state."""
    pattern, points, find_ends = systems.pattern, systems.rest.points, systems.rest.find_ends
    ends = None if find_ends is None else find_ends()
    modes = make_rigid_modes(points)
    if systems.rest.is_held is not None:
        modes[systems.rest.is_held] = 0.0
    cycle = Cycle(pattern.matrix(systems.rest.assemble()), modes, ends=ends)
    factor = RestFactor("multigrid", np.arange(pattern.nodes), lambda b: cycle(b.reshape(points.shape)).reshape(-1))
    return ConjugateGradients(systems, RotatedFactor(pattern, factor))
