"""netCDF files: one lock for the library, and one way to lay out, read and write a CF dataset."""

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pipeline.errors import SeriesError
from pipeline.formats.atomic import replace_file

if TYPE_CHECKING:
    import xarray
    from numpy.typing import ArrayLike

# the netCDF library serves one thread at a time and crashes with two; xarray's own locks do not cover opening a file
NETCDF_LOCK = threading.RLock()
CONVENTIONS = "CF-1.11"


class NetcdfVariable(NamedTuple):
    """A variable or coordinate to create: uncompressed, and float64 unless `dtype` says otherwise.

    `chunks` are the sizes of a chunk along each dimension; without them the library chooses. `values`, if given, are
    written at once. Values that are never written read as `fill_value`.
    """

    dims: tuple[str, ...]
    attributes: Mapping[str, str]
    values: "ArrayLike | None" = None
    chunks: tuple[int, ...] | None = None
    dtype: Any = "f8"
    fill_value: float | None = None


def add_variables(dataset: Any, sizes: Mapping[str, int | None], variables: Mapping[str, NetcdfVariable]) -> None:
    """Create dimensions (size None: unlimited) and variables, in that order, in a netCDF4.Dataset."""
    for name, size in sizes.items():
        dataset.createDimension(name, size)
    for name, variable in variables.items():
        dataset.createVariable(
            name, variable.dtype, variable.dims, chunksizes=variable.chunks, fill_value=variable.fill_value
        )
    for name, variable in variables.items():
        if variable.values is not None:
            dataset[name][:] = variable.values
    for name, variable in variables.items():
        dataset[name].setncatts(variable.attributes)


def create_dataset(
    path: str | os.PathLike[str],
    *,
    title: str,
    sizes: Mapping[str, int | None],
    variables: Mapping[str, NetcdfVariable],
) -> Any:
    """Return a new netCDF4.Dataset with these dimensions and variables, open for writing; the caller holds the lock."""
    import netCDF4

    dataset = netCDF4.Dataset(path, "w", format="NETCDF4")
    dataset.setncatts({"Conventions": CONVENTIONS, "title": title})
    add_variables(dataset, sizes, variables)
    return dataset


@contextmanager
def open_dataset(path: str | os.PathLike[str]) -> "Iterator[xarray.Dataset]":
    """Yield a netCDF file whose arrays are read on access; raises SeriesError if it cannot be opened.

    Other threads wait until it is closed.
    """
    import xarray

    with ExitStack() as stack:
        stack.enter_context(NETCDF_LOCK)
        try:
            dataset = stack.enter_context(xarray.open_dataset(path, engine="netcdf4"))
        except (OSError, ValueError) as error:
            raise SeriesError(f"{path}: cannot be read ({error})") from error
        yield dataset


def read_dataset(path: str | os.PathLike[str]) -> "xarray.Dataset":
    """Return the dataset of a netCDF file, in memory; raises SeriesError if it cannot be read."""
    try:
        with open_dataset(path) as dataset:
            return dataset.load()
    except (OSError, ValueError) as error:
        raise SeriesError(f"{path}: cannot be read ({error})") from error


def write_dataset(dataset: "xarray.Dataset", path: str | os.PathLike[str]) -> None:
    """Write a dataset as one whole netCDF file; raises OutputError."""
    with NETCDF_LOCK, replace_file(Path(path)) as hidden:
        # CF allows no fill value on a coordinate; xarray writes one on every float
        no_fill_values = {str(name): {"_FillValue": None} for name in dataset.coords}
        dataset.to_netcdf(hidden, engine="netcdf4", format="NETCDF4", encoding=no_fill_values)
