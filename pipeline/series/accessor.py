"""ds.deformation: measures of a dataset of a moving body, and ways to extract and export it.

xarray_plugin registers it with xarray.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import MeshError, SeriesError
from pipeline.formats.cell_types import CELL_TYPES
from pipeline.mesh.locate import locate_points
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.run.measures import make_attributes, measure_cells
from pipeline.series.dataset_layout import read_mesh
from pipeline.series.dataset_writer import write_pvd_series

if TYPE_CHECKING:
    import xarray


class Worst(NamedTuple):
    """The volume ratio that is farthest from one, its cell and its time [s]."""

    volume_ratio: float
    cell: int
    time: float


class DeformationAccessor:
    """Measures of a dataset with rest_position, connectivity and displacement, computed frame by frame.

    Methods are named after their results, as xarray's own are: `ds.deformation.volume_ratio().max("time")`.
    """

    def __init__(self, dataset: "xarray.Dataset") -> None:
        self._dataset = dataset

    def volume_ratio(self) -> "xarray.DataArray":
        """Return the volume ratio of every cell in every frame (time, cell)."""
        return self._stack("volume_ratio", [ratio for _, ratio in self._iterate_ratios(self.mesh())])

    def rotation_angle(self) -> "xarray.DataArray":
        """Return the angle of the polar rotation of every cell in every frame (time, cell) [degree]."""
        mesh = self.mesh()
        rows = [np.degrees(measure_cells(mesh, x).angles) for x in self._iterate_positions(mesh)]
        return self._stack("rotation_angle", rows)

    def worst(self) -> Worst:
        """Return the largest deviation |V / V0 - 1| of a cell, with that cell and its time."""
        mesh, worst = self.mesh(), Worst(1.0, 0, float(self._dataset["time"][0]))
        for time, ratio in self._iterate_ratios(mesh):
            cell = int(np.abs(ratio - 1).argmax())
            if abs(ratio[cell] - 1) > abs(worst.volume_ratio - 1):
                worst = Worst(float(ratio[cell]), cell, time)
        return worst

    def mesh(self) -> Mesh:
        """Return the rest mesh; raises SeriesError if the dataset has none."""
        return read_mesh(self._dataset)

    def to_pyvista(self, time: float) -> Any:
        """Return the frame nearest to a time [s] as a PyVista grid with deformed points and all fields."""
        return make_pyvista_grid(self._dataset.sel(time=time, method="nearest"))

    def probe(self, field: "str | xarray.DataArray", points: Any) -> "xarray.DataArray":
        """Return a field at points (p, d) of the body at rest, which move with it (time, point[, axis]).

        A nodal field is interpolated linearly in the cell around the point; a cell field has that cell's value; outside
        the body the result is NaN. `field` is a name, or any DataArray over nodes or cells. Raises SeriesError.
        """
        import xarray

        values = self._dataset[field] if isinstance(field, str) else field
        try:
            cells, weights = locate_points(self.mesh(), np.atleast_2d(np.asarray(points, dtype=np.float64)))
        except MeshError as error:
            raise SeriesError(str(error)) from error
        if "node" in values.dims:
            nodes, places = np.unique(self._dataset["connectivity"].values[cells], return_inverse=True)
            nodal = values.isel(node=nodes)
            nodal = nodal if nodal.chunks else nodal.compute()  # read only the nodes needed, each once
            corners = xarray.DataArray(places.reshape(weights.shape), dims=("point", "corner"))
            shares = xarray.DataArray(weights, dims=("point", "corner"))
            out = xarray.dot(nodal.isel(node=corners), shares, dim="corner")
        elif "cell" in values.dims:
            inside = xarray.DataArray(np.isfinite(weights[:, 0]), dims="point")
            out = values.isel(cell=xarray.DataArray(cells, dims="point")).where(inside)
        else:
            raise SeriesError(
                f"{values.name} is a field of neither nodes nor cells: {', '.join(map(str, values.dims))}"
            )
        out = out.transpose("time", "point", ...) if "time" in out.dims else out.transpose("point", ...)
        return out.rename(values.name).assign_attrs(values.attrs)

    def extract(self, cells: Any) -> "xarray.Dataset":
        """Return the dataset restricted to some cells, chosen by indices or a mask, and to their nodes."""
        corners = self.mesh().cells
        chosen = np.arange(len(corners))[np.asarray(cells)].reshape(-1)
        nodes, renumbered = np.unique(corners[chosen], return_inverse=True)
        out = self._dataset.isel(cell=chosen, node=nodes)
        shape = len(chosen), corners.shape[1]
        return out.assign(connectivity=out["connectivity"].copy(data=renumbered.reshape(shape)))

    def to_pvd(self, path: str | os.PathLike[str]) -> Path:
        """Write the dataset as NAME.pvd with a folder NAME of .vtu files; return the index. See write_pvd_series."""
        return write_pvd_series(self._dataset, path)

    def _iterate_positions(self, mesh: Mesh) -> Iterator[Floats]:
        field = self._dataset["displacement"].transpose("time", "node", "axis")
        return (mesh.points + field[i].values[:, : mesh.dimension] for i in range(field.sizes["time"]))

    def _iterate_ratios(self, mesh: Mesh) -> Iterator[tuple[float, Floats]]:
        times = self._dataset["time"].values.tolist()
        ratios = (signed_volumes(x, mesh.cells) / mesh.rest_volumes for x in self._iterate_positions(mesh))
        return zip(times, ratios, strict=True)

    def _stack(self, name: str, rows: list[Floats]) -> "xarray.DataArray":
        import xarray

        d = self._dataset.sizes["corner"] - 1
        time = {"time": self._dataset["time"]}
        return xarray.DataArray(np.stack(rows), time, ("time", "cell"), name, make_attributes(name, d))


def make_pyvista_grid(frame: "xarray.Dataset") -> Any:
    """Return one frame as an unstructured grid with DEFORMED points, as in our own files."""
    import pyvista

    cells, rest = frame["connectivity"].values, frame["rest_position"].values
    kind = CELL_TYPES[cells.shape[1] - 1]
    grid = pyvista.UnstructuredGrid({kind: cells}, rest + frame["displacement"].values)
    grid.point_data["rest_position"] = rest
    for name, variable in frame.data_vars.items():
        if name in ("connectivity", "rest_position"):
            continue
        whole = variable.dims[:1]
        data = grid.point_data if whole == ("node",) else grid.cell_data if whole == ("cell",) else grid.field_data
        values = variable.values
        data[str(name)] = values if data is not grid.field_data else np.atleast_2d(values)
    if "time" in frame.coords:
        grid.field_data["TimeValue"] = [float(frame["time"])]
    return grid
