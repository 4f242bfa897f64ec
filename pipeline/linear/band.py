"""The band to which reverse Cuthill-McKee reduces a symmetric block pattern, in LAPACK's layout."""

from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from pipeline.arrays import Floats, Ints
from pipeline.fem.assembly import BlockPattern


class Band:
    """The order of the nodes and the position of every block entry of a pattern in LAPACK's lower band."""

    def __init__(self, pattern: BlockPattern) -> None:
        self.pattern = pattern
        i, j = pattern.rows, pattern.indices
        ones = np.ones(2 * len(i))
        graph = csr_array((ones, (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(pattern.nodes,) * 2)
        # numpy's index type: 32-bit indices would be copied at every solve
        self.order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.intp)
        self.place = np.argsort(self.order)
        self.width = pattern.dimension * (int(np.abs(self.place[i] - self.place[j]).max()) + 1)
        self.size = pattern.dimension * pattern.nodes

    def __repr__(self) -> str:
        return f"Band(size={self.size}, width={self.width}, {self.megabytes:.3g} MB)"

    @property
    def megabytes(self) -> float:
        """Return the size of a factor in double precision [MB]."""
        return self.size * self.width * 8e-6

    @cached_property
    def _entries(self) -> tuple[Ints, Ints]:
        """Return the stored entries of the values, flat, and their positions in the band."""
        pattern, d = self.pattern, self.pattern.dimension
        i, j = pattern.rows, pattern.indices
        axis = np.arange(d)
        row = d * self.place[i][:, None, None] + axis[:, None]
        column = d * self.place[j][:, None, None] + axis[None, :]
        # a block off the diagonal also represents its transpose; only the lower half of a diagonal block is stored
        stored = np.flatnonzero(((i != j)[:, None, None] | (row >= column)).ravel())
        row, column = np.maximum(row, column), np.minimum(row, column)
        # entry (row, column) is at [row - column, column]; column-major, as pbtrf requires
        return stored, ((row - column) + self.width * column).ravel()[stored]

    def fill(self, values: Floats, storage: np.ndarray) -> np.ndarray:
        """Write the values (blocks, d, d) into storage (size, width); return it as LAPACK's (width, size)."""
        from pipeline.linear.kernels.band import fill_band

        fill_band(values.reshape(-1), *self._entries, storage.reshape(-1))
        return storage.T
