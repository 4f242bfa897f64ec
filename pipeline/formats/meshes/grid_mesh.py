"""Meshes from the files that frames are read from: one instant of a series is a mesh, too."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import Ints
from pipeline.errors import MeshError, SeriesError
from pipeline.formats.grid import Grid
from pipeline.formats.meshes.plain_mesh import (
    CellBlock,
    CellGroup,
    PlainMesh,
    find_integer_fields,
    group_by_number,
    make_block,
)
from pipeline.formats.readers import read_grid, read_times
from pipeline.formats.vtu_read import read_inline

# VTK's cell types: meshio's name, dimension
_KINDS = {
    0: ("empty", 0), 1: ("vertex", 0), 2: ("vertices", 0), 3: ("line", 1), 4: ("polyline", 1), 5: ("triangle", 2),
    6: ("triangle strip", 2), 7: ("polygon", 2), 8: ("pixel", 2), 9: ("quad", 2), 10: ("tetra", 3), 11: ("voxel", 3),
    12: ("hexahedron", 3), 13: ("wedge", 3), 14: ("pyramid", 3), 15: ("penta_prism", 3), 16: ("hexa_prism", 3),
    21: ("line3", 1), 22: ("triangle6", 2), 23: ("quad8", 2), 24: ("tetra10", 3), 25: ("hexahedron20", 3),
    26: ("wedge15", 3), 27: ("pyramid13", 3), 28: ("quad9", 2), 29: ("hexahedron27", 3), 30: ("quad6", 2),
    31: ("wedge12", 3), 32: ("wedge18", 3), 33: ("hexahedron24", 3), 34: ("triangle7", 2), 35: ("line4", 1),
    36: ("polygon", 2), 37: ("pyramid19", 3), 42: ("polyhedron", 3), 68: ("VTK_LAGRANGE_CURVE", 1),
    69: ("VTK_LAGRANGE_TRIANGLE", 2), 70: ("VTK_LAGRANGE_QUADRILATERAL", 2), 71: ("VTK_LAGRANGE_TETRAHEDRON", 3),
    72: ("VTK_LAGRANGE_HEXAHEDRON", 3), 73: ("VTK_LAGRANGE_WEDGE", 3), 74: ("VTK_LAGRANGE_PYRAMID", 3),
    75: ("VTK_BEZIER_CURVE", 1), 76: ("VTK_BEZIER_TRIANGLE", 2), 77: ("VTK_BEZIER_QUADRILATERAL", 2),
    78: ("VTK_BEZIER_TETRAHEDRON", 3), 79: ("VTK_BEZIER_HEXAHEDRON", 3), 80: ("VTK_BEZIER_WEDGE", 3),
    81: ("VTK_BEZIER_PYRAMID", 3),
}  # fmt: skip
_LINEAR = {(69, 3): "triangle", (71, 4): "tetra"}  # Lagrange cells of order 1
_REGIONS = {"materialids", "material", "materials", "material_id", "region", "regions", "gmsh:physical", "subdomain"}
_MOST_REGIONS = 100  # a field with more values is none


def read_grid_mesh(path: Path) -> PlainMesh:
    """Return the first instant of a file of a series as a mesh; raises MeshError."""
    try:
        grid = read_inline(path)
        if grid is None:
            grid = read_grid(path)
            times = read_times(path) or []
        else:
            times = []
        notes = [f"the mesh is that of the first of {len(times)} instants"] if len(times) > 1 else []
        connectivity, joined = _join_parts(grid)
        blocks, order = _split_blocks(grid, connectivity)
        fields = {name: np.asarray(values)[order] for name, values in grid.cell_data.items()}
        groups = _find_groups(fields)
        regions = [name for name, *_ in groups] if len(groups) > 1 else []
        told = [*notes, *grid.notes, *joined]
        return PlainMesh(grid.points, blocks, told, regions, [], groups, find_integer_fields(fields))
    except SeriesError as error:
        raise MeshError(str(error)) from None


def _join_parts(grid: Grid) -> tuple[Ints, list[str]]:
    """Return the connectivity in which coincident points of different parts are one node, and a note."""
    if len(grid.parts) < 2:
        return grid.connectivity, []
    _, first, inverse = np.unique(grid.points, axis=0, return_index=True, return_inverse=True)
    return first[inverse.ravel()][grid.connectivity], [f"{len(grid.parts)} parts are joined at their common points"]


def _split_blocks(grid: Grid, connectivity: Ints) -> tuple[list[CellBlock], Ints]:
    """Return the cells by type and number of nodes, and the places in the grid of those of the highest dimension."""
    sizes = np.diff(grid.offsets)
    blocks, places = [], [(-1, np.zeros(0, dtype=np.int64))]
    for kind, size in np.unique(np.column_stack([grid.types, sizes]), axis=0).tolist():
        name, dimension = _KINDS.get(kind, (f"cell type {kind}", 3))
        chosen = np.flatnonzero((grid.types == kind) & (sizes == size))
        starts = grid.offsets[:-1][chosen]
        cells = connectivity[starts[:, None] + np.arange(size)]
        blocks.append(make_block(_LINEAR.get((kind, size), name), dimension, cells))
        places.append((dimension, chosen))
    top = max(dimension for dimension, _ in places)
    return blocks, np.concatenate([chosen for dimension, chosen in places if dimension == top])


def _find_groups(fields: Mapping[str, Any]) -> list[CellGroup]:
    """Return the groups in the first field that names regions of the cells of the highest dimension."""
    for name, values in fields.items():
        if name.lower().replace(" ", "_") in _REGIONS and len(values) == values.size:
            numbers = np.unique(values)
            if 0 < len(numbers) <= _MOST_REGIONS and (numbers == np.round(numbers)).all():
                return group_by_number(np.ravel(values), name)
    return []
