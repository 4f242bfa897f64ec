"""The rest mesh of a series: one node for points of different parts that coincide, cells oriented, in a plane or space.

A cell without volume at rest is left out with a note, because its volume ratio means nothing; a cell that is folded
into its neighbor is an error, because then the rest state is not one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, SeriesError, join_names
from pipeline.formats.grid import CellArray, Grid, PolyhedronFaces
from pipeline.mesh.blocks import find_simplices, mirror_cells
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_mesh import CellMesh, measure_volumes
from pipeline.mesh.cleanup import PLANAR
from pipeline.mesh.simplex import CELL_NAMES, Mesh
from pipeline.series.body.arrangement import Arrangement
from pipeline.series.body.cell_arrays import select_array
from pipeline.series.body.cell_selection import CellChoice, describe_left_out, extract_cells, find_doubled_cells
from pipeline.series.body.cell_sides import compare_sides

_COINCIDENT = 1e-9  # of the size, and at least a few units of the precision of the points
_FEW = 0.05  # of the cells: more flat ones are a fault of the rest state
_FLAT = 1e-13  # of the cube (square) of a cell's size: rounding of its volume


@dataclass(frozen=True, eq=False)
class RestMesh:
    """The mesh, the place of its nodes and cells in the first frame, and notes.

    `twins` (k, 2) are the points of the first frame that are one node with another, and that other.
    """

    mesh: BodyMesh
    arrangement: Arrangement
    notes: tuple[str, ...]
    left_out: str
    twins: Ints


def build_rest_mesh(
    grid: Grid, rest: Floats, choice: CellChoice, rounding: float, where: str, *, bends: bool, trusted: bool = False,
    motion: Sequence[Floats] = (),
) -> RestMesh:  # fmt: skip
    """Return the mesh of the chosen cells of a grid with rest positions (n, 3); raises SeriesError.

    `rounding` is that of the points [m]; `bends` says that a later frame leaves the plane of a planar body; in a
    `trusted` grid no cell is there twice; `motion` has the positions (n, 3) of some frames: parts may move apart.
    """
    chosen, cells, notes = choice.cells, extract_cells(grid, choice.cells), list(choice.notes)
    _check_finite(rest, cells, where)
    merged, twins = None, np.zeros((0, 2), dtype=np.int64)
    if grid.parts and (merged := merge_parts(rest, grid.parts, rounding)) is not None:
        merged, apart = _keep_apart(merged, motion, rounding)
        notes += apart
        used = np.unique(cells.connectivity)
        twins = np.stack([used, merged[used]], axis=1)[merged[used] != used]
        joined = merged[cells.connectivity]
        if count := len(np.unique(cells.connectivity)) - len(np.unique(joined)):
            notes.append(f"{count} points of different parts coincide with others at rest and count as one node each")
        cells = cells._replace(connectivity=joined, faces=_renumber_faces(cells, merged))
    if not trusted and (doubled := find_doubled_cells(rest, cells)).size:
        notes.append(f"{len(doubled)} cells are there twice (first {chosen[doubled[0]]}) and count once")
        chosen, cells = np.delete(chosen, doubled), select_array(cells, np.delete(np.arange(len(chosen)), doubled))
    points, plane, plane_notes = _flatten(rest, cells, choice.dimension, rounding, bends=bends)
    chosen, cells, cell_notes, flat = _settle_cells(points, plane, chosen, cells, choice.dimension, rounding, where)
    nodes, cells, unused = _drop_unused(points, cells, merged)
    if unused:
        notes.append(unused)
    points = points if nodes is None else points[nodes]
    arrangement = Arrangement(nodes, None if len(chosen) == len(grid.types) else chosen)
    try:
        mesh = make_mesh(points, cells, choice.dimension, plane, where)
    except MeshError as error:
        raise SeriesError(f"rest state: {error}") from error
    left_out = describe_left_out(grid, rest, choice, flat, float(mesh.rest_volumes.sum()))
    return RestMesh(mesh, arrangement, (*notes, *plane_notes, *cell_notes, *mesh.notes), left_out, twins)


def make_mesh(points: Floats, cells: CellArray, dimension: int, plane: Floats | None, name: str) -> BodyMesh:
    """Return the mesh: of linear simplices if all cells are, else of cells of any kind."""
    if points.shape[1] == dimension and (simplices := find_simplices(cells)) is not None:
        return Mesh(points, simplices, name=name)
    return CellMesh(points, cells, dimension, plane=plane, name=name)


def _check_finite(rest: Floats, cells: CellArray, where: str) -> None:
    used = np.unique(cells.connectivity)
    bad = used[~np.isfinite(rest[used]).all(axis=1)]
    if bad.size:
        raise SeriesError(f"{where}: rest state: {bad.size} points are not finite, first {bad[0]}")


def merge_parts(rest: Floats, parts: tuple[int, ...], rounding: float) -> Ints | None:
    """Return the point that stands for each point (n,): the first at its place, among different parts.

    Points of one part stay apart, and so do those at a place where one part has several. None if nothing merges.
    """
    if len(parts) < 2 or sum(parts) != len(rest):
        return None
    part = np.repeat(np.arange(len(parts)), parts)
    finite = np.isfinite(rest).all(axis=1)
    size = float(np.ptp(rest[finite], axis=0).max(initial=0.0))
    tolerance = max(_COINCIDENT * size, 2 * rounding)
    usable = np.flatnonzero(finite)
    pairs = usable[cKDTree(rest[usable]).query_pairs(tolerance, output_type="ndarray")]
    if not len(pairs):
        return None
    crowded = np.zeros(len(rest), dtype=bool)
    crowded[pairs[part[pairs[:, 0]] == part[pairs[:, 1]]]] = True
    pairs = pairs[(part[pairs[:, 0]] != part[pairs[:, 1]]) & ~crowded[pairs].any(axis=1)]
    merged = np.arange(len(rest))
    for a, b in np.sort(pairs, axis=1)[np.lexsort(np.sort(pairs, axis=1).T)].tolist():
        merged[b] = min(merged[b], merged[a])
    return merged.astype(np.int64) if len(pairs) else None


def _keep_apart(merged: Ints, motion: Sequence[Floats], rounding: float) -> tuple[Ints, list[str]]:
    """Return the points that stand for others (n,), without those that leave them later, and a note on these.

    Bodies in contact touch at rest, and slide or open later.
    """
    leaves: NDArray[np.bool_] = np.zeros(len(merged), dtype=bool)
    for x in motion:
        leaves |= np.abs(x - x[merged]).max(axis=1) > allow_gap(x, rounding)  # False for NaN
    if not leaves.any():
        return merged, []
    note = f"{leaves.sum()} points of different parts coincide with others at rest and move apart later"
    return np.where(leaves, np.arange(len(merged)), merged), [f"{note}: they stay nodes of their own"]


def allow_gap(x: Floats, rounding: float) -> float:
    """Return the distance [m] up to which points (n, 3) that were one at rest still are."""
    finite = x[np.isfinite(x).all(axis=1)]  # none in a frame without its displacement
    size = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
    return max(PLANAR * size, 4 * rounding)


def _renumber_faces(cells: CellArray, merged: Ints) -> PolyhedronFaces | None:
    return None if cells.faces is None else cells.faces._replace(connectivity=merged[cells.faces.connectivity])


def _flatten(
    rest: Floats, cells: CellArray, dimension: int, rounding: float, *, bends: bool
) -> tuple[Floats, Floats | None, list[str]]:
    """Return points (n, 2) or (n, 3) for the mesh, its plane if it is not one of constant z, and notes."""
    if dimension == 3:
        return rest, None, []
    used = np.unique(cells.connectivity)
    normal, _ = find_normal(rest[used], rounding)
    if bends:
        return rest, None, ["the body leaves its plane later: it is measured as a surface in space, by areas"]
    if normal is None:
        return rest, None, ["the cells are a surface in space: area ratios, and rotations from its own frame"]
    if normal[2] == 1:
        return np.ascontiguousarray(rest[:, :2]), None, []
    plane = _choose_axes(normal)
    areas = measure_volumes(rest, cells, 2, plane)
    if np.nansum(areas) < 0:
        plane = plane[::-1].copy()
    return rest, plane, [f"the body is planar, normal to {_describe_normal(np.cross(plane[0], plane[1]))}"]


def find_normal(X: Floats, rounding: float) -> tuple[Floats | None, float]:
    """Return the normal of the plane in which points (n, 3) lie, None if they do not, and the tolerance [m].

    The normal of a plane of constant z is exactly (0, 0, 1).
    """
    X = X[np.isfinite(X).all(axis=1)]
    tolerance = max(PLANAR * float(np.ptp(X, axis=0).max(initial=0.0)), 2 * rounding)
    if np.ptp(X[:, 2]) <= tolerance:
        return np.array([0.0, 0.0, 1.0]), tolerance
    centered = X - X.mean(axis=0)
    _, _, axes = np.linalg.svd(centered[:: max(1, len(X) // 20_000)], full_matrices=False)
    if len(axes) < 3 or np.ptp(centered @ axes[2]) > tolerance:
        return None, tolerance
    return np.asarray(axes[2]), tolerance


def _choose_axes(normal: Floats) -> Floats:
    """Return two orthonormal rows (2, 3) normal to a vector, along axes of coordinates if it is one of these."""
    k = int(np.abs(normal).argmax())
    exact = np.zeros(3)
    exact[k] = 1.0
    normal = exact if np.abs(normal * np.sign(normal[k]) - exact).max() < PLANAR else normal * np.sign(normal[k])
    start = np.zeros(3)
    start[(k + 1) % 3] = 1.0
    first = start - (start @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def _describe_normal(normal: Floats) -> str:
    k = int(np.abs(normal).argmax())
    if abs(normal[k]) > 1 - PLANAR:
        return "xyz"[k]
    return f"({', '.join(f'{c:.3g}' for c in normal)})"


def _settle_cells(
    points: Floats, plane: Floats | None, chosen: Ints, cells: CellArray, dimension: int, rounding: float, where: str
) -> tuple[Ints, CellArray, list[str], int]:
    """Return the cells oriented and without flat ones, notes, and the number of flat ones."""
    volumes = measure_volumes(points, cells, dimension, plane)
    known = np.isfinite(volumes)
    surface = dimension == 2 and points.shape[1] == 3 and plane is None
    local = points if plane is None else np.ascontiguousarray(points @ plane.T)
    notes = list[str]()
    if not surface and (known & (volumes < 0)).any():
        sides = compare_sides(local, cells, volumes)
        cells = mirror_cells(cells, np.flatnonzero(sides.mirrored))
        notes += _note_mirrored(int(sides.mirrored.sum()), cells, dimension)
        volumes = np.where(sides.mirrored, -volumes, volumes)
    lengths = _find_lengths(local, cells)
    rounded = max(rounding, np.finfo(float).eps * float(np.abs(local[np.isfinite(local).all(axis=1)]).max(initial=0.0)))
    least = np.maximum(_FLAT * lengths**dimension, np.where(volumes < 0, 4 * rounded, 0.0) * lengths ** (dimension - 1))
    flat = known & (np.abs(volumes) <= least)
    folded = np.flatnonzero(known & (volumes < 0) & ~flat)
    if folded.size:
        raise SeriesError(
            f"{where}: rest state: {folded.size} inverted cells, {join_names(map(str, chosen[folded]))}: they are "
            f"folded into their neighbors (the first has volume {volumes[folded[0]]:.3g}), so that this is no state of "
            "rest; name another one (rest = FILE)"
        )
    if not flat.any():
        return chosen, cells, notes, 0
    count = int(flat.sum())
    text = f"{count} of {len(flat)} cells are flat at rest (first {chosen[np.argmax(flat)]})"
    if (count > _FEW * len(flat) and count > 1) or count == len(flat):
        raise SeriesError(
            f"{where}: rest state: {text}, with no volume to compare with; name another one (rest = FILE)"
        )
    notes.append(f"{text} and are left out: they have no volume")
    kept = np.flatnonzero(~flat)
    return chosen[kept], select_array(cells, kept), notes, count


def _note_mirrored(count: int, cells: CellArray, dimension: int) -> list[str]:
    if not count:
        return []
    name = CELL_NAMES[dimension] if find_simplices(cells) is not None else ""
    kind = f"{name} cells" if name else "cells"
    if count == len(cells.types):
        return [f"all {count} {kind} were mirrored and have been reoriented"]
    return [
        f"{count} of {len(cells.types)} {kind} were mirrored by their numbering and have been reoriented: no cell lies "
        "on the same side of a face as its neighbor"
    ]


def _find_lengths(points: Floats, cells: CellArray) -> Floats:
    """Return the largest extent (e,) of every cell."""
    starts = cells.offsets[:-1]
    if not len(starts) or (np.diff(cells.offsets) == 0).any():
        return np.zeros(len(starts))
    nodes = points[cells.connectivity]
    extent = np.maximum.reduceat(nodes, starts) - np.minimum.reduceat(nodes, starts)
    return np.asarray(extent.max(axis=1))


def _drop_unused(points: Floats, cells: CellArray, merged: Ints | None) -> tuple[Ints | None, CellArray, str]:
    """Return the points that cells have, None for all, the cells with the new numbers of these, and a note."""
    used: NDArray[np.bool_] = np.zeros(len(points), dtype=bool)
    used[cells.connectivity] = True
    if cells.faces is not None:
        used[cells.faces.connectivity] = True
    if used.all():
        return None, cells, ""
    numbers = (np.cumsum(used) - 1).astype(np.int64)
    faces = _renumber_faces(cells, numbers)
    alone = ~used if merged is None else ~used & (merged == np.arange(len(used)))
    note = f"{alone.sum()} points that belong to no measured cell are left out, first {np.argmax(alone)}"
    cells = cells._replace(connectivity=numbers[cells.connectivity], faces=faces)
    return np.flatnonzero(used), cells, note if alone.any() else ""
