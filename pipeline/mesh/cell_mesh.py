"""The rest mesh of a body with cells of any kind: hexahedra, wedges, quadratic cells, polyhedra, surfaces, mixtures."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import MeshError
from pipeline.formats.cell_kinds import TYPES
from pipeline.formats.grid import CellArray
from pipeline.mesh.blocks import KindBlock, check_types, split_blocks
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.faceted import FacetedCells, collect_faceted
from pipeline.mesh.regions import Regions
from pipeline.mesh.rest_cells import RestBlock, measure_block, prepare_block, share_among_nodes
from pipeline.mesh.rest_facets import RestFacets, measure_facets, prepare_facets, share_among_corners
from pipeline.mesh.simplex import Mesh, signed_volumes

_LARGEST = 1e30  # [m], as for simplices
_OFF_THE_PLANE = 1e-5  # of the size: positions in single precision leave a few 1e-7 of it


@dataclass(frozen=True, eq=False, repr=False)
class CellMesh:
    """Points (n, 2) or (n, 3) [m] and cells of one dimension in VTK's layout; see BodyMesh.

    `plane` are two orthonormal rows (2, 3) if a planar body lies in any plane of space: areas are signed in it. Raises
    MeshError for cells that are inverted or flat at rest, that cannot be measured, or that name nodes that do not
    exist. `notes` say how cells that are not simple are measured, `regions` which groups of their file they are in.
    """

    points: Floats
    cell_array: CellArray
    dimension: int
    plane: Floats | None = None
    name: str = "mesh"
    notes: tuple[str, ...] = ()
    regions: Regions | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", np.ascontiguousarray(self.points, dtype=np.float64))
        _check_layout(self)
        check_types(self.cell_array, self.name)
        bad = np.flatnonzero(~((self.rest_volumes > 0) & np.isfinite(self.rest_volumes)))
        if bad.size:
            kind = TYPES[int(self.cell_array.types[bad[0]])].name
            raise MeshError(
                f"{self.name}: {bad.size} inverted or flat cells, first {bad[0]} ({kind}) with "
                f"{'volume' if self.dimension == 3 else 'area'} {self.rest_volumes[bad[0]]:.3g}; "
                "reorient or remove them"
            )
        object.__setattr__(self, "notes", (*self.notes, *list_shape_notes(self)))
        self.points.setflags(write=False)

    def __repr__(self) -> str:
        return (
            f"<CellMesh {self.name}: {len(self.points)} nodes, {len(self.cell_array.types)} cells, {self.dimension}D>"
        )

    @property
    def is_surface(self) -> bool:
        """Return whether the cells are surfaces in space, without a plane of their own."""
        return self.dimension == 2 and self.points.shape[1] == 3 and self.plane is None

    @cached_property
    def blocks(self) -> tuple[KindBlock, ...]:
        """Return the cells that have shape functions, kind by kind."""
        return split_blocks(self.cell_array)

    @cached_property
    def rest_blocks(self) -> tuple[RestBlock, ...]:
        """Return the rest state of every block, which measures of frames need; computed once."""
        local = self.find_local(self.points)
        return tuple(prepare_block(local, block) for block in self.blocks)

    @cached_property
    def triangles(self) -> Mesh | None:
        """Return the linear triangles of a planar body as a mesh of their own, if there are any."""
        parts = [block.connectivity for block in self.blocks if block.kind.is_linear_simplex]
        planar = self.points.shape[1] == 2
        return Mesh(self.points, parts[0], self.name) if planar and parts else None

    @cached_property
    def facets(self) -> FacetedCells | None:
        """Return the cells that have only faces, if there are any."""
        return collect_faceted(self.points, self.cell_array, self.dimension, self.name)

    @cached_property
    def rest_facets(self) -> RestFacets | None:
        """Return the rest state of the cells that have only faces; computed once."""
        return None if self.facets is None else prepare_facets(self.find_local(self.points), self.facets)

    def find_local(self, points: Floats) -> Floats:
        """Return points (n, c) in the coordinates of the plane, if there is one; raises MeshError if they leave it."""
        if self.plane is None:
            return points
        height = (points - self.points) @ np.cross(*self.plane)
        height = height[np.isfinite(height)]
        away = float(np.ptp(height)) if height.size else 0.0
        if away > _OFF_THE_PLANE * self.size:
            raise MeshError(
                f"{self.name}: nodes leave the plane of the body by {away:.3g} m, so that areas in it mean nothing; "
                "measure the cells as a surface in space"
            )
        return np.ascontiguousarray(points @ self.plane.T)

    @cached_property
    def rest_volumes(self) -> Floats:
        """Return the rest volume of every cell (e,) [m3; m2 if the dimension is 2]."""
        return _measure(self.find_local(self.points), self.blocks, self.facets, len(self.cell_array.types))

    @cached_property
    def node_volumes(self) -> Floats:
        """Return each node's share of the volumes of its cells (n,): integrals of its shape functions."""
        local, total = self.find_local(self.points), np.zeros(len(self.points))
        for block in self.blocks:
            shares = share_among_nodes(local, block)
            # surfaces are integrated with more points here: their sum is made that of the volumes
            shares *= (self.rest_volumes[block.cells] / shares.sum(axis=1))[:, None]
            total += np.bincount(block.connectivity.ravel(), shares.ravel(), minlength=len(total))
        if self.facets is not None:
            total += share_among_corners(local, self.facets, len(total))
        return total

    @cached_property
    def centers(self) -> Floats:
        """Return the mean rest position of the points of every cell (e, d)."""
        return find_centers(self.points, self.cell_array)

    @cached_property
    def size(self) -> float:
        """Return the diagonal of the bounding box [m]."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


def find_centers(points: Floats, cells: CellArray) -> Floats:
    """Return the mean position (e, c) of the points of every cell."""
    counts = np.diff(cells.offsets)
    owner = np.repeat(np.arange(len(counts)), counts)
    sums = [np.bincount(owner, axis, minlength=len(counts)) for axis in points[cells.connectivity].T]
    return np.column_stack(sums) / np.maximum(counts, 1)[:, None]


def measure_volumes(
    points: Floats, cell_array: CellArray, dimension: int, plane: Floats | None = None, *, name: str = "mesh"
) -> Floats:
    """Return the signed volume (e,) of every cell at points (n, 2) or (n, 3), NaN for those of another dimension.

    Areas are signed in the plane of z or in `plane`; areas of surfaces in space and volumes of polyhedra are positive.
    Raises MeshError, which begins with `name`, for polyhedra whose faces do not enclose a volume.
    """
    local = points if plane is None else np.ascontiguousarray(points @ plane.T)
    blocks = tuple(block for block in split_blocks(cell_array) if block.kind.dimension == dimension)
    return _measure(local, blocks, collect_faceted(points, cell_array, dimension, name), len(cell_array.types))


def _measure(local: Floats, blocks: tuple[KindBlock, ...], facets: FacetedCells | None, count: int) -> Floats:
    """Return the volumes of `count` cells at points in their own coordinates, NaN for those in neither group."""
    volumes = np.full(count, np.nan)
    for block in blocks:
        surface = local.shape[1] > block.kind.dimension
        if block.kind.is_linear_simplex and not surface:
            volumes[block.cells] = signed_volumes(local, block.connectivity)
        else:
            volumes[block.cells] = measure_block(local, block, "surface" if surface else "volume")
    if facets is not None:
        volumes[facets.cells] = measure_facets(local, facets)
    return volumes


def require_cell_mesh(mesh: BodyMesh) -> CellMesh:
    """Return the mesh itself if it is one of cells of any kind; raises MeshError otherwise."""
    if not isinstance(mesh, CellMesh):
        raise MeshError(f"{mesh.name}: its cells are not described by VTK's types")
    return mesh


def _check_layout(mesh: CellMesh) -> None:
    """Raise MeshError if points and cells do not fit each other."""
    cells, n, name = mesh.cell_array, len(mesh.points), mesh.name
    if mesh.points.ndim != 2 or mesh.points.shape[1] not in (2, 3) or mesh.dimension not in (2, mesh.points.shape[1]):
        raise MeshError(f"{name}: points {mesh.points.shape} do not fit cells of dimension {mesh.dimension}")
    if not len(cells.types):
        raise MeshError(f"{name}: no cells")
    if not (np.abs(mesh.points) <= _LARGEST).all():  # written so that NaN fails too
        raise MeshError(f"{name}: a point is not finite, or farther than {_LARGEST:g} from the origin")
    for nodes in (cells.connectivity, *(cells.faces[:1] if cells.faces else ())):
        if len(nodes) and not 0 <= nodes.min() <= nodes.max() < n:
            wrong = nodes.min() if nodes.min() < 0 else nodes.max()
            raise MeshError(f"{name}: a cell names node {wrong} of {n} (counted from 0)")
    other = [int(t) for t in np.unique(cells.types) if int(t) in TYPES and TYPES[int(t)].dimension != mesh.dimension]
    if other:
        first = int(np.flatnonzero(cells.types == other[0])[0])
        raise MeshError(f"{name}: cell {first} ({TYPES[other[0]].name}) is not of dimension {mesh.dimension}")


def list_shape_notes(mesh: CellMesh) -> tuple[str, ...]:
    """Return notes on cells that are folded or degenerate at rest."""
    nothing = [np.zeros(0, dtype=np.int64)]
    folded = np.concatenate(nothing + [rest.block.cells[rest.folded_cells] for rest in mesh.rest_blocks])
    flat = np.concatenate(nothing + [rest.block.cells[rest.degenerate_cells] for rest in mesh.rest_blocks])
    notes = []
    if mesh.facets is not None:
        name = "polyhedra or prisms" if mesh.dimension == 3 else "polygons"
        notes.append(
            f"{len(mesh.facets.cells)} {name} are measured by their faces, fanned about their centers; their rotation "
            "is that of the least-squares fit to their points"
        )
    if folded.size:
        notes.append(
            f"{folded.size} cells are folded at rest (first {folded.min()}): their volumes are positive, but their "
            "maps are inverted somewhere; det F is relative to that"
        )
    if flat.size:
        notes.append(
            f"{flat.size} cells have nodes or edges that coincide at rest (first {flat.min()}): det F is not sampled "
            "at these points"
        )
    return tuple(notes)
