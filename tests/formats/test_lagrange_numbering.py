"""Lagrange hexahedra of old files: VTK 9 exchanged two of their edges, and tells the order by the file's version."""

from pathlib import Path

import numpy as np
import pytest
import vtk
from vtk.util.numpy_support import numpy_to_vtk

from pipeline.formats.grid import CellArray
from pipeline.mesh.cell_mesh import measure_volumes
from pipeline.mesh.shape_functions import find_kind
from pipeline.series.files.frame_files import read_grid

OLD_TO_NEW = [*range(18), 19, 18, *range(20, 27)]


def write_cell(file: Path, mode: str, points: np.ndarray) -> None:
    """One triquadratic Lagrange hexahedron, with its nodes as given."""
    grid, stored = vtk.vtkUnstructuredGrid(), vtk.vtkPoints()
    stored.SetData(numpy_to_vtk(points, deep=True))
    grid.SetPoints(stored)
    grid.InsertNextCell(vtk.VTK_LAGRANGE_HEXAHEDRON, 27, list(range(27)))
    writer = vtk.vtkUnstructuredGridWriter() if file.suffix == ".vtk" else vtk.vtkXMLUnstructuredGridWriter()
    if file.suffix == ".vtk":
        writer.SetFileVersion(51)
    else:
        getattr(writer, f"SetDataModeTo{mode}")()
    writer.SetFileName(str(file))
    writer.SetInputData(grid)
    writer.Write()


@pytest.mark.parametrize("mode", ["Binary", "Ascii", "Appended", "legacy"])
@pytest.mark.parametrize("old", [False, True], ids=["new", "old"])
def test_the_version_of_a_file_decides_the_order_of_its_nodes(tmp_path: Path, mode: str, old: bool) -> None:
    nodes = find_kind(72, 27).nodes
    radius, turn = 1 + nodes[:, 0], nodes[:, 2]
    points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), -nodes[:, 1]])
    file = tmp_path / ("cell.vtk" if mode == "legacy" else "cell.vtu")
    write_cell(file, mode, points[OLD_TO_NEW] if old else points)
    if old:
        content = file.read_bytes()
        if mode == "legacy":
            content = content.replace(b"Version 5.1", b"Version 5.0")
        else:
            head, _, rest = content.partition(b"byte_order")
            content = head.replace(b'version="2.', b'version="1.') + b"byte_order" + rest
        assert content != file.read_bytes()
        file.write_bytes(content)
    grid = read_grid(file)
    array = CellArray(grid.types, grid.offsets, grid.connectivity)
    assert measure_volumes(grid.points, array, 3)[0] == pytest.approx(1.5, rel=3e-3)
    mixed_up = array._replace(connectivity=array.connectivity[OLD_TO_NEW])
    assert measure_volumes(grid.points, mixed_up, 3)[0] != pytest.approx(1.5, rel=0.01)
