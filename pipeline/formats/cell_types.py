"""VTK's numbers for cell types, and how many nodes each type has.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html; the numbers are those of vtkCellType.h.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.cell_kinds import ROWS

TRIANGLE, TETRAHEDRON = 5, 10
CELL_TYPES = {2: TRIANGLE, 3: TETRAHEDRON}  # the simplex of each dimension
_LAGRANGE = 68  # from here on VTK decides, which reads the order of nodes by the version of the file
# types with a fixed number of nodes: those of cell_kinds.py, and cells without shape functions
CORNERS = {row.number: next(iter(row.kinds)) for row in ROWS if len(row.kinds) == 1 and row.number < _LAGRANGE} | {
    1: 1,  # vertex
    3: 2,  # line
    15: 10,  # pentagonal prism
    16: 12,  # hexagonal prism
    21: 3,  # quadratic edge
    35: 4,  # cubic line
}
# types whose number of nodes varies, and the least that one may have
LEAST_NODES = {
    0: 0,  # empty cell
    2: 1,  # vertices
    4: 2,  # polyline
    6: 3,  # triangle strip
    7: 3,  # polygon
    36: 6,  # quadratic polygon
    41: 1,  # convex point set
    42: 4,  # polyhedron
    **dict.fromkeys(range(68, 75), 2),  # Lagrange: curve, triangle, quadrilateral, tetrahedron, hexahedron, wedge...
    **dict.fromkeys(range(75, 82), 2),  # Bezier
}


def find_cell_fault(types: NDArray[np.uint8], offsets: NDArray[Any], length: int) -> str | None:
    """Return a fault in the cell types, or in the offsets into a connectivity of that length; None if there is none."""
    unknown = set(np.unique(types).tolist()) - CORNERS.keys() - LEAST_NODES.keys()
    if unknown:
        return f"a cell has the unknown type {min(unknown)}"
    sizes = np.diff(offsets)
    if len(sizes) != len(types) or offsets[0] != 0 or offsets[-1] != length or (sizes < 0).any():
        return f"the offsets of its {len(types)} cells do not fit their {length} nodes"
    needed = np.full(256, -1)
    needed[list(CORNERS)] = list(CORNERS.values())
    bad = np.flatnonzero((sizes != needed[types]) & (needed[types] >= 0))
    if bad.size:
        return f"cell {bad[0]} has {sizes[bad[0]]} nodes, not {needed[types[bad[0]]]}"
    least = np.zeros(256, dtype=np.int64)
    least[list(LEAST_NODES)] = list(LEAST_NODES.values())
    bad = np.flatnonzero(sizes < least[types])
    return f"cell {bad[0]} has {sizes[bad[0]]} nodes, at least {least[types[bad[0]]]} are needed" if bad.size else None
