"""Assembly: the sparsity pattern of a mesh's symmetric block matrices, and sums of cell matrices into it.

The pattern is computed once per mesh; a matrix is then an array of values.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array

from pipeline.arrays import Floats, Ints
from pipeline.mesh.element_mesh import ElementMesh


@dataclass(frozen=True, eq=False, repr=False)
class BlockPattern:
    """The blocks of a symmetric matrix of d x d blocks on and below its diagonal, in compressed rows.

    Values are (blocks, d, d); blocks above the diagonal are their transposes. The diagonal block is the last of its
    row. Row k belongs to node `order[k]`.
    """

    indptr: Ints
    indices: Ints
    dimension: int
    order: Ints

    def __repr__(self) -> str:
        return f"<BlockPattern: {self.nodes} rows, {self.blocks} blocks, {self.dimension}D>"

    @property
    def nodes(self) -> int:
        """Return the number of block rows."""
        return len(self.indptr) - 1

    @property
    def blocks(self) -> int:
        """Return the number of stored blocks."""
        return len(self.indices)

    @cached_property
    def rows(self) -> Ints:
        """Return the row of every block."""
        return np.repeat(np.arange(self.nodes), np.diff(self.indptr))

    @cached_property
    def diagonal(self) -> Ints:
        """Return the number of the diagonal block of every row."""
        return self.indptr[1:] - 1

    @cached_property
    def _full_pattern(self) -> tuple[Ints, Ints, Ints, Ints]:
        """Return the off-diagonal blocks, and the order of blocks, indptr and indices of the full matrix."""
        off = np.flatnonzero(self.rows != self.indices)
        i, j = self.order[self.rows], self.order[self.indices]
        rows, columns = np.concatenate([i, j[off]]), np.concatenate([j, i[off]])
        indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=self.nodes))])
        sort = np.lexsort((columns, rows))
        return off, sort, indptr, columns[sort]

    def matrix(self, values: Floats) -> bsr_array:
        """Return the full matrix, rows and columns in node order."""
        off, sort, indptr, indices = self._full_pattern
        both = np.concatenate([values, np.swapaxes(values[off], 1, 2)])[sort]
        size = self.dimension * self.nodes
        return bsr_array((both, indices, indptr), shape=(size, size))

    @cached_property
    def columns(self) -> Ints:
        """Return the node of every block's column."""
        in_order = (self.order == np.arange(self.nodes)).all()
        return self.indices if in_order else self.order[self.indices]

    def multiply(self, values: Floats, x: Floats, out: Floats) -> Floats:
        """Write the matrix times x (n, d) into out, both in node order, and return it."""
        from pipeline.fem.kernels.blocks import multiply

        multiply(self.indptr, self.columns, self.order, values, x, out)
        return out

    def leading(self, count: int) -> "BlockPattern":
        """Return the pattern of the first `count` rows and columns; its values are the first of this pattern's."""
        last = self.indptr[count]
        return BlockPattern(self.indptr[: count + 1], self.indices[:last], self.dimension, np.arange(count))


@dataclass(frozen=True, eq=False)
class Assembly:
    """The pattern of a mesh and the map from cells into it.

    `corners` (e, k) sorts the nodes of each cell by row. `pairs` (e, k (k + 1)/2) are then the blocks of the nodes
    (0, 0), (1, 0), (1, 1), (2, 0), …
    """

    pattern: BlockPattern
    corners: Ints
    pairs: Ints

    def sum_scalars(self, cell_matrices: Floats) -> Floats:
        """Return the values (blocks,) of the sum of symmetric cell matrices (e, k, k)."""
        return self.sum_blocks(cell_matrices[:, :, None, :, None])[:, 0, 0]

    def sum_blocks(self, cell_matrices: Floats) -> Floats:
        """Return the values (blocks, c, c) of the sum of symmetric cell matrices (e, k, c, k, c)."""
        c, corners = cell_matrices.shape[2], self.corners
        a, b = np.tril_indices(corners.shape[1])
        cells = np.arange(len(corners))[:, None]
        lower = cell_matrices[cells, corners[:, a], :, corners[:, b], :].reshape(-1, c * c)
        sums = [np.bincount(self.pairs.ravel(), weights=entry, minlength=self.pattern.blocks) for entry in lower.T]
        return np.asarray(np.stack(sums, axis=1), np.float64).reshape(-1, c, c)


def sort_corners(mesh: ElementMesh, order: Ints) -> Ints:
    """Return the nodes of every cell (e, k) sorted by the rows of their nodes; row k belongs to node order[k]."""
    return np.argsort(np.argsort(order)[mesh.cells], axis=1)


def assemble_pattern(mesh: ElementMesh, order: Ints | None = None, patches: Ints | None = None) -> Assembly:
    """Return the assembly of a mesh; row k belongs to node order[k], by default to node k.

    The pattern has blocks for all pairs of nodes of a cell, and of a patch (g, m) if there are any.
    """
    n = len(mesh.points)
    order = np.arange(n) if order is None else order
    corners = sort_corners(mesh, order)
    cells = np.argsort(order)[np.take_along_axis(mesh.cells, corners, axis=1)]
    a, b = np.tril_indices(cells.shape[1])
    keys = (cells[:, a] * n + cells[:, b]).ravel()
    # a node without cells has a zero block on the diagonal too
    more = [np.arange(n) * (n + 1)] if patches is None else [np.arange(n) * (n + 1), _number_pairs(patches, order)[1]]
    blocks, pairs = np.unique(np.concatenate([keys, *more]), return_inverse=True)
    indptr = np.concatenate([[0], np.cumsum(np.bincount(blocks // n, minlength=n))])
    pattern = BlockPattern(indptr, blocks % n, mesh.dimension, order)
    return Assembly(pattern, corners, pairs[: len(keys)].reshape(len(cells), -1))


def locate_patches(pattern: BlockPattern, patches: Ints) -> Assembly:
    """Return the map from patches (g, m) into a pattern that has their blocks, as that from cells."""
    corners, keys = _number_pairs(patches, pattern.order)
    blocks = pattern.rows * pattern.nodes + pattern.indices
    return Assembly(pattern, corners, np.searchsorted(blocks, keys).reshape(len(patches), -1))


def _number_pairs(patches: Ints, order: Ints) -> tuple[Ints, Ints]:
    """Return the nodes of patches (g, m) sorted by row, and the number row n + column of each of their blocks."""
    rows = np.argsort(order)[patches]
    corners = np.argsort(rows, axis=1, kind="stable")
    rows = np.take_along_axis(rows, corners, axis=1)
    a, b = np.tril_indices(rows.shape[1])
    return corners, (rows[:, a] * len(order) + rows[:, b]).ravel()
