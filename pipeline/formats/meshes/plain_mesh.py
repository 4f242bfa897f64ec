"""A mesh as plain arrays and text: what a reader of meshes returns from its child process."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import MeshError

# cell type (meshio's name), dimension, count, and the nodes (count, k) of simplices of any order, None for other types
CellBlock = tuple[str, int, int, Any]
# a set of cells by name, and by number if it has one: "" if not. Its cells (m,) are counted among those of the highest
# dimension, in the order of the blocks
CellGroup = tuple[str, str, Any]
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
    `groups` are all sets of cells of the highest dimension, also those that are no regions, and `fields` the integers
    (e,) of these cells by name.
    """

    points: Floats
    blocks: list[CellBlock]
    notes: list[str]
    regions: list[str] = []  # noqa: RUF012  (never changed)
    bodies: list[int] = []  # noqa: RUF012  (never changed)
    groups: list[CellGroup] = []  # noqa: RUF012  (never changed)
    fields: dict[str, Any] = {}  # noqa: RUF012  (never changed)


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


def group_by_number(values: Any, word: str, names: Mapping[int, str] | None = None) -> list[CellGroup]:
    """Return a group for each of the numbers of cells (e,), called by its name, else by the word and the number."""
    values = np.asarray(values)
    unique, inverse = np.unique(values, return_inverse=True)
    parts = np.split(np.argsort(inverse, kind="stable"), np.cumsum(np.bincount(inverse, minlength=len(unique)))[:-1])
    names = names or {}
    return [
        (names.get(number, f"{word} {number:g}"), f"{number:g}", cells)
        for number, cells in zip(unique.tolist(), parts, strict=len(unique) > 0)
    ]


def find_integer_fields(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of cells (e,) that have one whole number in every cell, as integers."""
    found = {}
    for name, values in fields.items():
        array = np.asarray(values)
        if array.dtype.kind in "biuf" and array.ndim and array.size == len(array) > 0:
            array = array.reshape(-1)
            if (np.abs(array) < 2**53).all() and (array == np.round(array)).all():
                found[name] = array.astype(np.int64)
    return found
