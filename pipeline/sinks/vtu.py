"""ParaView files: a .vtu a frame, inline base64 with zlib, and a .pvd index with the true times.

Points are where the body is NOW; `displacement` and `rest_position` lead back. Appended data is never written: the
ParaView of several distributions cannot read it.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from pipeline.errors import OutputError
from pipeline.frame import Frame, Values
from pipeline.measures import VARIABLES, spatial
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.sinks.atomic import write_whole

_VTK_TYPES = {2: 5, 3: 10}
_INDEX_SECONDS = 1.0  # the index grows with the run; written every frame it would cost the square of it


class VtuSink:
    """Writes frames/frame_000000.vtu … and series.pvd into a folder, after frames of `earlier` times [s] there."""

    def __init__(self, folder: Path, *, earlier: Sequence[float] = ()) -> None:
        self.folder = Path(folder)
        self.index = self.folder / "series.pvd"
        self._listed = [(t, _file(index)) for index, t in enumerate(earlier)]
        self._indexed = -np.inf
        self._mesh: Mesh | None = None

    def write(self, frame: Frame, measured: Values) -> None:
        """Write one frame whole; the index follows within a second."""
        name = _file(frame.index)
        write_whole(self.folder / name, self._encoded(frame, measured))
        self._listed.append((frame.time, name))
        if time.monotonic() - self._indexed >= _INDEX_SECONDS:
            self._write_index()

    def close(self) -> None:
        """Write the index of all frames."""
        if self._listed:
            self._write_index()

    def _write_index(self) -> None:
        write_whole(self.index, pvd_text(self._listed))
        self._indexed = time.monotonic()

    def _encoded(self, frame: Frame, measured: Values) -> str:
        """Return the text of the frame's .vtu."""
        from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

        if self._mesh is not frame.mesh:
            self._mesh, self._grid = frame.mesh, _rest_grid(frame.mesh)
        _fill(self._grid, frame, measured)
        writer = vtkXMLUnstructuredGridWriter()
        writer.SetInputData(self._grid)
        writer.SetDataModeToBinary()
        writer.SetCompressorTypeToZLib()
        writer.SetCompressionLevel(1)
        writer.SetWriteToOutputString(True)
        if not writer.Write():
            raise OutputError(f"{self.folder}: VTK could not encode frame {frame.index}")
        return str(writer.GetOutputString())


def _file(index: int) -> str:
    return f"frames/frame_{index:06d}.vtu"


def pvd_text(listed: list[tuple[float, str]]) -> str:
    """Return a ParaView index of (time [s], file) pairs."""
    rows = [f"    <DataSet timestep={quoteattr(repr(t))} file={quoteattr(name)}/>" for t, name in listed]
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">'
    return "\n".join([head, "  <Collection>", *rows, "  </Collection>", "</VTKFile>", ""])


def _rest_grid(mesh: Mesh) -> Any:
    """Return an unstructured grid of the mesh's cells, its points to be filled."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid

    e, corners = mesh.cells.shape
    cells = vtkCellArray()
    offsets = np.arange(0, corners * e + 1, corners, dtype=np.int64)
    cells.SetData(numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(mesh.cells.ravel(), deep=True))
    points = vtkPoints()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(spatial(mesh.points), deep=True))
    grid = vtkUnstructuredGrid()
    grid.SetPoints(points)
    grid.SetCells(_VTK_TYPES[mesh.dimension], cells)
    return grid


def _fill(grid: Any, frame: Frame, measured: Values) -> None:
    """Give the grid the positions and fields of a frame."""
    from vtkmodules.util.numpy_support import numpy_to_vtk

    mesh = frame.mesh
    grid.GetPoints().SetData(numpy_to_vtk(spatial(frame.x), deep=True))
    nodal = {"displacement": frame.x - mesh.points, "rest_position": mesh.points}
    if frame.v is not None:
        nodal["velocity"] = frame.v
    cellular = {"volume": signed_volumes(frame.x, mesh.cells)}
    numbers = {"TimeValue": np.asarray([frame.time])}
    if frame.step is not None:
        numbers["step"] = np.asarray([frame.step], dtype=np.int64)
    for name, value in measured.items():
        (cellular if VARIABLES[name].dims == ("cell",) else numbers)[name] = np.atleast_1d(value)
    for data, arrays in (
        (grid.GetPointData(), {name: spatial(value) for name, value in nodal.items()}),
        (grid.GetCellData(), cellular),
        (grid.GetFieldData(), numbers),
    ):
        for name, value in arrays.items():
            # a vector of the whole body is one tuple of its components
            one = numpy_to_vtk(np.atleast_2d(value) if data is grid.GetFieldData() else value, deep=True)
            one.SetName(name)
            data.AddArray(one)
