"""Red refinement of simplex meshes of order 1 and 2: 4 triangles of each triangle, 8 tetrahedra of each tetrahedron.

The sides of a tetrahedron are halved. Four tetrahedra are cut off at its corners; the octahedron that remains is cut
into four along a diagonal, which joins the middles of two opposite sides. If later generations take the diagonal
between the middles of that diagonal and of the side opposite to it, all descendants of a tetrahedron have at most three
shapes, mirrored ones counted once (Bey 1995).

The first diagonal of every cell is that with the best of these shapes, and `times` generations keep to it. If each is a
call of its own, it chooses again; since a child may always go on with its parent's choice, shapes do not become worse
than the first refinement makes them. Neighbors need not agree: the faces between them are cut in four, however the
diagonals lie.
"""

from functools import cache

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.mesh.cell_mesh import list_shape_notes
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.node_order import SIMPLEX_EDGES, turn_nodes
from pipeline.mesh.quadratic import QuadraticMesh, find_sides, make_quadratic_mesh
from pipeline.mesh.regions import Regions
from pipeline.mesh.shape_functions import make_kind
from pipeline.mesh.simplex import Mesh, measure_quality, require_simplices

# children by the nodes of a quadratic cell: corners, then the middles of its sides. Those of a tetrahedron have their
# next diagonal in the same place, between the middles of the sides 02 and 13
_TRIANGLES = [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)]
_TETRAHEDRA = [
    (0, 4, 6, 7), (4, 1, 5, 8), (6, 5, 2, 9), (7, 8, 9, 3), (4, 6, 7, 8), (5, 6, 4, 8), (6, 7, 8, 9), (8, 5, 6, 9),
]  # fmt: skip
_CHILDREN = {2: np.array(_TRIANGLES), 3: np.array(_TETRAHEDRA)}
_INNER = _CHILDREN[3][[4, 5]]  # the other two inner children are these, turned about the center
# even permutations of the corners (volumes stay positive), each with another diagonal between the sides 02 and 13
_TURNS = np.array([(0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2)])
_ROUNDING = 1e-9  # a diagonal that is better by no more than this does not replace that of the cell's own order


def refine_mesh(mesh: ElementMesh, times: int = 1) -> ElementMesh:
    """Return the mesh with 2^d children of every cell, those of cell c from 2^d c to 2^d (c + 1) - 1; and so on.

    Old nodes keep their numbers, and new ones follow. Cells of order 2 keep their curved shape: the volumes of children
    sum to that of their parent. Raises MeshError for a child that is folded, as QuadraticMesh does.
    """
    corners = _turn_cells(mesh.points, mesh.cells[:, : mesh.dimension + 1])
    for _ in range(times):
        mesh = _refine_once(mesh, corners)
        corners = mesh.cells[:, : mesh.dimension + 1]
    return mesh


def _refine_once(mesh: ElementMesh, corners: Ints) -> ElementMesh:
    """Return the mesh with 2^d children of every cell, whose corners (e, d + 1) are in the order that cuts it."""
    if isinstance(mesh, QuadraticMesh):
        return _refine_quadratic(mesh, turn_nodes(mesh.cells, corners))
    mesh = require_simplices(mesh)
    ends, sides = find_sides(corners)
    points = np.concatenate([mesh.points, mesh.points[ends].mean(axis=1)])
    nodes = np.concatenate([corners, len(mesh.points) + sides], axis=1)
    return Mesh(points, _divide(nodes, mesh.dimension), mesh.name, mesh.notes, _refine_regions(mesh))


def list_parents(children: int, dimension: int) -> Ints:
    """Return the parent of each of so many cells of a refined mesh; raises MeshError if it cannot be one."""
    count = 2**dimension
    if children % count:
        raise MeshError(f"{children} cells are not a refined mesh; a multiple of {count} is needed")
    return np.arange(children, dtype=np.int64) // count


def _refine_quadratic(mesh: QuadraticMesh, cells: Ints) -> QuadraticMesh:
    d, n = mesh.dimension, len(mesh.points)
    corners = _divide(cells, d)
    _, sides = find_sides(corners)
    # a new node has the same place in all cells that share it, up to rounding: the first one decides
    places = np.einsum("ska,eai->eski", _evaluate_middles(d), mesh.points[cells]).reshape(-1, d)
    _, first = np.unique(sides.ravel(), return_index=True)
    points = np.concatenate([mesh.points, places[first]])
    counted = list_shape_notes(mesh)  # the finer mesh counts its own cells
    notes = tuple(note for note in mesh.notes if note not in counted)
    cells = np.concatenate([corners, n + sides], axis=1)
    return make_quadratic_mesh(points, cells, mesh.name, notes, _refine_regions(mesh))


def _refine_regions(mesh: ElementMesh) -> Regions | None:
    return None if mesh.regions is None else mesh.regions.refine(2**mesh.dimension)


def _divide(nodes: Ints, d: int) -> Ints:
    """Return the corners (2^d e, d + 1) of the children of cells with the nodes of order 2 (e, k)."""
    return np.ascontiguousarray(nodes[:, _CHILDREN[d]].reshape(-1, d + 1))


@cache
def _evaluate_middles(d: int) -> Floats:
    """Return the parent's shape functions in the middle of every side of its children (2^d, sides, k)."""
    kind = make_kind("triangle 2" if d == 2 else "tetrahedron 2")
    middles = kind.nodes[_CHILDREN[d]][:, SIMPLEX_EDGES[d]].mean(axis=2)
    return kind.evaluate(middles.reshape(-1, d)).reshape(*middles.shape[:2], -1)


def _turn_cells(points: Floats, cells: Ints) -> Ints:
    """Return the corners (e, d + 1) of cells, turned so that their best diagonal lies between the sides 02 and 13."""
    if cells.shape[1] == 3:
        return cells
    worst = np.column_stack([_find_worst_child(points, cells[:, turn]) for turn in _TURNS])
    best = worst.argmax(axis=1)
    own = worst[:, 0] >= worst.max(axis=1) - _ROUNDING
    return np.take_along_axis(cells, _TURNS[np.where(own, 0, best)], axis=1)


def _find_worst_child(points: Floats, cells: Ints) -> Floats:
    """Return the lower quality of the two shapes of the children inside each tetrahedron (e,)."""
    X = points[cells]
    X = np.concatenate([X, X[:, SIMPLEX_EDGES[3]].mean(axis=2)], axis=1).reshape(-1, 3)
    inner = (10 * np.arange(len(cells))[:, None, None] + _INNER).reshape(-1, 4)
    return measure_quality(Mesh(X, inner)).reshape(-1, 2).min(axis=1)
