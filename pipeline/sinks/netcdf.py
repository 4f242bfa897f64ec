"""statistics.nc: the numbers of every frame, appended and synced, so that a killed run keeps all its frames."""

import os
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import OutputError
from pipeline.formats.netcdf import NETCDF_LOCK, NetcdfVariable, create_dataset
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.run.frame import Frame, Values
from pipeline.run.measures import AXES, QUANTILES, STEPS, VARIABLES, make_attributes

CHUNK_FRAMES = 256  # the default of one would give every number its own chunk and index entry
_CELLS_CHUNK = 2048  # cell values, if a frame has fewer: the index of chunks is kept in memory


class NetcdfSink:
    """Appends frames to a netCDF file (CF-1.11, float64), a new one unless it has `earlier` frames."""

    def __init__(self, path: str | os.PathLike[str], *, title: str, earlier: int = 0) -> None:
        self.path = Path(path)
        self.title = title
        self._dataset: Any = None
        self._count = earlier

    def write(self, frame: Frame, measured: Values) -> None:
        """Append one frame and sync it to the disk."""
        try:
            with NETCDF_LOCK:
                self._append(frame, measured)
        except UnicodeError as error:
            raise OutputError(
                f"{self.path}: the locale's encoding, which netCDF uses, lacks characters of this name; "
                "set PYTHONUTF8=1, or choose another folder"
            ) from error
        except (OSError, RuntimeError) as error:
            raise OutputError(f"{self.path}: cannot be written ({error})") from error
        self._count += 1

    def _append(self, frame: Frame, measured: Values) -> None:
        if self._dataset is None:
            self._dataset = self._open(frame.mesh, measured)
            _limit_caches(self._dataset)
        self._dataset["time"][self._count] = frame.time
        for name, value in measured.items():
            if name in VARIABLES:
                self._dataset[name][self._count] = value
        self._write_steps(frame.step or 0, measured)
        self._dataset.sync()

    def _write_steps(self, last: int, measured: Values) -> None:
        """Append the numbers of the steps since the previous frame; there are none before the first."""
        for name in [name for name in STEPS if name in measured] if last else ():  # in this order, for the same bytes
            first = last - len(measured[name])
            self._dataset[name][first:last] = measured[name]
            self._dataset["step"][first:last] = np.arange(first, last) + 1

    def _open(self, mesh: BodyMesh, measured: Values) -> Any:
        if self._count:
            import netCDF4

            return netCDF4.Dataset(self.path, "a")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        return _create(self.path, mesh, measured, self.title)

    def close(self) -> None:
        """Close the file."""
        if self._dataset is not None:
            dataset, self._dataset = self._dataset, None
            try:
                with NETCDF_LOCK:
                    dataset.close()
            except (OSError, RuntimeError) as error:
                raise OutputError(f"{self.path}: cannot be closed ({error})") from error


def _limit_caches(dataset: Any) -> None:
    """Let each field of cells keep two chunks in memory, because chunks are not read again; the default is many.

    Masks, which no variable here has, are not looked for.
    """
    dataset.set_auto_maskandscale(False)
    for variable in dataset.variables.values():
        if {"time", "cell"} <= set(variable.dimensions):
            variable.set_var_chunk_cache(size=2 * 8 * prod(variable.chunking()))


def _create(path: Path, mesh: BodyMesh, measured: Values, title: str) -> Any:
    """Return a new dataset with every dimension, coordinate and variable, and the rest volumes."""
    d, e = mesh.dimension, len(mesh.cell_array.types)
    steps = [name for name in STEPS if name in measured]
    sizes = {"time": None, "cell": e, "axis": 3, "quantile": len(QUANTILES), **({"step": None} if steps else {})}
    time = {**make_attributes("time", d), "standard_name": "time", "axis": "T"}
    variables = {
        "time": NetcdfVariable(("time",), time, chunks=(CHUNK_FRAMES,)),
        "quantile": NetcdfVariable(("quantile",), make_attributes("quantile", d), QUANTILES),
        "axis": NetcdfVariable(("axis",), make_attributes("axis", d), np.array(AXES, dtype=object), dtype=str),
        "rest_volume": NetcdfVariable(("cell",), make_attributes("rest_volume", d), mesh.rest_volumes),
    }
    for name, variable in VARIABLES.items():
        if name in measured:
            frames = max(_CELLS_CHUNK // e, 1) if "cell" in variable.dims else CHUNK_FRAMES
            chunks = (min(frames, CHUNK_FRAMES), *(sizes[dim] or 1 for dim in variable.dims))
            variables[name] = NetcdfVariable(("time", *variable.dims), make_attributes(name, d), chunks=chunks)
    for name in ["step", *steps] if steps else ():
        dtype = "i8" if name == "step" else "f8"
        variables[name] = NetcdfVariable(("step",), make_attributes(name, d), chunks=(CHUNK_FRAMES,), dtype=dtype)
    return create_dataset(path, title=title, sizes=sizes, variables=variables)
