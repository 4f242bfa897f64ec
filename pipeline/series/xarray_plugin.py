"""xarray's engine for series: `xarray.open_dataset("series.pvd")`, a frame read when its numbers are asked for.

The class is made when it is first asked for (`SeriesBackend`): its base is xarray's, and `import pipeline` does not
cost xarray. Making it also gives every dataset the accessor `deformation`.
"""

import json
from collections import OrderedDict
from collections.abc import Callable
from functools import cache
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.run.measures import AXES, STEPS, VARIABLES, attributes, spatial
from pipeline.series.frame_files import Grid
from pipeline.series.series import Series, read_series

if TYPE_CHECKING:
    import xarray

_SUFFIXES = (".pvd", ".vtu", ".pvtu", ".vtk", ".vtkhdf", ".xdmf", ".series")
ATTRIBUTES = "dataset_attributes"  # field data of a first frame: what a dataset said beyond its numbers, as JSON
_KEPT_BYTES = 1 << 25  # 32 MB: 1000 frames of a few hundred cells, two of a million
STATIC = ("rest_position", "connectivity")
_KNOWN = {
    "rest_position": ("m", "position at rest"),
    "displacement": ("m", "position now, less that at rest"),
    "velocity": ("m s-1", "velocity"),
    "volume": ("m3", "signed volume"),
    "connectivity": ("1", "nodes of the cell, counted from 0"),
}


def __getattr__(name: str) -> Any:
    if name == "SeriesBackend":
        return _backend()
    raise AttributeError(name)


@cache
def _backend() -> type:
    """Return the engine, and register the accessor."""
    import xarray
    from xarray.backends import BackendEntrypoint

    from pipeline.series.accessor import DeformationAccessor

    class SeriesBackend(BackendEntrypoint):
        """Opens deformable bodies that move: .pvd, .vtu.series, numbered files, temporal .vtkhdf, .xdmf."""

        description = "Time series of deformable bodies in ParaView's files"
        url = "docs/analysis.md"
        open_dataset_parameters = ("filename_or_obj", "drop_variables", "displacement", "rest", "strict")

        def guess_can_open(self, filename_or_obj: Any) -> bool:
            return isinstance(filename_or_obj, str | Path) and Path(filename_or_obj).suffix in _SUFFIXES

        def open_dataset(
            self, filename_or_obj: Any, *, drop_variables: Any = None, displacement: str | None = None,
            rest: str | Path | None = None, strict: bool = False,
        ) -> "xarray.Dataset":  # fmt: skip
            series = read_series(filename_or_obj, displacement=displacement, rest=rest, strict=strict)
            dropped = [drop_variables] if isinstance(drop_variables, str) else list(drop_variables or ())
            return make_lazy_dataset(series).drop_vars(dropped, errors="ignore")

    register: Any = xarray.register_dataset_accessor  # without types
    register("deformation")(DeformationAccessor)
    return SeriesBackend


class FrameStore:
    """The frames of a series, the last ones kept: several fields of one frame cost one reading.

    Kept are the last two, and as many more as `_KEPT_BYTES` hold: fields are asked for one after the other, each in
    all frames.
    """

    def __init__(self, series: Series) -> None:
        self.series = series
        self._kept: OrderedDict[int, Grid] = OrderedDict()
        self._bytes = 0
        self._lock = Lock()

    def read_grid(self, index: int) -> Grid:
        """Return what the files say of a frame, which must have the cells of the first."""
        with self._lock:  # VTK reads one at a time; dask asks from several threads
            if index in self._kept:
                self._kept.move_to_end(index)
                return self._kept[index]
            grid = self.series.read_grid(index)
            self.series.layout.check_cells(grid, str(self.series.files[index]))
            self._kept[index] = grid = grid.sharing(self.series.layout.grid)
            self._bytes += grid.nbytes
            while len(self._kept) > 2 and self._bytes > _KEPT_BYTES:
                self._bytes -= self._kept.popitem(last=False)[1].nbytes
            return grid

    def values(self, kind: str, name: str, index: int) -> NDArray[Any]:
        """Return a field of a frame, of the nodes and cells that are measured."""
        grid, layout = self.read_grid(index), self.series.layout
        if name == "displacement":
            # ours says it exactly; a difference of positions has been rounded twice
            if "displacement" in grid.point_data and "rest_position" in grid.point_data:
                told = np.asarray(grid.point_data["displacement"], dtype=np.float64)
                return told if layout.nodes is None else told[layout.nodes]
            return spatial(self.series.read_frame(index, grid).x - layout.mesh.points)
        data = getattr(grid, f"{kind}_data")
        if name not in data:
            raise SeriesError(
                f"{self.series.files[index]}: no {kind} field {shorten(name)}; it has {join_names(sorted(data))}"
            )
        value: NDArray[Any] = data[name]
        if kind == "point":
            return value if layout.nodes is None else value[layout.nodes]
        if kind == "cell":
            return value if layout.chosen is None else value[layout.chosen]
        return value.reshape(-1)[0] if value.size == 1 and name not in STEPS else value.reshape(-1)

    def __getstate__(self) -> Series:  # a lock does not travel to another process
        return self.series

    def __setstate__(self, series: Series) -> None:
        FrameStore.__init__(self, series)


