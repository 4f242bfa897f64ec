"""ds.deformation: measures of a dataset of a moving body, and ways to extract and export it.

xarray_plugin registers it with xarray.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats
from pipeline.errors import MeshError, SeriesError
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.locate import locate_points
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.run.measures import measure_cells
from pipeline.series.dataset.attributes import describe_field
from pipeline.series.dataset.mesh_variables import (
    MESH_VARIABLES,
    NODE_COORDINATES,
    describe_mesh,
    read_mesh,
    select_cells,
)
from pipeline.series.dataset.pyvista_grid import make_pyvista_grid
from pipeline.series.dataset.writer import write_pvd_series

if TYPE_CHECKING:
    import xarray

_ALONG = ("time", "node", "axis")


class Worst(NamedTuple):
    """The volume ratio that is farthest from one, its cell and its time [s]."""

    volume_ratio: float
    cell: int
    time: float


class DeformationAccessor:
    """Measures of a dataset with rest_position, connectivity and displacement, computed frame by frame.

    Methods are named after their results, as xarray's own are: `ds.deformation.volume_ratio().max("time")`. Cells with
    a node whose position is not known (NaN) have the value NaN. If the dataset has chunks of dask, so have the results.
    """

    def __init__(self, dataset: "xarray.Dataset") -> None:
        self._dataset = dataset

    def volume_ratio(self) -> "xarray.DataArray":
        """Return the volume over rest volume of every cell in every frame (time, cell); negative if inverted."""
        mesh = self.mesh()
        return self._measure("volume_ratio", mesh, lambda x: _measure_ratio(mesh, x))

    def volume_ratio_min(self) -> "xarray.DataArray":
        """Return the smallest det F in every cell in every frame (time, cell), of quadrature points and nodes."""
        mesh = self.mesh()
        return self._measure("volume_ratio_min", mesh, lambda x: measure_cells(mesh, x).ratio_min)

    def volume_ratio_max(self) -> "xarray.DataArray":
        """Return the largest det F in every cell in every frame (time, cell), of quadrature points and nodes."""
        mesh = self.mesh()
        return self._measure("volume_ratio_max", mesh, lambda x: measure_cells(mesh, x).ratio_max)

    def is_inverted(self) -> "xarray.DataArray":
        """Return whether det F is zero or less somewhere in the cell (time, cell); False if it is not known."""
        mesh = self.mesh()
        return self._measure("inverted", mesh, lambda x: measure_cells(mesh, x).ratio_min <= 0)

    def rotation_angle(self) -> "xarray.DataArray":
        """Return the angle of the polar rotation of every cell in every frame (time, cell) [degree]."""
        mesh = self.mesh()
        return self._measure("rotation_angle", mesh, lambda x: np.degrees(measure_cells(mesh, x).angles))

    def worst(self) -> Worst:
        """Return the largest deviation |V / V0 - 1| of a cell, with that cell and its time; NaN does not count."""
        mesh = self.mesh()
        times = self._dataset["time"].values.tolist()
        worst = Worst(1.0, 0, float(times[0]))
        for time, x in zip(times, self._iterate_positions(mesh), strict=True):
            ratio = _measure_ratio(mesh, x)
            deviation = np.nan_to_num(np.abs(ratio - 1), nan=-1.0)
            cell = int(deviation.argmax())
            if deviation[cell] > abs(worst.volume_ratio - 1):
                worst = Worst(float(ratio[cell]), cell, float(time))
        return worst

    def mesh(self) -> BodyMesh:
        """Return the rest mesh; raises SeriesError if the dataset has none."""
        return read_mesh(self._dataset)

    def to_pyvista(self, time: float) -> Any:
        """Return the frame nearest to a time [s] as a PyVista grid with deformed points and all fields.

        Cells with nodes whose positions are not known are left out. Raises SeriesError if several frames have that
        time.
        """
        self._check_dims()
        times = np.asarray(self._dataset["time"].values, dtype=np.float64)
        nearest = np.flatnonzero(times == times[int(np.abs(times - time).argmin())])
        if len(nearest) > 1:
            raise SeriesError(
                f"{len(nearest)} frames have the time {times[nearest[0]]:g} s: drop_duplicates('time'), or choose one "
                "with isel(time=[...])"
            )
        return make_pyvista_grid(self._dataset.isel(time=int(nearest[0])))

    def probe(self, field: "str | xarray.DataArray", points: Any) -> "xarray.DataArray":
        """Return a field at points (p, d) of the body at rest, which move with it (time, point[, axis]).

        A nodal field is interpolated by the shape functions of the cell around the point (in polyhedra and polygons
        linearly, from their middle); a cell field has that cell's value; outside the body the result is NaN. `field` is
        a name, or any DataArray over nodes or cells. Raises SeriesError.
        """
        import xarray

        values, mesh = self._dataset[field] if isinstance(field, str) else field, self.mesh()
        try:
            cells, weights = locate_points(mesh, np.atleast_2d(np.asarray(points, dtype=np.float64)))
        except MeshError as error:
            raise SeriesError(str(error)) from error
        if "node" in values.dims:
            nodes, places = np.unique(_list_nodes(mesh, cells, weights.shape[1]), return_inverse=True)
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
        out.attrs = {name: value for name, value in values.attrs.items() if name not in ("mesh", "location")}
        return out.rename(values.name)

    def extract(self, cells: Any) -> "xarray.Dataset":
        """Return the dataset restricted to some cells, chosen by indices or a mask, and to their nodes."""
        mesh = self.mesh()
        indices = np.asarray(cells)
        chosen = np.arange(len(mesh.cell_array.types))[indices].reshape(-1) if indices.size else indices
        if not chosen.size:
            raise SeriesError("no cells were chosen")
        part, nodes = select_cells(mesh, chosen)
        described = describe_mesh(part)
        rest = self._dataset.drop_vars((*MESH_VARIABLES, *NODE_COORDINATES), errors="ignore")
        out = rest.isel(cell=chosen, node=nodes, missing_dims="ignore")
        return out.assign(described.variables).assign_coords(described.coordinates)

    def to_pvd(self, path: str | os.PathLike[str]) -> Path:
        """Write the dataset as NAME.pvd with a folder NAME of .vtu files; return the index. See write_pvd_series."""
        return write_pvd_series(self._dataset, path)

    def _check_dims(self) -> "xarray.DataArray":
        """Return the displacement (time, node, axis); raises SeriesError if it has other dimensions."""
        field = self._dataset["displacement"]
        if set(field.dims) != set(_ALONG):
            extra = [str(name) for name in field.dims if name not in _ALONG]
            remedy = f"select one {extra[0]} first (isel)" if extra else "keep time (isel(time=[i]))"
            raise SeriesError(f"displacement has the dimensions {', '.join(map(str, field.dims))}: {remedy}")
        _check_units(self._dataset["rest_position"], field)
        return field.transpose(*_ALONG)

    def _iterate_positions(self, mesh: BodyMesh) -> Iterator[Floats]:
        field, d = self._check_dims(), mesh.points.shape[1]
        return (mesh.points + field[i].values[:, :d] for i in range(field.sizes["time"]))

    def _measure(self, name: str, mesh: BodyMesh, measure: Callable[[Floats], NDArray[Any]]) -> "xarray.DataArray":
        """Return measures of all cells in all frames (time, cell), given those of one frame's positions."""
        import xarray

        field, d = self._check_dims(), mesh.points.shape[1]
        kind = np.dtype(np.bool_ if name == "inverted" else np.float64)

        def measure_frames(displacement: Floats) -> NDArray[Any]:
            """Return the measures of some frames (t, cell), given the displacement (t, node, axis)."""
            rows = [measure(mesh.points + frame[:, :d]) for frame in displacement]
            return np.array(rows, dtype=kind).reshape(len(displacement), len(mesh.rest_volumes))

        if field.chunks:
            whole = field.chunk(node=-1, axis=-1)
            values = xarray.apply_ufunc(
                measure_frames, whole, input_core_dims=[["node", "axis"]], output_core_dims=[["cell"]],
                dask="parallelized", output_dtypes=[kind],
                dask_gufunc_kwargs={"output_sizes": {"cell": len(mesh.rest_volumes)}},
            ).data  # fmt: skip
        else:
            values = np.concatenate([measure_frames(field[i : i + 1].values) for i in range(field.sizes["time"])])
        coordinates = {key: self._dataset[key] for key in ("time", "cell_type") if key in self._dataset.coords}
        attributes = describe_field(name, ("cell",), mesh.dimension)
        return xarray.DataArray(values, coordinates, ("time", "cell"), name, attributes)


