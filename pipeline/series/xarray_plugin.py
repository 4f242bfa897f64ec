"""xarray's engine for series: `xarray.open_dataset("series.pvd")`; a frame is read when its values are needed.

xarray loads this module through its entry point, and with it the accessor `deformation`; `import pipeline` does not
load it.
"""

import json
from collections.abc import Iterable
from contextlib import suppress
from functools import wraps
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray, BackendEntrypoint, H5netcdfBackendEntrypoint, NetCDF4BackendEntrypoint
from xarray.backends.locks import SerializableLock
from xarray.core import indexing

from pipeline.formats.grid import Grid
from pipeline.formats.pvd import INDEX_SUFFIXES
from pipeline.formats.readers import SUFFIXES, TEMPORAL_SUFFIXES
from pipeline.run.measures import AXES, QUANTILES, make_attributes
from pipeline.series.accessor import DeformationAccessor
from pipeline.series.dataset.attributes import ATTRIBUTES
from pipeline.series.dataset.field_columns import list_columns
from pipeline.series.dataset.frame_store import FieldColumn, FrameStore
from pipeline.series.dataset.mesh_variables import RESERVED, describe_mesh
from pipeline.series.series import Series, open_series

_SUFFIXES = (*INDEX_SUFFIXES, *TEMPORAL_SUFFIXES, *SUFFIXES)
_HEAD_BYTES = 1 << 16  # of an HDF5 file: the names of its first groups
_NO_FILL = {"_FillValue": None}  # CF allows none on a coordinate; xarray writes one on every float
_CACHE_BYTES = 1 << 25  # 32 MB: 1000 frames of a few hundred cells, or two of a million


