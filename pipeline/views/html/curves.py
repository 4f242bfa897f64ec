"""The numbers of whole bodies over time, for the curves of the page."""

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.views.palette import BANDS, ENERGIES

if TYPE_CHECKING:
    import xarray

MOST_TIMES = 1000  # more than the pixels across a curve on a screen


def choose_times(statistics: "xarray.Dataset") -> list[int]:
    """Return the frames of a curve: evenly spaced ones and the one with the largest change."""
    count = statistics.sizes["time"]
    if count <= MOST_TIMES:
        return list(range(count))
    return sorted({*np.linspace(0, count - 1, MOST_TIMES).round().astype(int).tolist(), find_worst_frame(statistics)})


def find_worst_frame(statistics: "xarray.Dataset") -> int:
    """Return the frame of the largest |V / V0 - 1| of any cell; 0 if none is finite."""
    change = np.abs(statistics["volume_ratio_quantile"].values[:, [0, -1]] - 1).max(axis=1)
    for frame in np.flatnonzero(np.isnan(change)):  # quantiles are NaN if one cell is
        ratio = statistics["volume_ratio"].isel(time=int(frame)).values
        known = ratio[np.isfinite(ratio)]
        change[frame] = np.abs(known - 1).max() if known.size else np.nan
    return int(np.nan_to_num(change, nan=-1.0).argmax())


def collect_curves(statistics: "xarray.Dataset") -> dict[str, Any]:
    """Return times, total volume, bands of the cells' volume ratios, and energies of one series, for JSON."""
    shown = statistics.drop_vars(["volume_ratio", "rotation_angle"], errors="ignore").isel(
        time=choose_times(statistics)
    )
    quantiles = shown["volume_ratio_quantile"].values
    column = {round(float(q), 6): round_numbers(quantiles[:, i]) for i, q in enumerate(shown["quantile"].values)}
    energies = {name: shown[f"{name}_energy"].values for name in ENERGIES if f"{name}_energy" in shown}
    if len(energies) > 1:
        energies["total"] = sum(energies.values(), np.zeros(shown.sizes["time"]))
    return {
        "times": round_numbers(shown["time"].values, digits=9),
        "total": round_numbers(100 * (1 + shown["volume_drift"].values)),
        "bands": [[column[low], column[high]] for low, high, _ in BANDS],
        "median": column[0.5],
        "energies": {name: round_numbers(values) for name, values in energies.items()},
    }


def round_numbers(values: Floats, digits: int = 6) -> list[float | None]:
    """Return numbers rounded to `digits` significant digits; None if not finite, as JSON has no NaN."""
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in np.asarray(values).tolist()]
