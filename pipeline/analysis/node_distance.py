"""Distances between the nodes of several series and those of the first one, at common times.

A series on another mesh is sampled at the rest positions of the first's nodes: distances are those of displacements.
Between two frames, nodes are assumed to move in a straight line. Frames are read and written one at a time.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.analysis.sampling import Sampling
from pipeline.arrays import Floats
from pipeline.formats.netcdf import NetcdfVariable, add_variables
from pipeline.run.measures import pad_to_space
from pipeline.series.series import Series
from pipeline.system.times import are_same_times

# unit, dimensions after (variant, time), and meaning
_VARIABLES = {
    "displacement_difference": ("m", ("node", "axis"), "displacement"),
    "velocity_difference": ("m s-1", ("node", "axis"), "velocity"),
    "node_distance_worst": ("m", (), "largest distance of a node"),
    "node_distance_rms": ("m", (), "root mean square over nodes of their distances"),
}


class NodeDistance(NamedTuple):
    """The largest distance of a node of a series from the first series, its node and time, and the largest RMS."""

    name: str
    worst: float
    node: int
    time: float
    rms: float
    rms_time: float


class NodeMotion:
    """Positions and velocities of a series at any time within it; the last two frames read are cached."""

    def __init__(self, series: Series) -> None:
        self.series = series
        self._times = np.asarray(series.times)
        self._frames: dict[int, tuple[Floats, Floats | None]] = {}

    def interpolate(self, time: float) -> tuple[Floats, Floats | None]:
        """Return x (n, d) and v (n, d) or None, interpolated linearly between the frames around a time [s]."""
        i = int(np.clip(np.searchsorted(self._times, time, side="right") - 1, 0, max(0, len(self._times) - 2)))
        for j in range(i, min(i + 2, len(self._times))):
            if len(self._times) == 1 or are_same_times(time, self._times[j]):
                return self._read_frames([j])[0]
        (x, v), (after_x, after_v) = self._read_frames([i, i + 1])
        share = (time - self._times[i]) / (self._times[i + 1] - self._times[i])
        between = None if v is None or after_v is None else (1 - share) * v + share * after_v
        return (1 - share) * x + share * after_x, between

    def _read_frames(self, indices: list[int]) -> list[tuple[Floats, Floats | None]]:
        frames = {i: self._frames[i] for i in indices if i in self._frames}
        for i in indices:
            if i not in frames:
                frame = self.series.read_frame(i)
                frames[i] = frame.x, frame.v
        self._frames = frames
        return [frames[i] for i in indices]


def write_node_distances(
    out: Any, series: Sequence[Series], samplings: Sequence[Sampling | None], times: Floats,
    on_time: Callable[[int, int], None] | None = None,
) -> tuple[NodeDistance, ...]:  # fmt: skip
    """Add the differences of nodes to a netCDF4 dataset with (variant, time, axis); return the distances of series[1:].

    Series without a sampling have the nodes of the first. Velocities are compared if the first and another series have
    them, and are NaN for a series without them. `on_time(done, times)` is called after each time.
    """
    motions, first = [NodeMotion(s) for s in series], series[0]
    moving = [motion.interpolate(float(times[0]))[1] is not None for motion in motions]
    names = [name for name in _VARIABLES if name != "velocity_difference" or (moving[0] and any(moving[1:]))]
    _create_variables(out, names, first)
    largest: dict[str, NodeDistance] = {}
    for k, time in enumerate(times.tolist()):
        states = [motion.interpolate(time) for motion in motions]
        x0, v0 = states[0]
        for m, (s, sampling, (x, v)) in enumerate(zip(series, samplings, states, strict=True)):
            moved = x - s.mesh.points
            if sampling is not None:  # the distance is that of displacements
                moved = sampling.take_nodes(moved)
                x, v = first.mesh.points + moved, None if v is None else sampling.take_nodes(v)
            distance = np.linalg.norm(x - x0, axis=1)
            rms, worst = _measure_distances(distance)
            moved = moved - (x0 - first.mesh.points)
            row = {"displacement_difference": pad_to_space(moved), "node_distance_worst": distance[worst],
                   "node_distance_rms": rms}  # fmt: skip
            row["velocity_difference"] = np.nan if v is None or v0 is None else pad_to_space(v - v0)
            for name in names:
                out[name][m, k] = row[name]
            owner = s if sampling is None else first
            now = NodeDistance(s.name, float(distance[worst]), owner.layout.find_point(worst), time, rms, time)
            largest[s.name] = _take_larger(largest.get(s.name, now), now)
        if on_time is not None:
            on_time(k + 1, len(times))
    return tuple(largest[s.name] for s in series[1:])


def _measure_distances(distance: Floats) -> tuple[float, int]:
    """Return the root mean square of distances and the place of the largest, without those that are NaN."""
    known = distance[np.isfinite(distance)]
    rms = float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
    return rms, int(np.nan_to_num(distance, nan=-1.0).argmax())


def _create_variables(out: Any, names: list[str], first: Series) -> None:
    """Create the dimension of nodes and the variables."""
    nodes, variables = len(first.mesh.points), {}
    for name in names:
        unit, dims, meaning = _VARIABLES[name]
        relation = "minus that of" if dims else "from that of"
        attributes = {"units": unit, "long_name": f"{meaning}, {relation} {first.name}"}
        chunks = (1, 1, nodes, 3) if dims else (1, len(out.dimensions["time"]))
        variables[name] = NetcdfVariable(("variant", "time", *dims), attributes, chunks=chunks, fill_value=np.nan)
    add_variables(out, {"node": nodes}, variables)


def _take_larger(before: NodeDistance, now: NodeDistance) -> NodeDistance:
    """Return the one with the larger distance, given the larger RMS of the two; NaN is smaller than any."""
    worst = max(now, before, key=lambda row: float(np.nan_to_num(row.worst, nan=-1.0)))
    rms = max(now, before, key=lambda row: float(np.nan_to_num(row.rms, nan=-1.0)))
    return worst._replace(rms=rms.rms, rms_time=rms.rms_time)
