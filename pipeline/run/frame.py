"""Frame and the Sink protocol: the joint between what solves and what records, measures and draws."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats
from pipeline.linear.work import Work
from pipeline.mesh.simplex import Mesh
from pipeline.stepping.state import State

Values = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant of a motion: where the nodes of a rest mesh are now.

    `known` holds what only the solver knows (energies, momenta, iterations), by the names of
    `measures.VARIABLES` and `STEPS`; it is empty, and v, work and state are None, for a foreign series.
    """

    index: int
    time: float
    mesh: Mesh
    x: Floats
    step: int | None = None
    v: Floats | None = None
    known: Values = field(default_factory=dict)
    work: Work | None = None
    state: State | None = None


class Sink(Protocol):
    """Takes frames in order, with what was measured on them, and leaves complete files behind."""

    def write(self, frame: Frame, measured: Values) -> None:
        """Record one frame; raises OutputError where it cannot."""
        ...

    def close(self) -> None:
        """Leave everything written so far readable."""
        ...
