"""Cells of a mixed mesh sorted by kind, as arrays of connectivity, and the permutations that mirror them."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from pipeline.arrays import Ints
from pipeline.errors import MeshError
from pipeline.formats.cell_kinds import POLYGON, TYPES, explain_refusal
from pipeline.formats.grid import CellArray
from pipeline.mesh.shape_functions import CellKind, find_kind, make_kind

_TYPES = 256  # VTK's numbers of types are bytes


@dataclass(frozen=True, eq=False, repr=False)
class KindBlock:
    """The cells of one kind: their numbers `cells` (m,), and their nodes `connectivity` (m, k) in VTK's order."""

    kind: CellKind
    cells: Ints
    connectivity: Ints

    def __repr__(self) -> str:
        return f"<Block of {len(self.cells)} cells: {self.kind.name}>"


def check_types(cell_array: CellArray, name: str) -> None:
    """Raise MeshError if a cell can neither be measured by shape functions nor by its faces."""
    keys = _combine(cell_array)
    for key in np.unique(keys).tolist():
        count, number = divmod(key, _TYPES)
        if reason := explain_refusal(number, count):
            raise MeshError(f"{name}: cell {int(np.flatnonzero(keys == key)[0])}: {reason}")


def split_blocks(cell_array: CellArray) -> tuple[KindBlock, ...]:
    """Return the cells with shape functions, kind by kind; faceted cells and those that are refused are left out.

    Types of the same shape functions (tetrahedra of type 10 and of type 71 with 4 nodes) make one block.
    """
    keys, chosen = _combine(cell_array), dict[CellKind, list[Ints]]()
    for key in np.unique(keys).tolist():
        count, number = divmod(key, _TYPES)
        if number in TYPES and count in TYPES[number].kinds:
            chosen.setdefault(find_kind(number, count), []).append(np.flatnonzero(keys == key))
    blocks = []
    for kind, parts in chosen.items():
        cells = np.sort(np.concatenate(parts)).astype(np.int64)
        places = cell_array.offsets[:-1][cells][:, None] + np.arange(len(kind.nodes))
        blocks.append(KindBlock(kind, cells, np.ascontiguousarray(cell_array.connectivity[places], dtype=np.int64)))
    return tuple(blocks)


def _combine(cell_array: CellArray) -> Ints:
    """Return one number (e,) for the type and the number of nodes of every cell."""
    return np.asarray(np.diff(cell_array.offsets) * _TYPES + cell_array.types, dtype=np.int64)


def select_faceted(cell_array: CellArray) -> Ints:
    """Return the numbers of the cells whose volumes follow from their faces: polygons, polyhedra and some prisms."""
    faceted = [row.number for row in TYPES.values() if row.faceted]
    return np.flatnonzero(np.isin(cell_array.types, faceted)).astype(np.int64)


def find_simplices(cell_array: CellArray) -> Ints | None:
    """Return the connectivity (e, d + 1) if all cells are linear tetrahedra or all linear triangles, else None."""
    blocks = split_blocks(cell_array)
    if len(blocks) != 1 or len(blocks[0].cells) != len(cell_array.types) or not blocks[0].kind.is_linear_simplex:
        return None
    return blocks[0].connectivity


def mirror_cells(cell_array: CellArray, which: Ints) -> CellArray:
    """Return the cells with those of numbers `which` mirrored: the nodes of each renumbered by a reflection.

    A renumbered cell has the same points and the opposite sign of its volume. Polyhedra and prisms measured by their
    faces stay: their faces are oriented outward in any case.
    """
    connectivity = cell_array.connectivity.copy()
    mirrored = np.zeros(len(cell_array.types), dtype=bool)
    mirrored[which] = True
    for block in split_blocks(cell_array):
        cells = np.flatnonzero(mirrored[block.cells])
        places = cell_array.offsets[:-1][block.cells[cells]][:, None] + np.arange(len(block.kind.nodes))
        connectivity[places] = block.connectivity[cells][:, find_mirror(block.kind.name)]
    for cell in np.flatnonzero(mirrored & (cell_array.types == POLYGON)):
        first, last = cell_array.offsets[cell : cell + 2]
        connectivity[first:last] = connectivity[first:last][::-1].copy()
    return cell_array._replace(connectivity=connectivity)


@cache
def find_mirror(name: str) -> Ints:
    """Return the order of nodes (k,) that mirrors a cell of the kind of that name."""
    nodes = make_kind(name).nodes
    swapped, flipped = nodes.copy(), nodes.copy()
    swapped[:, [0, 1]] = nodes[:, [1, 0]]
    flipped[:, 0] = 1 - nodes[:, 0]
    for image in (swapped, flipped):  # quads that are quadratic along one axis cannot be swapped
        apart = np.abs(image[:, None] - nodes).max(axis=2)
        if (apart.min(axis=1) < 1e-9).all():
            return np.asarray(apart.argmin(axis=1), dtype=np.int64)
    raise AssertionError(f"{name} is not symmetric")
