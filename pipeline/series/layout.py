"""How the files of a series are read: which cells are measured, their rest state, and where the points are.

Solvers write deformed points, or rest points and a displacement field; some write hexahedra along with tetrahedra,
nodes without cells, or mirrored cells. A note reports each of these decisions.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, SeriesError, shorten
from pipeline.formats.cell_types import CELL_TYPES
from pipeline.formats.grid import Grid
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cleanup import orient_cells
from pipeline.mesh.simplex import CELL_NAMES, Mesh
from pipeline.series.displacement import SAME, Displacement, choose_displacement, collect_evidence
from pipeline.series.rest_state import FIELD, choose_rest_points, read_rest_file

_LARGEST = 1e75  # [m]: volumes of larger bodies would overflow; larger coordinates count as not finite
_PLANAR = 1e-6  # of the size: rounding to single precision leaves a few 1e-7 of it


@dataclass(frozen=True)
class Options:
    """The caller's choices of the displacement field and the rest state.

    `displacement` is a point field, scalar fields ("ux,uy,uz"), or "none" if the points are the motion.
    `rest` is "first" (frame), "points" (of the first frame), "subtract" (these minus the displacement), a point field
    such as "rest_position", or the path of a file. None means that the evidence decides: the field rest_position, the
    points if they rest, points minus displacement if the first frame is displaced, else the first frame.
    """

    displacement: str | None = None
    rest: str | os.PathLike[str] | None = None


class Arrangement(NamedTuple):
    """The points (n,) and cells (e,) of a file that are the nodes and cells of the mesh; None if they are equal."""

    nodes: Ints | None = None
    cells: Ints | None = None

    def select_nodes(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the mesh's nodes, given those of a file's points."""
        return values if self.nodes is None else values[self.nodes]

    def select_cells(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the mesh's cells, given those of a file's cells."""
        return values if self.cells is None else values[self.cells]


@dataclass(frozen=True, eq=False)
class SeriesLayout:
    """How frames become positions on one mesh.

    `arrangement` says where the first frame has the nodes and cells of the mesh; `motion` says which field is the
    displacement, and whether it is added to the points.
    """

    mesh: BodyMesh
    arrangement: Arrangement
    motion: Displacement
    grid: Grid  # points and cells of the first frame, without fields
    notes: tuple[str, ...]

    @property
    def displacement(self) -> str | None:
        """Return the label of the field that is added to the points."""
        return self.motion.field.label if self.motion.field is not None and self.motion.is_added else None

    def arrange(self, grid: Grid, where: str) -> Arrangement:
        """Return where a frame has the nodes and cells of the mesh; raises SeriesError if it does not have them."""
        self.check_cells(grid, where)
        return self.arrangement

    def check_cells(self, grid: Grid, where: str) -> None:
        """Raise SeriesError if the cells of a frame are not those of the first."""
        if not have_same_cells(grid, self.grid):
            raise SeriesError(
                f"{where}: its cells are not those of the first frame "
                f"({len(grid.types)} cells, {grid.count} points; it has {len(self.grid.types)} and "
                f"{self.grid.count}): the topology changes"
            )

    def compute_positions(self, grid: Grid, where: str) -> Floats:
        """Return the positions of a frame (n, d); raises SeriesError if they do not fit this mesh."""
        points = self.arrange(grid, where).select_nodes(add_displacement(grid, self.motion, self.grid, where))
        points[~(np.abs(points) < _LARGEST).all(axis=1)] = np.nan  # negated so that NaN counts too
        return drop_z(points, where) if self.mesh.dimension == 2 else np.ascontiguousarray(points)

    def find_point(self, node: int) -> int:
        """Return the number that a node of the mesh has in the files."""
        nodes = self.arrangement.nodes
        return int(node if nodes is None else nodes[node])


def have_same_cells(a: Grid, b: Grid) -> bool:
    """Return whether two grids have equal cells and the same number of points."""
    if a.connectivity is b.connectivity and a.types is b.types:  # equal text is decoded only once
        return a.count == b.count
    return a.count == b.count and np.array_equal(a.types, b.types) and np.array_equal(a.connectivity, b.connectivity)


def add_displacement(grid: Grid, motion: Displacement, first: Grid, where: str) -> Floats:
    """Return the deformed points of a grid (n, 3), a new array.

    Raises SeriesError if the points of a series whose displacement is added move themselves.
    """
    points = np.array(grid.points)
    if motion.field is None or not motion.is_added:
        return points
    moved = motion.field.read(grid)
    if grid.count == first.count and not np.array_equal(points, first.points):
        strayed, most = np.nanmax(np.abs(points - first.points)), np.nanmax(np.abs(moved))
        if strayed > SAME * max(most, float(np.ptp(first.points))):
            raise SeriesError(
                f"{where}: the points move by up to {strayed:.3g}, unlike those of the frames that were compared: say "
                f'whether displacement = "{shorten(motion.field.label)}" must be added to them, or "none"'
            )
    return points + moved


def drop_z(points: Floats, where: str) -> Floats:
    """Return points (n, 2) without the third coordinate; raises SeriesError unless it is constant."""
    if np.ptp(points[:, 2]) > _PLANAR * float(np.ptp(points, axis=0).max()):
        raise SeriesError(f"{where}: triangles that do not lie in a plane of constant z are a surface, not a body")
    return np.ascontiguousarray(points[:, :2])


def infer_layout(first: Grid, read: Callable[[int], Grid], count: int, options: Options, where: str) -> SeriesLayout:
    """Return the layout of a series of `count` frames from the first one; raises SeriesError if it is ambiguous.

    `read` is called for a few other frames, and for all of them if these show neither a motion nor a displacement.
    """
    dimension, chosen, cell_notes = _select_cells(first, where)
    from_file = read_rest_file(options.rest, first, where)
    if FIELD in first.point_data and options.displacement is None:
        motion = Displacement(None, False, False)
    else:
        evidence = collect_evidence(first, read, count, from_file)
        included = {"points": False, "subtract": True}.get(str(options.rest))
        motion = choose_displacement(evidence, options.displacement, where, included=included)
    cells = first.select_cells(CELL_TYPES[dimension])
    rest, rest_notes = choose_rest_points(first, motion, options.rest, from_file, where)
    used = np.zeros(len(rest), dtype=bool)
    used[cells] = True
    nodes = None if used.all() else np.flatnonzero(used)
    if nodes is not None:
        rest, cells = rest[nodes], (np.cumsum(used) - 1)[cells]
        cell_notes += (f"{(~used).sum()} points that belong to no measured cell are left out, first {np.argmin(used)}",)
    try:
        points = drop_z(rest, f"{where}: rest state") if dimension == 2 else rest
        cells, orientation_notes = orient_cells(points, cells)
        mesh = Mesh(points, cells, name=where)
    except MeshError as error:
        raise SeriesError(f"rest state: {error}") from error
    bare = Grid(first.points, first.count, first.types, first.offsets, first.connectivity, {}, {}, {})
    arrangement = Arrangement(nodes, None if chosen.all() else np.flatnonzero(chosen))
    notes = (*cell_notes, *motion.notes, *rest_notes, *orientation_notes)
    return SeriesLayout(mesh, arrangement, motion, bare, notes)


def _select_cells(grid: Grid, where: str) -> tuple[int, NDArray[np.bool_], tuple[str, ...]]:
    """Return the dimension, the mask of its simplices among the cells, and a note that counts the other cells."""
    kinds, counts = np.unique(grid.types, return_counts=True)
    for d, kind in CELL_TYPES.items():
        if kinds.tolist() == [kind]:
            return d, np.ones(len(grid.types), dtype=bool), ()
    import pyvista
    from vtkmodules.vtkCommonDataModel import vtkGenericCell

    cell, dimensions = vtkGenericCell(), dict[int, int]()
    for kind in kinds.tolist():
        cell.SetCellType(kind)
        dimensions[kind] = cell.GetCellDimension()
    d = max(dimensions.values())
    names = {kind: f"{count} {pyvista.CellType(kind).name.lower()}"
             for kind, count in zip(kinds.tolist(), counts.tolist(), strict=True)}  # fmt: skip
    if CELL_TYPES.get(d) not in dimensions:
        raise SeriesError(f"{where}: it has no tetrahedra and no triangles, but {', '.join(names.values())}")
    others = [name for kind, name in names.items() if kind != CELL_TYPES[d]]
    notes = (f"cells other than {CELL_NAMES[d]} cells are not measured: {', '.join(others)}",) if others else ()
    return d, grid.types == CELL_TYPES[d], notes
