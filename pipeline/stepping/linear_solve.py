"""Linear systems A x = b on the free nodes of a body: symmetric block matrices of one pattern, many values.

banded     Cholesky of the reverse Cuthill-McKee band; the fastest factor of small meshes
superlu    sparse LU, symmetric mode with a minimum-degree order of A + A^T; a factor per matrix, any conditioning
cg         conjugate gradients with block Jacobi; no factor: for small steps, where few iterations suffice
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import LinearOperator, cg, splu

from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.mesh.simplex import Floats
from pipeline.stepping.state import Work

# a factor beyond this costs more to make and to read than many iterations
_BAND_MEGABYTES = 1000.0


class LinearSolver(Protocol):
    """A solver prepared for one pattern; it holds the last matrix that `update` gave it."""

    def update(self, values: Floats) -> Work:
        """Take the matrix with these values (blocks, d, d); raises SolveError where it is singular."""
        ...

    def solve(self, b: Floats, guess: Floats) -> tuple[Floats, Work]:
        """Return x (n, d) with A x = b (n, d); iterative solvers start at guess."""
        ...


@dataclass(eq=False)
class SuperLU:
    """A sparse direct solve."""

    pattern: BlockPattern
    rtol: float

    def update(self, values: Floats) -> Work:
        """Factor the matrix."""
        try:
            self._factor = splu(
                self.pattern.matrix(values).tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise SolveError(f"the system's matrix is singular ({error})") from error
        return Work(factorisations=1)

    def solve(self, b: Floats, guess: Floats) -> tuple[Floats, Work]:
        """Return the solution by substitution; the guess is not used."""
        return self._factor.solve(b.ravel()).reshape(b.shape), Work(solves=1)


@dataclass(eq=False)
class BlockJacobiCG:
    """Conjugate gradients, preconditioned by the inverse diagonal blocks."""

    pattern: BlockPattern
    rtol: float

    def update(self, values: Floats) -> Work:
        """Take the matrix and invert its diagonal blocks."""
        self._matrix = self.pattern.matrix(values)
        try:
            self._inverse = np.linalg.inv(values[self.pattern.indices == self.pattern.rows])
        except np.linalg.LinAlgError as error:
            raise SolveError("a diagonal block of the system's matrix is singular") from error
        return Work()

    def solve(self, b: Floats, guess: Floats) -> tuple[Floats, Work]:
        """Return the solution to a relative residual of rtol; raises SolveError where that is not reached."""
        d = self.pattern.dimension

        def precondition(r: Floats) -> Floats:
            return (self._inverse @ r.reshape(-1, d, 1)).ravel()

        M = LinearOperator((b.size, b.size), matvec=precondition)
        limit = max(1000, 10 * b.size)
        x, info = cg(self._matrix, b.ravel(), x0=guess.ravel(), rtol=self.rtol, maxiter=limit, M=M)
        if info:
            raise SolveError(f"conjugate gradients did not reach {self.rtol:g} in {limit} iterations")
        return x.reshape(b.shape), Work(solves=1)


def automatic(pattern: BlockPattern, rtol: float) -> "LinearSolver":
    """Return the solver of the size: banded where its band fits, else conjugate gradients."""
    banded = BandedCholesky(pattern, rtol)
    return banded if banded.megabytes <= _BAND_MEGABYTES else BlockJacobiCG(pattern, rtol)


class BandedCholesky:
    """A Cholesky factor of the band that reverse Cuthill-McKee leaves: LAPACK, no fill-in to find; for small meshes."""

    def __init__(self, pattern: BlockPattern, rtol: float) -> None:
        self.pattern = pattern
        d, n = pattern.dimension, pattern.nodes
        graph = csr_array((np.ones(len(pattern.indices)), pattern.indices, pattern.indptr), shape=(n, n))
        order = reverse_cuthill_mckee(graph, symmetric_mode=True)
        place = np.empty(n, dtype=np.int64)
        place[order] = np.arange(n)
        axis = np.arange(d)
        row = d * place[pattern.rows][:, None, None] + axis[:, None]
        column = d * place[pattern.indices][:, None, None] + axis[None, :]
        below = row >= column
        # LAPACK's lower band: entry (i, j) at [i - j, j]; column-major, as pbtrf wants it
        self._taken = np.flatnonzero(below.ravel())
        self._width = int((row - column).max()) + 1
        self._target = ((row - column) + self._width * column).ravel()[self._taken]
        self._order, self._size = order, d * n
        self._band: Floats | None = None

    @property
    def megabytes(self) -> float:
        """Return what the factor takes."""
        return self._size * self._width * 8e-6

    def update(self, values: Floats) -> Work:
        """Factor the matrix; raises SolveError where it is not positive definite."""
        if self._band is None:
            self._band = np.empty((self._size, self._width))
        flat = self._band.reshape(-1)
        flat[:] = 0.0
        flat[self._target] = values.reshape(-1)[self._taken]
        self._factor, info = dpbtrf(self._band.T, lower=1, overwrite_ab=1)
        if info:
            raise SolveError(f"the system's matrix is not positive definite (row {info} of its band)")
        return Work(factorisations=1)

    def solve(self, b: Floats, guess: Floats) -> tuple[Floats, Work]:
        """Return the solution by substitution; the guess is not used."""
        x, _ = dpbtrs(self._factor, b[self._order].reshape(-1), lower=1, overwrite_b=1)
        out = np.empty_like(b)
        out[self._order] = x.reshape(b.shape)
        return out, Work(solves=1)
