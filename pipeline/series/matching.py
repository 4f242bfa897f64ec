"""The same mesh in two series: one solver renumbers it, another splits it into partitions."""

from dataclasses import replace

import numpy as np

from pipeline.arrays import Ints
from pipeline.errors import MeshError
from pipeline.formats.grid import CellArray
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.simplex import Mesh
from pipeline.series.body.arrangement import APART, Arrangement, match_by_positions
from pipeline.series.series import Series


def match_cells(first: Series, other: Series) -> Series | None:
    """Return the other series with the nodes and cells of the first, in its order; None if the meshes differ.

    Nodes are matched by rest positions, to a millionth of the body's size, and cells by their corners. The series
    itself is returned if its order is that of the first.
    """
    mine, theirs = first.mesh, other.mesh
    if (
        mine.dimension != theirs.dimension
        or mine.points.shape != theirs.points.shape
        or len(mine.cell_array.types) != len(theirs.cell_array.types)
    ):
        return None
    if _are_equal(mine.cell_array, theirs.cell_array) and _lie_together(mine, theirs):
        return other
    match = match_by_positions(mine.points, mine.cell_array, theirs.points, theirs.cell_array, APART * mine.size)
    if match is None or match.nodes is None or match.cells is None:
        return None
    layout = other.layout
    base = Arrangement(_select(layout.arrangement.nodes, match.nodes), _select(layout.arrangement.cells, match.cells))
    try:
        mesh = _renumber(mine, theirs, match.nodes)
    except MeshError:  # the corners of a cell are in another order, and one of the two is inverted
        return None
    ids = layout.ids.rearrange(match.nodes, match.cells, base, mesh.cell_array)
    return replace(other, layout=replace(layout, mesh=mesh, arrangement=base, ids=ids))


def _are_equal(a: CellArray, b: CellArray) -> bool:
    return np.array_equal(a.types, b.types) and np.array_equal(a.connectivity, b.connectivity)


def _lie_together(mine: BodyMesh, theirs: BodyMesh) -> bool:
    return bool((np.abs(mine.points - theirs.points) <= APART * mine.size).all())


def _select(indices: Ints | None, chosen: Ints) -> Ints:
    return chosen if indices is None else indices[chosen]


def _renumber(mine: BodyMesh, theirs: BodyMesh, nodes: Ints) -> BodyMesh:
    """Return the first mesh with the rest positions of the other at its nodes; raises MeshError."""
    points = theirs.points[nodes]
    if isinstance(mine, Mesh):
        return Mesh(points, mine.cells, name=theirs.name, notes=theirs.notes)
    assert isinstance(mine, CellMesh)
    return replace(mine, points=points, name=theirs.name, notes=())
