"""Linear systems A x = b on the free nodes of a body: symmetric block matrices of one pattern, many values.

banded     Cholesky of the reverse Cuthill-McKee band; the fastest factor of small meshes
superlu    sparse LU, symmetric mode with a minimum-degree order of A + A^T; a factor per matrix, any conditioning
pardiso    sparse Cholesky of Intel MKL, where that is installed; the fastest direct solve of large meshes
warped     conjugate gradients with the rest state's factor, turned along; one factor a run: for larger meshes
cg         conjugate gradients with block Jacobi; no factor: for small steps, where few iterations suffice
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg, splu

from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.mesh.simplex import Floats
from pipeline.stepping.banded import Band, BandedCholesky
from pipeline.stepping.pardiso import Pardiso, library
from pipeline.stepping.state import Work
from pipeline.stepping.warped import WarpedCG

# [MB] of a double precision band. A matrix that stays is factored once: reading its band is what counts. One that
# changes is factored every step, which costs the band's width more; from here on one factor, warped, is faster.
_CONSTANT_BAND = 20.0
_CONSTANT_BAND_WITHOUT_MKL = 60.0
_CHANGING_BAND = 1.5

# gives the values (blocks, d, d) of the system at rest; None where the system is always that
Rest = Callable[[], Floats] | None
Frames = Callable[[], Floats]


class LinearSolver(Protocol):
    """A solver prepared for one pattern; it holds the last matrix that `update` gave it."""

    def update(self, values: Floats, frames: Frames) -> Work:
        """Take the matrix with these values (blocks, d, d) and the nodes' rotations (n, d, d) where it is of use.

        Raises SolveError where the matrix is singular.
        """
        ...

    def solve(self, b: Floats, guess: Floats) -> tuple[Floats, Work]:
        """Return x (n, d) with A x = b (n, d); iterative solvers start at guess."""
        ...


@dataclass(eq=False)
class SuperLU:
    """A sparse direct solve."""

    pattern: BlockPattern
    rtol: float
    rest: Rest = None

    def update(self, values: Floats, frames: Frames) -> Work:
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
    rest: Rest = None

    def update(self, values: Floats, frames: Frames) -> Work:
        """Take the matrix and invert its diagonal blocks."""
        self._matrix = self.pattern.matrix(values)
        try:
            self._inverse = np.linalg.inv(values[self.pattern.diagonal])
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


def automatic(pattern: BlockPattern, rtol: float, rest: Rest) -> LinearSolver:
    """Return the solver for the size of the pattern, and for whether its matrix changes."""
    band, mkl = Band(pattern), library() is not None
    if rest is None:
        if band.megabytes <= (_CONSTANT_BAND if mkl else _CONSTANT_BAND_WITHOUT_MKL):
            return BandedCholesky(pattern, rtol, rest)
        return (Pardiso if mkl else SuperLU)(pattern, rtol, rest)
    changing = BandedCholesky if band.megabytes <= _CHANGING_BAND else WarpedCG
    return changing(pattern, rtol, rest)
