"""The frames of a series behind a dataset: read when values are needed, with a cache, and the fields of each."""

from collections import OrderedDict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MeshChangedError
from pipeline.formats.grid import Grid, have_same_cells
from pipeline.run.measures import STEPS, pad_to_space
from pipeline.series.body.arrangement import Arrangement
from pipeline.series.dataset.field_table import FieldForm, fit_value
from pipeline.series.series import Series


class FieldColumn(NamedTuple):
    """A field of all frames: its name, dimensions after time, sizes of these, type and attributes in the dataset.

    The form is that in the files, None for `displacement`: position minus rest position; `exact` says that the files
    hold it.
    """

    name: str
    form: FieldForm | None
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    attributes: dict[str, str]
    exact: bool = False


class FrameStore:
    """The frames of a series, with a cache, so that several fields of one frame cost one read.

    The last two are cached, and as many more as fit into `capacity` bytes: xarray reads one field in all frames, then
    the next. `lock` is held while a file is read: VTK reads one at a time, and dask asks from several threads.
    """

    def __init__(self, series: Series, lock: Any, first: Grid | None = None, *, capacity: int = 1 << 25) -> None:
        self.series, self.capacity = series, capacity
        self._lock = lock
        self._cache: OrderedDict[int, Grid] = OrderedDict()
        self._arrangements: dict[int, Arrangement | None] = {}
        self._bytes = 0
        self._cells: Grid | None = None
        if first is not None:
            self._keep(0, first)

    def read_grid(self, index: int) -> Grid:
        """Return the content of a frame's file; raises SeriesError if it cannot be read."""
        with self._lock:
            if index in self._cache:
                self._cache.move_to_end(index)
                return self._cache[index]
            return self._keep(index, self.series.read_grid(index))

    def _keep(self, index: int, grid: Grid) -> Grid:
        """Return the grid, with the cells of the others if they are the same, and cache it."""
        if self._cells is None:
            self._cells = grid
        elif have_same_cells(grid, self._cells):
            grid = grid.share_cells(self._cells)
        self._cache[index] = grid
        self._bytes += grid.nbytes
        while len(self._cache) > 2 and self._bytes > self.capacity:
            oldest, content = self._cache.popitem(last=False)
            self._bytes -= content.nbytes
            self._arrangements.pop(oldest, None)
        return grid

    def read_field(self, column: FieldColumn, index: int) -> NDArray[Any]:
        """Return a field of a frame at the nodes or cells of the mesh, in the type of the table; NaN if it has none.

        Raises SeriesError if the values do not fit the table.
        """
        grid, where = self.read_grid(index), str(self.series.files[index])
        if column.form is None:
            return self._read_displacement(column, index, grid)
        kind, source = column.form.kind, column.form.source
        data = getattr(grid, f"{kind}_data")
        value: NDArray[Any] | None = data.get(source)
        if kind != "field":
            value = None if value is None else self._arrange(value, kind, index, grid)
        elif value is not None:
            value = value.reshape(-1)
            value = value[:1].reshape(()) if value.size == 1 and source not in STEPS else value
        return fit_value(value, column.form, column.shape, where)

    def find_arrangement(self, index: int, grid: Grid) -> Arrangement | None:
        """Return where a frame has the nodes and cells of the mesh; None if it has others. Cached with the frame."""
        with self._lock:
            if index in self._arrangements:
                return self._arrangements[index]
        try:
            found = self.series.layout.arrange(grid, str(self.series.files[index]))
        except MeshChangedError:
            found = None
        with self._lock:
            if index in self._cache:
                self._arrangements[index] = found
        return found

    def _arrange(self, value: NDArray[Any], kind: str, index: int, grid: Grid) -> NDArray[Any] | None:
        """Return values in the order of the mesh; None if the frame has other cells."""
        if (arrangement := self.find_arrangement(index, grid)) is None:
            return None
        return arrangement.select_nodes(value) if kind == "point" else arrangement.select_cells(value)

    def _read_displacement(self, column: FieldColumn, index: int, grid: Grid) -> NDArray[Any]:
        arrangement = self.find_arrangement(index, grid)
        if column.exact and "displacement" in grid.point_data and arrangement is not None:
            # our files hold it exactly; a difference of positions is rounded twice
            return arrangement.select_nodes(np.asarray(grid.point_data["displacement"], dtype=np.float64))
        return pad_to_space(self.series.read_frame(index, grid).x - self.series.mesh.points)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the cached frames: dask sends it to other processes."""
        return self.__dict__ | {"_cache": OrderedDict(), "_arrangements": {}, "_bytes": 0, "_cells": None}
