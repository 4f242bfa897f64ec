"""Meshes from files: anything that meshio reads, brought to one simplex mesh; every clean-up is told in a note."""

import io
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from pipeline.errors import MeshError
from pipeline.mesh.cleanup import (
    check_connectivity,
    check_points,
    oriented,
    without_repeated_cells,
    without_unused_nodes,
)
from pipeline.mesh.simplex import CELL_NAMES, Floats, Ints, Mesh

Note = Callable[[str], object]
_SIMPLICES = {2: "triangle", 3: "tetra"}  # meshio's names
_NEEDED = "linear tetrahedra or planar triangles are needed"


def read_mesh(path: Path, scale: float = 1.0, *, note: Note | None = None) -> Mesh:
    """Return the tetrahedra of a file, or its triangles where it is planar, with points times scale.

    `note` is called with each clean-up in words. Raises MeshError for a file that meshio cannot read, a surface,
    higher-order or other solid cells, and for what cleanup.py refuses.
    """
    raw, said = _read(path)
    notes = [f"meshio says: {said}"] if said else []
    try:
        points, cells, dropped = _simplices(raw)
        check_connectivity(points, cells)
        cells, repeated = without_repeated_cells(cells)
        points, cells, unused = without_unused_nodes(points, cells)
        check_points(points)
        points = _planar(points) if cells.shape[1] == 3 else points
        cells, mirrored = oriented(points, cells)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from None
    notes += [*dropped, *repeated, *unused, *mirrored]
    if note is not None:
        for text in notes:
            note(f"{path.name}: {text}")
    return Mesh(points * scale, cells, name=str(path))


def _read(path: Path) -> tuple[Any, str]:
    """Return meshio's mesh and what it would have printed.

    meshio prints, warns and, where no reader takes the file, exits; its readers raise whatever their parser does.
    """
    if not path.is_file():
        raise MeshError(f"{path}: no such mesh file")
    if not path.stat().st_size:
        raise MeshError(f"{path}: the file is empty")
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            raw = _parsed(path)
    except (Exception, SystemExit) as error:
        why = said.getvalue() if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        missing = f"; pip install {error.name}" if isinstance(error, ModuleNotFoundError) else ""
        # the parser of a text file may quote all of it; the first words say what it stumbled on
        raise MeshError(f"{path}: meshio cannot read it ({' '.join(why.split())[:300]}){missing}") from error
    return raw, " ".join(said.getvalue().split())


def _parsed(path: Path) -> Any:
    """Return meshio's mesh, of a gmsh 4.1 file also where only some entities are in a physical group.

    meshio 5.3 wants a group for all of them or for none; without the section $Entities it knows of none.
    """
    import meshio

    try:
        return meshio.read(path)
    except ValueError as error:
        if "gmsh:physical" not in str(error):
            raise
    content = path.read_bytes().replace(b"$Entities", b"$Ignored_").replace(b"$EndEntities", b"$EndIgnored_")
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(content)
        return meshio.read(copy)


def _simplices(raw: Any) -> tuple[Floats, Ints, list[str]]:
    """Return points (n, 2 or 3), the simplices of the highest dimension and a note of what else was dropped."""
    blocks = [block for block in raw.cells if len(block.data)]
    d = max((block.dim for block in blocks), default=0)
    top = {block.type for block in blocks if block.dim == d}
    if top != {_SIMPLICES.get(d)}:
        raise MeshError(f"has {_listed(b.type for b in blocks)}; {_NEEDED}{_remedy(top, d)}")
    points = np.asarray(raw.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (d, 3):
        raise MeshError(f"points {points.shape} do not go with {CELL_NAMES[d]} cells")
    cells = np.concatenate([block.data for block in blocks if block.dim == d]).astype(np.int64)
    lower = Counter[str]()
    for block in blocks:
        if block.dim < d:
            lower[block.type] += len(block.data)
    if not lower:
        return points, cells, []
    counts = ", ".join(f"{count} {kind}" for kind, count in sorted(lower.items()))
    return points, cells, [f"cells of lower dimension were dropped: {counts}"]


def _listed(kinds: Iterable[str]) -> str:
    return ", ".join(sorted(set(kinds))) or "no cells"


def _remedy(kinds: set[str], d: int) -> str:
    """Return what to do about cells of the highest dimension that are not all linear simplices."""
    if d < 2:
        return ""
    if any(kind.startswith("VTK_LAGRANGE") or kind.strip("abcdefghijklmnopqrstuvwxyz") for kind in kinds):
        return "; save it with cells of first order (gmsh: Mesh.ElementOrder = 1)"
    return f"; split the others into {_SIMPLICES[d]} cells (pyvista: grid.triangulate())"


def _planar(points: Floats) -> Floats:
    """Return the points of triangles without their third coordinate, which must be constant."""
    if points.shape[1] == 2:
        return points
    # what was computed in double precision differs by a few 1e-16 of its size
    if np.ptp(points[:, 2]) > 1e-12 * float(np.abs(points).max()):
        raise MeshError(
            "triangles that do not lie in a plane of constant z are a surface; "
            f"fill it with {CELL_NAMES[3]} cells first (gmsh, tetgen, pyvista.delaunay_3d)"
        )
    return np.ascontiguousarray(points[:, :2])
