"""Errors and cost of the measures of every kind of cell, as a table in markdown.

    python -m benchmarks.cells [--cells 20000] [--only hexahedron]

`affine` is the largest error of volume ratio, extremes of det F and angle (radians) of cells with curved faces under
one stretch and rotation; `curved` that of the volumes of a ring of such cells against a quadrature of 16 points along
each axis; `VTK` is the difference between the volume of vtkCellSizeFilter and ours in a sixth of a ring of one cell.
The time is that of a frame in one process, without reading: volumes, det F at all samples, and the angle.
"""

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.formats.cell_kinds import POLYGON, POLYHEDRON, ROWS
from pipeline.formats.grid import CellArray, PolyhedronFaces
from pipeline.mesh.cell_mesh import CellMesh, measure_volumes
from pipeline.mesh.quadrature import find_quadrature, find_samples
from pipeline.mesh.shape_functions import CellKind, find_kind, make_kind
from pipeline.run.measures import measure_cells

TURN, STRETCH = 0.7, np.array([1.2, 0.9, 1.1])
FACES = np.array([[0, 4, 7, 3], [1, 2, 6, 5], [0, 1, 5, 4], [3, 7, 6, 2], [0, 3, 2, 1], [4, 5, 6, 7]])
HEAD = "| cells | VTK types | nodes | points | samples | affine | curved | VTK | ns a cell |"


class Row(NamedTuple):
    """A line of the table."""

    name: str
    types: str
    nodes: str
    points: int | str
    samples: int | str
    affine: float
    curved: float | None
    vtk: float | None
    nanoseconds: float

    def format(self) -> str:
        """Return the line in markdown."""
        curved = "" if self.curved is None else f"{self.curved:.0e}"
        vtk = "" if self.vtk is None else f"{self.vtk:+.1%}"
        cells = (self.name, self.types, self.nodes, self.points, self.samples, f"{self.affine:.0e}", curved, vtk)
        return "| " + " | ".join(str(cell) for cell in cells) + f" | {self.nanoseconds:,.0f} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and return 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cells", type=int, default=20_000, help="cells of each kind (%(default)s)")
    parser.add_argument("--only", metavar="WORD", default="", help="only kinds whose names have this word")
    options = parser.parse_args(arguments)
    print(HEAD, "| --- " * 9 + "|", sep="\n")
    for row in iterate_rows(options.cells, options.only):
        print(row.format(), flush=True)
    return 0


def iterate_rows(count: int, word: str) -> Iterable[Row]:
    """Yield the rows of all kinds whose names have the word."""
    kinds: dict[str, list[tuple[int, int]]] = {}
    for cell_type in ROWS:
        for nodes, name in cell_type.kinds.items():
            kinds.setdefault(name, []).append((cell_type.number, nodes))
    for name in sorted(kinds, key=lambda name: (make_kind(name).dimension, make_kind(name).shape)):
        if word in name:
            yield measure_kind(kinds[name], count)
    for name, number, dimension in (("polyhedra (cubes)", POLYHEDRON, 3), ("polygons (hexagons)", POLYGON, 2)):
        if word in name:
            points, array = make_faceted(number, count)
            affine, seconds = measure_affine(points, array, dimension)
            pieces = 24 if dimension == 3 else 6
            yield Row(name, str(number), "any", "faces", pieces, affine, None, None, 1e9 * seconds)


