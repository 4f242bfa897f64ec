"""How the files of a series are read: which cells are measured, their rest state, and where the points are.

Every decision follows from the numbers of the files (displacement.py, rest_state.py, cell_selection.py, rest_mesh.py,
arrangement.py), and a note reports it.
"""

import os
from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshChangedError, SeriesError, join_names, shorten
from pipeline.formats.grid import Grid, have_same_cells
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.cleanup import PLANAR
from pipeline.run.frame import Values
from pipeline.series.body.arrangement import (
    Arrangement,
    IdTable,
    make_missing,
    match_by_ids,
    match_by_positions,
)
from pipeline.series.body.cell_arrays import select_array
from pipeline.series.body.cell_selection import find_ghosts
from pipeline.series.body.cell_sides import join_coincident
from pipeline.series.body.decisions import Decisions
from pipeline.series.body.displacement import DisplacementChoice
from pipeline.series.body.rest_mesh import allow_gap
from pipeline.series.body.vector_fields import VectorField, find_vector_fields
from pipeline.series.body.whole_body import measure_whole_body

_PARTED = 0.5  # of the points that coincide at rest
_LARGEST = 1e75  # [m]: volumes of larger bodies would overflow; larger coordinates count as not finite


@dataclass(frozen=True)
class Options:
    """The caller's choices: the displacement field ("none" for deformed points) and the rest state.

    `displacement` is a point field, or two or three of them separated by commas. `rest` is "first", "rest_position",
    "points" or the path of a file. None means that the numbers of the files decide.
    """

    displacement: str | None = None
    rest: str | os.PathLike[str] | None = None


