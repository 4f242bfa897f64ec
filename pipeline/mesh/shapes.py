"""Structured meshes: boxes of tetrahedra and rectangles of triangles."""

from collections.abc import Sequence
from itertools import permutations
from math import factorial, prod

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, quote_value
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.system.memory import require_memory

# a cell is split into simplices along the diagonal from its low to its high corner; `alternating` mirrors every other
# cell, which removes the bias of one diagonal direction
SPLITS = ("kuhn", "alternating")
_BYTES = 270  # per simplex of a complete body, measured with 100 000 and 800 000 tetrahedra


def box(size: Sequence[float], cells: Sequence[int], split: str = "kuhn") -> Mesh:
    """Return a box [0, size] in cells of 6 tetrahedra: 3 sizes [m], 3 counts. Kuhn's split: one diagonal direction."""
    return _mesh_grid(size, cells, split, dimension=3, name="box")


def rectangle(size: Sequence[float], cells: Sequence[int], split: str = "kuhn") -> Mesh:
    """Return a rectangle [0, size] in cells of 2 triangles: 2 sizes [m], 2 counts."""
    return _mesh_grid(size, cells, split, dimension=2, name="rectangle")


def _mesh_grid(size: Sequence[float], cells: Sequence[int], split: str, *, dimension: int, name: str) -> Mesh:
    if len(size) != dimension or len(cells) != dimension:
        raise MeshError(f"a {name} takes {dimension} sizes and {dimension} cell counts, not {size} and {cells}")
    if split not in SPLITS:
        raise MeshError(f"split {quote_value(split)} is not one of {', '.join(SPLITS)}")
    _check_memory(cells, dimension)
    counts = np.array(cells) + 1
    index = np.stack(np.meshgrid(*[np.arange(c) for c in counts], indexing="ij"), axis=-1).reshape(-1, dimension)
    points = index * (np.array(size, dtype=np.float64) / np.array(cells))
    low = np.stack(np.meshgrid(*[np.arange(c) for c in cells], indexing="ij"), axis=-1).reshape(-1, dimension)
    mirrored = (low % 2).astype(bool) if split == "alternating" else np.zeros(low.shape, dtype=bool)
    simplices = [_number_nodes(corners, low, mirrored, counts) for corners in _find_kuhn_paths(dimension)]
    return Mesh(points, _orient_cells(points, np.stack(simplices, axis=1).reshape(-1, dimension + 1)), name=name)


def _check_memory(cells: Sequence[int], dimension: int) -> None:
    """Raise MeshError if the mesh would not fit into free memory: the system would kill the process."""
    require_memory(prod(cells) * factorial(dimension), _BYTES, "take fewer cells")


def _find_kuhn_paths(dimension: int) -> list[Ints]:
    """Return the corners (d + 1, d) of each simplex of the unit cube: paths along axes from low to high corner."""
    steps = np.eye(dimension, dtype=np.int64)
    return [
        np.concatenate([np.zeros((1, dimension), np.int64), np.cumsum(steps[list(order)], axis=0)])
        for order in permutations(range(dimension))
    ]


def _number_nodes(corners: Ints, low: Ints, mirrored: np.ndarray, counts: Ints) -> Ints:
    """Return the node numbers (cells, d + 1) of one simplex in every grid cell; marked cells are mirrored."""
    offset = np.where(mirrored[:, None, :], 1 - corners, corners)
    return np.ravel_multi_index(tuple(np.moveaxis(low[:, None, :] + offset, -1, 0)), tuple(counts)).astype(np.int64)


def _orient_cells(points: Floats, cells: Ints) -> Ints:
    """Return the cells with the last two vertices swapped if the volume would be negative."""
    wrong = signed_volumes(points, cells) < 0
    cells[wrong] = cells[wrong][:, [*range(cells.shape[1] - 2), -1, -2]]
    return cells
