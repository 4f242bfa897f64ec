"""Meshes from files, converted to one mesh of simplices of order 1 or 2.

A note reports every correction and all that is left out.
"""

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
from pipeline.mesh.node_order import SIMPLEX_DEGREES
from pipeline.mesh.quadratic import make_quadratic_mesh, raise_order, require_quadratic_memory
from pipeline.mesh.regions import Regions
from pipeline.mesh.side_nodes import arrange_sides, measure_bend
from pipeline.mesh.simplex import CELL_NAMES, Mesh

_QUADRATIC = {d: nodes for nodes, (order, d) in SIMPLEX_DEGREES.items() if order == 2}
_NEEDED = "tetrahedra or planar triangles are needed"


def read_mesh(path: str | PathLike[str], scale: float = 1.0, order: int = 1) -> ElementMesh:
    """Return the tetrahedra of a file, or the triangles of a planar one, with points multiplied by scale.

    With order 2, cells of 10 or 6 nodes keep those on their sides, and linear ones get new nodes in the middle. The
    mesh's `notes` list every correction. Raises MeshError for a file that cannot be read, a surface, other solid cells,
    and for cells and points that cleanup.py and side_nodes.py refuse.
    """
    path = Path(path)
    plain = _read_plain(path)
    try:
        points, cells, dropped = _find_simplices(plain.points, plain.blocks, order)
        cells, places, repeated = drop_repeated_cells(cells)
        body = np.repeat(np.arange(len(plain.bodies)), plain.bodies)[np.unique(cells)] if plain.bodies else None
        points, cells, unused = drop_unused_nodes(points, cells)
        check_points(points, body)
        own_order, d = SIMPLEX_DEGREES[cells.shape[1]]
        points, flattened = _drop_z(points) if d == 2 else (points, [])
        check_distances(points, body)
        arranged = list[str]()
        if own_order == 2:
            require_quadratic_memory(len(cells), d)
            cells, arranged = arrange_sides(points, cells)
        cells, mirrored = orient_cells(points, cells)
        arranged += _note_kept(points, cells) if own_order == 2 else []
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from None
    about_regions = _note_regions(plain.regions)
    notes = [*plain.notes, *about_regions, *dropped, *repeated, *unused, *flattened, *arranged, *mirrored]
    texts = tuple(f"{path.name}: {note}" for note in notes)
    regions = Regions(plain.groups, plain.fields, places, note="".join(f"{path.name}: {n}" for n in about_regions))
    if own_order == 2:
        return make_quadratic_mesh(points * scale, cells, str(path), texts, regions)
    mesh = Mesh(points * scale, cells, str(path), texts, regions)
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
    """Return points (n, 2 or 3), the simplices of the highest dimension and notes on what is left out."""
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
    count = _count_kept_nodes([nodes for *_, nodes in top], d, order)
    cells = np.concatenate([nodes[:, :count] for *_, nodes in top])
    check_connectivity(points, cells)
    notes = [_note_curved(points, nodes, d) for *_, nodes in top if nodes.shape[1] > count]
    lower = Counter[str]()
    for kind, dimension, number, _ in blocks:
        if dimension < d:
            lower[kind] += number
    counts = ", ".join(f"{number} {kind}" for kind, number in sorted(lower.items()))
    return points, cells, [*notes, *([f"cells of lower dimension were dropped: {counts}"] if counts else [])]


def _count_kept_nodes(blocks: Sequence[Ints], d: int, order: int) -> int:
    """Return how many nodes of every cell are kept: all of quadratic cells with order 2, else the corners."""
    sizes = Counter[int]()
    for nodes in blocks:
        sizes[nodes.shape[1]] += len(nodes)
    if order == 1 or _QUADRATIC[d] not in sizes:
        return d + 1
    if len(sizes) > 1:
        counts = join_names(f"{count} of {size} nodes" for size, count in sorted(sizes.items()))
        raise MeshError(
            f"has {CELL_NAMES[d]} cells of different order ({counts}), which do not fit together; write all of "
            f"them with {_QUADRATIC[d]} nodes, or take mesh.order = 1"
        )
    return _QUADRATIC[d]


def _note_curved(points: Floats, cells: Ints, d: int) -> str:
    """Return the note on cells of higher order that lose their nodes on sides."""
    text = (
        f"{len(cells)} {CELL_NAMES[d]} cells of {cells.shape[1]} nodes are simulated by their corners; the nodes in "
        "the middle of sides are left out"
    )
    if cells.shape[1] != _QUADRATIC[d]:
        return text
    check_connectivity(points, cells)
    bend = measure_bend(points, cells)
    curved = f"; these lie up to {100 * bend:.2g} % of a side's length from its middle: sides become straight"
    return text + (curved if bend > PLANAR else "") + "; mesh.order = 2 keeps them"


def _note_kept(points: Floats, cells: Ints) -> list[str]:
    """Return a note on curved sides that are kept."""
    bend = measure_bend(points, cells)
    if bend <= PLANAR:
        return []
    name = CELL_NAMES[points.shape[1]]
    return [
        f"{len(cells)} {name} cells of {cells.shape[1]} nodes keep their curved sides, whose nodes lie up to "
        f"{100 * bend:.2g} % of a side's length from the middle"
    ]


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
