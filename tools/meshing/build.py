"""Writes cases/meshes/*.vtu: `python -m tools.meshing.build [FOLDER]`, 20 s; FOLDER is cases/meshes by default.

The meshes are committed. Other versions of numpy and scipy may round differently, and rounding can change a decision
of the mesher and so the mesh, though not its counts: build into another folder and look first.
"""

import sys
import time
from pathlib import Path

import meshio
import numpy as np

from pipeline.errors import MeshError
from pipeline.mesh.simplex import Mesh, label_components, measure_quality
from tools.meshing.cell_count import improve_cells
from tools.meshing.points import carve, find_defects, make_points
from tools.meshing.shapes import Floats, Ints, Shape, make_armadillo, make_mushroom
from tools.meshing.smoothing import list_surface_faces

SHAPES = {"mushroom": make_mushroom, "armadillo": make_armadillo}
MESHES = Path(__file__).resolve().parents[2] / "cases" / "meshes"
_FLATTENED = 5e-3  # of the sliver's former height


def make_mesh(shape: Shape) -> Mesh:
    """Return the mesh of a shape; raises ValueError if its counts or its surface are wrong."""
    points = make_points(shape)
    points, cells = improve_cells(shape, points, carve(shape, points))
    mesh = Mesh(points, cells, name=shape.name)
    counts = len(mesh.points), len(mesh.cells), label_components(mesh)[0], find_defects(cells, len(points))[0]
    if counts != (shape.nodes, shape.cells, 1, 0):
        raise ValueError(f"{shape.name}: nodes, cells, components, defects are {counts}")
    return mesh


def add_sliver(mesh: Mesh) -> Mesh:
    """Return the mesh with one interior node moved almost into the opposite face of one of its cells.

    The move is the one that leaves the worst of the other cells best.
    """
    interior = np.setdiff1d(np.arange(len(mesh.points)), list_surface_faces(mesh.cells))
    best: tuple[float, Floats] | None = None
    for node in interior:
        for cell in np.flatnonzero((mesh.cells == node).any(axis=1)):
            points = _flatten_cell(mesh, int(node), mesh.cells[cell])
            try:
                q = measure_quality(Mesh(points, mesh.cells))
            except MeshError:  # the move inverts a neighbor
                continue
            others = float(np.delete(q, cell).min())
            if best is None or others > best[0]:
                best = others, points
    assert best is not None
    return Mesh(best[1], mesh.cells, name=f"{mesh.name}_sliver")


def _flatten_cell(mesh: Mesh, node: int, cell: Ints) -> Floats:
    """Return the points with a node at a small fraction of its height over the opposite face of a cell."""
    a, b, c = (mesh.points[other] for other in cell if other != node)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    points = mesh.points.copy()
    points[node] -= (1 - _FLATTENED) * ((points[node] - a) @ normal) * normal
    return points


def write_mesh(mesh: Mesh, folder: Path) -> None:
    """Write NAME.vtu: float64, inline binary, not appended."""
    meshio.Mesh(mesh.points, [("tetra", mesh.cells)]).write(folder / f"{mesh.name}.vtu")


def main(folder: Path) -> None:
    """Make every mesh and print its numbers."""
    for shape in (make_shape() for make_shape in SHAPES.values()):
        began = time.perf_counter()
        mesh = make_mesh(shape)
        seconds = time.perf_counter() - began
        for made_mesh in (mesh, add_sliver(mesh)) if shape.name == "mushroom" else (mesh,):
            write_mesh(made_mesh, folder)
            q = measure_quality(made_mesh)
            counts = f"{len(made_mesh.points)} nodes, {len(made_mesh.cells)} tetrahedra"
            print(f"{made_mesh.name}: {counts}, 3r/R worst {q.min():.4f}, median {np.median(q):.3f}, {seconds:.0f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else MESHES)
