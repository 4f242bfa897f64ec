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

from scipy.sparse.linalg import splu

from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.memory import installed_bytes
from pipeline.mesh.simplex import Floats
from pipeline.stepping.banded import band_of
from pipeline.stepping.pardiso import library
from pipeline.stepping.state import Work
from pipeline.stepping.warped import factor_kind

# [MB] of a double precision band. A matrix that stays is factored once: reading its band is what counts. One that
# changes is factored every step, which costs the band's width more; from here on one factor, warped, is faster.
_CONSTANT_BAND = 20.0
_CONSTANT_BAND_WITHOUT_MKL = 60.0
_CHANGING_BAND = 0.5
# a factor in single precision by nested dissection, measured at 10k and 100k tetrahedra: bytes over dofs^(4/3)
_FACTOR_BYTES = 63.0
_MOST_OF_MEMORY = 0.5
# of h omega_max: at 16.8 and 100k tetrahedra 59 iterations without a factor took 117 ms, 4 with one 150
_SOFT = 20.0

# gives the values (blocks, d, d) of the system at rest; None where the system is always that
Rest = Callable[[], Floats] | None
# writes the nodes' rotations (n, d, d)
Frames = Callable[[Floats], object]


class LinearSolver(Protocol):
    """A solver prepared for one pattern; it holds the last matrix that `update` gave it."""

    def update(self, values: Floats, frames: Frames) -> Work:
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

    def solve(self, b: Floats, x: Floats) -> Work:
        """Write the solution by substitution into x."""
        x[:] = self._factor.solve(b.ravel()).reshape(b.shape)
        return Work(solves=1)


def choice(pattern: BlockPattern, *, constant: bool, stiffness: float) -> tuple[str, str]:
    """Return the name of the solver for a pattern whose matrix stays, or changes every step, and why.

    `stiffness` is h times (a bound of) the highest frequency [1]: conjugate gradients take about three times that
    many iterations without a factor.
    """
    band, mkl = band_of(pattern).megabytes, library() is not None
    most = _CHANGING_BAND if not constant else _CONSTANT_BAND if mkl else _CONSTANT_BAND_WITHOUT_MKL
    kind = "stays" if constant else "changes every step"
    if band <= most:
        return "banded", f"the matrix {kind}; its band takes {band:.3g} MB, at most {most:g}"
    why = f"the matrix {kind}; its band would take {band:.3g} MB, more than {most:g}"
    size = factor_bytes(pattern, "pardiso" if constant else "warped")
    if size > _MOST_OF_MEMORY * installed_bytes():
        return "cg", f"{why}; a sparse factor would take {size / 1e9:.3g} GB, too much for this machine"
    if constant:
        return ("pardiso", f"{why}; MKL is installed") if mkl else ("superlu", f"{why}; MKL is not installed")
    if factor_kind(band) != "banded" and stiffness <= _SOFT:
        return "cg", f"{why}; the step is short: h omega_max is {stiffness:.3g}, at most {_SOFT:g}"
    return "warped", f"{why}; h omega_max is up to {stiffness:.3g}; the factor at rest is {factor_kind(band)}"


def factor_bytes(pattern: BlockPattern, name: str) -> float:
    """Return what the factor of a solver takes [bytes]: of a band exactly, of a sparse one about; 0 without one."""
    band = band_of(pattern).megabytes
    dofs = pattern.nodes * pattern.dimension
    if name == "cg":
        return 0.0
    if name == "banded":
        return 1e6 * band
    if name == "warped":
        return 0.5e6 * band if factor_kind(band) == "banded" else _FACTOR_BYTES * dofs ** (4 / 3)
    return 2 * _FACTOR_BYTES * dofs ** (4 / 3)
