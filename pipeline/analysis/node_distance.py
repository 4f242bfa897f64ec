"""How far the nodes of several series are apart: their differences to the first one, at common times.

Between two frames nodes are taken to move along the chord. Frames are read one after the other, and written at once.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.run.measures import spatial
from pipeline.series.series import Series

# unit, dimensions after (variant, time), and meaning
VARIABLES = {
    "displacement_difference": ("m", ("node", "axis"), "displacement"),
    "velocity_difference": ("m s-1", ("node", "axis"), "velocity"),
    "node_distance_worst": ("m", (), "largest distance of a node"),
    "node_distance_rms": ("m", (), "root mean square over nodes of their distances"),
}


class NodeDistance(NamedTuple):
    """A series beside the first one: the largest distance of a node, where and when, and the largest RMS distance."""

    name: str
    worst: float
    node: int
    time: float
    rms: float
    rms_time: float


class Nodes:
    """Positions and velocities of a series at any time within it; the last two frames are kept."""

    def __init__(self, series: Series) -> None:
        self.series = series
        self._times = np.asarray(series.times)
        self._kept: dict[int, tuple[Floats, Floats | None]] = {}

    def at(self, time: float) -> tuple[Floats, Floats | None]:
        """Return x (n, d) and v (n, d) or None, interpolated linearly between the frames around a time [s]."""
        i = int(np.clip(np.searchsorted(self._times, time, side="right") - 1, 0, max(0, len(self._times) - 2)))
        needed = [i] if len(self._times) == 1 else [i, i + 1]
        share = 0.0 if len(needed) == 1 else (time - self._times[i]) / (self._times[i + 1] - self._times[i])
        if round(share, 9) in (0.0, 1.0):  # at a frame: i * dt of another dt is rounded otherwise
            return self._frames([needed[round(share)]])[0]
        (x, v), (after_x, after_v) = self._frames(needed)
        between = None if v is None or after_v is None else (1 - share) * v + share * after_v
        return (1 - share) * x + share * after_x, between

    def _frames(self, needed: list[int]) -> list[tuple[Floats, Floats | None]]:
        kept = {i: self._kept[i] for i in needed if i in self._kept}
        for i in needed:
            if i not in kept:
                frame = self.series.read_frame(i)
                kept[i] = frame.x, frame.v
        self._kept = kept
        return [kept[i] for i in needed]


def write_node_distances(
    out: Any, series: Sequence[Series], times: Floats, on_time: Callable[[int, int], None] | None = None
) -> tuple[NodeDistance, ...]:
    """Add the differences of nodes to a netCDF4 dataset with (variant, time, axis); return each one's but the first's.

    All series have the cells of the first. Velocities are there where the first and one more have them, NaN for those
    that have none. `on_time(done, times)` is called after each time.
    """
    nodes, first = [Nodes(one) for one in series], series[0]
    moving = [one.at(float(times[0]))[1] is not None for one in nodes]
    names = [name for name in VARIABLES if name != "velocity_difference" or (moving[0] and any(moving[1:]))]
    _create(out, names, first)
    found: dict[str, NodeDistance] = {}
    for k, time in enumerate(times.tolist()):
        states = [one.at(time) for one in nodes]
        x0, v0 = states[0]
        for m, (one, (x, v)) in enumerate(zip(series, states, strict=True)):
            distance = np.linalg.norm(x - x0, axis=1)
            rms, worst = float(np.sqrt(np.mean(distance**2))), int(distance.argmax())
            moved = (x - one.mesh.points) - (x0 - first.mesh.points)
            row = {"displacement_difference": spatial(moved), "node_distance_worst": distance[worst],
                   "node_distance_rms": rms}  # fmt: skip
            row["velocity_difference"] = np.nan if v is None or v0 is None else spatial(v - v0)
            for name in names:
                out[name][m, k] = row[name]
            now = NodeDistance(one.name, float(distance[worst]), one.layout.find_point(worst), time, rms, time)
            found[one.name] = _larger(found.get(one.name, now), now)
        if on_time is not None:
            on_time(k + 1, len(times))
    return tuple(found[one.name] for one in series[1:])


def _create(out: Any, names: list[str], first: Series) -> None:
    """Create dimension and variables."""
    out.createDimension("node", len(first.mesh.points))
    for name in names:
        unit, dims, meaning = VARIABLES[name]
        sizes = [1, 1, *(len(out.dimensions[dim]) for dim in dims)] if dims else None
        variable = out.createVariable(name, "f8", ("variant", "time", *dims), chunksizes=sizes)
        ending = "less that" if dims else "from that"
        variable.setncatts({"units": unit, "long_name": f"{meaning}, {ending} of {first.name}"})


def _larger(before: NodeDistance, now: NodeDistance) -> NodeDistance:
    """Return the larger of two, worst and RMS each for itself."""
    worst, rms = max(now, before, key=lambda one: one.worst), max(now, before, key=lambda one: one.rms)
    return worst._replace(rms=rms.rms, rms_time=rms.rms_time)
