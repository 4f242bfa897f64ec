"""Natural frequencies of a body at rest: K u = omega^2 M u on its free components."""

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csc_array
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.mesh.simplex import label_components

# omega^2 of a rigid mode is only rounding error: below this fraction of (wave speed / size)^2
_RIGID = 1e-6


def find_lowest_frequencies(body: Body, count: int = 1) -> tuple[Floats, Floats]:
    """Return the lowest elastic frequencies (count,) [rad/s] and their modes (count, n, d), M-normalized.

    Rigid modes of unsupported bodies are left out. Raises SolveError if the iteration does not converge.
    """
    K, M = _assemble_free_matrices(body)
    d = body.mesh.dimension
    scale = (body.material.slowest_wave_speed / body.mesh.size) ** 2
    extra = d * (d + 1) // 2 * label_components(body.mesh)[0]
    wanted = count + extra
    if wanted >= K.shape[0] - 1:
        values, vectors = _solve_dense(K, M)
    else:
        shift = -1e-3 * scale  # negative, below the rigid modes, so that K - shift M can be factored
        try:
            inverse = splu((K - shift * M).tocsc()).solve
            operator = LinearOperator(K.shape, matvec=inverse, dtype=np.float64)
            start = np.random.default_rng(0).standard_normal(K.shape[0])
            values, vectors = eigsh(K, wanted, M, sigma=shift, OPinv=operator, v0=start)
        except (ArpackError, RuntimeError) as error:
            raise SolveError(f"the lowest frequencies were not found ({error})") from error
    elastic = np.flatnonzero(values > _RIGID * scale)[:count]
    modes = np.zeros((len(elastic), *body.mesh.points.shape))
    modes.reshape(len(elastic), -1)[:, body.free_components] = vectors.T[elastic]
    return np.sqrt(values[elastic]), modes


def _assemble_free_matrices(body: Body) -> tuple[csc_array, csc_array]:
    pattern = body.free_pattern
    _, K = body.linearize(body.mesh.points)
    matrices = csc_array(pattern.matrix(K[: pattern.blocks])), csc_array(pattern.matrix(body.mass[: pattern.blocks]))
    if body.guide_cut is None:
        return matrices
    kept = np.flatnonzero(~body.guide_cut.is_held.ravel())
    return matrices[0][kept][:, kept], matrices[1][kept][:, kept]


def _solve_dense(K: csc_array, M: csc_array) -> tuple[Floats, Floats]:
    values, vectors = eigh(K.toarray(), M.toarray())
    return values, vectors
