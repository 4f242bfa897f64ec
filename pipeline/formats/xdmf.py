"""Temporal collections of XDMF 3, as meshio reads them."""

import contextlib
import io
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError, shorten
from pipeline.formats.grid import Grid
from pipeline.formats.vtk_readers import make_grid


class _Collection(NamedTuple):
    """meshio's reader of a time series, the points and cells of all steps, and the times [s]."""

    reader: Any
    points: Floats
    cells: Any
    times: tuple[float, ...]


def read_xdmf(file: Path, step: int) -> Grid:
    """Return one step of a temporal collection; raises SeriesError."""
    import meshio
    import pyvista

    collection = _open_collection(file, file.stat().st_mtime_ns)
    try:
        _, point_data, cell_data = collection.reader.read_data(step)
    except Exception as error:  # meshio passes on whatever its parsers raise
        raise SeriesError(
            f"{file}: step {step} cannot be read ({type(error).__name__}: {shorten(str(error), 200)})"
        ) from error
    mesh = meshio.Mesh(collection.points, collection.cells, point_data, cell_data)
    return make_grid(pyvista.from_meshio(mesh), file)


def read_xdmf_times(file: Path) -> list[float] | None:
    """Return the times [s] of the steps."""
    return list(_open_collection(file, file.stat().st_mtime_ns).times)


@lru_cache(maxsize=4)
def _open_collection(file: Path, _modified: int) -> _Collection:
    import meshio

    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            reader = meshio.xdmf.TimeSeriesReader(file)
            points, cells = reader.read_points_cells()
        moving = [grid for grid in reader.collection[1:] if grid.find("Geometry") is not None]
        times = tuple(float(grid.find("Time").get("Value")) for grid in reader.collection)
    except ModuleNotFoundError as error:
        raise SeriesError(f"{file}: its arrays are in an HDF5 file; pip install {error.name}") from error
    except (Exception, SystemExit) as error:
        words = " ".join(f"{error} {printed.getvalue()}".split()) or "not a temporal collection of XDMF 3"
        raise SeriesError(f"{file}: meshio cannot read it ({type(error).__name__}: {shorten(words, 200)})") from error
    if moving:
        raise SeriesError(f"{file}: {len(moving)} steps have a geometry of their own, which meshio cannot read")
    if points.shape[1] == 2:
        points = np.pad(points, [(0, 0), (0, 1)])
    return _Collection(reader, points, cells, times)
