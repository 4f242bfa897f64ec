"""The displacement of a series: which point fields hold it, and whether the points include it already.

The motion of the points decides. Points that rest need a displacement field; points that move as a field does include
it already, and points minus displacement are the rest state. A name decides only if it can mean nothing else: `U` is
the velocity of one program and the displacement of another. In all other cases the caller is asked.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.grid import Grid
from pipeline.series.arrangement import have_same_cells, match_points
from pipeline.series.vector_fields import VectorField, find_vector_field, list_vector_fields

_PRESSURES = ("p", "pressure", "p_rgh", "p_h", "ph")
SAME = 1e-3  # relative difference of motions that are one and the same: texts may have four digits
_ROUNDING = 4.0  # differences of numbers that are stored in single precision, in units of their spacing


class Displacement(NamedTuple):
    """The displacement field, None if there is none; whether it must be added to the points; notes on the decision.

    `at_rest` says that the points do not move.
    """

    field: VectorField | None
    is_added: bool
    at_rest: bool
    notes: tuple[str, ...] = ()


class _Motion(NamedTuple):
    """The largest motion of the points, of a field, and of their difference, since the first frame; their rounding."""

    points: float
    field: float
    difference: float
    rounding: float

    @property
    def is_included(self) -> bool:
        """Return whether the points move as the field does."""
        return self.points > self.rounding and self.difference <= SAME * self.points + self.rounding

    @property
    def is_apart(self) -> bool:
        """Return whether the points rest while the field changes."""
        return self.field > self.rounding and self.points <= SAME * self.field + self.rounding


class Evidence:
    """Points and fields of some frames of a series whose points correspond; `rest` are rest points, if a file has them.

    `grids` are given by the numbers of the frames, of which 0 is one.
    """

    def __init__(self, grids: Mapping[int, Grid], rest: Floats | None = None) -> None:
        self.grids = dict(grids)
        self.first = self.grids[0]
        self.fields = list_vector_fields(self.grids.values())
        self._rest, self._x = rest, self.first.points
        self._others: list[tuple[Grid, Ints | None, Floats]] = []  # grid, places of the first one's points, motion
        for index, grid in self.grids.items():
            if index and grid.count == self.first.count:
                places = None if have_same_cells(grid, self.first) else self._find_places(grid)
                if places is not None or have_same_cells(grid, self.first):
                    x = grid.points if places is None else grid.points[places]
                    self._others.append((grid, places, x - self._x))

    def _find_places(self, grid: Grid) -> Ints | None:
        """Return where a frame that lists its cells in another order has the points of the first; None if unknown.

        Its points are those of the first, or become so without a displacement.
        """
        places = match_points(self._x, grid.points)
        for field in self.fields.values() if places is None else ():
            places = match_points(self._x - field.read(self.first), grid.points - field.read(grid))
            if places is not None:
                break
        return places

    def measure(self, field: VectorField) -> _Motion:
        """Return how far points and field move in these frames, and from the rest points of a file if there are any."""
        start = field.read(self.first)
        pairs = []
        for grid, places, dx in self._others:
            values = field.read(grid)
            pairs.append((dx, (values if places is None else values[places]) - start))
        if self._rest is not None:
            pairs.append((self._x - self._rest, start))
        points, moved, difference = 0.0, 0.0, 0.0
        for dx, du in pairs:
            points, moved = max(points, find_largest(dx)), max(moved, find_largest(du))
            difference = max(difference, find_largest(dx - du))
        return _Motion(points, moved, difference, self.rounding)

    @cached_property
    def motion(self) -> float:
        """Return how far the points move in these frames, and from the rest points of a file if there are any."""
        from_rest = [] if self._rest is None else [find_largest(self._x - self._rest)]
        return max([0.0, *from_rest, *(find_largest(dx) for *_, dx in self._others)])

    @property
    def shows_motion(self) -> bool:
        """Return whether the points move, or a field that may be a displacement changes."""
        if self.motion > self.rounding:
            return True
        return any(self.measure(field).field > 0 for field in self.fields.values() if not field.is_other)

    @cached_property
    def rounding(self) -> float:
        """Return how far rounding can move a point: in single precision if all points are such numbers."""
        points = [self._x, *(grid.points for grid, *_ in self._others)]
        single = all(np.array_equal(x.astype(np.float32), x, equal_nan=True) for x in points)
        largest = max(find_largest(x) for x in points)
        return _ROUNDING * float(np.spacing(np.float32(largest)) if single else np.spacing(largest))

    def is_position(self, field: VectorField) -> bool:
        """Return whether a field is the points themselves, up to a shift: points minus it are one point."""
        offset = self._x - field.read(self.first)
        size = find_largest(np.ptp(self._x, axis=0))
        return find_largest(offset - offset.mean(axis=0)) <= SAME * size


def collect_evidence(first: Grid, read: Callable[[int], Grid], count: int, rest: Floats | None) -> Evidence:
    """Return the first frame of `count`, the middle and the last one.

    If their points rest and none of them has a displacement that changes, further frames are read, up to the first one
    that shows either.
    """
    sampled = sorted({count // 2, count - 1} - {0})
    evidence = Evidence({0: first} | {index: read(index) for index in sampled}, rest)
    if evidence.shows_motion:
        return evidence
    for index in set(range(1, count)).difference(sampled):
        more = Evidence({0: first, index: read(index)}, rest)
        if more.shows_motion:
            return Evidence(evidence.grids | more.grids, rest)
    return evidence


def choose_displacement(
    evidence: Evidence, wanted: str | None, where: str, *, included: bool | None = None
) -> Displacement:
    """Return the displacement of a series; raises SeriesError, with the choices, if the evidence does not decide.

    `wanted` is the caller's field, "none" for no field, or None; `included` is the caller's word on whether the points
    include it.
    """
    moves = evidence.motion > evidence.rounding
    if wanted == "none":
        return Displacement(None, False, not moves)
    if wanted is not None:
        field = find_vector_field(wanted, evidence.grids.values(), where)
        return _judge_wanted(evidence, field, where, included=included)
    fields = [field for field in evidence.fields.values() if not field.is_other and not evidence.is_position(field)]
    motions = {field: evidence.measure(field) for field in fields}
    if moving := [field for field in fields if motions[field].is_included and not motions[field].is_apart]:
        return _choose_included(evidence, moving, where)
    if moves and not any(motions[field].is_apart for field in fields):
        if strange := [field for field in fields if field.is_clear]:
            raise SeriesError(_describe_conflict(strange[0], motions[strange[0]], where))
        return Displacement(None, False, False)
    changing = [field for field in fields if motions[field].field > 0 or find_largest(field.read(evidence.first)) > 0]
    return _choose_added(evidence, changing, where, included=included)


def _judge_wanted(evidence: Evidence, field: VectorField, where: str, *, included: bool | None) -> Displacement:
    """Return the decision for the field that the caller names: only whether the points include it is open."""
    motion = evidence.measure(field)
    if included or (included is None and motion.is_included and not motion.is_apart):
        return Displacement(field, False, False, (f"the points move by {field.label}: it is not added to them again",))
    if evidence.motion > evidence.rounding and not motion.is_apart:
        raise SeriesError(_describe_conflict(field, motion, where))
    return Displacement(field, True, True)


def _choose_included(evidence: Evidence, fields: Sequence[VectorField], where: str) -> Displacement:
    """Return the displacement that the points include; several fields must agree in the first frame."""
    best = [field for field in fields if field.is_clear] or list(fields)
    starts = [field.read(evidence.first) for field in best]
    if any(find_largest(start - starts[0]) > evidence.rounding + SAME * find_largest(start) for start in starts):
        raise SeriesError(
            f"{where}: the points move as {_join(best)} do, which differ in the first frame: say which one is the "
            'displacement (displacement = NAME), or displacement = "none" if the first frame is the rest state'
        )
    note = f"the points move by {best[0].label}: it is not added to them again"
    return Displacement(best[0], False, False, (note,))


def _choose_added(
    evidence: Evidence, fields: Sequence[VectorField], where: str, *, included: bool | None
) -> Displacement:
    """Return the displacement to add to points that rest; `fields` are the candidates that are not zero everywhere."""
    clear = [field for field in fields if field.is_clear]
    candidates = clear or fields
    if not candidates:
        named = [field for field in evidence.fields.values() if field.is_clear]
        if named:
            return Displacement(named[0], True, True, (f"{named[0].label} is zero: the body rests",))
        note = "the points do not move and there is no displacement field" if len(evidence.grids) > 1 else ""
        return Displacement(None, False, True, (note,) if note else ())
    if len(candidates) == 1 and (clear or _starts_as_displacement(evidence, candidates[0])):
        return _add_only(evidence, candidates[0], where, included=included)
    raise SeriesError(
        f"{where}: the points do not move, and the displacement may be any of {_join(candidates)}: "
        'say which (displacement = NAME), or displacement = "none" if the body is at rest'
    )


def _add_only(evidence: Evidence, field: VectorField, where: str, *, included: bool | None) -> Displacement:
    """Return the decision for the only candidate, unless nothing shows whether the points include it."""
    motion = evidence.measure(field)
    if included:
        return Displacement(field, False, False, (f"the points are taken to include {field.label}",))
    if included is None and not motion.is_apart and find_largest(field.read(evidence.first)) > evidence.rounding:
        raise SeriesError(
            f"{where}: {field.label} does not change, so nothing shows whether the points include it: say "
            f'rest = "points" if they are the rest state (displacement = "{field.label}" is added to them), '
            'or rest = "subtract" if they include it'
        )
    notes = [f"the points do not move; {field.label} is taken as the displacement and added to them"]
    absent = [index for index, grid in evidence.grids.items() if not field.is_in(grid)]
    if absent:
        notes.append(f"frames without {field.label}, such as frame {absent[0]}, count as not displaced")
    return Displacement(field, True, True, tuple(notes))


def _starts_as_displacement(evidence: Evidence, field: VectorField) -> bool:
    """Return whether a field with a short name is a displacement: zero in the first frame, and no pressure beside it.

    A velocity field of a flow usually has a pressure beside it, or a start that is not zero.
    """
    names = {name.lower() for grid in evidence.grids.values() for name in (*grid.point_data, *grid.cell_data)}
    on_cells = any(name in grid.cell_data for grid in evidence.grids.values() for name in field.names)
    flow = on_cells or bool(names.intersection(_PRESSURES))
    return field.is_short and not flow and find_largest(field.read(evidence.first)) == 0.0


def _describe_conflict(field: VectorField, motion: _Motion, where: str) -> str:
    return (
        f"{where}: the points move by up to {motion.points:.3g}, {shorten(field.label)} by up to {motion.field:.3g}, "
        f'and they differ by up to {motion.difference:.3g}: say displacement = "none" if the points alone are the '
        "motion, or write points and displacement that agree"
    )


def find_largest(values: Floats) -> float:
    """Return the largest finite absolute value."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def _join(fields: Iterable[VectorField]) -> str:
    return join_names(sorted(field.label for field in fields))
