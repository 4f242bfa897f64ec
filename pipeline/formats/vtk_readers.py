"""VTK's readers: .vtu, .pvtu, .vtp, .vtk (legacy) and temporal .vtkhdf as plain arrays.

VTK's errors become a SeriesError; nothing is printed.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import SeriesError, shorten
from pipeline.formats.cell_types import find_cell_fault
from pipeline.formats.grid import Grid


def read_vtk(file: Path, step: int) -> Grid:
    """Return one instant of a file; raises SeriesError if it cannot be read or is not an unstructured grid."""
    reader, errors = _make_reader(file)
    if file.suffix == ".vtkhdf":
        reader.SetStep(step)
    with _collect_output(errors) if file.suffix == ".vtk" else contextlib.nullcontext():
        reader.Update()
    _check_errors(file, errors, reader.GetErrorCode())
    return make_grid(reader.GetOutputDataObject(0), file)


def read_vtk_times(file: Path) -> list[float] | None:
    """Return the times [s] stored in a file, None if there are none; raises SeriesError."""
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

    reader, errors = _make_reader(file)
    reader.UpdateInformation()
    _check_errors(file, errors, reader.GetErrorCode())
    information, key = reader.GetOutputInformation(0), Pipeline.TIME_STEPS()
    return [float(time) for time in information.Get(key)] if information.Has(key) else None


def read_legacy_times(file: Path) -> list[float] | None:
    """Return the time [s] of a legacy file, known only after all of it has been read; None if there is none."""
    value = read_vtk(file, 0).field_data.get("TimeValue") if b"TimeValue" in file.read_bytes() else None
    return None if value is None else [float(value.ravel()[0])]


def _make_reader(file: Path) -> tuple[Any, list[str]]:
    """Return a VTK reader of the file and the list to which it appends its errors."""
    from vtkmodules import vtkIOHDF, vtkIOLegacy, vtkIOXML

    kinds: dict[str, Any] = {
        ".vtu": vtkIOXML.vtkXMLUnstructuredGridReader,
        ".pvtu": vtkIOXML.vtkXMLPUnstructuredGridReader,
        ".vtp": vtkIOXML.vtkXMLPolyDataReader,
        ".vtk": vtkIOLegacy.vtkDataSetReader,
        ".vtkhdf": vtkIOHDF.vtkHDFReader,
    }
    reader, errors = kinds[file.suffix](), list[str]()

    def append_error(_reader: object, _event: str, text: str) -> None:
        errors.append(" ".join(text.split()))

    append_error.CallDataType = "string0"  # type: ignore[attr-defined]  # makes VTK pass the text
    reader.AddObserver("ErrorEvent", append_error)
    reader.SetFileName(str(file))
    if file.suffix == ".vtk":
        # by default VTK reads only the first field of each kind
        for kind in ("Scalars", "Vectors", "Tensors", "Fields", "Normals"):
            getattr(reader, f"ReadAll{kind}On")()
    return reader, errors


@contextlib.contextmanager
def _collect_output(errors: list[str]) -> Iterator[None]:
    """Append VTK's general output to the errors: the only sign that legacy data end too early."""
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    before, window = vtkOutputWindow.GetInstance(), vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(window)
    try:
        yield
    finally:
        vtkOutputWindow.SetInstance(before)
        errors += [" ".join(line.split()) for line in window.GetOutput().splitlines() if line.strip()]


def _check_errors(file: Path, errors: list[str], code: int) -> None:
    if errors or code:
        reason = errors[0].rsplit("): ", 1)[-1] if errors else f"VTK's error {code}"
        raise SeriesError(f"{file}: cannot be read ({shorten(reason, 200)})")


def make_grid(data: Any, file: Path) -> Grid:
    """Return the arrays of a VTK dataset without ghost cells; raises SeriesError unless it is an unstructured grid."""
    import pyvista
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if data is None:
        raise SeriesError(f"{file}: cannot be read (VTK finds no data in it)")
    grid = pyvista.wrap(data)
    if isinstance(grid, pyvista.PartitionedDataSet) and len(grid) == 1:
        grid = grid[0]
    if isinstance(grid, pyvista.PolyData):
        grid = grid.cast_to_unstructured_grid()
    if not isinstance(grid, pyvista.UnstructuredGrid):
        raise SeriesError(f"{file}: contains a {type(grid).__name__}, not an unstructured grid")
    if "vtkGhostType" in grid.cell_data:  # pieces of a .pvtu overlap there
        grid = grid.extract_cells(np.asarray(grid.cell_data["vtkGhostType"]) == 0)
    points = np.asarray(grid.points, dtype=np.float64)
    if not grid.n_cells or grid.GetCells() is None:
        raise SeriesError(f"{file}: has no cells")
    connectivity = np.asarray(grid.cell_connectivity, dtype=np.int64)
    offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray()).astype(np.int64)
    types = np.asarray(grid.celltypes)
    if (fault := find_cell_fault(types, offsets, len(connectivity))) is not None:
        raise SeriesError(f"{file}: {fault}")
    if connectivity.min() < 0 or connectivity.max() >= len(points):
        wrong = connectivity.min() if connectivity.min() < 0 else connectivity.max()
        raise SeriesError(f"{file}: a cell refers to point {wrong} of {len(points)} (counted from 0)")
    nodal, cellular, numbers = (
        {name: np.asarray(data[name]) for name in data.keys()}  # noqa: SIM118  (pyvista's fields iterate over values)
        for data in (grid.point_data, grid.cell_data, grid.field_data)
    )
    return Grid(points, len(points), types, offsets, connectivity, nodal, cellular, numbers)
