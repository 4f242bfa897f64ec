"""Datasets of volume statistics: of one series, and of several variants joined along `variant`."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from pipeline.run.measures import AXES, QUANTILES, VARIABLES, attributes, measure
from pipeline.series import Series

if TYPE_CHECKING:
    import xarray

# of the times of two variants: what separates i * dt computed with another dt
_SAME_TIME = 1e-12


def series_statistics(series: Series) -> "xarray.Dataset":
    """Return the dataset of a series, measured anew from its points; the same names as statistics.nc."""
    import xarray

    mesh = series.mesh
    rows = [measure(frame) for frame in series]
    names = [name for name in VARIABLES if all(name in row for row in rows)]
    d = mesh.dimension
    data = {
        name: (("time", *VARIABLES[name].dims), np.stack([row[name] for row in rows]), attributes(name, d))
        for name in names
    }
    coordinates = {"time": series.times, "quantile": QUANTILES, "axis": AXES}
    return xarray.Dataset(
        {"rest_volume": ("cell", mesh.rest_volumes, attributes("rest_volume", d)), **data},
        {name: (name, np.array(values), attributes(name, d)) for name, values in coordinates.items()},
        {"Conventions": "CF-1.11", "title": series.name},
    )


def joined(datasets: Mapping[str, "xarray.Dataset"], *, title: str) -> tuple["xarray.Dataset", list[str]]:
    """Return the variants of one mesh joined along `variant`, and a note for each that had to be left out.

    The times are those of the longest variant; one that stopped early is NaN after its last frame.
    """
    import xarray

    longest = max(datasets, key=lambda name: datasets[name].sizes["time"])
    reference = datasets[longest]
    times = reference["time"].values
    kept, notes = {}, []
    for name, dataset in datasets.items():
        count = dataset.sizes["time"]
        if not np.array_equal(dataset["rest_volume"].values, reference["rest_volume"].values):
            notes.append(f"{name} is left out of the comparison: its mesh is not that of {longest}")
        elif not np.allclose(dataset["time"].values, times[:count], rtol=_SAME_TIME, atol=_SAME_TIME * times[-1]):
            notes.append(f"{name} is left out of the comparison: its frame times are not those of {longest}")
        else:
            kept[name] = dataset.assign_coords(time=reference["time"][:count]).reindex(time=reference["time"])
    rest = reference["rest_volume"]
    methods = xarray.Variable("variant", np.array(list(kept), dtype=object), {"long_name": "variant of the case"})
    out = xarray.concat(
        [dataset.drop_vars("rest_volume").drop_dims("step", errors="ignore") for dataset in kept.values()],
        dim=methods,
        join="exact",
        combine_attrs="drop_conflicts",
    )
    out["rest_volume"] = rest
    out.encoding["unlimited_dims"] = {"time"}
    out.attrs = {"Conventions": "CF-1.11", "title": title}
    return out, notes
