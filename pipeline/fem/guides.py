"""Matrices and rotations of bodies some of whose free nodes have held components.

Such a node keeps its rows in the matrix, so that all blocks stay d x d. The rows and columns of its held components
are cut, all but their diagonal: A stays symmetric and positive definite, and they are uncoupled from the free ones.
"""

from functools import cached_property

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.assembly import BlockPattern


class GuideCut:
    """The cut of one pattern of free nodes (f,): `components` (c,) are held, each d node + axis."""

    def __init__(self, pattern: BlockPattern, free: Ints, components: Ints) -> None:
        d = pattern.dimension
        nodes, axes = np.divmod(components, d)
        self.pattern = pattern
        self.components = components
        self.is_held = np.zeros((len(free), d), dtype=bool)
        self.is_held[np.searchsorted(free, nodes), axes] = True
        self.rows = np.flatnonzero(self.is_held.any(axis=1))

    def __repr__(self) -> str:
        return f"<GuideCut of {len(self.components)} components>"

    @cached_property
    def entries(self) -> Ints:
        """Return the places of the entries to cut among the values (blocks, d, d), flat."""
        pattern, held = self.pattern, self.is_held
        rows, columns, d = pattern.rows, pattern.indices, pattern.dimension
        touched = np.flatnonzero(held[rows].any(axis=1) | held[columns].any(axis=1))
        rows, columns = rows[touched], columns[touched]
        cut = held[rows][:, :, None] | held[columns][:, None, :]
        cut &= (rows != columns)[:, None, None] | ~np.eye(d, dtype=bool)
        return (touched[:, None, None] * d * d + np.arange(d * d).reshape(d, d))[cut]

    @cached_property
    def diagonal(self) -> Ints:
        """Return the places of the diagonal entries of the components, flat."""
        rows, axes = np.nonzero(self.is_held)
        d = self.pattern.dimension
        return self.pattern.diagonal[rows] * d * d + axes * (d + 1)

    def apply(self, A: Floats, out: Floats | None = None) -> Floats:
        """Cut the values A (blocks, d, d), which may have more rows than the pattern; return the entries, in `out`."""
        values = A.reshape(-1)
        before = values.take(self.entries, out=out, mode="clip")
        values[self.entries] = 0.0
        return before

    def undo(self, A: Floats, entries: Floats) -> None:
        """Put back the entries that `apply` returned."""
        A.reshape(-1)[self.entries] = entries

    def restrict_rotations(self, Q: Floats) -> None:
        """Replace the rotations Q (f, d, d) of guided nodes by the nearest that turn no held axis into a free one.

        So a preconditioner turned by Q leaves held components uncoupled too.
        """
        rows = self.rows
        held, d = self.is_held[rows], Q.shape[1]
        R = np.zeros((len(rows), d, d))
        R[:, np.arange(d), np.arange(d)] = 1.0
        for axis in range(d if d == 3 else 0):
            turns = np.flatnonzero(held[:, axis] & (held.sum(axis=1) == 1))
            b, c = (axis + 1) % 3, (axis + 2) % 3
            P = Q[rows[turns]]
            angle = np.arctan2(P[:, c, b] - P[:, b, c], P[:, b, b] + P[:, c, c])
            R[turns, b, b] = R[turns, c, c] = np.cos(angle)
            R[turns, c, b] = np.sin(angle)
            R[turns, b, c] = -np.sin(angle)
        Q[rows] = R
