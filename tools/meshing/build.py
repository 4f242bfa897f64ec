"""Makes cases/meshes/*.vtu: `python -m tools.meshing.build [FOLDER]`, 20 s; FOLDER is cases/meshes.

The meshes are committed. Other versions of numpy and scipy may round differently, and the steps from there to a mesh
are decisions, so that a rebuild may give another mesh of the same counts: build into another folder and look first.
"""

import sys
import time
from pathlib import Path

import meshio
import numpy as np

from pipeline.errors import MeshError
from pipeline.mesh.simplex import Mesh, label_components, measure_quality
from tools.meshing.improve import improve
from tools.meshing.points import carve, find_defects, make_points
from tools.meshing.shapes import Floats, Ints, Shape, make_armadillo, make_mushroom
from tools.meshing.smooth import list_surface_faces

SHAPES = {"mushroom": make_mushroom, "armadillo": make_armadillo}
_FLATTENED = 5e-3  # what is left of the sliver's height


def make_mesh(shape: Shape) -> Mesh:
    """Return the mesh of a shape; raises ValueError where its counts or its surface are not what they must be."""
    points = make_points(shape)
    points, cells = improve(shape, points, carve(shape, points))
    mesh = Mesh(points, cells, name=shape.name)
    found = len(mesh.points), len(mesh.cells), label_components(mesh)[0], find_defects(cells, len(points))[0]
    if found != (shape.nodes, shape.cells, 1, 0):
        raise ValueError(f"{shape.name}: nodes, cells, components, defects are {found}")
    return mesh


def add_sliver(mesh: Mesh) -> Mesh:
    """Return the mesh with one interior node moved almost into the opposite face of one of its cells.

    Of all such moves it is the one that leaves the other cells best.
    """
    interior = np.setdiff1d(np.arange(len(mesh.points)), list_surface_faces(mesh.cells))
    best: tuple[float, Floats] | None = None
    for node in interior:
        for cell in np.flatnonzero((mesh.cells == node).any(axis=1)):
            points = _flatten_cell(mesh, int(node), mesh.cells[cell])
            try:
                q = measure_quality(Mesh(points, mesh.cells))
            except MeshError:  # the move inverts a neighbour
                continue
            others = float(np.delete(q, cell).min())
            if best is None or others > best[0]:
                best = others, points
    assert best is not None
    return Mesh(best[1], mesh.cells, name=f"{mesh.name}_sliver")


def _flatten_cell(mesh: Mesh, node: int, cell: Ints) -> Floats:
    """Return the points with a node at a small part of its height over the opposite face of a cell."""
    a, b, c = (mesh.points[other] for other in cell if other != node)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    points = mesh.points.copy()
    points[node] -= (1 - _FLATTENED) * ((points[node] - a) @ normal) * normal
    return points


def write_mesh(mesh: Mesh, folder: Path) -> None:
    """Write NAME.vtu: binary in the file itself, not appended, float64."""
    meshio.Mesh(mesh.points, [("tetra", mesh.cells)]).write(folder / f"{mesh.name}.vtu")


def main(folder: Path) -> None:
    """Make every mesh and print its numbers."""
    for shape in (make() for make in SHAPES.values()):
        began = time.perf_counter()
        mesh = make_mesh(shape)
        seconds = time.perf_counter() - began
        for made in (mesh, add_sliver(mesh)) if shape.name == "mushroom" else (mesh,):
            write_mesh(made, folder)
            q = measure_quality(made)
            counts = f"{len(made.points)} nodes, {len(made.cells)} tetrahedra"
            print(f"{made.name}: {counts}, 3r/R worst {q.min():.4f}, median {np.median(q):.3f}, {seconds:.0f} s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1])
