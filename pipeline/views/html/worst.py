"""The cells with the largest volume change, found by reading a few frames at a time."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.arrays import Floats
from pipeline.mesh.body_mesh import BodyMesh

if TYPE_CHECKING:
    import xarray

_VALUES = 4_000_000  # volume ratios read at once: 32 MB


@dataclass(frozen=True)
class WorstCell:
    """A cell at its largest |V / V0 - 1|: its volume ratio, the time [s], and its center at rest [m].

    `extremes` are the smallest and largest det F in it at that time, if it is not a linear simplex.
    """

    cell: int
    volume_ratio: float
    time: float
    place: tuple[float, ...]
    extremes: tuple[float, float] | None = None


def find_worst_cells(statistics: "xarray.Dataset", mesh: BodyMesh, count: int) -> list[WorstCell]:
    """Return the cells with the largest |V / V0 - 1| over all frames, worst first; NaN is ignored."""
    ratio, frame = _find_extremes(statistics["volume_ratio"])
    change = np.abs(ratio - 1)
    # ties are broken by index: symmetric bodies have equal cells, and the page must not depend on the sort
    order = np.lexsort((np.arange(len(change)), -change))[:count]
    middles = mesh.centers[order]
    times = statistics["time"].values[frame[order]]
    return [
        WorstCell(int(cell), float(ratio[cell]), float(time), tuple(middle), _read_extremes(statistics, cell, frame))
        for cell, time, middle in zip(order, times, middles.tolist(), strict=True)
    ]


def _read_extremes(statistics: "xarray.Dataset", cell: int, frame: np.ndarray) -> tuple[float, float] | None:
    """Return the smallest and the largest det F in a cell at its frame, if they were recorded."""
    names = ("volume_ratio_min", "volume_ratio_max")
    if not all(name in statistics for name in names):
        return None
    low, high = (float(statistics[name].isel(time=int(frame[cell]), cell=int(cell))) for name in names)
    return low, high


def _find_extremes(ratios: "xarray.DataArray") -> tuple[Floats, np.ndarray]:
    """Return every cell's ratio farthest from 1, and its frame; 1 in frame 0 if none is finite."""
    frames, cells = ratios.sizes["time"], ratios.sizes["cell"]
    extreme, frame = np.ones(cells), np.zeros(cells, dtype=np.int64)
    block = max(1, _VALUES // cells)
    for start in range(0, frames, block):
        values = ratios.isel(time=slice(start, start + block)).transpose("time", "cell").values
        values = np.where(np.isfinite(values), values, 1.0)
        index = np.abs(values - 1).argmax(axis=0)
        here = values[index, np.arange(cells)]
        farther = np.abs(here - 1) > np.abs(extreme - 1)
        extreme[farther], frame[farther] = here[farther], start + index[farther]
    return extreme, frame
