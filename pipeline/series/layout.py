"""How the files of a series are read: which cells are measured, their rest state, and where the points are.

Solvers write deformed points, or rest points and a displacement field; some write hexahedra along with tetrahedra,
nodes without cells, or mirrored cells. A note reports each of these decisions.
"""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, SeriesError, join_names, shorten
from pipeline.formats.cell_types import CELL_TYPES
from pipeline.formats.grid import Grid
from pipeline.formats.readers import SUFFIXES
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cleanup import orient_cells
from pipeline.mesh.simplex import CELL_NAMES, Mesh
from pipeline.series.frame_files import read_grid

_DISPLACEMENTS = {"displacement", "displacements", "disp", "u", "deformation"}  # compared in lower case
# vector fields that are not displacements
_OTHERS = ("velocity", "veloc", "acceler", "force", "normal", "reaction", "load", "momentum", "traction", "rest_")
_LARGEST = 1e75  # [m]: volumes of larger bodies would overflow; larger coordinates count as not finite
_PLANAR = 1e-6  # of the size: rounding to single precision leaves a few 1e-7 of it


@dataclass(frozen=True)
class Options:
    """The caller's choices: the displacement field ("none" for deformed points) and the rest state.

    `rest` is "first", "rest_position", "points" or the path of a file. None means the first of these that exists:
    the field rest_position, the points if a displacement field is added to them, the first frame.
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

    `arrangement` says where the first frame has the nodes and cells of the mesh; `displacement` names the field that is
    added to the points.
    """

    mesh: BodyMesh
    arrangement: Arrangement
    displacement: str | None
    grid: Grid  # points and cells of the first frame, without fields
    notes: tuple[str, ...]
    guessed: bool  # the displacement was found by its name

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
        arrangement = self.arrange(grid, where)
        if self.guessed and not np.array_equal(grid.points, self.grid.points):
            field = shorten(self.displacement or "")
            raise SeriesError(
                f"{where}: the points move, unlike those of the first, the middle and the last frame: say whether "
                f'displacement = "{field}" must be added to them, or "none"'
            )
        points = add_displacement(grid, self.displacement, where)
        points = arrangement.select_nodes(points)
        bad = np.flatnonzero(~(np.abs(points) < _LARGEST).all(axis=1))  # negated so that NaN counts too
        if bad.size:
            raise SeriesError(f"{where}: {bad.size} points are not finite, first {self.find_point(bad[0])}")
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


def add_displacement(grid: Grid, displacement: str | None, where: str) -> Floats:
    """Return the deformed points of a grid (n, 3)."""
    if displacement is None:
        return grid.points
    if displacement not in grid.point_data:
        raise SeriesError(f"{where}: no point field {shorten(displacement)}; it has {_join_fields(grid.point_data)}")
    field = np.asarray(grid.point_data[displacement], dtype=np.float64)
    if field.ndim != 2 or field.shape[1] not in (2, 3):
        raise SeriesError(f"{where}: the point field {shorten(displacement)} {field.shape} is not a vector field")
    return grid.points + np.pad(field, [(0, 0), (0, 3 - field.shape[1])])


def drop_z(points: Floats, where: str) -> Floats:
    """Return points (n, 2) without the third coordinate; raises SeriesError unless it is constant."""
    if np.ptp(points[:, 2]) > _PLANAR * float(np.ptp(points, axis=0).max()):
        raise SeriesError(f"{where}: triangles that do not lie in a plane of constant z are a surface, not a body")
    return np.ascontiguousarray(points[:, :2])


def infer_layout(first: Grid, read: Callable[[int], Grid], count: int, options: Options, where: str) -> SeriesLayout:
    """Return the layout of a series of `count` frames from the first one; raises SeriesError if it is ambiguous.

    `read` may be called for the middle and the last frame.
    """
    dimension, chosen, cell_notes = _select_cells(first, where)
    displacement, displacement_notes = _choose_displacement(first, read, count, options, where)
    cells = first.select_cells(CELL_TYPES[dimension])
    rest, rest_notes = _choose_rest_points(first, displacement, options, where)
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
    guessed = displacement is not None and options.displacement is None
    notes = (*cell_notes, *displacement_notes, *rest_notes, *orientation_notes)
    return SeriesLayout(mesh, arrangement, displacement, bare, notes, guessed)


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


def _choose_displacement(
    first: Grid, read: Callable[[int], Grid], count: int, options: Options, where: str
) -> tuple[str | None, tuple[str, ...]]:
    """Return the displacement field to add to the points, or None if the points themselves move, and a note."""
    if options.displacement is not None:
        if options.displacement == "none":
            return None, ()
        add_displacement(first, options.displacement, where)
        return options.displacement, ()
    if "rest_position" in first.point_data:
        return None, ()
    points = first.points
    if any(not np.array_equal(read(i).points, points) for i in sorted({count // 2, count - 1} - {0})):
        return None, ()
    vectors = [n for n, a in first.point_data.items() if a.ndim == 2 and a.shape[1] in (2, 3)]
    named = [name for name in vectors if name.lower() in _DISPLACEMENTS]
    if len(named) == 1:
        return named[0], (f"the points do not move; the field {named[0]} is taken as the displacement",)
    candidates = named or [name for name in vectors if not any(word in name.lower() for word in _OTHERS)]
    if candidates:
        raise SeriesError(
            f"{where}: the points do not move, and the displacement may be any of {_join_fields(candidates)}: "
            'say which (displacement = NAME), or displacement = "none" if the body is at rest'
        )
    return None, ("the points do not move and there is no displacement field",) if count > 1 else ()


def _choose_rest_points(
    first: Grid, displacement: str | None, options: Options, where: str
) -> tuple[Floats, tuple[str, ...]]:
    """Return the points of the rest state (n, 3), and a note if they are a guess."""
    rest = options.rest
    if rest is None:
        rest = "rest_position" if "rest_position" in first.point_data else "points" if displacement else "first"
        if rest == "first":
            return first.points, ("the rest state is the first frame",)
    if rest == "first":
        return add_displacement(first, displacement, where), ()
    if rest == "points":
        return first.points, ()
    if rest == "rest_position":
        if "rest_position" not in first.point_data:
            raise SeriesError(f"{where}: no point field rest_position; it has {_join_fields(first.point_data)}")
        return np.asarray(first.point_data["rest_position"], dtype=np.float64), ()
    file = Path(rest)
    if file.suffix not in SUFFIXES:
        raise SeriesError(f"rest state {file}: must be a file ({', '.join(SUFFIXES)}), first, points or rest_position")
    grid = read_grid(file)
    if not have_same_cells(grid, first):
        raise SeriesError(f"{where}: its cells are not those of the rest state {file}")
    return grid.points, ()


def _join_fields(names: Iterable[str]) -> str:
    return join_names(sorted(names)) or "none"
