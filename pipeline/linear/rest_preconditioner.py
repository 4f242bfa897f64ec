r"""Conjugate gradients with the rest state's factor, turned along with the body.

The systems of a motion, M + h^2 sum_e R K_e R^T, differ from the one at rest, A_0, mostly by rotations. So A_0 is
factored once and Q A_0^-1 Q^T preconditions them all, Q the block diagonal of nodal rotations: on the thesis' bar in
10 000 tetrahedra, to 1e-6, 2 to 10 iterations, thrown three times as hard up to 15. Nothing is
factored in a step. The factor is in single precision: it only preconditions.

For stiff steps of middle meshes; small ones are faster with a banded factor every step. On large ones a multigrid
cycle of A_0, turned the same way, takes the factor's place: 12 to 16 iterations at a million tetrahedra instead of 3 to
10, but each a sixth as long, and with a sixth of the set-up. Stretched cells, 1 : 3 : 9, cost it 60.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from scipy.linalg.lapack import spbtrs
from scipy.sparse.linalg import splu

from pipeline.arrays import Floats, Singles
from pipeline.fem.assembly import BlockPattern
from pipeline.linear import pardiso
from pipeline.linear.banded import band_of, factor_with_shift
from pipeline.linear.cg import ConjugateGradients, NodalRotations
from pipeline.linear.multigrid import Cycle, rigid_modes
from pipeline.linear.work import Work

# [MB] of the band in double precision: above the first MKL's sparse factor is faster to read, above the second any is
_SMALL_BAND = 20.0
_LARGE_BAND = 60.0


@dataclass(frozen=True, eq=False)
class Rest:
    """The state at rest: its free nodes (n, d) [m], and what gives the values of A_0 (blocks, d, d) when asked."""

    points: Floats
    values: Callable[[], Floats]


@dataclass(frozen=True, eq=False)
class RestFactor:
    """Solves A_0 y = b in single precision, for flat vectors whose nodes stand in `order`.

    b may be overwritten; y is another's until the next call.
    """

    name: str
    order: np.ndarray
    solve: Callable[[Singles], Singles]


def factor_kind(band_megabytes: float) -> str:
    """Return how the state at rest is factored: banded; for larger ones by MKL, CHOLMOD (`fast` extra), or SuperLU."""
    if band_megabytes <= (_LARGE_BAND if pardiso.load_mkl() is None else _SMALL_BAND):
        return "banded"
    if pardiso.load_mkl() is not None:
        return "mkl"
    return "superlu" if find_spec("cholespy") is None else "cholmod"


def factor_rest(pattern: BlockPattern, rest: Rest) -> RestFactor:
    """Return the factor of the matrix at rest, of the kind for its size."""
    return FACTORS[factor_kind(band_of(pattern).megabytes)](pattern, rest)


def _factor_banded(pattern: BlockPattern, rest: Rest) -> RestFactor:
    band = band_of(pattern)
    factor = band.preconditioner(rest.values())
    return RestFactor("banded", band.order, lambda b: spbtrs(factor, b, lower=1, overwrite_b=1)[0])


def _factor_by_mkl(pattern: BlockPattern, rest: Rest) -> RestFactor:
    factor, values = pardiso.PardisoFactor(pattern, np.float32), rest.values()
    diagonal = values[pattern.diagonal]

    def with_shift(shift: float) -> None:
        values[pattern.diagonal] = (1 + shift) * diagonal
        factor.update(values)

    factor_with_shift(with_shift)
    y = np.empty(factor.size, dtype=np.float32)
    return RestFactor("mkl", np.arange(pattern.nodes), lambda b: factor.solve(b, y))


def _factor_by_cholmod(pattern: BlockPattern, rest: Rest) -> RestFactor:
    from cholespy import CholeskySolverF, MatrixType

    matrix = pattern.matrix(rest.values()).tocoo()
    made = CholeskySolverF(matrix.shape[0], matrix.row, matrix.col, matrix.data, MatrixType.COO)
    y = np.empty(matrix.shape[0], dtype=np.float32)

    def solve(b: Singles) -> Singles:
        made.solve(b, y)
        return y

    return RestFactor("cholmod", np.arange(pattern.nodes), solve)


def _factor_by_superlu(pattern: BlockPattern, rest: Rest) -> RestFactor:
    matrix = pattern.matrix(rest.values()).tocsc()
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    nodes = np.arange(pattern.nodes)
    return RestFactor("superlu", nodes, lambda b: factor.solve(b.astype(np.float64)).astype(np.float32))


FACTORS = {
    "banded": _factor_banded,
    "mkl": _factor_by_mkl,
    "cholmod": _factor_by_cholmod,
    "superlu": _factor_by_superlu,
}


class RotatedFactor:
    """Q A_0^-1 Q^T, with one factor, or what stands for it, for all matrices."""

    def __init__(self, pattern: BlockPattern, factor: RestFactor) -> None:
        self.factor = factor
        self._setup = Work(factorizations=1)
        n, d = pattern.nodes, pattern.dimension
        self._y = np.zeros(n * d, dtype=np.float32)
        self._Q = np.zeros((n, d, d))
        # kernels are compiled, or loaded, here and not in a timed step
        self.apply(np.zeros((n, d)), 0.0, np.zeros((n, d)), np.zeros((n, d)))

    def update(self, values: Floats, frames: NodalRotations) -> Work:
        """Take the nodal rotations of the matrix' state."""
        frames(self._Q)
        work, self._setup = self._setup, Work()
        return work

    def apply(self, r: Floats, size: float, Ap: Floats, z: Floats) -> tuple[float, float]:
        """Write Q A_0^-1 Q^T r into z; r / size is what single precision has to hold."""
        from pipeline.linear.kernels import vectors as kernels

        size = size or 1.0
        kernels.rotate_back(self._Q, r, self.factor.order, size, self._y)
        y = self.factor.solve(self._y)
        result: tuple[float, float] = kernels.rotate_forth(self._Q, y, self.factor.order, size, r, Ap, z)
        return result


def warped_cg(pattern: BlockPattern, rtol: float, rest: Rest) -> ConjugateGradients:
    """Return conjugate gradients with the turned factor of the state at rest."""
    return ConjugateGradients(pattern, rtol, RotatedFactor(pattern, factor_rest(pattern, rest)))


def multigrid_cg(pattern: BlockPattern, rtol: float, rest: Rest) -> ConjugateGradients:
    """Return conjugate gradients with the turned multigrid cycle of the state at rest."""
    cycle = Cycle(pattern.matrix(rest.values()), rigid_modes(rest.points))
    shape = rest.points.shape
    factor = RestFactor("multigrid", np.arange(pattern.nodes), lambda b: cycle(b.reshape(shape)).reshape(-1))
    return ConjugateGradients(pattern, rtol, RotatedFactor(pattern, factor))
