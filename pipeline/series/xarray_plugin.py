"""xarray's engine for series: `xarray.open_dataset("series.pvd")`; a frame is read when its values are needed.

xarray loads this module through its entry point, and with it the accessor `deformation`; `import pipeline` does not
load it.
"""

import json
from collections import OrderedDict
from collections.abc import Iterable
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.backends.locks import SerializableLock
from xarray.core import indexing

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.grid import Grid
from pipeline.formats.pvd import INDEX_SUFFIXES
from pipeline.formats.readers import SUFFIXES, TEMPORAL_SUFFIXES
from pipeline.mesh.simplex import require_simplices
from pipeline.run.measures import AXES, STEPS, make_attributes, pad_to_space
from pipeline.series.accessor import DeformationAccessor
from pipeline.series.dataset_layout import ATTRIBUTES, STATIC, describe_field
from pipeline.series.series import Series, open_series

_SUFFIXES = (*INDEX_SUFFIXES, *TEMPORAL_SUFFIXES, *SUFFIXES)
_CACHE_BYTES = 1 << 25  # 32 MB: 1000 frames of a few hundred cells, or two of a million
_DIMENSIONS = {"point": ("node",), "cell": ("cell",), "field": ()}  # of each kind of field, after time


class SeriesBackend(BackendEntrypoint):
    """Opens series of deforming bodies: .pvd, .vtu.series, numbered files, temporal .vtkhdf, .xdmf."""

    description = "Time series of deformable bodies in ParaView's files"
    url = "docs/analysis.md"
    open_dataset_parameters = ("filename_or_obj", "drop_variables", "displacement", "rest", "strict")

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Return whether the path has the suffix of a series."""
        return isinstance(filename_or_obj, str | PathLike) and Path(filename_or_obj).suffix in _SUFFIXES

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None,
        displacement: str | None = None, rest: str | PathLike[str] | None = None, strict: bool = False,
    ) -> xarray.Dataset:  # fmt: skip
        """Return the dataset of a series; the options are those of read_series."""
        series, first = open_series(fspath(filename_or_obj), displacement=displacement, rest=rest, strict=strict)
        dropped = [drop_variables] if isinstance(drop_variables, str) else list(drop_variables or ())
        return make_lazy_dataset(series, first).drop_vars(dropped, errors="ignore")


class FrameStore:
    """The frames of a series, with a cache, so that several fields of one frame cost one read.

    The last two are cached, and as many more as fit into `_CACHE_BYTES`: xarray reads one field in all frames, then the
    next.
    """

    def __init__(self, series: Series, lock: SerializableLock, first: Grid | None = None) -> None:
        self.series = series
        self._lock = lock
        self._cache: OrderedDict[int, Grid] = OrderedDict()
        self._bytes = 0
        if first is not None:
            self._keep(0, first)

    def read_grid(self, index: int) -> Grid:
        """Return the content of a frame's file; raises SeriesError unless it has the cells of the first frame."""
        with self._lock:  # VTK reads one file at a time; dask reads from several threads
            if index in self._cache:
                self._cache.move_to_end(index)
                return self._cache[index]
            grid = self.series.read_grid(index)
            self.series.layout.check_cells(grid, str(self.series.files[index]))
            return self._keep(index, grid)

    def _keep(self, index: int, grid: Grid) -> Grid:
        """Return the grid with the cells of the first frame, and cache it."""
        self._cache[index] = grid = grid.share_cells(self.series.layout.grid)
        self._bytes += grid.nbytes
        while len(self._cache) > 2 and self._bytes > _CACHE_BYTES:
            self._bytes -= self._cache.popitem(last=False)[1].nbytes
        return grid

    def read_field(self, kind: str, name: str, index: int) -> NDArray[Any]:
        """Return a field of a frame at the measured nodes or cells; raises SeriesError if the frame lacks it."""
        grid, layout = self.read_grid(index), self.series.layout
        arrangement = layout.arrange(grid, str(self.series.files[index]))
        if name == "displacement":
            # our files hold it exactly; a difference of positions is rounded twice
            if "displacement" in grid.point_data and "rest_position" in grid.point_data:
                displacement = np.asarray(grid.point_data["displacement"], dtype=np.float64)
                return arrangement.select_nodes(displacement)
            return pad_to_space(self.series.read_frame(index, grid).x - layout.mesh.points)
        data = getattr(grid, f"{kind}_data")
        if name not in data:
            raise SeriesError(
                f"{self.series.files[index]}: no {kind} field {shorten(name)}; it has {join_names(sorted(data))}"
            )
        value: NDArray[Any] = data[name]
        if kind == "point":
            return arrangement.select_nodes(value)
        if kind == "cell":
            return arrangement.select_cells(value)
        return value.reshape(-1)[0] if value.size == 1 and name not in STEPS else value.reshape(-1)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the cached frames: dask sends it to other processes."""
        return self.__dict__ | {"_cache": OrderedDict(), "_bytes": 0}


class FrameArray(BackendArray):
    """One field of all frames (time, ...); `kind` is point, cell or field."""

    def __init__(self, store: FrameStore, kind: str, name: str) -> None:
        self._store, self._kind, self._name = store, kind, name
        sample = np.asarray(store.read_field(kind, name, 0))
        self.shape = (len(store.series), *sample.shape)
        self.dtype = sample.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Return the values at a key that indexes each axis by itself (xarray's outer indexing)."""
        frames, (part, squeezed) = np.arange(self.shape[0])[key[0]], _to_numpy_index(key[1:], self.shape[1:])
        if frames.ndim == 0:
            return np.array(self._read_frame(int(frames))[part].squeeze(axis=squeezed))
        shape = np.empty(self.shape[1:], dtype=np.bool_)[part].squeeze(axis=squeezed).shape
        out = np.empty((len(frames), *shape), dtype=self.dtype)
        for row, index in enumerate(frames.tolist()):
            out[row] = self._read_frame(index)[part].squeeze(axis=squeezed)
        return out

    def _read_frame(self, index: int) -> NDArray[Any]:
        value = np.asarray(self._store.read_field(self._kind, self._name, index))
        if value.shape != self.shape[1:]:
            raise SeriesError(
                f"{self._store.series.files[index]}: {self._name} has shape {value.shape}, "
                f"in the first frame {self.shape[1:]}"
            )
        return value