class SeriesBackend(BackendEntrypoint):
    """Opens series of deforming bodies: .pvd, .vtu.series, numbered files, temporal .vtkhdf, .xdmf."""

    description = "Time series of deformable bodies in ParaView's files"
    url = "docs/analysis.md"
    open_dataset_parameters = ("filename_or_obj", "drop_variables", "displacement", "rest", "strict", "scan_all")

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Return whether the path has the suffix of a series."""
        return isinstance(filename_or_obj, str | PathLike) and Path(filename_or_obj).suffix.lower() in _SUFFIXES

    def open_dataset(
        self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None,
        displacement: str | None = None, rest: str | PathLike[str] | None = None, strict: bool = False,
        scan_all: bool = False,
    ) -> xarray.Dataset:  # fmt: skip
        """Return the dataset of a series; the options are those of read_series and make_lazy_dataset."""
        series, first = open_series(fspath(filename_or_obj), displacement=displacement, rest=rest, strict=strict)
        dropped = [drop_variables] if isinstance(drop_variables, str) else list(drop_variables or ())
        return make_lazy_dataset(series, first, scan_all=scan_all).drop_vars(dropped, errors="ignore")


class FrameArray(BackendArray):
    """One field of all frames (time, ...)."""

    def __init__(self, store: FrameStore, column: FieldColumn) -> None:
        self._store, self._column = store, column
        self.shape = (len(store.series), *column.shape)
        self.dtype = column.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        """Return the values at a key that indexes each axis by itself (xarray's outer indexing)."""
        frames, (part, squeezed) = np.arange(self.shape[0])[key[0]], _to_numpy_index(key[1:], self.shape[1:])
        if frames.ndim == 0:
            return np.array(self._store.read_field(self._column, int(frames))[part].squeeze(axis=squeezed))
        shape = np.empty(self.shape[1:], dtype=np.bool_)[part].squeeze(axis=squeezed).shape
        out = np.empty((len(frames), *shape), dtype=self.dtype)
        for row, index in enumerate(frames.tolist()):
            out[row] = self._store.read_field(self._column, index)[part].squeeze(axis=squeezed)
        return out


def _to_numpy_index(key: tuple[Any, ...], shape: tuple[int, ...]) -> tuple[tuple[Any, ...], tuple[int, ...]]:
    """Return numpy's index for an outer key, and the axes to squeeze afterwards."""
    if all(isinstance(k, slice | int | np.integer) for k in key):
        return key, ()
    single = tuple(i for i, k in enumerate(key) if isinstance(k, int | np.integer))
    lists = ([k] if i in single else np.arange(n)[k] for i, (n, k) in enumerate(zip(shape, key, strict=True)))
    return np.ix_(*lists), single


def make_lazy_dataset(series: Series, first: Grid | None = None, *, scan_all: bool = False) -> xarray.Dataset:
    """Return the dataset of a series whose fields are read when needed; `first` is frame 0 if it has been read already.

    It has displacement (time, node, axis), the mesh (see mesh_variables), and every other point field (time, node[,
    axis]), cell field (time, cell) and number per frame (time). Their names, types and shapes are those of all frames,
    or of some if there are many, unless `scan_all`; a note names these. Raises SeriesError.
    """
    store, d = FrameStore(series, SerializableLock(), first, capacity=_CACHE_BYTES), series.mesh.dimension
    grid, described = store.read_grid(0), describe_mesh(series.mesh)
    sizes = {dim for dims, *_ in described.variables.values() for dim in dims}
    taken = {*RESERVED, *described.variables, *described.coordinates, *sizes}
    columns, notes = list_columns(store, taken, scan_all=scan_all)
    variables: dict[str, Any] = dict(described.variables)
    for column in columns:
        variables[column.name] = _make_variable(store, column)
    time = {**make_attributes("time", d), "standard_name": "time", "axis": "T"}
    coordinates: dict[str, Any] = {
        "time": ("time", np.array(series.times), time, _NO_FILL),
        "axis": ("axis", list(AXES), make_attributes("axis", d)),
        **described.coordinates,
    }
    if any("quantile" in column.dims for column in columns):
        coordinates["quantile"] = ("quantile", np.array(QUANTILES), make_attributes("quantile", d), _NO_FILL)
    out = xarray.Dataset(variables, coordinates, {"Conventions": "CF-1.11 UGRID-1.0", "title": series.name})
    out.attrs |= _describe_decisions(series)
    if notes := (*series.notes, *notes):
        out.attrs["comment"] = "; ".join(notes)
    return _restore_attributes(out, grid)


def _describe_decisions(series: Series) -> dict[str, str]:
    """Return the decisions about the files as attributes of the dataset."""
    decisions = series.describe_decisions()
    texts = {
        "points": decisions.points, "rest_state": decisions.rest, "cells": decisions.cells,
        "left_out": decisions.left_out, "times": decisions.times,
    }  # fmt: skip
    return {name: text for name, text in texts.items() if text}


def _restore_attributes(dataset: xarray.Dataset, first: Grid) -> xarray.Dataset:
    """Return the dataset with the attributes that write_pvd_series recorded in the first frame, if it did."""
    if ATTRIBUTES in first.field_data:
        recorded = json.loads(str(first.field_data[ATTRIBUTES].ravel()[0]))
        dataset.attrs = recorded.pop("")
        for name, attrs in recorded.items():
            if name in dataset.variables:
                dataset[name].attrs = attrs
    return dataset


def _make_variable(store: FrameStore, column: FieldColumn) -> xarray.Variable:
    """Return a variable whose frames are read when needed."""
    dims = ("time", *column.dims)
    chunks = dict(zip(dims, (1, *column.shape), strict=True))
    lazy = indexing.LazilyIndexedArray(FrameArray(store, column))
    return xarray.Variable(dims, lazy, column.attributes, {"preferred_chunks": chunks})


def _decline_series(backend: type[BackendEntrypoint]) -> None:
    """Make a backend of xarray's own decline HDF5 files that are series: .vtkhdf, .cgns, and .hdf from VTK.

    xarray asks them first, and they take every HDF5 file: without this, a series opens as an empty dataset unless the
    engine is named. All other files are theirs as before.
    """
    guess = backend.guess_can_open

    @wraps(guess)
    def guess_can_open(self: BackendEntrypoint, filename_or_obj: Any) -> bool:
        if isinstance(filename_or_obj, str | PathLike) and _is_hdf_series(Path(filename_or_obj)):
            return False
        return guess(self, filename_or_obj)

    backend.guess_can_open = guess_can_open  # type: ignore[method-assign]  # on purpose: see above


def _is_hdf_series(path: Path) -> bool:
    """Return whether a path is a series in HDF5; a file .hdf may be anything, and names its group VTKHDF early on."""
    if path.suffix != ".hdf":
        return path.suffix in (".vtkhdf", ".cgns")
    with suppress(OSError), path.open("rb") as stream:
        return b"VTKHDF" in stream.read(_HEAD_BYTES)
    return False


for _backend in (NetCDF4BackendEntrypoint, H5netcdfBackendEntrypoint):
    _decline_series(_backend)
xarray.register_dataset_accessor("deformation")(DeformationAccessor)  # type: ignore[no-untyped-call]  # xarray has no types here
