"""The interface that the meshes of all bodies share: simplices that can be solved, and cells of any kind.

Everything after a Frame (measures, sinks, series, analysis, views) uses only this, so that it works alike on our runs
and on any program's files.
"""

from typing import Protocol

from pipeline.arrays import Floats
from pipeline.formats.grid import CellArray


class BodyMesh(Protocol):
    """The rest state of a body: n nodes, and e cells of dimension 2 or 3."""

    @property
    def name(self) -> str:
        """Return the name, for messages."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Return notes on corrections of the mesh."""
        ...

    @property
    def points(self) -> Floats:
        """Return the rest positions [m]: (n, 2) in a plane of constant z, else (n, 3)."""
        ...

    @property
    def dimension(self) -> int:
        """Return the dimension of the cells, which decides units: 3 for solids, 2 for planar bodies and surfaces."""
        ...

    @property
    def cell_array(self) -> CellArray:
        """Return the cells in VTK's layout."""
        ...

    @property
    def rest_volumes(self) -> Floats:
        """Return the rest volume of every cell (e,) [m3; m2 if the dimension is 2], positive."""
        ...

    @property
    def node_volumes(self) -> Floats:
        """Return each node's share of the volumes of its cells (n,)."""
        ...

    @property
    def centers(self) -> Floats:
        """Return the mean rest position of the points of every cell (e, d)."""
        ...

    @property
    def size(self) -> float:
        """Return the diagonal of the bounding box [m]."""
        ...