def _check_units(rest: "xarray.DataArray", displacement: "xarray.DataArray") -> None:
    """Raise SeriesError if positions at rest and displacements cannot be added as plain numbers."""
    if any(hasattr(part.data, "units") for part in (rest, displacement.isel(time=slice(0)))):  # of pint
        raise SeriesError("rest_position or displacement holds quantities: use ds.pint.dequantify() first")
    units = [part.attrs.get("units") for part in (rest, displacement)]
    if None not in units and units[0] != units[1]:
        raise SeriesError(f"rest_position is in {units[0]}, displacement in {units[1]}: convert one of them")


def _measure_ratio(mesh: BodyMesh, x: Floats) -> Floats:
    """Return the volume ratio of every cell; of simplices without their angles, which take longer."""
    volumes = signed_volumes(x, mesh.cells) if isinstance(mesh, Mesh) else measure_cells(mesh, x).volumes
    return volumes / mesh.rest_volumes


def _list_nodes(mesh: BodyMesh, cells: NDArray[np.int64], width: int) -> NDArray[np.int64]:
    """Return the nodes of cells (p, width); beyond the last node of a cell its first, which has no weight there."""
    array = mesh.cell_array
    starts, lengths = array.offsets[cells], np.diff(array.offsets)[cells]
    places = np.arange(width)
    return array.connectivity[starts[:, None] + np.where(places < lengths[:, None], places, 0)]
