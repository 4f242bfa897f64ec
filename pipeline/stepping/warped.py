r"""Conjugate gradients with the rest state's factor, turned along with the body.

The systems of a motion, M + h^2 sum_e R K_e R^T, differ from the one at rest, A_0, mostly by rotations. So A_0 is
factored once and Q A_0^-1 Q^T preconditions them all, Q the block diagonal of nodal rotations: on the thesis' bar in
10 000 tetrahedra, to 1e-6, 10 to 16 iterations in the violent steps where A_0^-1 alone needs 60 to 133. Nothing is
factored in a step. The factor is in single precision: it only preconditions.

For stiff steps of middle and large meshes; small ones are faster with a banded factor every step.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg.lapack import spbtrs
from scipy.sparse.linalg import splu

from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.mesh.simplex import Floats
from pipeline.stepping.banded import Band
from pipeline.stepping.state import Work

Singles = np.ndarray
_LIMIT = 2000
# above this the band's fill costs more to read than a sparse factor's
_BAND_MEGABYTES = 60.0


def rest_factor(pattern: BlockPattern, values: Floats) -> Callable[[Singles], Singles]:
    """Return b -> A^-1 b (n, d) in single precision: banded, else CHOLMOD by the `fast` extra, else SuperLU."""
    band = Band(pattern)
    if band.megabytes / 2 <= _BAND_MEGABYTES:
        factor = band.factored(values, np.float32)
        return lambda b: band.ordered(spbtrs(factor, band.flat(b), lower=1)[0], b.shape)
    matrix = pattern.matrix(values).tocsc()
    try:
        from cholespy import CholeskySolverF, MatrixType
    except ImportError:
        solve = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve
        return lambda b: solve(b.ravel().astype(np.float64)).reshape(b.shape).astype(np.float32)
    coo = matrix.tocoo()
    made = CholeskySolverF(matrix.shape[0], coo.row, coo.col, coo.data, MatrixType.COO)

    def solve_sparse(b: Singles) -> Singles:
        x = np.empty(b.size, dtype=np.float32)
        made.solve(np.ascontiguousarray(b.ravel()), x)
        return x.reshape(b.shape)

    return solve_sparse


class WarpedCG:
    """Solves for changing matrices of one pattern with one factor: that of rest(), or of the first."""

    def __init__(self, pattern: BlockPattern, rtol: float, rest: Callable[[], Floats] | None) -> None:
        self.pattern = pattern
        self.rtol = rtol
        self._rest = rest
        self._factor: Callable[[Singles], Singles] | None = None if rest is None else rest_factor(pattern, rest())
        self._setup = Work(factorisations=1)

    def update(self, values: Floats, frames: Callable[[], Floats]) -> Work:
        """Take the matrix with these values and the nodal rotations (n, d, d) of its state."""
        self._matrix = self.pattern.matrix(values)
        if self._factor is None:
            self._factor = rest_factor(self.pattern, values)
        self._Q = frames().astype(np.float32)
        work, self._setup = self._setup, Work()
        return work

    def solve(self, b: Floats, guess: Floats) -> tuple[Floats, Work]:
        """Return x (n, d) to a relative residual of rtol from guess; raises SolveError where that is not reached."""
        x = guess.copy()
        r = b - self._product(x)
        target = self.rtol * np.linalg.norm(b)
        z = self._preconditioned(r)
        p, rz = z, float((r * z).sum())
        for _ in range(_LIMIT):
            if np.linalg.norm(r) <= target:
                return x, Work(solves=1)
            Ap = self._product(p)
            curvature = float((p * Ap).sum())
            if not curvature > 0:
                raise SolveError(f"the system's matrix is not positive definite (p . A p = {curvature:.3g})")
            step = rz / curvature
            x += step * p
            r_new = r - step * Ap
            z = self._preconditioned(r_new)
            # Polak-Ribiere: the single precision of the factor makes the preconditioner a little different each time
            rz_new, beta = float((r_new * z).sum()), float(((r_new - r) * z).sum()) / rz
            p, r, rz = z + beta * p, r_new, rz_new
        raise SolveError(f"warped conjugate gradients did not reach {self.rtol:g} in {_LIMIT} iterations")

    def _product(self, x: Floats) -> Floats:
        return np.asarray(self._matrix @ x.ravel()).reshape(x.shape)

    def _preconditioned(self, r: Floats) -> Floats:
        """Return Q A_0^-1 Q^T r; scaled, so that single precision neither over- nor underflows."""
        size = float(np.abs(r).max()) or 1.0
        assert self._factor is not None
        turned = np.einsum("nji,nj->ni", self._Q, (r / size).astype(np.float32))
        back = np.einsum("nij,nj->ni", self._Q, self._factor(turned))
        return back.astype(np.float64) * size
