"""Meshes from files, converted to one simplex mesh; a note reports every correction and all that is left out."""

from collections import Counter
from collections.abc import Iterable, Sequence
from os import PathLike
from os.path import isfile  # pathlib's raises if a name is longer than the system allows
from pathlib import Path

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, join_names, shorten
from pipeline.formats.meshes.plain_mesh import SIMPLEX_DIMENSIONS, SIMPLEX_NAMES, CellBlock, PlainMesh
from pipeline.formats.preflight import find_refusal
from pipeline.formats.sandbox import SHARED_READER
from pipeline.mesh.cleanup import (
    PLANAR,
    check_connectivity,
    check_distances,
    check_points,
    drop_repeated_cells,
    drop_unused_nodes,
    orient_cells,
)
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.quadratic import make_quadratic_mesh, raise_order
from pipeline.mesh.side_nodes import CORNERS, sort_side_nodes
from pipeline.mesh.simplex import CELL_NAMES, Mesh

_QUADRATIC = {2: "triangle6", 3: "tetra10"}
_NEEDED = "tetrahedra or planar triangles are needed"


def read_mesh(path: str | PathLike[str], scale: float = 1.0, order: int = 1) -> ElementMesh:
    """Return the tetrahedra of a file, or the triangles of a planar one, with points multiplied by scale.

    If the order is 2, quadratic cells keep the nodes in their sides; other cells get them in the middles. The mesh's
    `notes` list every correction. Raises MeshError for a file that cannot be read, a surface, other solid cells, folded
    quadratic cells, and for cells and points that cleanup.py refuses.
    """
    path = Path(path)
    plain = _read_plain(path)
    try:
        points, cells, dropped = _find_simplices(plain.points, plain.blocks, order)
        check_connectivity(points, cells)
        cells, repeated = drop_repeated_cells(cells)
        body = np.repeat(np.arange(len(plain.bodies)), plain.bodies)[np.unique(cells)] if plain.bodies else None
        points, cells, unused = drop_unused_nodes(points, cells)
        check_points(points, body)
        points, flattened = _drop_z(points) if cells.shape[1] in (3, 6) else (points, [])
        check_distances(points, body)
        cells, mirrored = orient_cells(points, cells)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from None
    notes = [*plain.notes, *_note_regions(plain.regions), *dropped, *repeated, *unused, *flattened, *mirrored]
    named = tuple(f"{path.name}: {note}" for note in notes)
    if cells.shape[1] in CORNERS:
        return make_quadratic_mesh(points * scale, cells, str(path), named)
    mesh = Mesh(points * scale, cells, name=str(path), notes=named)
    return raise_order(mesh) if order == 2 else mesh


def _read_plain(path: Path) -> PlainMesh:
    """Return the content of a file, read in a child process."""
    if not isfile(path):
        raise MeshError(f"{shorten(str(path), 500)}: no such mesh file")
    if not path.stat().st_size:
        raise MeshError(f"{path}: the file is empty")
    if reason := find_refusal(path):
        raise MeshError(f"{path}: {reason}")
    return PlainMesh(*SHARED_READER.read("pipeline.formats.meshes.mesh_readers:read_plain_mesh", path, error=MeshError))


def _note_regions(regions: Sequence[str]) -> list[str]:
    if len(regions) < 2:
        return []
    return [f"{len(regions)} regions ({join_names(regions)}) get the one material of the case"]


