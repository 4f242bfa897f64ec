"""Meshes from files that meshio reads, converted to one simplex mesh; a note reports every correction."""

from collections import Counter
from collections.abc import Iterable, Sequence
from os import PathLike
from os.path import isfile  # pathlib's raises if a name is longer than the system allows
from pathlib import Path

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, join_names, shorten
from pipeline.formats.meshio_reader import SIMPLEX_NAMES, CellBlock
from pipeline.formats.preflight import find_refusal
from pipeline.formats.sandbox import SHARED_READER
from pipeline.mesh.cleanup import (
    check_connectivity,
    check_points,
    drop_repeated_cells,
    drop_unused_nodes,
    orient_cells,
)
from pipeline.mesh.simplex import CELL_NAMES, Mesh

_NEEDED = "linear tetrahedra or planar triangles are needed"


def read_mesh(path: str | PathLike[str], scale: float = 1.0) -> Mesh:
    """Return the tetrahedra of a file, or the triangles of a planar one, with points multiplied by scale.

    The mesh's `notes` list every correction. Raises MeshError for a file that meshio cannot read, a surface,
    higher-order or other solid cells, and for cells and points that cleanup.py refuses.
    """
    path = Path(path)
    points, blocks, output = _read_blocks(path)
    notes = [f"meshio says: {output}"] if output else []
    try:
        points, cells, dropped = _find_simplices(points, blocks)
        check_connectivity(points, cells)
        cells, repeated = drop_repeated_cells(cells)
        points, cells, unused = drop_unused_nodes(points, cells)
        check_points(points)
        points = _drop_z(points) if cells.shape[1] == 3 else points
        cells, mirrored = orient_cells(points, cells)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from None
    notes += [*dropped, *repeated, *unused, *mirrored]
    return Mesh(points * scale, cells, name=str(path), notes=tuple(f"{path.name}: {note}" for note in notes))


def _read_blocks(path: Path) -> tuple[Floats, list[CellBlock], str]:
    """Return points, blocks of cells and meshio's printed output, read in a child process."""
    if not isfile(path):
        raise MeshError(f"{shorten(str(path), 500)}: no such mesh file")
    if not path.stat().st_size:
        raise MeshError(f"{path}: the file is empty")
    if reason := find_refusal(path):
        raise MeshError(f"{path}: {reason}")
    points, blocks, output = SHARED_READER.read("pipeline.formats.meshio_reader:read_plain_mesh", path, error=MeshError)
    return points, blocks, output


def _find_simplices(points: Floats, blocks: Sequence[CellBlock]) -> tuple[Floats, Ints, list[str]]:
    """Return points (n, 2 or 3), the simplices of the highest dimension and a note about dropped cells."""
    d = max((dimension for _, dimension, *_ in blocks), default=0)
    top = {kind for kind, dimension, *_ in blocks if dimension == d}
    if top != {SIMPLEX_NAMES.get(d)}:
        raise MeshError(f"has {_join_kinds(kind for kind, *_ in blocks)}; {_NEEDED}{_find_remedy(top, d)}")
    if points.ndim != 2 or points.shape[1] not in (d, 3):
        raise MeshError(f"points {points.shape} do not fit {CELL_NAMES[d]} cells")
    cells = np.concatenate([nodes for _, dimension, _, nodes in blocks if dimension == d])
    if cells.ndim != 2 or cells.shape[1] != d + 1:
        raise MeshError(f"cells {cells.shape} are not {CELL_NAMES[d]} cells")
    lower = Counter[str]()
    for kind, dimension, count, _ in blocks:
        if dimension < d:
            lower[kind] += count
    if not lower:
        return points, cells, []
    counts = ", ".join(f"{count} {kind}" for kind, count in sorted(lower.items()))
    return points, cells, [f"cells of lower dimension were dropped: {counts}"]


def _join_kinds(kinds: Iterable[str]) -> str:
    return join_names(sorted(set(kinds))) or "no cells"


def _find_remedy(kinds: set[str], d: int) -> str:
    """Return the remedy for cells of the highest dimension that are not all linear simplices."""
    if d < 2:
        return ""
    if any(kind.startswith("VTK_LAGRANGE") or kind.strip("abcdefghijklmnopqrstuvwxyz") for kind in kinds):
        return "; save it with cells of first order (gmsh: Mesh.ElementOrder = 1)"
    return f"; split the others into {SIMPLEX_NAMES[d]} cells (pyvista: grid.triangulate())"


def _drop_z(points: Floats) -> Floats:
    """Return the points of triangles without their third coordinate, which must be constant."""
    if points.shape[1] == 2:
        return points
    # coordinates computed in double precision differ by a few 1e-16 of their size
    if np.ptp(points[:, 2]) > 1e-12 * float(np.abs(points).max()):
        raise MeshError(
            "triangles that do not lie in a plane of constant z are a surface; "
            f"fill it with {CELL_NAMES[3]} cells first (gmsh, tetgen, pyvista.delaunay_3d)"
        )
    return np.ascontiguousarray(points[:, :2])
