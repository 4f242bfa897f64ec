"""One frame of a dataset as a PyVista grid with deformed points, for cells of any kind."""

from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.formats.grid import CellArray
from pipeline.series.dataset.mesh_variables import MESH_VARIABLES, read_mesh

if TYPE_CHECKING:
    import xarray


def make_pyvista_grid(frame: "xarray.Dataset") -> Any:
    """Return one frame as an unstructured grid with DEFORMED points, as in our own files, and all fields.

    Cells with a node whose position is not known are left out.
    """
    mesh, rest = read_mesh(frame), frame["rest_position"].values
    points = rest + frame["displacement"].values
    grid = build_grid(points, mesh.cell_array)
    grid.point_data["rest_position"] = rest
    for name, variable in frame.data_vars.items():
        if name in MESH_VARIABLES:
            continue
        whole = variable.dims[:1]
        data = grid.point_data if whole == ("node",) else grid.cell_data if whole == ("cell",) else grid.field_data
        values = variable.values
        data[str(name)] = values if data is not grid.field_data else np.atleast_2d(values)
    if "time" in frame.coords:
        grid.field_data["TimeValue"] = [float(frame["time"])]
    missing = ~np.isfinite(points).all(axis=1)
    if missing.any():
        lost = np.logical_or.reduceat(missing[mesh.cell_array.connectivity], mesh.cell_array.offsets[:-1])
        grid = grid.extract_cells(np.flatnonzero(~lost), pass_cell_ids=False, pass_point_ids=False)
    return grid


def build_grid(points: Floats, cells: CellArray) -> Any:
    """Return an unstructured grid of points (n, 3) and cells of any kind."""
    import pyvista
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    def make_rows(offsets: Any, connectivity: Any) -> Any:
        rows = vtkCellArray()
        rows.SetData(*(numpy_to_vtk(np.asarray(a, dtype=np.int64), deep=True) for a in (offsets, connectivity)))
        return rows

    grid = pyvista.UnstructuredGrid()
    grid.points = np.ascontiguousarray(points)
    types, rows = numpy_to_vtk(cells.types, deep=True), make_rows(cells.offsets, cells.connectivity)
    if cells.faces is None:
        grid.SetCells(types, rows)
    else:
        faces = make_rows(cells.faces.offsets, cells.faces.connectivity)
        owned = make_rows(cells.faces.cell_offsets, np.arange(len(cells.faces.offsets) - 1))
        grid.SetPolyhedralCells(types, rows, owned, faces)
    return grid
