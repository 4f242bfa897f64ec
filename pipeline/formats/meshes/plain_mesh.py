"""A mesh as plain arrays and text: what a reader of meshes returns from its child process."""

from typing import Any, NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import MeshError

# cell type (meshio's name), dimension, count, and the nodes (count, k) of simplices of any order, None for other types
CellBlock = tuple[str, int, int, Any]
SIMPLEX_NAMES = {2: "triangle", 3: "tetra"}  # by dimension
# simplices of higher order; their corners come first
_CURVED = {
    "triangle6": 2, "triangle7": 2, "triangle10": 2, "triangle15": 2, "triangle21": 2, "VTK_LAGRANGE_TRIANGLE": 2,
    "tetra10": 3, "tetra11": 3, "tetra14": 3, "tetra15": 3, "tetra20": 3, "tetra35": 3, "tetra56": 3,
    "VTK_LAGRANGE_TETRAHEDRON": 3,
}  # fmt: skip
SIMPLEX_DIMENSIONS = {**{name: d for d, name in SIMPLEX_NAMES.items()}, **_CURVED}


class PlainMesh(NamedTuple):
    """Points (n, 2 or 3), blocks of cells, notes, and the regions of the cells of the highest dimension by name.

    `bodies` are the numbers of points of bodies that are separate although their points may coincide; empty for one.
    """

    points: Floats
    blocks: list[CellBlock]
    notes: list[str]
    regions: list[str] = []  # noqa: RUF012  (never changed)
    bodies: list[int] = []  # noqa: RUF012  (never changed)


def make_block(kind: str, dimension: int, cells: Any) -> CellBlock:
    """Return a block of cells (count, k); only the nodes of simplices are needed later."""
    nodes = np.ascontiguousarray(cells, dtype=np.int64) if kind in SIMPLEX_DIMENSIONS else None
    return kind, dimension, len(cells), nodes


def number_nodes(ids: Any, cells: Any, where: str) -> Any:
    """Return cells with the positions of their nodes in `ids` (n,); raises MeshError for a node that is not there."""
    order = np.argsort(ids, kind="stable")
    place = np.searchsorted(ids, cells, sorter=order)
    found = order[np.minimum(place, max(len(ids) - 1, 0))] if len(ids) else np.zeros_like(cells)
    wrong = (ids[found] != cells) if len(ids) else np.ones(np.shape(cells), dtype=bool)
    if wrong.any():
        raise MeshError(f"{where} names node {cells[wrong][0]}, which is not defined")
    return found