@dataclass(frozen=True, eq=False)
class SeriesLayout:
    """How frames become positions on one mesh.

    `arrangement` says where the first frame has the nodes and cells of the mesh; `displacement` names the field that is
    added to the points, `choice` has the whole decision.
    """

    mesh: BodyMesh
    arrangement: Arrangement
    choice: DisplacementChoice
    grid: Grid  # points and cells of the first frame, without fields
    ids: IdTable
    notes: tuple[str, ...]
    decisions: Decisions
    rounding: float = 0.0  # of the points [m]
    own_points: bool = False  # every cell has its own points, so the connectivity reveals no order
    trusted: bool = False  # recorded by this program: all frames have the same mesh
    twins: Ints = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))  # see RestMesh
    _last: list[tuple[Grid, Arrangement]] = field(default_factory=list, init=False, repr=False)

    @property
    def displacement(self) -> str | None:
        """Return the name of the field that is added to the points, None if they are deformed."""
        return self.choice.vector.name if self.choice.added and self.choice.vector is not None else None

    @property
    def plane(self) -> Floats | None:
        """Return the rows (2, 3) of the plane of a planar body that is not one of constant z."""
        return self.mesh.plane if isinstance(self.mesh, CellMesh) else None

    def __getstate__(self) -> dict[str, object]:
        """Return the state without the last frame."""
        return self.__dict__ | {"_last": []}

    def arrange(self, grid: Grid, where: str) -> Arrangement:
        """Return where a frame has the nodes and cells of the mesh; raises MeshChangedError if it lacks them."""
        arrangement = self.find_arrangement(grid)
        if arrangement.fault:
            raise MeshChangedError(f"{where}: {arrangement.fault}")
        return arrangement

    def find_arrangement(self, grid: Grid) -> Arrangement:
        """Return the same as `arrange`, with a `fault` if a frame does not have the nodes and cells of the mesh."""
        for known, arrangement in self._last:
            if known is grid:
                return arrangement
        arrangement = self._find_arrangement(grid)
        self._last[:] = [(grid, arrangement)]
        return arrangement

    def _find_arrangement(self, grid: Grid) -> Arrangement:
        same = have_same_cells(grid, self.grid)
        if same and self.trusted:
            return self.arrangement
        in_place = same and self.ids.are_in_place(grid)
        may_change = self.own_points or (self.choice.added and len(self.grid.parts) > 1)  # places in equal cells
        if in_place and not (may_change and self._is_moved(grid)):
            return self._check_coincident(grid) if self.own_points and not self.ids.names else self.arrangement
        if not in_place and (matched := match_by_ids(grid, self.ids)) is not None:
            return matched
        if (matched := self._match_at_rest(grid)) is not None:
            return matched
        if in_place:
            return self.arrangement
        nodes, cells = len(self.mesh.points), len(self.mesh.cell_array.types)
        return make_missing(nodes, cells, self._describe_change(grid))

    def _describe_change(self, grid: Grid) -> str:
        return (
            f"its cells are not those of the first frame ({len(grid.types)} cells, {grid.count} points; it has "
            f"{len(self.grid.types)} and {self.grid.count}): the topology changes"
        )

    def _match_at_rest(self, grid: Grid) -> Arrangement | None:
        """Return where a frame has the mesh by rest positions, if it has any."""
        rest = self._find_rest_points(grid)
        if rest is None:
            return None
        rest, mesh = rest[:, : self.mesh.points.shape[1]], self.mesh
        tolerance = max(1e-7 * mesh.size, 4 * self.rounding)
        own = np.flatnonzero(~find_ghosts(grid))  # copies may hold old values
        found = match_by_positions(mesh.points, mesh.cell_array, rest, select_array(grid.cells, own), tolerance)
        return None if found is None or found.cells is None else found._replace(cells=own[found.cells])

    def _check_coincident(self, grid: Grid) -> Arrangement:
        """Return the arrangement of cells with points of their own, with a fault if they come in another order.

        Points that coincide at rest stay together in a body. If most of them part, although as many points coincide
        as before, the cells have changed places.
        """
        nodes = self.arrangement.select_nodes(grid.points)
        if not np.isfinite(nodes).all():
            return self.arrangement
        before, now = join_coincident(self.mesh.points), join_coincident(nodes)
        shared = np.flatnonzero(before != np.arange(len(before)))
        parted = float(np.mean(now[shared] != now[before[shared]])) if len(shared) else 0.0
        counts = len(np.unique(before)), len(np.unique(now))
        if parted > _PARTED and counts[1] < (counts[0] + len(before)) / 2:
            text = "its cells come in another order than those of the first frame, and it has no ids"
            return make_missing(len(before), len(self.mesh.cell_array.types), text)
        return self.arrangement

    def _find_rest_points(self, grid: Grid) -> Floats | None:
        """Return the rest positions (n, 3) that a frame itself has, or None."""
        if "rest_position" in grid.point_data and "rest_position" in self.grid.point_data:
            return np.asarray(grid.point_data["rest_position"], dtype=np.float64)
        if self.choice.added:
            return grid.points
        if self.choice.vector is not None and (u := self.choice.vector.read(grid)) is not None:
            return grid.points - u
        return None

    def _is_moved(self, grid: Grid) -> bool:
        """Return whether a frame has rest positions that are not those of the first frame."""
        rest = self._find_rest_points(grid)
        if rest is None or len(rest) != self.grid.count:
            return False
        rest = self.arrangement.select_nodes(rest)[:, : self.mesh.points.shape[1]]
        tolerance = max(1e-7 * self.mesh.size, 4 * self.rounding)
        return not bool((np.abs(rest - self.mesh.points) <= tolerance).all())

    def compute_positions(self, grid: Grid, where: str) -> tuple[Floats, str]:
        """Return the positions of a frame (n, d), NaN for nodes that it does not have, and the fault if there are any.

        Raises SeriesError if a guess turns out to be wrong.
        """
        arrangement = self.find_arrangement(grid)
        if arrangement.fault:
            return np.full(self.mesh.points.shape, np.nan), arrangement.fault
        self._check_guess(grid, arrangement, where)
        points, fault = self.deform(grid)
        if arrangement is self.arrangement and (gap := self._find_gap(points)):
            return np.full(self.mesh.points.shape, np.nan), gap
        points = arrangement.select_nodes(points)
        bad = np.asarray(~(np.abs(points) < _LARGEST).all(axis=1))  # negated so that NaN counts too
        if bad.any() and not fault:
            fault = f"{bad.sum()} points are not finite, first {self.find_point(int(np.argmax(bad)))}"
        points = np.where(bad[:, None], np.nan, points) if bad.any() else points
        if self.mesh.points.shape[1] == 2:
            return self._drop_z(points, fault)
        return self._check_plane(np.ascontiguousarray(points), fault)

    def _find_gap(self, points: Floats) -> str:
        """Return the fault if points (n, 3) that are one node have moved apart, as bodies in contact do."""
        if not len(self.twins):
            return ""
        a, b = points[self.twins.T]
        distances = np.nan_to_num(np.abs(a - b).max(axis=1))
        if distances.max() <= allow_gap(points, self.rounding):
            return ""
        return f"parts that touch at rest move apart by {distances.max():.3g} m: read each part by itself"

    def deform(self, grid: Grid) -> tuple[Floats, str]:
        """Return the deformed points of a grid (n, 3), and a fault if it lacks the displacement."""
        vector = self.choice.vector
        if not self.choice.added or vector is None:
            return grid.points, ""
        u = vector.read(grid)
        if u is not None:
            return grid.points + u, ""
        if self.choice.late and grid.point_data.keys() == self.grid.point_data.keys():
            return grid.points, ""
        fault = f"no point field {shorten(vector.name)}; it has {join_names(sorted(grid.point_data)) or 'none'}"
        return np.full((grid.count, 3), np.nan), fault

    def _check_guess(self, grid: Grid, arrangement: Arrangement, where: str) -> None:
        """Raise SeriesError if a frame that was not looked at contradicts the guess about the displacement."""
        choice = self.choice
        if not choice.guessed:
            return
        if choice.vector is None:
            for vector, first in choice.still:
                _check_still(vector, first, grid, where)
            new = [
                n
                for n, v in find_vector_fields(grid).items()
                if v.role in ("clear", "short") and n not in self.grid.point_data
            ]
            if new:
                raise SeriesError(
                    f"{where}: the field {shorten(new[0])} was not in the frames looked at: say "
                    f'displacement = "{new[0]}" or "none"'
                )
            return
        X, points = self.grid.points, grid.points
        if arrangement is self.arrangement and np.array_equal(points, X):
            return
        moved = np.abs(arrangement.select_nodes(points) - self.arrangement.select_nodes(X))
        allowed = max(4 * self.rounding, PLANAR * self.mesh.size)
        if np.where(np.isfinite(moved), moved, 0.0).max(initial=0.0) > allowed:
            name = shorten(choice.vector.name) if choice.vector else ""
            raise SeriesError(
                f"{where}: the points move, unlike those of the frames looked at before: say whether displacement = "
                f'"{name}" must be added to them, or "none"'
            )

    def _drop_z(self, points: Floats, fault: str) -> tuple[Floats, str]:
        """Return points (n, 2) in the plane of constant z; NaN with a fault if they leave it."""
        z = points[:, 2][np.isfinite(points[:, 2])]
        extent = (
            float(np.nanmax(np.ptp(points[np.isfinite(points).all(axis=1)], axis=0), initial=0.0)) if len(z) else 0.0
        )
        if len(z) and np.ptp(z) > max(PLANAR * max(extent, self.mesh.size), 4 * self.rounding):
            return np.full(self.mesh.points.shape, np.nan), f"the body leaves its plane by {np.ptp(z):.3g} m"
        return np.ascontiguousarray(points[:, :2]), fault

    def _check_plane(self, points: Floats, fault: str) -> tuple[Floats, str]:
        """Return the points; NaN with a fault if they leave the plane of the mesh."""
        if self.plane is None:
            return points, fault
        normal = np.cross(self.plane[0], self.plane[1])
        height = points @ normal
        height = height[np.isfinite(height)]
        if len(height) and np.ptp(height) > max(10 * PLANAR * self.mesh.size, 4 * self.rounding):
            return np.full(points.shape, np.nan), f"the body leaves its plane by {np.ptp(height):.3g} m"
        return points, fault

    def measure_whole(self, grid: Grid) -> Values:
        """Return numbers of the whole body for a frame whose cells are not those of the mesh."""
        points, fault = self.deform(grid)
        return {} if fault else measure_whole_body(grid, points, self.mesh, self.plane)

    def find_point(self, node: int) -> int:
        """Return the number that a node of the mesh has in the files."""
        nodes = self.arrangement.nodes
        return int(node if nodes is None else nodes[node])


def _check_still(vector: VectorField, first: Floats | None, grid: Grid, where: str) -> None:
    """Raise SeriesError if a field changes that was constant in the frames looked at."""
    u = vector.read(grid)
    if u is None or first is None or len(u) != len(first) or np.allclose(u, first, rtol=1e-9, atol=0, equal_nan=True):
        return
    name = shorten(vector.name)
    raise SeriesError(
        f"{where}: the field {name} changes, unlike in the frames looked at: say whether displacement = "
        f'"{name}" must be added to the points, or "none"'
    )