def _to_numpy_index(key: tuple[Any, ...], shape: tuple[int, ...]) -> tuple[tuple[Any, ...], tuple[int, ...]]:
    """Return numpy's index for an outer key, and the axes to squeeze afterwards."""
    if all(isinstance(k, slice | int | np.integer) for k in key):
        return key, ()
    single = tuple(i for i, k in enumerate(key) if isinstance(k, int | np.integer))
    lists = ([k] if i in single else np.arange(n)[k] for i, (n, k) in enumerate(zip(shape, key, strict=True)))
    return np.ix_(*lists), single


def make_lazy_dataset(series: Series, first: Grid | None = None) -> xarray.Dataset:
    """Return the dataset of a series whose fields are read when needed; `first` is frame 0 if it has been read already.

    It has displacement (time, node, axis), rest_position and connectivity, and every other point field (time, node[,
    axis]), cell field (time, cell) and number per frame (time) under its name in the first frame.
    """
    store, mesh, d = FrameStore(series, SerializableLock(), first), series.mesh, series.mesh.dimension
    grid = store.read_grid(0)
    kinds = {"displacement": "point"} | {
        name: kind
        for kind in _DIMENSIONS
        for name, value in getattr(grid, f"{kind}_data").items()
        if value.dtype.kind in "fiu" and name not in (*STATIC, "TimeValue") and name != series.layout.displacement
    }
    variables: dict[str, Any] = {
        "rest_position": (("node", "axis"), pad_to_space(mesh.points), describe_field("rest_position", d)),
        "connectivity": (("cell", "corner"), require_simplices(mesh).cells, describe_field("connectivity", d)),
    }
    for name, kind in kinds.items():
        variables[name] = _make_variable(store, kind, name, d)
    time = {**make_attributes("time", d), "standard_name": "time", "axis": "T"}
    out = xarray.Dataset(
        variables,
        {"time": ("time", np.array(series.times), time), "axis": ("axis", list(AXES), make_attributes("axis", d))},
        {"Conventions": "CF-1.11", "title": series.name},
    )
    if series.notes:
        out.attrs["comment"] = "; ".join(series.notes)
    return _restore_attributes(out, grid)


def _restore_attributes(dataset: xarray.Dataset, first: Grid) -> xarray.Dataset:
    """Return the dataset with the attributes that write_pvd_series recorded in the first frame, if it did."""
    if ATTRIBUTES in first.field_data:
        recorded = json.loads(str(first.field_data[ATTRIBUTES].ravel()[0]))
        dataset.attrs = recorded.pop("")
        for name, attrs in recorded.items():
            if name in dataset.variables:
                dataset[name].attrs = attrs
    return dataset


def _make_variable(store: FrameStore, kind: str, name: str, dimension: int) -> xarray.Variable:
    """Return a variable whose frames are read when needed."""
    frames, whole = FrameArray(store, kind, name), _DIMENSIONS[kind]
    axis = "step_of_frame" if name in STEPS else "axis" if frames.shape[-1] == 3 else f"{name}_component"
    dims = ("time", *whole, *([axis] if len(frames.shape) > 1 + len(whole) else []))
    chunks = dict(zip(dims, (1, *frames.shape[1:]), strict=True))
    lazy = indexing.LazilyIndexedArray(frames)
    return xarray.Variable(dims, lazy, describe_field(name, dimension), {"preferred_chunks": chunks})


xarray.register_dataset_accessor("deformation")(DeformationAccessor)  # type: ignore[no-untyped-call]
