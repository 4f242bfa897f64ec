"""Multigrid by smoothed aggregation: for conjugate gradients a cycle is nearly as good as a factor, in far less memory.

Each node of a large mesh joins a group with its neighbors, and a group moves like a rigid body: that is the coarse
space, smoothed by one Jacobi step (Vanek, Mandel and Brezina 1996). With the prolongation P its matrix is P^T A P.
Groups form groups again until a band is small. On each level a cycle does a Gauss-Seidel sweep forward before the
correction and one backward after it, which makes it symmetric. Cycles work in single precision: they only precondition.

In a mesh of order 2 the first coarse space is that of order 1 on the corners instead: a node of a side moves with the
mean of its ends. Groups of all its nodes at once would need 25 to 28 iterations in place of 15.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg.lapack import spbtrs
from scipy.sparse import bsr_array, csr_array

from pipeline.arrays import Floats, Ints, Singles
from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.linear.band import Band
from pipeline.linear.banded import factor_in_single

# [MB] of the last level's band in double precision; at 100k tetrahedra 40 needs a third fewer cycles than 20
_LAST_BAND = 40.0
# a group lacks motions whose eigenvalue is below this fraction of the largest, such as rotations of a single node
_RANK = 1e-12
_POWER_STEPS = 10  # the estimate of the largest eigenvalue only scales a smoothing step


def make_rigid_modes(points: Floats) -> Floats:
    """Return the displacements (n, d, d (d + 1)/2) of translations and of small rotations about the mean point."""
    n, d = points.shape
    arm = points - points.mean(axis=0)
    arm /= np.abs(arm).max() or 1.0
    a, b = np.triu_indices(d, 1)
    rotation = d + np.arange(len(a))
    modes = np.zeros((n, d, d + len(a)))
    modes[:, range(d), range(d)] = 1.0
    modes[:, a, rotation], modes[:, b, rotation] = -arm[:, b], arm[:, a]
    return modes


class Cycle:
    """An approximate A^-1 for a symmetric positive definite A of d x d blocks that nearly maps its modes to zero.

    Modes are (n, d, m); nodes join groups along the edges of the graph, by default the blocks of A. With the `ends`
    (n, 2) of the sides that nodes of order 2 lie on there are no groups, but the corners; see RestState.
    """

    def __init__(self, A: bsr_array, modes: Floats, graph: csr_array | None = None, ends: Ints | None = None) -> None:
        n, d = modes.shape[:2]
        pattern, values = _split_lower(A)
        try:
            inverses = np.asarray(np.linalg.inv(values[pattern.diagonal]), np.float64)
        except np.linalg.LinAlgError as error:
            raise SolveError("a diagonal block of the system's matrix is singular") from error
        self._A = pattern.indptr.astype(np.int32), pattern.indices.astype(np.int32), values.astype(np.float32)
        self._A[2][pattern.diagonal] = inverses
        corners = np.empty(0, dtype=np.int64) if ends is None else _find_corners(ends)
        if ends is None or not corners.size:  # a body may have all its corners held
            if graph is None:
                graph = csr_array((np.ones(len(A.indices), dtype=np.float32), A.indices, A.indptr), shape=(n, n))
            group = _group_nodes(graph)
            P, coarse_modes = _make_prolongation(A, inverses, modes, group)
            member = csr_array((np.ones(n, dtype=np.float32), group, np.arange(n + 1)))
            coarse_graph = (member.T @ graph @ member).tocsr()
        else:
            P = _interpolate_sides(ends, corners, np.asarray(modes.any(axis=2)))
            coarse_modes, coarse_graph = modes[corners], None
        self._P = P.indptr.astype(np.int32), P.indices.astype(np.int32), P.data.astype(np.float32)
        c = P.blocksize[1]
        self._solve_below = _make_coarse_solver((P.T @ (A @ P)).tobsr((c, c)), coarse_modes, coarse_graph)
        self._x, self._residual = np.empty((2, n, d), dtype=np.float32)
        self._coarse = np.empty((len(coarse_modes), c), dtype=np.float32)

    def __call__(self, r: Singles) -> Singles:
        """Return approximately A^-1 r for r (n, d), in an array that the next call overwrites."""
        from pipeline.linear.kernels import multigrid as kernels

        sweep = kernels.compile_sweep(r.shape[1])
        restrict, prolong = kernels.compile_transfers(r.shape[1], self._coarse.shape[1])
        sweep(*self._A, r, self._x, self._residual, False)
        restrict(*self._P, self._residual, self._coarse)
        prolong(*self._P, self._solve_below(self._coarse), self._x)
        sweep(*self._A, r, self._x, self._residual, True)
        return self._x


def _make_coarse_solver(A: bsr_array, modes: Floats, graph: csr_array | None) -> Callable[[Singles], Singles]:
    """Return a solver of a coarse matrix: the factor of its band if that is small, else a cycle."""
    pattern, values = _split_lower(A)
    band = Band(pattern)
    if band.megabytes > _LAST_BAND:
        return Cycle(A, modes, graph)
    factor = factor_in_single(band, values)
    sort = (pattern.dimension * band.order[:, None] + np.arange(pattern.dimension)).ravel()

    def solve(r: Singles) -> Singles:
        r.reshape(-1)[sort] = spbtrs(factor, r.reshape(-1)[sort], lower=1, overwrite_b=1)[0]
        return r

    return solve


def _group_nodes(graph: csr_array) -> np.ndarray:
    """Return the group of every node."""
    from pipeline.linear.kernels import multigrid as kernels

    group = np.empty(len(graph.indptr) - 1, dtype=np.int32)
    kernels.group_nodes(graph.indptr.astype(np.int32), graph.indices.astype(np.int32), group)
    return group


def _make_prolongation(A: bsr_array, inverses: Floats, modes: Floats, group: np.ndarray) -> tuple[bsr_array, Floats]:
    """Return P = (1 - omega D^-1 A) T and the modes in the basis T, the groups' orthonormalized modes."""
    n, d, m = modes.shape
    count = int(group.max()) + 1
    products = np.einsum("nia,nib->abn", modes, modes).reshape(m * m, n)
    G = np.stack([np.bincount(group, weights=product) for product in products], axis=1).reshape(count, m, m)
    w, V = np.linalg.eigh(G)
    exists = w > _RANK * w[:, -1:]
    root = np.sqrt(np.where(exists, w, 1.0))
    T = modes @ np.where(exists[:, None], V / root[:, None], 0.0)[group]
    P = A @ bsr_array((T, group, np.arange(n + 1, dtype=np.int32)), shape=(n * d, m * count))
    rows = np.repeat(np.arange(n), np.diff(P.indptr))
    P.data[:] = -4 / (3 * _estimate_largest_eigenvalue(A, inverses)) * (inverses[rows] @ P.data)
    P.data[P.indices == group[rows]] += T
    return P, np.where(exists, root, 0.0)[:, :, None] * np.swapaxes(V, 1, 2)


