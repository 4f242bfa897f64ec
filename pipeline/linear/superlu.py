"""Sparse LU by SuperLU, in symmetric mode with a minimum-degree order of A + A^T; works at any conditioning."""

from scipy.sparse import csc_array
from scipy.sparse.linalg import SuperLU as Factor
from scipy.sparse.linalg import splu

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.linear.solver import NodalRotations, SystemSettings
from pipeline.linear.work import Work


def factor_symmetric(matrix: csc_array) -> Factor:
    """Return the LU factors of a symmetric matrix."""
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class SuperLU:
    """A factor for every new matrix."""

    def __init__(self, systems: SystemSettings) -> None:
        self._pattern = systems.pattern

    def update(self, values: Floats, write_rotations: NodalRotations) -> Work:
        """Factor the matrix; raises SolveError if it is singular."""
        try:
            self._factor = factor_symmetric(self._pattern.matrix(values).tocsc())
        except RuntimeError as error:
            raise SolveError(f"the system's matrix is singular ({error})") from error
        return Work(factorizations=1)

    def solve(self, b: Floats, x: Floats) -> Work:
        """Write the solution by substitution into x."""
        x[:] = self._factor.solve(b.ravel()).reshape(b.shape)
        return Work(solves=1)
