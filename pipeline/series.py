"""A recorded series of frames, replayed as Frames: what views and statistics read."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import MeshError, SeriesError
from pipeline.frame import Frame
from pipeline.measures import VARIABLES
from pipeline.mesh.simplex import Mesh

_VTK_TETRA, _VTK_TRIANGLE = 10, 5


@dataclass(frozen=True, eq=False)
class Series:
    """The frames of a .pvd index: a name, the files in order and their times [s]."""

    name: str
    folder: Path
    files: tuple[Path, ...]
    times: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[Frame]:
        return (self.frame(i) for i in range(len(self)))

    def frame(self, index: int) -> Frame:
        """Return one frame, read from its file now; raises SeriesError where the file is not one of this series."""
        file = self.files[index]
        grid = _read_grid(file)
        d = self.mesh.dimension
        if not np.array_equal(_cells(grid, file), self.mesh.cells):
            raise SeriesError(f"{file}: its cells are not those of {self.files[0].name}")
        known = {
            name: np.asarray(grid.field_data[name], dtype=np.float64).reshape([-1] if VARIABLES[name].dims else [])
            for name in grid.field_data.keys() & VARIABLES.keys()
        }
        step = int(grid.field_data["step"][0]) if "step" in grid.field_data else None
        v = (
            np.ascontiguousarray(grid.point_data["velocity"][:, :d], dtype=np.float64)
            if "velocity" in grid.point_data
            else None
        )
        x = np.ascontiguousarray(grid.points[:, :d], dtype=np.float64)
        return Frame(index, self.times[index], self.mesh, x, step=step, v=v, known=known)

    @cached_property
    def mesh(self) -> Mesh:
        """Return the rest mesh: the field `rest_position` of the first file, else its points."""
        file = self.files[0]
        grid = _read_grid(file)
        cells = _cells(grid, file)
        points = np.asarray(grid.point_data.get("rest_position", grid.points), dtype=np.float64)
        try:
            return Mesh(points[:, : cells.shape[1] - 1], cells, name=str(file))
        except MeshError as error:
            raise SeriesError(f"rest state: {error}") from error


def read_series(path: Path | str, name: str | None = None) -> Series:
    """Return the series of a .pvd file, or of a result folder that holds series.pvd.

    Raises SeriesError where there is none, where it is not an index or lists nothing.
    """
    path = Path(path)
    index = path / "series.pvd" if path.is_dir() else path
    try:
        entries = ET.parse(index).getroot().findall("./Collection/DataSet")
        listed = sorted((float(e.attrib["timestep"]), index.parent / e.attrib["file"]) for e in entries)
    except OSError as error:
        raise SeriesError(f"{index}: no series there ({error.strerror})") from error
    except (ET.ParseError, KeyError, ValueError) as error:
        raise SeriesError(f"{index}: not a ParaView index: {error}") from error
    if not listed:
        raise SeriesError(f"{index}: it lists no frame")
    times, files = zip(*listed, strict=True)
    return Series(name or index.parent.name, index.parent, files, times)


def _read_grid(file: Path) -> Any:
    """Return the unstructured grid of a file, as PyVista reads it."""
    import pyvista

    try:
        grid = pyvista.read(file)
    except (OSError, ValueError) as error:
        raise SeriesError(f"{file}: cannot be read ({error})") from error
    if not isinstance(grid, pyvista.UnstructuredGrid):
        raise SeriesError(f"{file}: holds a {type(grid).__name__}, not an unstructured grid")
    return grid


def _cells(grid: Any, file: Path) -> np.ndarray:
    """Return the tetrahedra, or else the triangles, of a grid (e, d + 1)."""
    cells = grid.cells_dict
    for kind in (_VTK_TETRA, _VTK_TRIANGLE):
        if kind in cells:
            return np.asarray(cells[kind], dtype=np.int64)
    raise SeriesError(f"{file}: it has no tetrahedra and no triangles")
