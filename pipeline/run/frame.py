"""Frame and the Sink protocol: they connect solving with recording, measuring and drawing."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.linear.work import Work
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.stepping.state import State

Values = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """One instant of a motion: the positions x (n, d) [m] of the nodes of a rest mesh, and velocities v [m/s].

    `known` are the values that only the solver knows (energies, momenta, iterations), by the names in
    `measures.VARIABLES` and `STEPS`; `work` is the work since the previous frame. A foreign series has none of
    them: `known` is empty, and step, v, work and state are None.

    Nodes that a frame does not have are NaN in x, and so are the numbers of their cells; `fault` says why. A frame
    whose cells are not those of the mesh (after remeshing) has numbers of the whole body in `whole`. `materials` are
    the numbers of the materials of cells (e,), if a body has several.
    """

    index: int
    time: float
    mesh: BodyMesh
    x: Floats
    step: int | None = None
    v: Floats | None = None
    known: Values = field(default_factory=dict)
    work: Work | None = None
    state: State | None = None
    whole: Values = field(default_factory=dict)
    fault: str = ""
    materials: Ints | None = None

    def __repr__(self) -> str:
        step = "" if self.step is None else f", step {self.step}"
        return f"<Frame {self.index}: t = {self.time:g} s{step}, {len(self.mesh.points)} nodes of {self.mesh.name}>"


class Sink(Protocol):
    """Writes frames, in order and with their measured values, into complete files."""

    def write(self, frame: Frame, measured: Values) -> None:
        """Record one frame; raises OutputError if it cannot be written."""
        ...

    def close(self) -> None:
        """Finish the files: everything written so far can be read."""
        ...
