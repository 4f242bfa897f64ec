"""Some of the cells of an array in VTK's layout, with the faces of polyhedra."""

import numpy as np

from pipeline.arrays import Ints
from pipeline.formats.grid import CellArray, PolyhedronFaces


def select_array(cells: CellArray, chosen: Ints) -> CellArray:
    """Return some cells, by their numbers (m,)."""
    connectivity, offsets = _gather(cells.connectivity, cells.offsets, chosen)
    faces = cells.faces
    if faces is not None:
        numbers, cell_offsets = _gather(np.arange(len(faces.offsets) - 1), faces.cell_offsets, chosen)
        corners, face_offsets = _gather(faces.connectivity, faces.offsets, numbers)
        faces = PolyhedronFaces(corners, face_offsets, cell_offsets)
    return CellArray(cells.types[chosen], offsets, connectivity, faces)


def _gather(values: Ints, offsets: Ints, chosen: Ints) -> tuple[Ints, Ints]:
    """Return the values of the chosen ranges, one after the other, and their offsets."""
    sizes = np.diff(offsets)[chosen]
    ends = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    places = np.arange(ends[-1]) + np.repeat(offsets[:-1][chosen] - ends[:-1], sizes)
    return np.asarray(values[places], dtype=np.int64), ends
