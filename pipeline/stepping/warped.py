r"""Conjugate gradients with the rest state's factor, turned along with the body.

The systems of a motion, M + h^2 sum_e R K_e R^T, differ from the one at rest, A_0, mostly by rotations. So A_0 is
factored once and Q A_0^-1 Q^T preconditions them all, Q the block diagonal of nodal rotations: on the thesis' bar in
10 000 tetrahedra, to 1e-6, 10 to 16 iterations in the violent steps where A_0^-1 alone needs 60 to 133. Nothing is
factored in a step. The factor is in single precision: it only preconditions.

For stiff steps of middle and large meshes; small ones are faster with a banded factor every step.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import spbtrs
from scipy.sparse.linalg import splu

from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.mesh.simplex import Floats
from pipeline.stepping import pardiso
from pipeline.stepping.banded import Band
from pipeline.stepping.state import Work

Singles = np.ndarray
_LIMIT = 2000
# [MB] of the band in double precision: above the first MKL's sparse factor is faster to read, above the second any is
_SMALL_BAND = 20.0
_LARGE_BAND = 60.0


@dataclass(frozen=True, eq=False)
class RestFactor:
    """Solves A_0 y = b in single precision, for flat vectors whose nodes stand in `order`; b may be overwritten."""

    name: str
    order: np.ndarray
    solve: Callable[[Singles], Singles]


def rest_factor(pattern: BlockPattern, values: Floats) -> RestFactor:
    """Return the factor: banded; for larger ones by MKL, by CHOLMOD (both from the `fast` extra), or by SuperLU."""
    band = Band(pattern)
    if band.megabytes <= (_LARGE_BAND if pardiso.library() is None else _SMALL_BAND):
        factor = band.factored(values, np.float32)
        return RestFactor("banded", band.order, lambda b: spbtrs(factor, b, lower=1, overwrite_b=1)[0])
    nodes = np.arange(pattern.nodes)
    if pardiso.library() is not None:
        sparse = pardiso.Factor(pattern, np.float32)
        sparse.update(values)
        return RestFactor("mkl", nodes, sparse.solve)
    matrix = pattern.matrix(values).tocsc()
    try:
        from cholespy import CholeskySolverF, MatrixType
    except ImportError:
        solve = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve
        return RestFactor("superlu", nodes, lambda b: solve(b.astype(np.float64)).astype(np.float32))
    coo = matrix.tocoo()
    made = CholeskySolverF(matrix.shape[0], coo.row, coo.col, coo.data, MatrixType.COO)

    def solve_sparse(b: Singles) -> Singles:
        x = np.empty_like(b)
        made.solve(b, x)
        return x

    return RestFactor("cholmod", nodes, solve_sparse)


class WarpedCG:
    """Solves for changing matrices of one pattern with one factor: that of rest(), or of the first."""

    def __init__(self, pattern: BlockPattern, rtol: float, rest: Callable[[], Floats] | None) -> None:
        self.pattern = pattern
        self.rtol = rtol
        self._factor = None if rest is None else rest_factor(pattern, rest())
        self._setup = Work(factorisations=1)
        n, d = pattern.nodes, pattern.dimension
        self._r, self._z, self._p, self._Ap = (np.empty((n, d)) for _ in range(4))
        self._y = np.empty(n * d, dtype=np.float32)

    def update(self, values: Floats, frames: Callable[[], Floats]) -> Work:
        """Take the matrix with these values and the nodal rotations (n, d, d) of its state; values are not copied."""
        self._values = values
        if self._factor is None:
            self._factor = rest_factor(self.pattern, values)
        self._Q = frames()
        work, self._setup = self._setup, Work()
        return work

    def solve(self, b: Floats, guess: Floats) -> tuple[Floats, Work]:
        """Return x (n, d) to a relative residual of rtol from guess; raises SolveError where that is not reached."""
        from pipeline.stepping import kernels

        x, r, z, p, Ap = guess.copy(), self._r, self._z, self._p, self._Ap
        target = self.rtol * np.sqrt(kernels.dot(b, b))
        size = kernels.subtract(b, self.pattern.product(self._values, x, Ap), r)
        p[:] = 0.0
        rz, step = 1.0, 0.0  # so that the first direction is z
        for iteration in range(_LIMIT):
            if size <= target:
                return x, Work(solves=1, linear_iterations=iteration)
            rz_new, zAp = self._precondition(size)
            # Polak-Ribiere, (r_new - r) . z = -step A p . z: the single precision of the factor makes the
            # preconditioner a little different each time
            kernels.follow(z, -step * zAp / rz, p)
            rz = rz_new
            curvature = kernels.dot(p, self.pattern.product(self._values, p, Ap))
            if not curvature > 0:
                raise SolveError(f"the system's matrix is not positive definite (p . A p = {curvature:.3g})")
            step = rz / curvature
            size = kernels.descend(step, p, Ap, x, r)
        raise SolveError(f"warped conjugate gradients did not reach {self.rtol:g} in {_LIMIT} iterations")

    def _precondition(self, size: float) -> tuple[float, float]:
        """Write z = Q A_0^-1 Q^T r, return z . r and z . A p; r / size is what single precision has to hold."""
        from pipeline.stepping import kernels

        assert self._factor is not None
        size = size or 1.0
        kernels.turn(self._Q, self._r, self._factor.order, size, self._y)
        y = self._factor.solve(self._y)
        return kernels.turn_back(self._Q, y, self._factor.order, size, self._r, self._Ap, self._z)
