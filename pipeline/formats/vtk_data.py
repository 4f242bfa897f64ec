"""VTK's data objects as grids: datasets of any kind, polyhedra, and trees of blocks."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import Ints
from pipeline.errors import SeriesError
from pipeline.formats.blocks import join_blocks, join_by_number
from pipeline.formats.cell_types import find_cell_fault
from pipeline.formats.grid import Grid, PolyhedronFaces

_POLYHEDRON = 42


def make_grid(data: Any, file: Path, *, node_number: str = "") -> Grid:
    """Return the arrays of a VTK data object without ghost cells; raises SeriesError if it has no cells.

    Blocks become parts of one grid. If they share points, `node_number` names the point field that tells equal ones.
    """
    if data is None:
        raise SeriesError(f"{file}: cannot be read (VTK finds no data in it)")
    grids, names = list[Grid](), list[str]()
    for name, leaf in _list_leaves(data, ""):
        if (grid := _make_leaf(leaf, file)) is not None:
            grids.append(grid)
            names.append(name)
    if not grids:
        raise SeriesError(f"{file}: has no cells")
    joined = join_by_number(grids, names, node_number) if node_number else join_blocks(grids, names)
    return replace(joined, field_data=_read_fields(data) | dict(joined.field_data))


def _list_leaves(data: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the datasets in a tree of blocks, each with the name of the innermost block that has one."""
    from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet

    if data.IsA("vtkMultiBlockDataSet") or data.IsA("vtkMultiPieceDataSet"):
        count, get = data.GetNumberOfChildren(), data.GetChild
    elif data.IsA("vtkPartitionedDataSetCollection"):
        count, get = data.GetNumberOfPartitionedDataSets(), data.GetPartitionedDataSet
    elif data.IsA("vtkPartitionedDataSet"):
        count, get = data.GetNumberOfPartitions(), data.GetPartitionAsDataObject
    else:
        yield name, data
        return
    for i in range(count):
        child = get(i)
        if child is not None:
            meta = data.GetChildMetaData(i) if data.HasChildMetaData(i) else None
            own = meta.Get(vtkCompositeDataSet.NAME()) if meta is not None else None
            yield from _list_leaves(child, own or name)


def _make_leaf(data: Any, file: Path) -> Grid | None:
    """Return one dataset as a grid, None if it has no cells."""
    import pyvista
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if not data.IsA("vtkDataSet"):
        raise SeriesError(f"{file}: contains a {data.GetClassName()}, not a grid of cells")
    grid: Any = pyvista.wrap(data)
    if not isinstance(grid, pyvista.UnstructuredGrid):
        grid = grid.cast_to_unstructured_grid()
    if "vtkGhostType" in grid.cell_data:  # pieces of a .pvtu overlap there
        grid = grid.extract_cells(np.asarray(grid.cell_data["vtkGhostType"]) == 0)
    points = np.asarray(grid.points, dtype=np.float64)
    if not grid.n_cells or grid.GetCells() is None:
        return None
    connectivity = np.asarray(grid.cell_connectivity, dtype=np.int64)
    offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray()).astype(np.int64)
    types = np.asarray(grid.celltypes)
    if (fault := find_cell_fault(types, offsets, len(connectivity))) is not None:
        raise SeriesError(f"{file}: {fault}")
    if connectivity.size and (connectivity.min() < 0 or connectivity.max() >= len(points)):
        wrong = connectivity.min() if connectivity.min() < 0 else connectivity.max()
        raise SeriesError(f"{file}: a cell refers to point {wrong} of {len(points)} (counted from 0)")
    faces = _read_faces(grid, file) if (types == _POLYHEDRON).any() else None
    fields = _Fields(grid)
    return Grid(points, len(points), types, offsets, connectivity, fields.nodal, fields.cellular, fields.whole, faces)


class _Fields:
    """The arrays of numbers at points and cells, and of the whole dataset."""

    def __init__(self, grid: Any) -> None:
        self.nodal, self.cellular, self.whole = (
            {name: np.asarray(data[name]) for name in data.keys()}  # noqa: SIM118  (pyvista's iterate over values)
            for data in (grid.point_data, grid.cell_data, grid.field_data)
        )


def _read_fields(data: Any) -> dict[str, Any]:
    """Return the arrays of numbers that belong to a whole tree of blocks."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    fields = data.GetFieldData() if data.IsA("vtkCompositeDataSet") else None
    arrays = [fields.GetArray(i) for i in range(fields.GetNumberOfArrays())] if fields is not None else []
    return {array.GetName(): vtk_to_numpy(array).copy() for array in arrays if array is not None and array.GetName()}


def _read_faces(grid: Any, file: Path) -> PolyhedronFaces:
    """Return the faces of the polyhedra in the order of the cells."""
    faces, locations = grid.GetPolyhedronFaces(), grid.GetPolyhedronFaceLocations()
    if faces is None or locations is None:
        raise SeriesError(f"{file}: has polyhedra without faces")
    numbers, cell_offsets = _unpack(locations)
    nodes, offsets = _unpack(faces)
    if numbers.size and (numbers.min() < 0 or numbers.max() >= len(offsets) - 1):
        raise SeriesError(f"{file}: a polyhedron refers to face {numbers.max()} of {len(offsets) - 1}")
    if (nodes.size and (nodes.min() < 0 or nodes.max() >= grid.n_points)) or len(cell_offsets) != grid.n_cells + 1:
        raise SeriesError(f"{file}: the faces of its polyhedra do not fit its points and cells")
    sizes = np.diff(offsets)[numbers]
    chosen = np.repeat(offsets[numbers] - np.concatenate([[0], np.cumsum(sizes)[:-1]]), sizes) + np.arange(sizes.sum())
    return PolyhedronFaces(nodes[chosen], np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), cell_offsets)


def _unpack(cells: Any) -> tuple[Ints, Ints]:
    """Return the connectivity and the offsets of a vtkCellArray."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    arrays = cells.GetConnectivityArray(), cells.GetOffsetsArray()
    connectivity, offsets = (vtk_to_numpy(array).astype(np.int64) for array in arrays)
    return connectivity, offsets
