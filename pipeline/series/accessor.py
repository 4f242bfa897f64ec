"""ds.series: what a dataset of a moving body says of its cells."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pipeline.errors import MeshError, SeriesError
from pipeline.fem.element import deformation_gradient
from pipeline.fem.rotation import angle, polar
from pipeline.measures import attributes
from pipeline.mesh.simplex import Floats, Mesh, signed_volumes

if TYPE_CHECKING:
    import xarray

_NEEDED = ("rest_position", "connectivity", "displacement")


class Worst(NamedTuple):
    """The volume ratio that is farthest from one, and the cell and the time [s] that it is in."""

    volume_ratio: float
    cell: int
    time: float


class SeriesAccessor:
    """Measures of a dataset with rest_position, connectivity and displacement, a frame at a time."""

    def __init__(self, dataset: "xarray.Dataset") -> None:
        self._dataset = dataset

    def volume_ratio(self) -> "xarray.DataArray":
        """Return the volume ratio of every cell in every frame (time, cell)."""
        mesh = self.mesh()
        return self._measured("volume_ratio", [ratio for _, ratio in self._ratios(mesh)])

    def rotation_angle(self) -> "xarray.DataArray":
        """Return the angle of the polar rotation of every cell in every frame (time, cell) [degree]."""
        mesh = self.mesh()
        rows = [np.degrees(angle(polar(deformation_gradient(mesh, x)))) for x in self._positions(mesh)]
        return self._measured("rotation_angle", rows)

    def worst(self) -> Worst:
        """Return the cell and the time of the largest |V / V0 - 1|."""
        mesh, found = self.mesh(), Worst(1.0, 0, float(self._dataset["time"][0]))
        for time, ratio in self._ratios(mesh):
            cell = int(np.abs(ratio - 1).argmax())
            if abs(ratio[cell] - 1) > abs(found.volume_ratio - 1):
                found = Worst(float(ratio[cell]), cell, time)
        return found

    def to_pyvista(self, time: float) -> Any:
        """Return the frame nearest to a time [s] as a grid of deformed points with all its fields."""
        frame = self._dataset.sel(time=time, method="nearest")
        return pyvista_grid(frame)

    def mesh(self) -> Mesh:
        """Return the rest mesh; raises SeriesError where the dataset has none."""
        missing = [name for name in _NEEDED if name not in self._dataset]
        if missing:
            raise SeriesError(f"the dataset is no series of a body: it has no {', '.join(missing)}")
        cells = self._dataset["connectivity"].values
        try:
            return Mesh(self._dataset["rest_position"].values[:, : cells.shape[1] - 1], cells, name="rest state")
        except MeshError as error:
            raise SeriesError(str(error)) from error

    def _positions(self, mesh: Mesh) -> Iterator[Floats]:
        field = self._dataset["displacement"].transpose("time", "node", "axis")
        return (mesh.points + field[i].values[:, : mesh.dimension] for i in range(field.sizes["time"]))

    def _ratios(self, mesh: Mesh) -> Iterator[tuple[float, Floats]]:
        times = self._dataset["time"].values.tolist()
        ratios = (signed_volumes(x, mesh.cells) / mesh.rest_volumes for x in self._positions(mesh))
        return zip(times, ratios, strict=True)

    def _measured(self, name: str, rows: list[Floats]) -> "xarray.DataArray":
        import xarray

        d = self._dataset.sizes["corner"] - 1
        time = {"time": self._dataset["time"]}
        return xarray.DataArray(np.stack(rows), time, ("time", "cell"), name, attributes(name, d))


def pyvista_grid(frame: "xarray.Dataset") -> Any:
    """Return one frame as an unstructured grid: points DEFORMED, as our own files have them."""
    import pyvista

    cells, rest = frame["connectivity"].values, frame["rest_position"].values
    kind = {4: 10, 3: 5}[cells.shape[1]]
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
