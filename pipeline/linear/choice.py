"""The choice of a solver for the systems A x = b on the free nodes of a body: symmetric, of one pattern.

banded     Cholesky of the reverse Cuthill-McKee band: the fastest factor of small meshes
superlu    sparse LU; one factor per matrix, at any conditioning
pardiso    sparse Cholesky of Intel MKL: the fastest direct solver of large meshes
warped     conjugate gradients with the factor of the rest state, rotated with the body; one factor a run: medium meshes
multigrid  the same with a multigrid cycle in place of the factor: large meshes
cg         conjugate gradients with block Jacobi, no factor: small steps, for which few iterations suffice
"""

from pipeline.fem.assembly import BlockPattern
from pipeline.linear.band import Band
from pipeline.linear.pardiso import load_mkl
from pipeline.linear.rest_preconditioner import choose_rest_factor
from pipeline.system.memory import read_installed_bytes

# [MB] of a band in double precision. A constant matrix is factored once: the cost is reading its band. A changing one
# is factored every step, at a cost that also grows with its width: above this size a single factor (warped) is faster
_CONSTANT_BAND = 20.0
_CONSTANT_BAND_WITHOUT_MKL = 60.0
_CHANGING_BAND = 0.5
# ms a step, warped and multigrid: 8 and 10.5 at 12.6 MB, 26 and 24 at 48.4 MB, 77 (MKL's factor) and 64 at 192 MB
_WARPED_BAND = 40.0
# ms a step of a constant matrix, SuperLU and multigrid: 37 and 50 at 192 MB, 139 and 115 at 624 MB
_LU_BAND = 400.0
# bytes over dofs^(4/3) of a factor in single precision by nested dissection, measured at 10k and 100k tetrahedra; with
# order 2 MKL's factor is .86, 1.02 and 1.13 times that at 1152, 9984 and 34 560 cells
_FACTOR_BYTES = 63.0
# bytes that a cycle reads, over those of the lower blocks in single precision, at a million tetrahedra
_CYCLE_BYTES = 2.5
_MOST_OF_MEMORY = 0.5
# [bytes] of MKL's factor. At 2.2e9 set-up took 28 s and a step 351 ms, with multigrid 5 s and 598 ms: paid back after
# 90 steps. At 5.4e9: 100 s and 897 ms, with multigrid 10 s and 1198 ms: after 300 steps
_PAID_FACTOR = 4e9
# h omega_max by order. Order 1: at 8.4 and 100k tetrahedra, 28 iterations without a cycle took 90 ms, 6 with one 87 ms.
# Order 2: the bound is looser (2.2 times the frequency, not 1.6) and cycles take more iterations: at 20 and 10k cells,
# 77 iterations without a cycle took 105 ms, 15 with one 120 ms
_SOFT = {1: 8.0, 2: 20.0}


def choose_solver(band: Band, *, constant: bool, stiffness: float, order: int = 1) -> tuple[str, str]:
    """Return the name of the solver for a matrix that is constant, or changes every step, and the reason.

    `stiffness` is h times (a bound on) the highest frequency [1]: conjugate gradients without a factor take about three
    times that many iterations. `order` is that of the elements. The thresholds of bands hold for both orders.
    """
    size, mkl = band.megabytes, load_mkl() is not None
    most = _CHANGING_BAND if not constant else _CONSTANT_BAND if mkl else _CONSTANT_BAND_WITHOUT_MKL
    kind = "is constant" if constant else "changes every step"
    if size <= most:
        return "banded", f"the matrix {kind}; its band takes {size:.3g} MB, at most {most:g}"
    reason = f"the matrix {kind}; its band would take {size:.3g} MB, more than {most:g}"
    stiff = f"h omega_max is up to {stiffness:.3g}"
    if constant and mkl:
        factor, half = _estimate_sparse_factor(band), _MOST_OF_MEMORY * read_installed_bytes()
        if factor <= min(half, _PAID_FACTOR):
            return "pardiso", f"{reason}; MKL is installed"
        limit = f"half of the memory, {half / 1e9:.3g}" if half < _PAID_FACTOR else f"{_PAID_FACTOR / 1e9:.3g}"
        reason += f"; MKL's factor would take {factor / 1e9:.3g} GB, more than {limit}"
    elif constant:
        if size <= _LU_BAND:
            return "superlu", f"{reason}; MKL is not installed"
        reason += f", with superlu {_LU_BAND:g}; MKL is not installed"
    else:
        if size <= _WARPED_BAND:
            return "warped", f"{reason}; {stiff}; the factor at rest is {choose_rest_factor(band)}"
        reason += f", with warped {_WARPED_BAND:g}"
    if stiffness <= _SOFT[order]:
        return "cg", f"{reason}; the step is short: {stiff}, at most {_SOFT[order]:g}"
    return "multigrid", f"{reason}; {stiff}"


def estimate_factor_bytes(pattern: BlockPattern, name: str) -> float:
    """Return the size of a solver's factor, or cycle [bytes]: exact for a band, else approximate; 0 without one."""
    if name == "cg":
        return 0.0
    band = Band(pattern)
    if name == "banded":
        return 1e6 * band.megabytes
    if name == "multigrid":
        return _CYCLE_BYTES * 4 * pattern.blocks * pattern.dimension**2
    if name == "warped":
        if choose_rest_factor(band) == "banded":
            return 0.5e6 * band.megabytes
        return _estimate_sparse_factor(band) / 2
    return _estimate_sparse_factor(band)


def _estimate_sparse_factor(band: Band) -> float:
    """Return the size of a sparse factor in double precision [bytes]."""
    return 2 * _FACTOR_BYTES * float(band.size ** (4 / 3))
