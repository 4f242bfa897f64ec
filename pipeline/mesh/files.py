"""Meshes from files: anything that meshio reads, brought to one simplex mesh."""

from pathlib import Path

import numpy as np

from pipeline.errors import MeshError
from pipeline.mesh.simplex import CELL_NAMES, Mesh

_KINDS = {"tetra": 3, "triangle": 2}
_DROPPED = {"vertex", "line"}


def read_mesh(path: Path, scale: float = 1.0) -> Mesh:
    """Return the tetrahedra of a file, or its triangles where it is planar, with points times scale.

    Raises MeshError for a missing or unreadable file, a surface, higher-order or other solid cells, inverted cells.
    """
    import meshio

    if not path.is_file():
        raise MeshError(f"{path}: no such mesh file")
    try:
        raw = meshio.read(path)
    except (
        Exception,
        SystemExit,
    ) as error:  # meshio's readers raise whatever their parser does, and exit for some
        raise MeshError(f"{path}: meshio cannot read it ({type(error).__name__}: {error})") from error
    kinds = {block.type for block in raw.cells if len(block.data)}
    dimension = max((_KINDS.get(kind, 0) for kind in kinds), default=0)
    other = sorted(kinds - _KINDS.keys() - _DROPPED)
    if other or not dimension:
        found = ", ".join(other or sorted(kinds)) or "no cells"
        raise MeshError(f"{path}: has {found}; linear tetrahedra or planar triangles are needed")
    cells = np.concatenate([b.data for b in raw.cells if _KINDS.get(b.type) == dimension])
    points = np.asarray(raw.points, dtype=np.float64) * scale
    if dimension == 2 and points.shape[1] == 3:
        if np.ptp(points[:, 2]) > 1e-12 * max(1.0, float(np.abs(points).max())):
            raise MeshError(
                f"{path}: triangles that do not lie in a plane of constant z are a surface; "
                f"fill it with {CELL_NAMES[3]} cells first"
            )
        points = points[:, :2]
    return Mesh(points, cells.astype(np.int64), name=str(path))
