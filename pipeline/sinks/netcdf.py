"""statistics.nc: the numbers of every frame, appended and synced, so that a killed run keeps all its frames."""

import threading
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import OutputError
from pipeline.mesh.simplex import Mesh
from pipeline.run.frame import Frame, Values
from pipeline.run.measures import AXES, QUANTILES, STEPS, VARIABLES, attributes

_CHUNK = 256  # frames; the default of one would make a chunk, and its index entry, of every number
_CELLS_CHUNK = 2048  # numbers of cells, where a frame has fewer: the index of chunks is kept in memory
# the netCDF library serves one thread at a time and dies of two; xarray's own locks leave out the opening
ALONE = threading.RLock()


class NetcdfSink:
    """Appends frames to one netCDF file (CF-1.11, float64), a new one unless `earlier` frames are in it."""

    def __init__(self, path: Path, *, title: str, earlier: int = 0) -> None:
        self.path = Path(path)
        self.title = title
        self._dataset: Any = None
        self._count = earlier

    def write(self, frame: Frame, measured: Values) -> None:
        """Append one frame and sync it to the disk."""
        try:
            with ALONE:
                self._append(frame, measured)
        except UnicodeError as error:
            raise OutputError(
                f"{self.path}: the locale's encoding, which netCDF uses, has not all of this name's letters; "
                "set PYTHONUTF8=1, or name another folder"
            ) from error
        except (OSError, RuntimeError) as error:
            raise OutputError(f"{self.path}: cannot be written ({error})") from error
        self._count += 1

    def _append(self, frame: Frame, measured: Values) -> None:
        if self._dataset is None:
            self._dataset = self._opened(frame.mesh, measured)
            _keep_little(self._dataset)
        self._dataset["time"][self._count] = frame.time
        for name, value in measured.items():
            if name in VARIABLES:
                self._dataset[name][self._count] = value
        self._write_steps(frame.step or 0, measured)
        self._dataset.sync()

    def _write_steps(self, last: int, measured: Values) -> None:
        """Append what is known of the steps since the frame before; none has led to the first frame."""
        for name in [name for name in STEPS if name in measured] if last else ():  # in this order: the same bytes
            first = last - len(measured[name])
            self._dataset[name][first:last] = measured[name]
            self._dataset["step"][first:last] = np.arange(first, last) + 1

    def _opened(self, mesh: Mesh, measured: Values) -> Any:
        if self._count:
            import netCDF4

            return netCDF4.Dataset(self.path, "a")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        return _created(self.path, mesh, measured, self.title)

    def close(self) -> None:
        """Close the file."""
        if self._dataset is not None:
            dataset, self._dataset = self._dataset, None
            try:
                with ALONE:
                    dataset.close()
            except (OSError, RuntimeError) as error:
                raise OutputError(f"{self.path}: cannot be closed ({error})") from error


def _keep_little(dataset: Any) -> None:
    """Let each field of cells keep two chunks in memory: by default each keeps many, which are not read again.

    And do not look for masks, which nothing here has.
    """
    dataset.set_auto_maskandscale(False)
    for one in dataset.variables.values():
        if {"time", "cell"} <= set(one.dimensions):
            one.set_var_chunk_cache(size=2 * 8 * prod(one.chunking()))


def _created(path: Path, mesh: Mesh, measured: Values, title: str) -> Any:
    """Return a new dataset with every dimension, coordinate and variable, and the rest volumes."""
    import netCDF4

    out = netCDF4.Dataset(path, "w", format="NETCDF4")
    out.Conventions = "CF-1.11"
    out.title = title
    sizes = {"time": None, "cell": len(mesh.cells), "axis": 3, "quantile": len(QUANTILES)}
    stepwise = [name for name in STEPS if name in measured]
    if stepwise:
        sizes["step"] = None
    for name, size in sizes.items():
        out.createDimension(name, size)
    made = {
        "time": out.createVariable("time", "f8", ("time",), chunksizes=(_CHUNK,)),
        "quantile": out.createVariable("quantile", "f8", ("quantile",)),
        "axis": out.createVariable("axis", str, ("axis",)),
        "rest_volume": out.createVariable("rest_volume", "f8", ("cell",)),
    }
    made["quantile"][:] = QUANTILES
    made["axis"][:] = np.array(AXES, dtype=object)
    made["rest_volume"][:] = mesh.rest_volumes
    for name, variable in VARIABLES.items():
        if name not in measured:
            continue
        lengths = [sizes[dim] or 1 for dim in variable.dims]
        frames = _CELLS_CHUNK // len(mesh.cells) if "cell" in variable.dims else _CHUNK
        chunks = (min(max(frames, 1), _CHUNK), *lengths)
        made[name] = out.createVariable(name, "f8", ("time", *variable.dims), chunksizes=chunks)
    for name in ["step", *stepwise] if stepwise else ():
        made[name] = out.createVariable(name, "i8" if name == "step" else "f8", ("step",), chunksizes=(_CHUNK,))
    for name, one in made.items():
        one.setncatts(attributes(name, mesh.dimension))
    made["time"].axis = "T"
    return out