def _described(name: str, dimension: int) -> dict[str, str]:
    """Return the CF attributes of a field; of a foreign one the unit is not known."""
    if name in VARIABLES or name in STEPS:
        return attributes(name, dimension)
    if name in _KNOWN:
        unit, text = _KNOWN[name]
        return {"units": "m2" if (unit, dimension) == ("m3", 2) else unit, "long_name": text}
    return {"long_name": name}


def make_lazy_dataset(series: Series) -> "xarray.Dataset":
    """Return the dataset of a series: what does not change read, fields read when asked for.

    displacement (time, node, axis), every other point field (time, node[, axis]), cell field (time, cell) and
    number of a frame (time), by their names in the first frame; rest_position, connectivity.
    """
    import xarray

    store, mesh, d = FrameStore(series), series.mesh, series.mesh.dimension
    first = store.read_grid(0)
    names = {"displacement": "point"} | {
        name: kind
        for kind in ("point", "cell", "field")
        for name, value in getattr(first, f"{kind}_data").items()
        if value.dtype.kind in "fiu" and name not in (*STATIC, "TimeValue") and name != series.layout.displacement
    }
    static = {
        "rest_position": (("node", "axis"), spatial(mesh.points)),
        "connectivity": (("cell", "corner"), mesh.cells),
    }
    variables: dict[str, Any] = {name: (*given, _described(name, d)) for name, given in static.items()}
    for name, kind in names.items():
        variables[name] = _variable(store, kind, name, d)
    time = {**attributes("time", d), "standard_name": "time", "axis": "T"}
    out = xarray.Dataset(
        variables,
        {"time": ("time", np.array(series.times), time), "axis": ("axis", list(AXES), attributes("axis", d))},
        {"Conventions": "CF-1.11", "title": series.name},
    )
    if series.notes:
        out.attrs["comment"] = "; ".join(series.notes)
    return _as_it_was(out, first)


def _as_it_was(dataset: "xarray.Dataset", first: Grid) -> "xarray.Dataset":
    """Return the dataset with the attributes that it was written with, where it was a dataset before."""
    if ATTRIBUTES in first.field_data:
        said = json.loads(str(first.field_data[ATTRIBUTES].ravel()[0]))
        dataset.attrs = said.pop("")
        for name, given in said.items():
            if name in dataset.variables:
                dataset[name].attrs = given
    return dataset


def _variable(store: FrameStore, kind: str, name: str, dimension: int) -> "xarray.Variable":
    """Return a variable whose frames are read when they are asked for."""
    import xarray
    from xarray.core import indexing

    frames = _frames(store, kind, name)
    whole = {"point": ("node",), "cell": ("cell",), "field": ()}[kind]
    axis = "step_of_frame" if name in STEPS else "axis" if frames.shape[-1] == 3 else f"{name}_component"
    dims = ("time", *whole, *([axis] if len(frames.shape) > 1 + len(whole) else []))
    chunks = dict(zip(dims, (1, *frames.shape[1:]), strict=True))
    lazy = indexing.LazilyIndexedArray(frames)
    return xarray.Variable(dims, lazy, _described(name, dimension), {"preferred_chunks": chunks})


def _frames(store: FrameStore, kind: str, name: str) -> Any:
    """Return one field of all frames (time, ...) as xarray's backends have their arrays."""
    from xarray.backends import BackendArray
    from xarray.core import indexing

    sample = np.asarray(store.values(kind, name, 0))

    class Frames(BackendArray):
        shape = (len(store.series), *sample.shape)
        dtype = sample.dtype

        def __reduce__(self) -> Any:  # dask sends it to other processes
            return _frames, (store, kind, name)

        def __getitem__(self, key: Any) -> Any:
            return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

        def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
            frames, part = np.arange(self.shape[0])[key[0]], _part(key[1:], sample.shape)
            if frames.ndim == 0:
                return np.array(part(self._one(int(frames))))
            out = np.empty((len(frames), *part(sample).shape), dtype=sample.dtype)
            for row, index in enumerate(frames.tolist()):
                out[row] = part(self._one(index))
            return out

        def _one(self, index: int) -> NDArray[Any]:
            value = np.asarray(store.values(kind, name, index))
            if value.shape != sample.shape:
                raise SeriesError(f"{store.series.files[index]}: {name} is {value.shape}, first it was {sample.shape}")
            return value

    return Frames()


def _part(key: tuple[Any, ...], shape: tuple[int, ...]) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Return what takes the part of a frame that a key names, each axis by itself (xarray's outer indexing)."""
    if all(isinstance(k, slice | int | np.integer) for k in key):
        return lambda frame: np.asarray(frame[key])
    single = tuple(i for i, k in enumerate(key) if isinstance(k, int | np.integer))
    each = np.ix_(*([k] if i in single else np.arange(n)[k] for i, (n, k) in enumerate(zip(shape, key, strict=True))))
    return lambda frame: np.asarray(frame[each].squeeze(axis=single))
