"""Quadratic mesh files with mesh.order = 2: nodes on sides and curved sides are kept, in the order of any program."""

import itertools
import math
from pathlib import Path

import meshio
import numpy as np
import pytest

from pipeline.mesh.files import read_mesh
from pipeline.mesh.quadratic import QuadraticMesh, raise_order
from pipeline.mesh.refinement import refine_mesh
from pipeline.mesh.simplex import Mesh
from pipeline.mesh.surface import find_boundary_faces

SIDES = {2: [(0, 1), (1, 2), (2, 0)], 3: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]}
SIZES = {2: math.pi, 3: 4 / 3 * math.pi}
KINDS = {2: "triangle6", 3: "tetra10"}
# nodes of sides in the file, as numbers of VTK's: of gmsh, which exchanges the last two, and others
ORDERS = {"gmsh": [0, 1, 2, 3, 5, 4], "reversed": [5, 4, 3, 2, 1, 0], "shuffled": [3, 0, 5, 1, 4, 2]}


def make_ball(d: int, times: int = 1) -> QuadraticMesh:
    """A ball or disk of radius 1 whose nodes all lie on or within its surface, and the sides of which are curved."""
    corners = np.vstack([np.zeros(d), np.eye(d), -np.eye(d)])
    signs = np.array(list(itertools.product((1, -1), repeat=d)))
    cells = np.array([[0, *(1 + axis + d * (s[axis] < 0) for axis in range(d))] for s in signs])
    cells[signs.prod(axis=1) < 0] = cells[signs.prod(axis=1) < 0][:, [0, 2, 1, 3][: d + 1]]
    coarse = refine_mesh(Mesh(corners, cells), times)
    length = np.linalg.norm(coarse.points, axis=1, keepdims=True)
    sums = np.abs(coarse.points).sum(axis=1, keepdims=True)
    straight = raise_order(Mesh(coarse.points * sums / np.where(length, length, 1.0), coarse.cells))
    points, outer = straight.points.copy(), np.unique(find_boundary_faces(straight)[0])
    points[outer] /= np.linalg.norm(points[outer], axis=1, keepdims=True)
    return QuadraticMesh(points, straight.cell_array, d)


def measure_exactly(points: np.ndarray, cells: np.ndarray) -> float:
    """The volume of quadratic simplices by 4 Gauss points along each axis of a collapsed cube, written out again."""
    d = points.shape[1]
    t, w = np.polynomial.legendre.leggauss(4)
    t, w = (t + 1) / 2, w / 2
    total = 0.0
    for place in itertools.product(range(4), repeat=d):
        weight, rest, b = math.prod(w[i] for i in place), 1.0, []
        for axis, i in enumerate(place):
            weight *= rest if axis < d - 1 else 1.0
            b.append(rest * t[i])
            rest *= 1 - t[i]
        weight = math.prod(w[i] * (1 - t[i]) ** (d - 1 - axis) for axis, i in enumerate(place))
        barycentric = np.array([1 - sum(b), *b])
        slopes = np.vstack([-np.ones(d), np.eye(d)])
        gradients = [(4 * barycentric[a] - 1) * slopes[a] for a in range(d + 1)]
        gradients += [4 * (barycentric[a] * slopes[c] + barycentric[c] * slopes[a]) for a, c in SIDES[d]]
        total += weight * np.linalg.det(np.einsum("eki,kj->eij", points[cells], np.array(gradients))).sum()
    return total


BALLS = {2: make_ball(2), 3: make_ball(3)}


