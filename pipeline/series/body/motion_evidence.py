"""The motion of points and of vector fields over a sample of frames: the evidence about the displacement.

With x the points and u a field, x_k - x_0 is compared with u_k - u_0, and with u_k for increments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import Floats
from pipeline.formats.grid import Grid
from pipeline.series.body.vector_fields import (
    VectorField,
    find_cell_displacements,
    find_flow_fields,
    find_unusable_fields,
    find_vector_fields,
)

_LOOKED_AT = 1_000_000  # points of all frames that are looked at when a series is opened
_FEWEST, _MOST = 3, 24  # frames
_ROUNDING = 64 * float(np.finfo(np.float64).eps)  # of the coordinates: x computed as (X + u) - u
_ROUNDING_SINGLE = 8 * float(np.finfo(np.float32).eps)
MATCH = 1e-2  # of the largest displacement: points that contain u up to this part of it

Sample = Sequence[tuple[int, Grid]]  # frames that have the mesh of the first, by their index; the first one first


@dataclass(eq=False)
class FieldMotion:
    """The numbers of one field over the sample: largest values, and how they compare with the motion of the points."""

    vector: VectorField
    first: Floats | None  # values in the first frame, None if it has none
    frames: int = 0  # that have it
    largest: float = 0.0
    varies: float = 0.0  # largest |u_k - u_0|
    differs: float = 0.0  # largest |(x_k - x_0) - (u_k - u_0)|
    is_position: bool = False  # the points minus the field are one point
    differs_from_steps: float = 0.0  # largest |(x_k - x_k-1) - u_k|, of consecutive frames
    scales: list[float] = field(default_factory=list)  # of u_k - u_0 that fit x_k - x_0 best, if they fit

    @property
    def at_start(self) -> float:
        """The largest value in the first frame; 0 if it has none."""
        return 0.0 if self.first is None else float(np.abs(self.first).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Evidence:
    """The motion of the points and of every vector field over the sample of frames."""

    motions: dict[str, FieldMotion]
    moves: float  # largest |x_k - x_0|
    rounding: float  # [m]: smaller motions may be the rounding of coordinates
    size: float  # [m]
    frames: int
    total: int
    flow: tuple[str, ...]  # fields of a flow
    on_cells: tuple[str, ...] = ()  # vectors of cells that may be a displacement
    unusable: tuple[str, ...] = ()  # fields that are named as a displacement and are no vectors
    elsewhere: tuple[str, ...] = ()  # vectors of frames with other points that may be a displacement

    @property
    def points_rest(self) -> bool:
        """Return whether the points move by less than their rounding."""
        return self.moves <= self.rounding


def choose_sample(count: int, points: int) -> list[int]:
    """Return the indices of the frames to look at: all of a short series, else the first ones and some of the rest."""
    most = int(np.clip(_LOOKED_AT // max(points, 1), _FEWEST, _MOST))
    if count <= most:
        return list(range(count))
    early = 3 if most > 6 else 1
    spread = np.linspace(early - 1, count - 1, most - early + 1).round().astype(int)
    return sorted({*range(early), *spread.tolist()})


def weigh_evidence(sample: Sample, reference: Floats | None, total: int) -> Evidence:
    """Return the evidence of the frames; `reference` is a known rest state of the first frame's points.

    With a reference, the fields are compared as displacements from it.
    """
    first = sample[0][1]
    x0 = first.points if reference is None else reference
    motions = dict[str, FieldMotion]()
    moves, last, names = 0.0, (-2, x0), set[str]()
    single = all(is_single(grid) for _, grid in sample)
    largest = max(find_largest(grid.points) for _, grid in sample)
    rounding = (_ROUNDING_SINGLE if single else _ROUNDING) * largest
    for index, grid in sample:
        names |= {*grid.point_data, *grid.cell_data}
        x = grid.points
        moves = max(moves, find_largest(x - x0))
        for name, vector in find_vector_fields(grid).items():
            if vector.role == "other" or (u := vector.read(grid)) is None:
                continue
            if name not in motions:
                motions[name] = FieldMotion(vector, vector.read(first), is_position=_is_position(x, u))
            motion = motions[name]
            start = 0.0 if reference is not None or motion.first is None else motion.first
            _compare(motion, x - x0, u, u - start, x - last[1] if index == last[0] + 1 else None)
        last = index, x
    size = float(np.linalg.norm(np.ptp(x0[np.isfinite(x0).all(axis=1)], axis=0))) if np.isfinite(x0).any() else 0.0
    on_cells = tuple(find_cell_displacements(sample[-1][1]))
    flow = tuple(sorted(find_flow_fields(names)))
    unusable = tuple(find_unusable_fields(sample[-1][1]))
    return Evidence(motions, moves, rounding, size, len(sample), total, flow, on_cells, unusable)


def _compare(motion: FieldMotion, moved: Floats, u: Floats, du: Floats, step: Floats | None) -> None:
    """Add a frame, in which the points have moved and the field u has changed by du, to a field's numbers."""
    motion.frames += 1
    motion.largest = max(motion.largest, find_largest(u))
    motion.varies = max(motion.varies, find_largest(du))
    motion.differs = max(motion.differs, find_largest(moved - du))
    if step is not None:
        motion.differs_from_steps = max(motion.differs_from_steps, find_largest(step - u))
    finite = np.isfinite(moved).all(axis=1) & np.isfinite(du).all(axis=1)
    a, b = moved[finite], du[finite]
    if (length := float((b * b).sum())) > 0:
        scale = float((a * b).sum()) / length
        if find_largest(a - scale * b) <= MATCH * find_largest(a):
            motion.scales.append(scale)


def _is_position(x: Floats, u: Floats) -> bool:
    """Return whether a field is the points themselves, up to a shift; then points minus field are no rest state."""
    size = float(np.ptp(x, axis=0).max(initial=0.0)) if np.isfinite(x).all() else 0.0
    return bool(np.isfinite(u).all() and np.ptp(x - u, axis=0).max(initial=0.0) <= MATCH * size)


def find_largest(values: Floats) -> float:
    """Return the largest absolute value, without those that are not finite."""
    finite = np.where(np.isfinite(values), np.abs(values), 0.0)
    return float(finite.max(initial=0.0))


def is_single(grid: Grid) -> bool:
    """Return whether all coordinates are numbers of single precision, however they are stored."""
    points = grid.points
    with np.errstate(over="ignore"):
        return np.array_equal(points.astype(np.float32), points, equal_nan=True)
