"""From cells to nodes: the block pattern of the mesh's matrices, computed once, and the sums over it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, coo_array, csr_array

from pipeline.mesh.simplex import Floats, Ints, Mesh


@dataclass(frozen=True, eq=False)
class BlockPattern:
    """Where a matrix of d x d blocks has entries: compressed rows of nodes. Values are (blocks, d, d)."""

    indptr: Ints
    indices: Ints
    dimension: int

    @property
    def nodes(self) -> int:
        """Return the number of block rows."""
        return len(self.indptr) - 1

    @cached_property
    def rows(self) -> Ints:
        """Return the block row of every block."""
        return np.repeat(np.arange(self.nodes), np.diff(self.indptr))

    def matrix(self, values: Floats) -> bsr_array:
        """Return the values as a scipy matrix that shares their memory."""
        size = self.dimension * self.nodes
        return bsr_array((values, self.indices, self.indptr), shape=(size, size))

    def product(self, values: Floats, vector: Floats) -> Floats:
        """Return the matrix times a nodal vector (n, d)."""
        return np.asarray((self.matrix(values) @ vector.ravel()).reshape(vector.shape))

    def restricted(self, kept: np.ndarray) -> tuple["BlockPattern", Ints]:
        """Return the pattern of the kept nodes (a mask) and the index of its blocks among ours."""
        columns = self.indices
        blocks = np.flatnonzero(kept[self.rows] & kept[columns])
        number = np.cumsum(kept) - 1
        counts = np.bincount(number[self.rows[blocks]], minlength=int(kept.sum()))
        indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        return BlockPattern(indptr, number[columns[blocks]].astype(np.int64), self.dimension), blocks


@dataclass(frozen=True, eq=False)
class Assembly:
    """The pattern of a mesh and the map from every pair of a cell's corners to its block."""

    pattern: BlockPattern
    pairs: Ints

    def sum_scalars(self, per_pair: Floats) -> Floats:
        """Return the block sums (blocks,) of one number a pair of corners (e, d + 1, d + 1)."""
        sums = np.bincount(self.pairs, weights=per_pair.ravel(), minlength=len(self.pattern.indices))
        return np.asarray(sums, np.float64)

    def sum_blocks(self, per_pair: Floats) -> Floats:
        """Return the values (blocks, d, d) of the cells' matrices (e, d + 1, d, d + 1, d)."""
        d = self.pattern.dimension
        blocks = per_pair.transpose(2, 4, 0, 1, 3).reshape(d * d, -1)
        count = len(self.pattern.indices)
        sums = [np.bincount(self.pairs, weights=b, minlength=count) for b in blocks]
        return np.asarray(np.stack(sums, axis=1), np.float64).reshape(-1, d, d)


def assemble_pattern(mesh: Mesh) -> Assembly:
    """Return the assembly of a mesh."""
    n, corners = len(mesh.points), mesh.cells.shape[1]
    rows = np.repeat(mesh.cells, corners, axis=1).ravel()
    columns = np.tile(mesh.cells, (1, corners)).ravel()
    # a node that no cell uses still has its (zero) diagonal block
    graph = csr_array(
        coo_array(
            (np.ones(rows.size + n), (np.append(rows, np.arange(n)), np.append(columns, np.arange(n)))),
            shape=(n, n),
        )
    )
    graph.sum_duplicates()
    keys = np.repeat(np.arange(n), np.diff(graph.indptr)) * n + graph.indices
    pairs = np.searchsorted(keys, rows.astype(np.int64) * n + columns)
    pattern = BlockPattern(graph.indptr.astype(np.int64), graph.indices.astype(np.int64), mesh.dimension)
    return Assembly(pattern, pairs.astype(np.int64))
