"""The simplex mesh, triangles in the plane (d = 2) or tetrahedra in space (d = 3), and its measures."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.formats.cell_types import CELL_TYPES
from pipeline.formats.grid import CellArray
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.integration import Integration
from pipeline.mesh.regions import Regions

_LARGEST = 1e30  # [m]: squares and cubes of coordinates do not overflow
_AT_A_TIME = 8192  # cells: intermediate arrays stay in the cache
CELL_NAMES = {2: "triangle", 3: "tetrahedron"}


def edge_matrices(points: Floats, cells: Ints) -> Floats:
    """Return D (e, d, d), whose columns are the edges from a cell's first vertex to the others."""
    return np.swapaxes(points[cells[:, 1:]] - points[cells[:, :1]], 1, 2)


def compute_shape_gradients(points: Floats, cells: Ints) -> Floats:
    """Return grad N_a (e, d + 1, d) [1/m] of cells that are not flat."""
    inverse = np.linalg.inv(edge_matrices(points, cells))
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)


def signed_volumes(points: Floats, cells: Ints) -> Floats:
    """Return det D / d! (e,): volumes [m3], or areas [m2] for triangles; negative if inverted.

    Cells are not checked: every node number must exist.
    """
    out, by_component = np.empty(len(cells)), np.ascontiguousarray(points.T)
    with np.errstate(all="ignore"):  # overflow and underflow are checked by the caller
        for k in range(0, len(cells), _AT_A_TIME):
            # clip: checking every index would take as long as the rest
            first, *others = (by_component.take(a, 1, mode="clip") for a in cells[k : k + _AT_A_TIME].T)
            D = np.stack([other - first for other in others], axis=1)  # D[i, k]: component i of edge k of all cells
            out[k : k + _AT_A_TIME] = _determinants(D) / (2 if len(D) == 2 else 6)
    return out


def _determinants(D: Floats) -> Floats:
    """Return the determinants of D (d, d, e); expanded: LAPACK takes four times as long and is no more accurate."""
    if len(D) == 2:
        return np.asarray(D[0, 0] * D[1, 1] - D[0, 1] * D[1, 0])
    return np.asarray(
        D[0, 0] * (D[1, 1] * D[2, 2] - D[1, 2] * D[2, 1])
        - D[0, 1] * (D[1, 0] * D[2, 2] - D[1, 2] * D[2, 0])
        + D[0, 2] * (D[1, 0] * D[2, 1] - D[1, 1] * D[2, 0])
    )


