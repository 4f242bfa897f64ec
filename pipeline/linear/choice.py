"""Linear systems A x = b on the free nodes of a body: symmetric block matrices of one pattern, many values.

banded     Cholesky of the reverse Cuthill-McKee band; the fastest factor of small meshes
superlu    sparse LU, symmetric mode with a minimum-degree order of A + A^T; a factor per matrix, any conditioning
pardiso    sparse Cholesky of Intel MKL, the fastest direct solve of large meshes; superlu where MKL is not installed
warped     conjugate gradients with the rest state's factor, turned along; one factor a run: for middle meshes
multigrid  the same with a multigrid cycle in place of the factor: for large meshes
cg         conjugate gradients with block Jacobi; no factor: for small steps, where few iterations suffice
"""

from dataclasses import dataclass
from typing import Protocol

from scipy.sparse.linalg import splu

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.linear.banded import band_of
from pipeline.linear.cg import NodalRotations
from pipeline.linear.pardiso import Pardiso, load_mkl
from pipeline.linear.rest_preconditioner import factor_kind
from pipeline.linear.work import Work
from pipeline.system.memory import read_installed_bytes

# [MB] of a double precision band. A matrix that stays is factored once: reading its band is what counts. One that
# changes is factored every step, which costs the band's width more; from here on one factor, warped, is faster.
_CONSTANT_BAND = 20.0
_CONSTANT_BAND_WITHOUT_MKL = 60.0
_CHANGING_BAND = 0.5
# at 12.6 MB a step took 8 ms with the factor and 10.5 with multigrid, at 48.4 26 and 24, at 192 77 (MKL's) and 64
_WARPED_BAND = 40.0
# SuperLU against multigrid, for a matrix that stays: 37 and 50 ms a step at 192 MB, 139 and 115 at 624
_LU_BAND = 400.0
# a factor in single precision by nested dissection, measured at 10k and 100k tetrahedra: bytes over dofs^(4/3)
_FACTOR_BYTES = 63.0
# what a cycle reads of a million tetrahedra, over the lower blocks in single precision
_CYCLE_BYTES = 2.5
_MOST_OF_MEMORY = 0.5
# [bytes] of MKL's: set-up and ms a step were 28 s and 351 at 2.2e9, with multigrid 5 and 598: paid after 90 steps; at
# 5.4e9 100 and 897, with multigrid 10 and 1198: after 300
_PAID_FACTOR = 4e9
# of h omega_max: at 8.4 and 100k tetrahedra 28 iterations without a cycle took 90 ms, 6 with one 87
_SOFT = 8.0


class LinearSolver(Protocol):
    """A solver prepared for one pattern; it holds the last matrix that `update` gave it."""

    def update(self, values: Floats, frames: NodalRotations) -> Work:
        """Take the matrix with these values (blocks, d, d) and the nodes' rotations where they are of use.

        Raises SolveError where the matrix is singular.
        """
        ...

    def solve(self, b: Floats, x: Floats) -> Work:
        """Make A x = b (n, d); iterative solvers start at the x that they get."""
        ...


@dataclass(eq=False)
class SuperLU:
    """A sparse direct solve."""

    pattern: BlockPattern
    rtol: float
    rest: object = None

    def update(self, values: Floats, frames: NodalRotations) -> Work:
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
        return Work(factorizations=1)

    def solve(self, b: Floats, x: Floats) -> Work:
        """Write the solution by substitution into x."""
        x[:] = self._factor.solve(b.ravel()).reshape(b.shape)
        return Work(solves=1)


def pardiso_or_lu(pattern: BlockPattern, rtol: float, rest: object) -> LinearSolver:
    """Return MKL's direct solver, or SuperLU where MKL is not installed."""
    return SuperLU(pattern, rtol, rest) if load_mkl() is None else Pardiso(pattern, rtol, rest)


def choose_solver(pattern: BlockPattern, *, constant: bool, stiffness: float) -> tuple[str, str]:
    """Return the name of the solver for a pattern whose matrix stays, or changes every step, and why.

    `stiffness` is h times (a bound of) the highest frequency [1]: conjugate gradients take about three times that
    many iterations without a factor.
    """
    band, mkl = band_of(pattern).megabytes, load_mkl() is not None
    most = _CHANGING_BAND if not constant else _CONSTANT_BAND if mkl else _CONSTANT_BAND_WITHOUT_MKL
    kind = "stays" if constant else "changes every step"
    if band <= most:
        return "banded", f"the matrix {kind}; its band takes {band:.3g} MB, at most {most:g}"
    why = f"the matrix {kind}; its band would take {band:.3g} MB, more than {most:g}"
    stiff = f"h omega_max is up to {stiffness:.3g}"
    if constant and mkl:
        factor, half = factor_bytes(pattern, "pardiso"), _MOST_OF_MEMORY * read_installed_bytes()
        if factor <= min(half, _PAID_FACTOR):
            return "pardiso", f"{why}; MKL is installed"
        limit = f"half of the memory, {half / 1e9:.3g}" if half < _PAID_FACTOR else f"{_PAID_FACTOR / 1e9:.3g}"
        why += f"; MKL's factor would take {factor / 1e9:.3g} GB, more than {limit}"
    elif constant:
        if band <= _LU_BAND:
            return "superlu", f"{why}; MKL is not installed"
        why += f", with superlu {_LU_BAND:g}; MKL is not installed"
    else:
        if band <= _WARPED_BAND:
            return "warped", f"{why}; {stiff}; the factor at rest is {factor_kind(band)}"
        why += f", with warped {_WARPED_BAND:g}"
    if stiffness <= _SOFT:
        return "cg", f"{why}; the step is short: {stiff}, at most {_SOFT:g}"
    return "multigrid", f"{why}; {stiff}"


def factor_bytes(pattern: BlockPattern, name: str) -> float:
    """Return what a solver's factor, or cycle, takes [bytes]: of a band exactly, else about; 0 without one."""
    band = band_of(pattern).megabytes
    dofs = pattern.nodes * pattern.dimension
    if name == "cg":
        return 0.0
    if name == "banded":
        return 1e6 * band
    if name == "multigrid":
        return _CYCLE_BYTES * 4 * pattern.blocks * pattern.dimension**2
    if name == "warped":
        return 0.5e6 * band if factor_kind(band) == "banded" else _FACTOR_BYTES * dofs ** (4 / 3)
    return 2 * _FACTOR_BYTES * dofs ** (4 / 3)
