"""How the files of a series are read: which cells are measured, their rest state, and where the points are.

Solvers write deformed points, or rest points and a displacement field; some write hexahedra along with tetrahedra,
nodes without cells, or mirrored cells. A note reports each of these decisions.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats
from pipeline.errors import MeshChangedError, MeshError, SeriesError, shorten
from pipeline.formats.cell_types import CELL_TYPES
from pipeline.formats.grid import Grid
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cleanup import orient_cells
from pipeline.mesh.simplex import CELL_NAMES, Mesh
from pipeline.series.arrangement import Arrangement, arrange_frame, keep_ids
from pipeline.series.displacement import SAME, Displacement, choose_displacement, collect_evidence, find_largest
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


@dataclass(frozen=True, eq=False)
class SeriesLayout:
    """How frames become positions on one mesh.

    `arrangement` says where the first frame has the nodes and cells of the mesh; `motion` says which field is the
    displacement, and whether it is added to the points.
    """

    mesh: BodyMesh
    arrangement: Arrangement
    motion: Displacement
    grid: Grid  # points and cells of the first frame, with the ids of both as its only fields
    at_rest: Grid  # the same with rest positions
    rest_field: str | None  # of the rest positions in every frame
    notes: tuple[str, ...]

    @property
    def displacement(self) -> str | None:
        """Return the label of the field that is added to the points."""
        return self.motion.field.label if self.motion.field is not None and self.motion.is_added else None

    def arrange(self, grid: Grid, where: str) -> Arrangement:
        """Return where a frame has the nodes and cells of the mesh; raises MeshChangedError if it has others."""
        arrangement = arrange_frame(grid, self.at_rest, self.arrangement, lambda: self._find_rest(grid))
        if arrangement is not None:
            return arrangement
        raise MeshChangedError(
            f"{where}: its cells are not those of the first frame ({len(grid.types)} cells, {grid.count} points; it "
            f"has {len(self.grid.types)} and {self.grid.count}): the topology changes"
        )

    def _find_rest(self, grid: Grid) -> Floats | None:
        """Return the rest positions of a frame's points (n, 3), None if nothing says them."""
        if self.rest_field is not None and self.rest_field in grid.point_data:
            return np.asarray(grid.point_data[self.rest_field], dtype=np.float64)
        if self.motion.field is None or not self.motion.field.is_in(grid):
            return None
        return grid.points if self.motion.is_added else grid.points - self.motion.field.read(grid)

    def compute_positions(self, grid: Grid, where: str) -> Floats:
        """Return the positions of a frame (n, d), NaN if they are not finite; raises SeriesError if they do not fit."""
        arrangement = self.arrange(grid, where)
        points = np.array(arrangement.select_nodes(grid.points))
        field = self.motion.field
        if field is not None and self.motion.is_added:
            moved = arrangement.select_nodes(field.read(grid))
            self._check_rest(points, moved, where)
            points += moved
        points[~(np.abs(points) < _LARGEST).all(axis=1)] = np.nan  # negated so that NaN counts too
        return drop_z(points, where) if self.mesh.dimension == 2 else np.ascontiguousarray(points)

    def _check_rest(self, points: Floats, moved: Floats, where: str) -> None:
        """Raise SeriesError if points to which the displacement is added move themselves."""
        first = self.arrangement.select_nodes(self.grid.points)
        if np.array_equal(points, first):
            return
        strayed, most = find_largest(points - first), find_largest(moved)
        if strayed > SAME * max(most, float(np.ptp(first))):
            name = self.motion.field.label if self.motion.field is not None else ""
            raise SeriesError(
                f"{where}: the points move by up to {strayed:.3g}, unlike those of the frames that were compared: say "
                f'whether displacement = "{shorten(name)}" must be added to them, or "none"'
            )

    def read_points(self, grid: Grid) -> Floats:
        """Return the deformed points (n, 3) of a file that may have other cells, in its order."""
        field = self.motion.field
        return grid.points if field is None or not self.motion.is_added else grid.points + field.read(grid)

    def find_point(self, node: int) -> int:
        """Return the number that a node of the mesh has in the files."""
        nodes = self.arrangement.nodes
        return int(node if nodes is None else nodes[node])


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
    all_rest = rest
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
    bare = keep_ids(first)
    at_rest = replace(bare, stored_points=all_rest)
    rest_field = FIELD if options.rest in (None, FIELD) and FIELD in first.point_data else None
    arrangement = Arrangement(nodes, None if chosen.all() else np.flatnonzero(chosen))
    notes = (*cell_notes, *motion.notes, *rest_notes, *orientation_notes)
    return SeriesLayout(mesh, arrangement, motion, bare, at_rest, rest_field, notes)


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