@dataclass(frozen=True, eq=False, repr=False)
class Mesh:
    """A rest mesh: points (n, d) [m] and positively oriented cells (e, d + 1).

    `notes` say how reading changed the file's content, `regions` which of its groups the cells are in. Raises MeshError
    for cells that are inverted or flat, or that name nodes that do not exist.
    """

    points: Floats
    cells: Ints
    name: str = "mesh"
    notes: tuple[str, ...] = ()
    regions: Regions | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", np.ascontiguousarray(self.points, dtype=np.float64))
        object.__setattr__(self, "cells", np.ascontiguousarray(self.cells, dtype=np.int64))
        n, d = self.points.shape
        if d not in CELL_NAMES or self.cells.ndim != 2 or self.cells.shape[1] != d + 1:
            raise MeshError(
                f"{self.name}: points {self.points.shape} and cells {self.cells.shape} are not a simplex mesh"
            )
        if not len(self.cells):
            raise MeshError(f"{self.name}: no {CELL_NAMES[d]}")
        if self.cells.min() < 0 or self.cells.max() >= n:
            wrong = self.cells.min() if self.cells.min() < 0 else self.cells.max()
            raise MeshError(f"{self.name}: a cell names node {wrong} of {n} (counted from 0)")
        if not (np.abs(self.points) <= _LARGEST).all():  # written so that NaN fails too
            raise MeshError(f"{self.name}: a point is not finite, or farther than {_LARGEST:g} from the origin")
        bad = np.flatnonzero(~((self.rest_volumes > 0) & np.isfinite(self.rest_volumes)))
        if bad.size:
            raise MeshError(
                f"{self.name}: {bad.size} inverted or flat {CELL_NAMES[d]} cells, first {bad[0]} with volume "
                f"{self.rest_volumes[bad[0]]:.3g}; reorient or remove them"
            )
        self.points.setflags(write=False)
        self.cells.setflags(write=False)

    def __repr__(self) -> str:
        return f"<Mesh {self.name}: {len(self.points)} nodes, {len(self.cells)} cells, {self.dimension}D>"

    @property
    def dimension(self) -> int:
        """Return d."""
        return self.points.shape[1]

    @cached_property
    def rest_volumes(self) -> Floats:
        """Return the rest volume of every cell (e,) [m3; m2 in the plane]."""
        return signed_volumes(self.points, self.cells)

    @cached_property
    def cell_array(self) -> CellArray:
        """Return the cells in VTK's layout."""
        e, corners = self.cells.shape
        types = np.full(e, CELL_TYPES[self.dimension], dtype=np.uint8)
        return CellArray(types, np.arange(0, corners * e + 1, corners, dtype=np.int64), self.cells.ravel())

    @cached_property
    def shape_gradients(self) -> Floats:
        """Return grad N_a (e, d + 1, d) [1/m]: the rows of Dm^-1, and minus their sum for the first vertex."""
        return compute_shape_gradients(self.points, self.cells)

    @property
    def order(self) -> int:
        """Return the degree of the shape functions."""
        return 1

    @cached_property
    def integration(self) -> Integration:
        """Return the one point of every cell: gradients are constant."""
        return Integration(self.rest_volumes[:, None], self.shape_gradients[:, None])

    @property
    def shape_products(self) -> Floats:
        """Return int N_a N_b dV of every cell (e, k, k) [m3; m2 in the plane]."""
        k = self.dimension + 1
        return (self.rest_volumes / (k * (k + 1)))[:, None, None] * (1 + np.eye(k))

    @property
    def lumped_shares(self) -> Floats:
        """Return the share V / (d + 1) of every node in its cells (e, d + 1)."""
        k = self.dimension + 1
        return np.repeat((self.rest_volumes / k)[:, None], k, axis=1)

    @property
    def lumped_volumes(self) -> Floats:
        """Return the sums of these shares at the nodes (n,)."""
        return self.node_volumes

    @cached_property
    def centers(self) -> Floats:
        """Return the mean rest position of the points of every cell (e, d)."""
        return np.asarray(self.points[self.cells].mean(axis=1))

    @cached_property
    def size(self) -> float:
        """Return the diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @cached_property
    def node_volumes(self) -> Floats:
        """Return each node's share V / (d + 1) of its cells (n,)."""
        share = np.repeat(self.rest_volumes / (self.dimension + 1), self.dimension + 1)
        return np.bincount(self.cells.ravel(), weights=share, minlength=len(self.points)).astype(np.float64, copy=False)


def require_simplices(mesh: BodyMesh) -> Mesh:
    """Return the mesh itself if it consists of linear simplices; raises MeshError otherwise."""
    if not isinstance(mesh, Mesh):
        raise MeshError(f"{mesh.name}: its cells are not linear tetrahedra or triangles")
    return mesh


def measure_quality(mesh: ElementMesh) -> Floats:
    """Return d inradius / circumradius of every cell's corners (e,): 1 for a regular cell, 0 for a flat one."""
    d = mesh.dimension
    cells = mesh.cells[:, : d + 1]
    faces = np.array([np.delete(np.arange(d + 1), a) for a in range(d + 1)])
    corners = mesh.points[cells[:, faces]]  # (e, face, d vertices, d)
    if d == 2:
        areas = np.linalg.norm(corners[:, :, 1] - corners[:, :, 0], axis=-1)
    else:
        sides = corners[:, :, 1:] - corners[:, :, :1]
        areas = np.linalg.norm(np.cross(sides[:, :, 0], sides[:, :, 1]), axis=-1) / 2
    inradius = d * signed_volumes(mesh.points, cells) / areas.sum(axis=1)
    edges = np.swapaxes(edge_matrices(mesh.points, cells), 1, 2)
    # the circumcenter c, relative to the first vertex, satisfies edge . c = |edge|^2 / 2 for every edge
    center = np.linalg.solve(edges, (edges**2).sum(axis=2, keepdims=True) / 2)[:, :, 0]
    return np.asarray(d * inradius / np.linalg.norm(center, axis=1))


def label_components(mesh: ElementMesh) -> tuple[int, Ints]:
    """Return the number of connected components and each node's label (n,); a node without cells is a component."""
    a = np.repeat(mesh.cells[:, :1], mesh.cells.shape[1] - 1, axis=1).ravel()
    b = mesh.cells[:, 1:].ravel()
    n = len(mesh.points)
    count, labels = connected_components(coo_array((np.ones(a.size), (a, b)), shape=(n, n)), directed=False)
    return int(count), labels.astype(np.int64)