def _find_corners(ends: Ints) -> Ints:
    """Return the nodes that are their own ends (n, 2)."""
    return np.flatnonzero((ends == np.arange(len(ends))[:, None]).all(axis=1))


def _interpolate_sides(ends: Ints, corners: Ints, moves: np.ndarray) -> bsr_array:
    """Return the P that gives every node the mean motion of its ends (n, 2), which are corners, or -1 if held.

    `moves` (n, d) marks the components that any mode moves; the others are held.
    """
    n, c, d = len(ends), len(corners), moves.shape[1]
    number = np.full(n + 1, -1)  # the last one is that of a held end
    number[corners] = np.arange(c)
    rows, columns = np.repeat(np.arange(n), 2), number[ends].ravel()
    free = columns >= 0
    weights = csr_array((np.full(int(free.sum()), 0.5), (rows[free], columns[free])), shape=(n, c))
    blocks = weights.data[:, None, None] * np.eye(d)
    from_node = np.repeat(np.arange(n), np.diff(weights.indptr))
    blocks *= (moves[from_node] & moves[corners[weights.indices]])[:, :, None]
    return bsr_array((blocks, weights.indices, weights.indptr), shape=(n * d, c * d))


def _estimate_largest_eigenvalue(A: bsr_array, inverses: Floats) -> float:
    """Return approximately the largest eigenvalue of D^-1 A, by power iterations."""
    x = np.random.default_rng(0).standard_normal(inverses.shape[:2])
    size = float(np.linalg.norm(x))
    for _ in range(_POWER_STEPS):
        x = (inverses @ (A @ (x / size).ravel()).reshape(*x.shape, 1))[:, :, 0]
        size = float(np.linalg.norm(x))
    return size


def _split_lower(A: bsr_array) -> tuple[BlockPattern, Floats]:
    """Return pattern and values of the lower blocks; a zero on the diagonal, a motion that a group lacks, becomes 1."""
    A.sort_indices()
    d = A.blocksize[0]
    rows = np.repeat(np.arange(len(A.indptr) - 1), np.diff(A.indptr))
    lower = A.indices <= rows
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows[lower]))])
    pattern = BlockPattern(indptr, A.indices[lower].astype(np.int64), d, np.arange(len(indptr) - 1))
    values = A.data[lower]
    values[pattern.diagonal] += np.eye(d) * (values[pattern.diagonal] == 0.0)
    return pattern, values