def write_ball(path: Path, d: int, order=None, **options) -> Path:
    ball = BALLS[d]
    cells = ball.cells if order is None else np.hstack([ball.cells[:, : d + 1], ball.cells[:, d + 1 :][:, order]])
    meshio.Mesh(np.pad(ball.points, [(0, 0), (0, 3 - d)]), [(KINDS[d], cells)]).write(path, **options)
    return path


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("it.msh", {"file_format": "gmsh22"}), ("it.msh", {"file_format": "gmsh22", "binary": False}),
        ("it.msh", {"file_format": "gmsh"}), ("it.msh", {"file_format": "gmsh", "binary": False}), ("it.inp", {}),
        ("it.vtu", {}), ("it.vtk", {}), ("it.xdmf", {}), ("it.e", {}), ("it.med", {}), ("it.vol", {}),
    ],
    ids=str,
)  # fmt: skip
def test_curved_sides_of_files_are_kept(tmp_path, d, name, options, capfd):
    ball = BALLS[d]
    mesh = read_mesh(write_ball(tmp_path / name, d, **options), scale=2.0, order=2)
    assert isinstance(mesh, QuadraticMesh)
    volume = mesh.rest_volumes.sum()
    assert volume == pytest.approx(measure_exactly(mesh.points, mesh.cells), rel=1e-12)
    precision = 1e-6 if name == "it.e" else 1e-14  # that of meshio's writer
    assert volume == pytest.approx(2**d * measure_exactly(ball.points, ball.cells), rel=100 * precision)
    straight = raise_order(Mesh(2 * ball.points, ball.cells[:, : d + 1])).rest_volumes.sum()
    assert abs(volume - 2**d * SIZES[d]) < 0.1 * abs(straight - 2**d * SIZES[d])
    assert mesh.points == pytest.approx(2 * ball.points, abs=4 * precision)
    wanted = ball.cells if name != "it.med" or d == 2 else np.sort(ball.cells, axis=1)  # meshio's MED is mirrored
    assert np.array_equal(mesh.cells if wanted is ball.cells else np.sort(mesh.cells, axis=1), wanted)
    assert "keep their curved sides, whose nodes lie up to" in mesh.notes[0]
    assert ["reoriented" in note for note in mesh.notes[1:]] == [True] * (name == "it.med" and d == 3), mesh.notes


def write_nastran(path: Path, points: np.ndarray, cells: np.ndarray) -> Path:
    """Free fields, two or three lines for a cell; meshio writes numbers that do not fit into its fields."""
    lines = [
        f"GRID,{i},,{','.join(map(repr, x))}" for i, x in enumerate(np.pad(points, [(0, 0), (0, 3)])[:, :3].tolist(), 1)
    ]
    name = "CTETRA" if cells.shape[1] == 10 else "CTRIA6"
    for i, row in enumerate((cells + 1).tolist(), 1):
        lines += [
            f"{name},{i},1,{','.join(map(str, row[:6]))}",
            *([f",{','.join(map(str, row[6:]))}"] if row[6:] else []),
        ]
    path.write_text("\n".join(["BEGIN BULK", *lines, "ENDDATA", ""]))
    return path


def write_tetgen(path: Path, points: np.ndarray, cells: np.ndarray) -> Path:
    nodes = [f"{i} {' '.join(map(repr, x))}" for i, x in enumerate(points.tolist())]
    rows = [f"{i} {' '.join(map(str, row))}" for i, row in enumerate(cells.tolist())]
    path.with_suffix(".node").write_text("\n".join([f"{len(points)} {points.shape[1]} 0 0", *nodes]))
    path.write_text("\n".join([f"{len(cells)} {cells.shape[1]} 0", *rows]))
    return path


def write_medit(path: Path, points: np.ndarray, cells: np.ndarray) -> Path:
    name = "TetrahedraP2" if cells.shape[1] == 10 else "TrianglesP2"
    texts = ["\n".join(" ".join(map(repr, [*row, 0])) for row in rows.tolist()) for rows in (points, cells + 1)]
    head = f"MeshVersionFormatted 2\nDimension {points.shape[1]}\nVertices {len(points)}\n{texts[0]}\n"
    path.write_text(f"{head}{name} {len(cells)}\n{texts[1]}\nEnd\n")
    return path


def put_in_order(cells: np.ndarray, d: int, order: list[int]) -> np.ndarray:
    return np.hstack([cells[:, : d + 1], cells[:, d + 1 :][:, [k for k in order if k < cells.shape[1] - d - 1]]])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("order", [None, *ORDERS.values()], ids=["VTK", *ORDERS])
@pytest.mark.parametrize(
    ("name", "write"), [("it.bdf", write_nastran), ("it.ele", write_tetgen), ("it.mesh", write_medit)]
)
def test_the_places_of_nodes_tell_their_sides_whatever_their_order(tmp_path, name, write, order, d):
    ball = BALLS[d]
    cells = ball.cells if order is None else put_in_order(ball.cells, d, order)
    path = write(tmp_path / name, ball.points, cells)
    mesh = read_mesh(path, order=2)
    assert np.array_equal(mesh.cells, ball.cells) and np.array_equal(mesh.points, ball.points)
    assert any("in VTK's order by their places" in note for note in mesh.notes) == (
        not np.array_equal(cells, mesh.cells)
    )
    linear = read_mesh(path)
    assert linear.order == 1 and len(linear.points) == len(np.unique(ball.cells[:, : d + 1]))
    bend = f"{50 * math.tan(math.pi / {2: 16, 3: 12}[d]):.2g}"  # arcs of 45 and 60 degrees over their chords
    assert f"lie up to {bend} % of" in linear.notes[0] and linear.notes[0].endswith("mesh.order = 2 keeps them")
