"""The drawable part of a recorded series: its surface in every frame, and the numbers shown beside it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.simplex import Mesh
from pipeline.mesh.skin import find_skin
from pipeline.run.frame import Frame
from pipeline.run.measures import measure_cells
from pipeline.series import Series
from pipeline.series.body.cell_sides import join_coincident
from pipeline.system.times import TIME_RTOL

# half-widths of a color range that give readable ticks; with the last, 1, the range begins at V = 0
RADII = (0.02, 0.04, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
SAMPLED_CELLS = 2000  # of a frame, for the color range: enough for a quantile of any mesh
_TOGETHER = 1e-5  # of the body's size: nodes this close are at one place, even in single precision
EXPLODED = 20.0  # a frame this many rest sizes wide has blown up: fitting it would shrink all others to a dot


@dataclass(frozen=True, eq=False)
class Track:
    """All frames of one panel: the surface only, in single precision, so that a long motion fits into memory.

    faces (f, 3) and lines (k, 2) are rows of rest (s, 3) and of points (t, s, 3); ratio (t, f) is that of the cell
    behind the face, the smallest det F in it if that is zero or less, NaN without data. Points without data stay at
    their last place.
    """

    label: str
    dimension: int
    times: Floats
    faces: Ints
    lines: Ints | None  # around the cells; None if these are the sides of the triangles
    normal: Floats | None  # of a planar body (3,)
    rest: NDArray[np.float32]
    points: NDArray[np.float32]
    ratio: NDArray[np.float32]
    total: Floats  # total volume over total rest volume (t,)
    low: Floats  # smallest and largest volume ratio of all cells, interior ones too (t,)
    high: Floats
    inverted: Ints  # number of inverted cells (t,)
    unknown: Ints  # number of cells without data (t,)
    sample: NDArray[np.float32]  # |J - 1| of some cells of every frame

    @property
    def worst(self) -> Floats:
        """Return the largest |J - 1| of every frame (t,)."""
        return np.maximum(self.high - 1, 1 - self.low)

    def find_frame(self, time: float) -> int:
        """Return the index of the last frame that is not later than a time, or 0 before the first."""
        slack = TIME_RTOL * max(float(np.ptp(self.times)), abs(time))
        return max(int(np.searchsorted(self.times, time + slack, side="right")) - 1, 0)

    def find_gap(self, index: int) -> float | None:
        """Return the time from which on no cell has had data up to a frame [s]; None if one has them in it."""
        if np.isfinite(self.low[index]):
            return None
        known = np.flatnonzero(np.isfinite(self.low[:index]))
        return float(self.times[known[-1] + 1 if known.size else 0])

    def ends_before(self, end: float) -> bool:
        """Return whether at least one frame is missing between the last one and a time."""
        interval = float(np.diff(self.times[-2:])[0]) if len(self.times) > 1 else 0.0
        return bool(end - self.times[-1] > max(0.5 * interval, TIME_RTOL * abs(end)))


def find_normal(mesh: BodyMesh) -> Floats | None:
    """Return the unit normal (3,) of a planar body; None for solids and for surfaces in space."""
    if mesh.points.shape[1] == 2:
        return np.array([0.0, 0.0, 1.0])
    if isinstance(mesh, CellMesh) and mesh.plane is not None:
        return np.asarray(np.cross(*mesh.plane), dtype=np.float64)
    return None


def join_nodes(series: Series) -> Ints | None:
    """Return the node that stands for each node (n,) at the same place at rest; None if every place has one node.

    Programs of discontinuous elements give every cell points of its own.
    """
    if series.ours:
        return None
    joined = join_coincident(series.mesh.points)
    return None if len(np.unique(joined)) == len(joined) else joined


def read_track(series: Series, label: str, on_read: Callable[[], None] = lambda: None, *, joins: bool = True) -> Track:
    """Return the whole motion of a series, each file read once; raises SeriesError if one cannot be read.

    Nodes at the same place at rest are drawn as one if it `joins` them and they stay together; else files are read
    once more.
    """
    mesh = series.mesh
    joined = join_nodes(series) if joins else None
    skin = find_skin(mesh, joined)
    count, d, rest_total = len(series), mesh.points.shape[1], mesh.rest_volumes.sum()
    points = np.zeros((count, skin.count, 3), dtype=np.float32)
    face_ratio = np.empty((count, len(skin.triangles)), dtype=np.float32)
    total, low, high = (np.empty(count) for _ in range(3))
    inverted, unknown = np.empty((2, count), dtype=np.int64)
    rest = np.zeros((skin.count, 3), dtype=np.float32)
    rest[:, :d] = skin.place(mesh.points)
    sample = []
    for i in range(count):
        x, whole = _read_instant(series, i)
        if joined is not None and (np.abs(x - x[joined]) > _TOGETHER * mesh.size).any():
            return read_track(series, label, joins=False)
        cells = measure_cells(mesh, x)
        ratio = cells.volumes / mesh.rest_volumes
        points[i, :, :d] = skin.place(x)
        face_ratio[i] = np.where(cells.ratio_min <= 0, np.minimum(ratio, cells.ratio_min), ratio)[skin.owners]
        known = ratio[np.isfinite(ratio)]
        low[i], high[i] = (known.min(), known.max()) if known.size else (np.nan, np.nan)
        total[i] = whole / rest_total if whole is not None else cells.volumes.sum() / rest_total
        inverted[i], unknown[i] = (cells.ratio_min <= 0).sum(), len(ratio) - len(known)
        sample.append(np.abs(ratio[:: max(1, len(ratio) // SAMPLED_CELLS)] - 1).astype(np.float32))
        _keep_places(points, i, rest)
        on_read()
    return Track(
        label=label, dimension=mesh.dimension, times=np.asarray(series.times, dtype=np.float64), faces=skin.triangles,
        lines=None if isinstance(mesh, Mesh) else skin.lines, normal=find_normal(mesh), rest=rest, points=points,
        ratio=face_ratio, total=total, low=low, high=high, inverted=inverted, unknown=unknown,
        sample=np.concatenate(sample),
    )  # fmt: skip


def _read_instant(series: Series, index: int) -> tuple[Floats, float | None]:
    """Return the positions of a frame, and the volume of the whole body if that is not the sum of its cells."""
    if series.ours:
        return series.read_positions(index), None
    frame: Frame = series.read_frame(index)
    whole = frame.whole.get("total_volume")
    return frame.x, None if whole is None else float(whole)


def _keep_places(points: NDArray[np.float32], index: int, rest: NDArray[np.float32]) -> None:
    """Give points of a frame (t, s, 3) that are not finite their places in the frame before, or at rest."""
    lost = ~np.isfinite(points[index]).all(axis=1)
    if lost.any():
        points[index, lost] = points[index - 1, lost] if index else rest[lost]


def choose_color_radius(tracks: Sequence[Track]) -> float:
    """Return r of the color range [1 - r, 1 + r]: cells within it hold 60 % of all |V / V0 - 1| over all frames.

    The quantile is weighted by the deviation, so that neither a long rest after a short motion nor one bad cell
    decides: unweighted, the thesis bar, at rest for six of seven seconds, would get 2 % for a motion of 100 %.
    """
    return fit_color_radius(np.concatenate([track.sample for track in tracks]))


def find_clipped_ends(tracks: Sequence[Track], radius: float) -> tuple[bool, bool]:
    """Return whether volume ratios of a motion lie below, and above, the color range of that radius."""
    low = np.concatenate([track.low for track in tracks])
    high = np.concatenate([track.high for track in tracks])
    return bool((low < 1 - radius).any()), bool((high > 1 + radius).any())  # NaN is neither


def fit_color_radius(deviations: NDArray[np.floating]) -> float:
    """Return r of the color range for all |V / V0 - 1| of a motion, or a sample of them."""
    pooled = np.sort(deviations[np.isfinite(deviations)].astype(np.float64), axis=None)
    sums = np.cumsum(pooled)
    radius = pooled[np.searchsorted(sums, 0.6 * sums[-1])] if pooled.size else 0.0
    return next((r for r in RADII if r >= radius), RADII[-1])


def list_drawn_points(track: Track) -> Floats:
    """Return every point that the camera must see (k, 3): rest and all frames that did not blow up."""
    size = np.linalg.norm(np.ptp(track.rest, axis=0))
    extent = np.linalg.norm(np.ptp(track.points, axis=1), axis=-1)
    keep = extent <= EXPLODED * size  # false for NaN too
    return np.concatenate([track.rest, track.points[keep].reshape(-1, 3)]).astype(np.float64)


def find_sharp_edges(
    points: NDArray[np.float32], faces: Ints, toward: Floats, angle: float = 50.0
) -> tuple[Ints, Ints]:
    """Return the creases (k, 2) of a triangle surface, and the edges (m, 2) of its contour seen from a direction.

    Faces meet in a crease at more than `angle` degrees. An edge of a single triangle is a crease too: in a planar mesh
    these are the outline.
    """
    corners = points[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, which, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.ravel(), kind="stable") // 3  # the triangles, sorted by edge
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    a, b = normals[order[first]], normals[order[first + count - 1]]
    crease = (count == 1) | ((a * b).sum(axis=1) < np.cos(np.radians(angle)))
    contour = (count > 1) & (((a @ toward) > 0) != ((b @ toward) > 0))
    return edges[crease], edges[contour & ~crease]