def _find_simplices(points: Floats, blocks: Sequence[CellBlock], order: int) -> tuple[Floats, Ints, list[str]]:
    """Return points (n, 2 or 3), the simplices of the highest dimension and notes on what is left out.

    They have the nodes of their sides if the order is 2 and all of them do, else their corners only.
    """
    d = max((dimension for _, dimension, *_ in blocks), default=0)
    top = [block for block in blocks if block[1] == d]
    kinds = {kind for kind, *_ in top}
    if not kinds or any(SIMPLEX_DIMENSIONS.get(kind) != d for kind in kinds):
        raise MeshError(f"has {_join_kinds(kind for kind, *_ in blocks)}; {_NEEDED}{_find_remedy(kinds, d)}")
    if points.ndim != 2 or points.shape[1] not in (d, 3):
        raise MeshError(f"points {points.shape} do not fit {CELL_NAMES[d]} cells")
    for kind, _, _, nodes in top:
        if nodes.ndim != 2 or nodes.shape[1] < d + 1 or (kind == SIMPLEX_NAMES[d] and nodes.shape[1] != d + 1):
            raise MeshError(f"cells {nodes.shape} are not {CELL_NAMES[d]} cells")
    if order == 2 and kinds == {_QUADRATIC[d]}:
        blocks_of_nodes = [nodes for *_, nodes in top]
        for nodes in blocks_of_nodes:
            check_connectivity(points, nodes)
        cells, notes = np.concatenate([sort_side_nodes(points, nodes) for nodes in blocks_of_nodes]), []
    else:
        cells = np.concatenate([nodes[:, : d + 1] for *_, nodes in top])
        notes = [_note_curved(points, nodes, d) for kind, _, _, nodes in top if kind != SIMPLEX_NAMES[d]]
    lower = Counter[str]()
    for kind, dimension, count, _ in blocks:
        if dimension < d:
            lower[kind] += count
    counts = ", ".join(f"{count} {kind}" for kind, count in sorted(lower.items()))
    return points, cells, [*notes, *([f"cells of lower dimension were dropped: {counts}"] if counts else [])]


def _note_curved(points: Floats, cells: Ints, d: int) -> str:
    """Return the note on cells of higher order; in VTK's order the nodes on sides follow the corners."""
    text = (
        f"{len(cells)} {CELL_NAMES[d]} cells of {cells.shape[1]} nodes are simulated by their corners; the nodes in "
        "the middle of sides are left out (mesh.order = 2 keeps those of cells with one node in each side)"
    )
    sides = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)][: 3 if d == 2 else 6]
    if cells.shape[1] != d + 1 + len(sides):
        return text
    check_connectivity(points, cells)
    bend = 0.0
    for k, (a, b) in enumerate(sides):
        ends, middle = points[cells[:, [a, b]]], points[cells[:, d + 1 + k]]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        with np.errstate(all="ignore"):  # sides of length zero are refused later
            bend = max(bend, float(np.nanmax(np.linalg.norm(middle - ends.mean(axis=1), axis=1) / length)))
    curved = f"; these lie up to {100 * bend:.2g} % of a side's length from its middle: sides become straight"
    return text + (curved if bend > PLANAR else "")


def _join_kinds(kinds: Iterable[str]) -> str:
    return join_names(sorted(set(kinds))) or "no cells"


def _find_remedy(kinds: set[str], d: int) -> str:
    """Return the remedy for cells of the highest dimension that are not all linear simplices."""
    if d < 2:
        return ""
    return f"; split the others into {SIMPLEX_NAMES[d]} cells (pyvista: grid.triangulate())"


def _drop_z(points: Floats) -> tuple[Floats, list[str]]:
    """Return the points of triangles without the third coordinate, which must be constant, and a note if it varies."""
    if points.shape[1] == 2:
        return points, []
    varies = float(np.ptp(points[:, 2]))
    if varies > PLANAR * float(np.ptp(points, axis=0).max()):
        raise MeshError(
            "triangles that do not lie in a plane of constant z are a surface; "
            f"fill it with {CELL_NAMES[3]} cells first (gmsh, tetgen, pyvista.delaunay_3d)"
        )
    # coordinates computed in double precision differ by a few 1e-16 of their size
    noise = varies > 1e-12 * float(np.abs(points).max())
    note = [f"the coordinates along z vary by {varies:.2g} and are left out"] if noise else []
    return np.ascontiguousarray(points[:, :2]), note
