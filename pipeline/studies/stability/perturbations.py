"""Displacements of nodes at the start: apexes toward or through the bases of their cells, and every node at random.

In a mesh of order 2 apexes are corners, and the free nodes of sides move with the mean of their ends.
"""

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.quadratic import find_side_ends
from pipeline.mesh.simplex import Mesh, signed_volumes

_MOST_APEXES = 8  # enough for every kind of place, and few enough to leave the rest of the body as it was
_FLAT = -1e-9  # of a cell's volume: allows for rounding in a neighbor that ends as flat as the chosen cell


def scramble_nodes(mesh: ElementMesh, free: Ints, reach: float, *, seed: int) -> Floats:
    """Return the points (n, d) with every free node moved along every axis by up to +-reach [m]."""
    offsets = np.random.default_rng(seed).uniform(-reach, reach, mesh.points.shape)
    x = mesh.points.copy()
    x[free] += offsets[free]
    return x


def move_apexes(mesh: ElementMesh, free: Ints, part: float, *, seed: int) -> Floats:
    """Return the points (n, d) with some free nodes moved part of the way to the center of a cell's base.

    At part = 1 - h the cell's height is h times its former height, and no other cell is flatter; beyond 1 the cell is
    inverted. At most eight random nodes are moved, no two in one cell. Raises MeshError if no node can be moved.
    """
    if isinstance(mesh, Mesh):
        return _move_corners(mesh, free, part, seed=seed)
    corners = Mesh(mesh.points, mesh.cells[:, : mesh.dimension + 1], mesh.name)
    moved = _move_corners(corners, np.intersect1d(free, corners.cells), part, seed=seed) - mesh.points
    x = mesh.points.copy()
    x[free] += moved[find_side_ends(mesh)[free]].mean(axis=1)
    return x


def _move_corners(mesh: Mesh, free: Ints, part: float, *, seed: int) -> Floats:
    x, generator = mesh.points.copy(), np.random.default_rng(seed)
    taken: set[int] = set()
    moved = 0
    cells_of = _list_cells_of_nodes(mesh)
    for node in generator.permutation(free):
        star = cells_of[node]
        if taken.intersection(mesh.cells[star].ravel().tolist()):
            continue
        target = _find_base_center(mesh, int(node), star)
        if target is None:
            continue
        x[node] += part * (target - x[node])
        taken.add(int(node))
        moved += 1
        if moved == _MOST_APEXES:
            break
    if not moved:
        raise MeshError(f"{mesh.name}: no free node can be moved to a base of its cells without inverting others")
    return x


def _list_cells_of_nodes(mesh: Mesh) -> list[Ints]:
    order = np.argsort(mesh.cells, axis=None, kind="stable")
    ends = np.cumsum(np.bincount(mesh.cells.ravel(), minlength=len(mesh.points)))
    return np.split(order // mesh.cells.shape[1], ends[:-1])


def _find_base_center(mesh: Mesh, node: int, star: Ints) -> Floats | None:
    """Return the center of a base opposite the node, to which it can move without inverting a cell; None if none is."""
    cells = mesh.cells[star]
    for cell in cells:
        target = mesh.points[cell[cell != node]].mean(axis=0)
        points = mesh.points.copy()
        points[node] = target
        if (signed_volumes(points, cells) >= _FLAT * mesh.rest_volumes[star]).all():
            return np.asarray(target)
    return None
