"""The dataset that statistics.nc of a series must equal, measured in memory."""

import numpy as np
import xarray

from pipeline.run.measures import AXES, QUANTILES, VARIABLES, make_attributes, measure
from pipeline.series import Series


def measure_series(series: Series) -> xarray.Dataset:
    """Return the numbers of a series, computed from its frames, under the names of statistics.nc."""
    mesh, d = series.mesh, series.mesh.dimension
    rows = [measure(frame) for frame in series]
    data = {
        name: (("time", *variable.dims), np.stack([row[name] for row in rows]), make_attributes(name, d))
        for name, variable in VARIABLES.items()
        if all(name in row for row in rows)
    }
    coordinates = {"time": series.times, "quantile": QUANTILES, "axis": AXES}
    return xarray.Dataset(
        {"rest_volume": ("cell", mesh.rest_volumes, make_attributes("rest_volume", d)), **data},
        {name: (name, np.array(values), make_attributes(name, d)) for name, values in coordinates.items()},
        {"Conventions": "CF-1.11", "title": series.name},
    )