def measure_kind(numbers: list[tuple[int, int]], count: int) -> Row:
    """Return the row of a kind, given its types and numbers of nodes."""
    kind = find_kind(*numbers[0])
    count = max(count * 8 // (8 + len(kind.nodes) ** 2 // 8), 200)
    points, array = make_cells(kind, numbers[0][0], count)
    affine, seconds = measure_affine(points, array, kind.dimension)
    bent, one = bend(points), bend(place_nodes(kind))
    exact = integrate_finely(kind, bent.reshape(count, -1, kind.dimension)[:200])
    ours = measure_volumes(bent, array, kind.dimension)[:200]
    curved = float(np.abs(ours / exact - 1).max())
    first = CellArray(array.types[:1], array.offsets[:2], array.connectivity[: len(kind.nodes)])
    vtk = None
    if numbers[0][0] not in (8, 11):  # pixels and voxels are boxes
        vtk = float(abs(measure_by_vtk(one, first)) / measure_volumes(one, first, kind.dimension)[0] - 1)
    return Row(
        name=kind.name,
        types=", ".join(str(number) for number, _ in numbers),
        nodes=str(len(kind.nodes)),
        points=len(find_quadrature(kind).weights),
        samples=len(find_samples(kind).weights),
        affine=affine,
        curved=curved,
        vtk=vtk,
        nanoseconds=1e9 * seconds,
    )


def place_nodes(kind: CellKind) -> Floats:
    """Return the nodes of a straight cell; those of pyramids lie in a collapsed cube."""
    nodes = kind.nodes.copy()
    if kind.shape == "pyramid":
        nodes[:, :2] = 0.5 + (nodes[:, :2] - 0.5) * (1 - nodes[:, 2:])
    return nodes


def make_cells(kind: CellKind, number: int, count: int) -> tuple[Floats, CellArray]:
    """Return points and separate cells with curved faces."""
    nodes, rng = place_nodes(kind), np.random.default_rng(0)
    points = nodes + 0.01 / kind.order**2 * rng.normal(size=(count, *nodes.shape))
    k = len(nodes)
    array = CellArray(np.full(count, number, np.uint8), np.arange(count + 1) * k, np.arange(count * k))
    return points.reshape(count * k, -1), array


def make_faceted(number: int, count: int) -> tuple[Floats, CellArray]:
    """Return points and separate polyhedra with six faces, or hexagons."""
    k = 8 if number == POLYHEDRON else 6
    turns = np.pi / 3 * np.arange(6)
    nodes = make_kind("hexahedron 1").nodes if k == 8 else np.column_stack([np.cos(turns), np.sin(turns)])
    points = nodes + 0.01 * np.random.default_rng(0).normal(size=(count, *nodes.shape))
    connectivity: Ints = np.arange(count * k)
    faces = None
    if k == 8:
        corners = connectivity.reshape(count, k)[:, FACES].reshape(-1)
        faces = PolyhedronFaces(corners, np.arange(6 * count + 1) * 4, np.arange(count + 1) * 6)
    array = CellArray(np.full(count, number, np.uint8), np.arange(count + 1) * k, connectivity, faces)
    return points.reshape(count * k, -1), array


def measure_affine(points: Floats, array: CellArray, dimension: int) -> tuple[float, float]:
    """Return the largest error under a stretch and a rotation, and the seconds a cell of the best of nine frames."""
    mesh = CellMesh(points, array, dimension)
    stretch, c, s = STRETCH[:dimension], np.cos(TURN), np.sin(TURN)
    R = np.eye(dimension)
    R[:2, :2] = [[c, -s], [s, c]]
    x = points * stretch @ R.T + 2
    found = measure_cells(mesh, x)
    ratio = float(stretch.prod())
    volume = found.volumes / mesh.rest_volumes
    errors = [np.abs(v / ratio - 1).max() for v in (volume, found.ratio_min, found.ratio_max)]
    times = []
    for _ in range(9):
        start = time.process_time()
        measure_cells(mesh, x)
        times.append(time.process_time() - start)
    return float(max(*errors, np.abs(found.angles - TURN).max())), min(times) / len(array.types)


def bend(points: Floats) -> Floats:
    """Return the points of a unit cube or square as those of a sixth of a ring of radii 1 and 2."""
    turn = np.pi / 3 * points[:, 1]
    return np.column_stack([(1 + points[:, 0]) * np.cos(turn), (1 + points[:, 0]) * np.sin(turn), *points[:, 2:].T])


def integrate_finely(kind: CellKind, cells: Floats) -> Floats:
    """Return the volumes of cells (m, k, d) by 16 points along each axis of a collapsed cube."""
    at, weight = np.polynomial.legendre.leggauss(16)
    at, weight = (at + 1) / 2, weight / 2
    points = np.stack([axis.ravel() for axis in np.meshgrid(*[at] * kind.dimension, indexing="ij")], axis=1)
    weights = np.prod(np.meshgrid(*[weight] * kind.dimension, indexing="ij"), axis=0).ravel()
    for axis in {"triangle": [1], "wedge": [1], "tetrahedron": [1, 2]}.get(kind.shape, []):
        weights = weights * (1 - points[:, axis]) ** axis
        points[:, :axis] *= 1 - points[:, axis : axis + 1]
    J = np.einsum("mai,qad->mqid", cells, kind.differentiate(points))
    return np.asarray(np.linalg.det(J) @ weights)


def measure_by_vtk(points: Floats, array: CellArray) -> float:
    """Return the volume or area of one cell by vtkCellSizeFilter."""
    import pyvista as pv

    cells = np.concatenate([[len(array.connectivity)], array.connectivity])
    grid = pv.UnstructuredGrid(cells, array.types, np.pad(points, [(0, 0), (0, 3 - points.shape[1])]))
    sizes = grid.compute_cell_sizes(length=False, area=points.shape[1] == 2, volume=points.shape[1] == 3)
    return float(sizes.cell_data["Area" if points.shape[1] == 2 else "Volume"][0])


if __name__ == "__main__":
    sys.exit(main())
