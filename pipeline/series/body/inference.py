"""The layout of a series, inferred from the numbers of some of its frames.

A few frames are enough: the first ones, the last, and some between; of a short series all. Frames that are read later
are checked against the decisions.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError, shorten
from pipeline.formats.grid import Grid, have_same_cells
from pipeline.mesh.cell_mesh import measure_volumes
from pipeline.mesh.cell_text import describe_cells
from pipeline.series.body.arrangement import (
    Arrangement,
    IdTable,
    find_ids,
    have_same_points,
    match_by_ids,
    match_by_positions,
)
from pipeline.series.body.cell_selection import choose_cells
from pipeline.series.body.decisions import Decisions
from pipeline.series.body.displacement import DisplacementChoice, choose_displacement, find_absurdity
from pipeline.series.body.layout import Options, SeriesLayout
from pipeline.series.body.motion_evidence import Evidence, Sample, choose_sample, is_single, weigh_evidence
from pipeline.series.body.rest_mesh import RestMesh, build_rest_mesh, find_normal
from pipeline.series.body.rest_state import RestPositions, find_rest_state, read_reference
from pipeline.series.body.vector_fields import find_vector_fields

_ALIKE = 1e-3  # of the largest motion: a displacement that differs less says the same
_ODD = 0.1  # of the coordinates: a number that was rounded has an odd last digit in every second case
_PRECISE = 1e-4  # of a cell's size: coarser coordinates deserve a note


def infer_layout(
    first: Grid, read: Callable[[int], Grid], count: int, options: Options, where: str, *, ours: bool = False
) -> SeriesLayout:
    """Return the layout of a series of `count` frames from the first one; raises SeriesError if it is ambiguous.

    `read` may be called for other frames. Frames of our own are taken at their word.
    """
    cells = choose_cells(first, where)
    ids = find_ids(first, Arrangement(), first.cells, use=not ours)
    reference, source = read_reference(options.rest, first, ids, where)
    own = ours and reference is not None and source == "the field rest_position" and options.displacement is None
    sample, elsewhere = ([(0, first)], list[str]()) if own else _collect_sample(first, read, count, ids)
    evidence = replace(weigh_evidence(sample, reference, count), elsewhere=tuple(elsewhere))
    if own:
        choice = DisplacementChoice(None, added=False, text="deformed points")
    else:
        choice = choose_displacement(evidence, options.displacement, first, where, known_rest=reference is not None)
    rest = find_rest_state(first, options.rest, reference, source, choice)
    bends = cells.dimension == 2 and not own and _do_points_bend(sample, choice, rest.points, evidence.rounding)
    motion = _list_positions(sample, choice) if len(first.parts) > 1 else []
    built = build_rest_mesh(
        first, rest.points, cells, evidence.rounding, where, bends=bends, trusted=own, motion=motion
    )
    layout = _join(first, choice, rest, built, evidence, ours=own)
    if choice.added and options.displacement is None:
        _check_guess_by_cells(layout, sample, where)
    return layout


def _collect_sample(
    first: Grid, read: Callable[[int], Grid], count: int, ids: IdTable
) -> tuple[list[tuple[int, Grid]], list[str]]:
    """Return the frames to look at, by index, with the points of each in the order of the first.

    Frames with other points are passed over; the fields in them that may be a displacement are returned beside.
    """
    sample, elsewhere = [(0, first)], set[str]()
    for index in choose_sample(count, first.count)[1:]:
        grid = read(index)
        if (arranged := _rearrange(grid, first, ids)) is not None:
            sample.append((index, arranged))
            continue
        for name, vector in find_vector_fields(grid).items():
            if vector.role in ("clear", "short") and (u := vector.read(grid)) is not None and np.nan_to_num(u).any():
                elsewhere.add(name)
    return sample, sorted(elsewhere)


def _rearrange(grid: Grid, first: Grid, ids: IdTable) -> Grid | None:
    """Return a frame with its points in the order of the first, or None if it has another mesh."""
    in_place = have_same_cells(grid, first) and ids.are_in_place(grid)
    is_shared = len(np.unique(first.connectivity)) < len(first.connectivity) or len(first.types) < 2
    if in_place and is_shared and not _may_be_swapped(grid, first):
        return grid
    # cells with points of their own may change places in equal connectivity; ids may only count them
    found = None if in_place else match_by_ids(grid, ids)
    if found is None and grid.count == first.count and not (in_place and np.array_equal(grid.points, first.points)):
        tolerance = 1e-7 * float(np.ptp(first.points, axis=0).max(initial=0.0))
        found = match_by_positions(first.points, first.cells, grid.points, grid.cells, tolerance)
    if found is None:
        changed = len(grid.types) != len(first.types)  # else the same points would come in another order
        return grid if in_place or (changed and have_same_points(grid, first)) else None
    points = {name: found.select_nodes(np.asarray(values)) for name, values in grid.point_data.items()}
    stored = found.select_nodes(grid.points)
    return Grid(stored, first.count, first.types, first.offsets, first.connectivity, points, {}, {}, first.faces)


def _may_be_swapped(grid: Grid, first: Grid) -> bool:
    """Return whether parts of a body may have changed places: the points move, and no displacement moves alike.

    Halves of a bar have equal cells; a rank that writes the other half does not move it there.
    """
    if len(first.parts) < 2 or grid.count != first.count or np.array_equal(grid.points, first.points):
        return False
    moved = grid.points - first.points
    vectors = [vector for vector in find_vector_fields(grid).values() if vector.role in ("clear", "short")]
    pairs = [(vector.read(grid), vector.read(first)) for vector in vectors]
    changes = [u - u0 for u, u0 in pairs if u is not None and u0 is not None]
    near = _ALIKE * float(np.nanmax(np.abs(moved)))
    return bool(changes) and not any(np.nanmax(np.abs(moved - u), initial=0.0) <= near for u in changes)


def _list_positions(sample: Sample, choice: DisplacementChoice) -> list[Floats]:
    """Return the deformed points (n, 3) of the frames that have them."""
    if not choice.added or choice.vector is None:
        return [grid.points for _, grid in sample]
    displaced = ((grid.points, choice.vector.read(grid)) for _, grid in sample)
    return [points + u for points, u in displaced if u is not None]


def _do_points_bend(sample: Sample, choice: DisplacementChoice, rest: Floats, rounding: float) -> bool:
    """Return whether a body that is planar at rest leaves its plane in one of the frames."""
    normal, tolerance = find_normal(rest, rounding)
    if normal is None:
        return False
    for _, grid in sample:
        u = choice.vector.read(grid) if choice.added and choice.vector is not None else None
        points = grid.points if u is None else grid.points + u
        height = points @ normal
        height = height[np.isfinite(height)]
        if len(height) and np.ptp(height) > 10 * tolerance:
            return True
    return False


def _join(
    first: Grid, choice: DisplacementChoice, rest: RestPositions, built: RestMesh, evidence: Evidence, *, ours: bool
) -> SeriesLayout:
    """Return the layout with its notes and the texts of all decisions."""
    bare = Grid(first.points, first.count, first.types, first.offsets, first.connectivity,
                dict.fromkeys(first.point_data, np.zeros(0)), {}, {}, first.faces, first.parts)  # fmt: skip
    ids = find_ids(first, built.arrangement, built.mesh.cell_array, use=not ours)
    mesh = built.mesh
    notes = (*built.notes, *choice.notes, *rest.notes, *_note_precision(first, built, evidence))
    cells = f"{describe_cells([mesh])} in {mesh.dimension}D"
    decisions = Decisions(choice.text, rest.text, cells, left_out=built.left_out)
    own_points = not ours and len(mesh.points) == len(mesh.cell_array.connectivity) and len(mesh.cell_array.types) > 1
    return SeriesLayout(
        mesh,
        built.arrangement,
        choice,
        bare,
        ids,
        notes,
        decisions,
        evidence.rounding,
        own_points,
        trusted=ours,
        twins=built.twins,
    )


def _note_precision(first: Grid, built: RestMesh, evidence: Evidence) -> list[str]:
    """Return a note if the coordinates are too coarse for the cells: single precision far from the origin."""
    if not is_single(first):
        return []
    mesh = built.mesh
    largest = float(np.abs(mesh.points).max(initial=0.0))
    spacing = float(np.spacing(np.float32(largest)))
    far = mesh.points[np.abs(mesh.points) > largest / 2] / spacing
    if not len(far) or (np.mean(far % 2 == 1) < _ODD and np.mean(far % 1 != 0) < _ODD):
        return []  # round numbers, such as 450000.0, are exact in single precision too
    size = float(np.median(mesh.rest_volumes)) ** (1 / mesh.dimension)
    if spacing <= _PRECISE * size:
        return []
    return [
        f"the points are in single precision: at {largest:.3g} m from the origin its numbers are {spacing:.2g} m "
        f"apart, and the cells are about {size:.2g} m large: volume ratios are uncertain by {3 * spacing / size:.1g}"
    ]


def _check_guess_by_cells(layout: SeriesLayout, sample: Sample, where: str) -> None:
    """Raise SeriesError if the guessed displacement makes an absurd body of most frames that were looked at.

    A solution that diverges in the end is absurd only there.
    """
    vector, mesh = layout.choice.vector, layout.mesh
    faults = list[str]()
    moved = 0
    for _, grid in sample:
        u = vector.read(grid) if vector is not None else None
        if vector is None or u is None or not np.isfinite(u).all() or not u.any():
            continue
        moved += 1
        local = layout.arrangement.select_nodes(layout.grid.points + u)[:, : mesh.points.shape[1]]
        volumes = measure_volumes(np.ascontiguousarray(local), mesh.cell_array, mesh.dimension, layout.plane)
        inverted = float((volumes < 0).mean())
        if fault := find_absurdity(mesh.size, layout.arrangement.select_nodes(u), inverted):
            faults.append(fault)
    if vector is not None and len(faults) > moved / 2:
        raise SeriesError(
            f"{where}: adding the field {shorten(vector.name)} to the points {faults[-1]}, so that it may not be the "
            f'displacement, or not in the unit of the points: say displacement = "{vector.name}" if it is, or "none"'
        )
