"""The interface of linear solvers, and the settings that each of them is made from."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.assembly import BlockPattern
from pipeline.linear.band import Band
from pipeline.linear.work import Work

NodalRotations = Callable[[Floats], object]  # writes the nodes' rotations into an array (n, d, d)


class LinearSolver(Protocol):
    """A solver prepared for one pattern; it holds the last matrix that `update` received."""

    def update(self, values: Floats, write_rotations: NodalRotations) -> Work:
        """Take the matrix with these values (blocks, d, d); solvers that need the nodes' rotations ask for them.

        Raises SolveError if the matrix is singular.
        """
        ...

    def solve(self, b: Floats, x: Floats) -> Work:
        """Write the solution of A x = b into x (n, d); iterative solvers start from the x that they are passed."""
        ...


@dataclass(frozen=True, eq=False)
class RestState:
    """The body at rest: its free nodes (n, d) [m], and a function that assembles the values of A_0 (blocks, d, d).

    In a mesh of order 2 `find_ends` returns the ends (n, 2) of the side that each free node is on: a corner twice for
    the corner itself, and -1 for an end that is held. `is_held` (n, d) marks single held components of the free nodes,
    whose rows and columns of A_0 are zero but for the diagonal; None if there are none.
    """

    points: Floats
    assemble: Callable[[], Floats]
    find_ends: Callable[[], Ints] | None = None
    is_held: np.ndarray | None = None

    @property
    def order(self) -> int:
        """Return the order of the elements."""
        return 1 if self.find_ends is None else 2


@dataclass(frozen=True, eq=False)
class SystemSettings:
    """The systems that a solver is for: their pattern, the relative residual that suffices, and the state at rest.

    Direct solvers use the pattern only; preconditioners are made from the state at rest.
    """

    pattern: BlockPattern
    rtol: float
    rest: RestState

    @cached_property
    def band(self) -> Band:
        """Return the band of the pattern."""
        return Band(self.pattern)
