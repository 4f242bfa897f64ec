"""The mesh of order 2: triangles with 6 nodes (d = 2) or tetrahedra with 10 (d = 3), straight or curved."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.formats.grid import CellArray
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.integration import Integration, integrate_cells, integrate_products
from pipeline.mesh.node_order import SIMPLEX_EDGES
from pipeline.mesh.quadrature import find_mass_quadrature, find_stress_quadrature
from pipeline.mesh.regions import Regions
from pipeline.mesh.shape_functions import CellKind, make_kind
from pipeline.mesh.simplex import Mesh
from pipeline.system.memory import require_memory

_TYPES = {2: 22, 3: 24}  # VTK's quadratic triangle and tetrahedron
_KINDS = {2: "triangle 2", 3: "tetrahedron 2"}
_NODES = {2: 6, 3: 10}
_BYTES = {2: 900, 3: 1900}  # per cell of a complete body, measured with 13 000 to 800 000 cells
_STRAIGHT = 1e-9  # of a side: the distance of its node from its middle


@dataclass(frozen=True, eq=False, repr=False)
class QuadraticMesh(CellMesh):
    """A rest mesh of order 2 that can be solved; its cells must not be folded. See ElementMesh."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.points.shape[1] != self.dimension or not np.isin(self.cell_array.types, _TYPES[self.dimension]).all():
            raise MeshError(f"{self.name}: its cells are not quadratic tetrahedra or planar quadratic triangles")
        folded = self._find_folded()
        if folded.size:
            raise MeshError(
                f"{self.name}: {folded.size} curved cells are folded, first {folded[0]}; move the nodes in the middle "
                "of their sides back, or take mesh.order = 1"
            )

    def _find_folded(self) -> Ints:
        """Return the cells whose map has a determinant below zero at a node, or not above it at a point of stress."""
        if self.is_straight:
            return np.empty(0, dtype=np.int64)  # their determinants are constant, and their volumes were checked
        at_points = np.flatnonzero((self.integration.weights <= 0).any(axis=1))
        return np.unique(np.concatenate([at_points, *(b.block.cells[b.folded_cells] for b in self.rest_blocks)]))

    def __repr__(self) -> str:
        return f"<QuadraticMesh {self.name}: {len(self.points)} nodes, {len(self.cells)} cells, {self.dimension}D>"

    @property
    def order(self) -> int:
        """Return the degree of the shape functions."""
        return 2

    @property
    def kind(self) -> CellKind:
        """Return the shape functions."""
        return make_kind(_KINDS[self.dimension])

    @cached_property
    def cells(self) -> Ints:
        """Return the nodes of every cell (e, k): its corners, and those of its sides in the order of SIMPLEX_EDGES."""
        return np.ascontiguousarray(self.cell_array.connectivity.reshape(-1, _NODES[self.dimension]), dtype=np.int64)

    @cached_property
    def is_straight(self) -> bool:
        """Return whether the node of every side is in its middle."""
        a, b = self.points[self.cells[:, SIMPLEX_EDGES[self.dimension].T]].transpose(1, 0, 2, 3)
        away = np.linalg.norm(self.points[self.cells[:, self.dimension + 1 :]] - (a + b) / 2, axis=2)
        return bool((away <= _STRAIGHT * np.linalg.norm(b - a, axis=2)).all())

    @cached_property
    def integration(self) -> Integration:
        """Return the points at which stresses are integrated: more of them if tetrahedra are curved."""
        rule = find_stress_quadrature(self.dimension, is_straight=self.is_straight)
        return integrate_cells(self.points, self.cells, self.kind, rule)

    @cached_property
    def shape_products(self) -> Floats:
        """Return int N_a N_b dV of every cell (e, k, k) [m3; m2 in the plane], exact."""
        rule = find_mass_quadrature(self.dimension, is_straight=self.is_straight)
        return integrate_products(self.points, self.cells, self.kind, rule)

    @cached_property
    def lumped_shares(self) -> Floats:
        """Return the share of every node in the volume of its cell (e, k), all positive.

        They are the diagonal of int N_a N_b, scaled to the volume (Hinton, Rock and Zienkiewicz 1976): the row sums
        are negative at corners.
        """
        diagonal = np.einsum("eaa->ea", self.shape_products)
        return np.asarray(diagonal * (self.rest_volumes / diagonal.sum(axis=1))[:, None])

    @cached_property
    def lumped_volumes(self) -> Floats:
        """Return the sums of these shares at the nodes (n,)."""
        sums = np.bincount(self.cells.ravel(), self.lumped_shares.ravel(), minlength=len(self.points))
        return sums.astype(np.float64, copy=False)


def make_quadratic_mesh(
    points: Floats, cells: Ints, name: str = "mesh", notes: tuple[str, ...] = (), regions: Regions | None = None
) -> QuadraticMesh:
    """Return the mesh of cells (e, 6) or (e, 10) in VTK's order; raises MeshError as QuadraticMesh does."""
    points, cells = np.asarray(points), np.asarray(cells)
    d = points.shape[1] if points.ndim == 2 else 0
    if d not in _NODES or cells.ndim != 2 or cells.shape[1] != _NODES[d]:
        raise MeshError(f"{name}: points {points.shape} and cells {cells.shape} are not a mesh of quadratic simplices")
    offsets = np.arange(0, cells.size + 1, cells.shape[1], dtype=np.int64)
    cell_array = CellArray(np.full(len(cells), _TYPES[d], dtype=np.uint8), offsets, cells.astype(np.int64).ravel())
    return QuadraticMesh(points, cell_array, d, None, name, notes, regions)


def require_quadratic_memory(count: int, dimension: int) -> None:
    """Raise MeshError if a body of so many cells of order 2 would not fit into free memory."""
    require_memory(count, _BYTES[dimension], "take fewer cells or mesh.order = 1")


def raise_order(mesh: Mesh) -> QuadraticMesh:
    """Return the mesh of order 2 with the same straight cells: the nodes of sides follow those of the mesh.

    Raises MeshError if it would not fit into free memory.
    """
    require_quadratic_memory(len(mesh.cells), mesh.dimension)
    ends, sides = find_sides(mesh.cells)
    points = np.concatenate([mesh.points, mesh.points[ends].mean(axis=1)])
    cells = np.concatenate([mesh.cells, len(mesh.points) + sides], axis=1)
    return make_quadratic_mesh(points, cells, mesh.name, mesh.notes, mesh.regions)


def find_sides(cells: Ints) -> tuple[Ints, Ints]:
    """Return the end nodes (s, 2) of all sides of simplices (e, d + 1), and those of each cell (e, sides)."""
    pairs = np.sort(cells[:, SIMPLEX_EDGES[cells.shape[1] - 1]], axis=2).reshape(-1, 2)
    n = int(cells.max()) + 1
    keys, sides = np.unique(pairs[:, 0] * n + pairs[:, 1], return_inverse=True)
    return np.stack([keys // n, keys % n], axis=1), sides.reshape(len(cells), -1)


def find_side_ends(mesh: ElementMesh) -> Ints:
    """Return the two corners between which every node of a mesh of order 2 lies (n, 2); of a corner, itself twice."""
    ends = np.repeat(np.arange(len(mesh.points))[:, None], 2, axis=1)
    ends[mesh.cells[:, mesh.dimension + 1 :]] = mesh.cells[:, SIMPLEX_EDGES[mesh.dimension]]
    return ends
