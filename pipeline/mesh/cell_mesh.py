"""The rest mesh of a body with cells of any kind: hexahedra, wedges, quadratic cells, polyhedra, surfaces, mixtures."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.arrays import Floats
from pipeline.formats.grid import CellArray


@dataclass(frozen=True, eq=False, repr=False)
class CellMesh:
    """Points (n, 2) or (n, 3) [m] and cells of one dimension in VTK's layout; see BodyMesh.

    `plane` are two orthonormal rows (2, 3) if a planar body lies in any plane of space: areas are signed in it. Raises
    MeshError for cells that are inverted or flat at rest.
    """

    points: Floats
    cell_array: CellArray
    dimension: int
    plane: Floats | None = None
    name: str = "mesh"
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return (
            f"<CellMesh {self.name}: {len(self.points)} nodes, {len(self.cell_array.types)} cells, {self.dimension}D>"
        )

    @cached_property
    def rest_volumes(self) -> Floats:
        """Return the rest volume of every cell (e,) [m3; m2 if the dimension is 2]."""
        raise NotImplementedError

    @cached_property
    def node_volumes(self) -> Floats:
        """Return each node's share of the volumes of its cells (n,): integrals of its shape functions."""
        raise NotImplementedError

    @cached_property
    def centers(self) -> Floats:
        """Return the mean rest position of the points of every cell (e, d)."""
        raise NotImplementedError

    @cached_property
    def size(self) -> float:
        """Return the diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))
