"""Quadratic mesh files with mesh.order = 2: nodes on sides and curved sides are kept, in the order of any program."""

import itertools
import math
from pathlib import Path

import meshio
import numpy as np
import pytest
import xarray

from pipeline import build, load_case, make_case
from pipeline.cli import main
from pipeline.errors import CaseError, MeshError
from pipeline.mesh.files import read_mesh
from pipeline.mesh.quadratic import QuadraticMesh, raise_order
from pipeline.mesh.refinement import refine_mesh
from pipeline.mesh.side_nodes import arrange_sides
from pipeline.mesh.simplex import Mesh
from pipeline.mesh.surface import find_boundary_faces
from tests.bodies import skip_figures, write_case
from tests.foreign import case_meshes as M

GMSH = Path(__file__).parent / "curved"
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


def test_curved_sides_leave_a_twentieth_of_the_error_of_a_ball():
    """The numbers of docs/meshes.md."""
    straight = Mesh(BALLS[3].points, BALLS[3].cells[:, :4]).rest_volumes.sum()
    assert 1 - straight / SIZES[3] == pytest.approx(0.297, abs=5e-4)
    assert 1 - BALLS[3].rest_volumes.sum() / SIZES[3] == pytest.approx(0.015, abs=5e-4)


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


@pytest.mark.parametrize("d", [2, 3])
def test_mirrored_cells_are_reoriented_with_the_nodes_of_their_sides(tmp_path, d):
    ball = BALLS[d]
    turn = [0, 2, 1, 5, 4, 3] if d == 2 else [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]  # corners 1 and 2 exchanged
    cells = ball.cells.copy()
    cells[::2] = cells[::2][:, turn]
    mesh = read_mesh(write_nastran(tmp_path / "it.bdf", ball.points, cells), order=2)
    assert mesh.rest_volumes == pytest.approx(ball.rest_volumes, rel=1e-12)
    assert any("mirrored by their numbering" in note for note in mesh.notes)
    mirrored = read_mesh(
        write_nastran(tmp_path / "it.bdf", ball.points * np.array([-1, 1, 1][:d]), ball.cells), order=2
    )
    assert mirrored.rest_volumes == pytest.approx(ball.rest_volumes, rel=1e-12)


def test_a_disk_lies_anywhere_along_z_beside_lines_and_stray_nodes(tmp_path):
    ball = BALLS[2]
    points = np.vstack([np.pad(ball.points, [(0, 0), (0, 1)], constant_values=7.0), [[5, 5, 5]]])
    blocks = [("line3", ball.cells[:3, [0, 1, 3]]), ("triangle6", ball.cells), ("triangle6", ball.cells[:1])]
    meshio.Mesh(points, blocks).write(tmp_path / "it.vtu")
    mesh = read_mesh(tmp_path / "it.vtu", order=2)
    assert np.array_equal(mesh.cells, ball.cells) and np.array_equal(mesh.points, ball.points)
    texts = "lower dimension were dropped: 3 line3", "1 cells were listed twice", "belong to no triangle", "keep their"
    assert [any(text in note for note in mesh.notes) for text in texts] == [True] * 4 and len(mesh.notes) == 4


def test_instances_of_abaqus_with_curved_sides_are_bodies_of_their_own(tmp_path):
    ball = BALLS[3]
    rows = [
        "*Part, name=ball",
        "*Node",
        *(f"{i}, {', '.join(map(repr, x))}" for i, x in enumerate(ball.points.tolist(), 1)),
    ]
    rows += [
        "*Element, type=C3D10",
        *(f"{i}, {', '.join(map(str, row))}" for i, row in enumerate((ball.cells + 1).tolist(), 1)),
    ]
    rows += ["*End Part", "*Instance, name=a, part=ball", "*End Instance", "*Instance, name=b, part=ball", "2., 0., 0."]
    (tmp_path / "it.inp").write_text("\n".join([*rows, "*End Instance", ""]))
    mesh = read_mesh(tmp_path / "it.inp", order=2)
    assert len(mesh.points) == 2 * len(ball.points)  # they touch at a point
    assert mesh.rest_volumes.sum() == pytest.approx(2 * ball.rest_volumes.sum(), rel=1e-12)


def test_linear_files_and_those_of_higher_order_get_straight_sides(tmp_path):
    ball = BALLS[3]
    corners = np.unique(ball.cells[:, :4])
    linear = Mesh(ball.points[corners], np.searchsorted(corners, ball.cells[:, :4]))
    meshio.Mesh(linear.points, [("tetra", linear.cells)]).write(tmp_path / "linear.vtu")
    mesh, wanted = read_mesh(tmp_path / "linear.vtu", order=2), raise_order(linear)
    assert np.array_equal(mesh.points, wanted.points) and np.array_equal(mesh.cells, wanted.cells) and not mesh.notes
    more = np.random.default_rng(0).random((16, 3))
    rows = np.hstack([linear.cells[:1], len(linear.points) + np.arange(16)[None]])
    meshio.Mesh(np.vstack([linear.points, more]), [("tetra20", rows)]).write(tmp_path / "cubic.msh", file_format="gmsh")
    cubic = read_mesh(tmp_path / "cubic.msh", order=2)
    assert cubic.order == 2 and cubic.is_straight and len(cubic.points) == 10
    assert "1 tetrahedron cells of 20 nodes are simulated by their corners" in cubic.notes[0]


def swap_sides(points, cells):
    cells[5, [4, 5]] = cells[5, [5, 4]]


def move_far(points, cells):
    points[cells[5, 4]] += 3.0


def fold(points, cells):
    a, b = points[cells[5, :2]]
    points[cells[5, 4]] = a + 0.2 * (b - a)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            swap_sides,
            r"1 cells have a node that does not lie on its side, but nearer to another one; first cell 5: ",
        ),
        (move_far, r"cells have a node that does not lie on its side, but farther away .* first cell \d+: node \d+ on"),
        (
            fold,
            r"curved cells are folded, first \d+; move the nodes in the middle of their sides back, or take ",
        ),
    ],
)
def test_wrong_nodes_on_sides_are_refused_in_one_line(tmp_path, change, words):
    points, cells = BALLS[3].points.copy(), BALLS[3].cells.copy()
    change(points, cells)
    path = write_nastran(tmp_path / "it.bdf", points, cells)
    with pytest.raises(MeshError, match=words) as caught:
        read_mesh(path, order=2)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    assert read_mesh(path).order == 1  # the remedy


def test_cells_of_different_order_are_refused(tmp_path):
    ball = BALLS[3]
    meshio.Mesh(ball.points, [("tetra10", ball.cells[1:]), ("tetra", ball.cells[:1, :4])]).write(tmp_path / "it.vtu")
    with pytest.raises(MeshError, match=r"different order \(1 of 4 nodes, 63 of 10 nodes\).* or take mesh.order = 1$"):
        read_mesh(tmp_path / "it.vtu", order=2)
    assert len(read_mesh(tmp_path / "it.vtu").cells) == 64


def test_neighbors_must_share_the_nodes_on_their_sides(tmp_path):
    ball = BALLS[3]
    inner = np.flatnonzero(np.bincount(ball.cells[:, 4:].ravel()) > 3)[0]
    cell, column = np.argwhere(ball.cells == inner)[0]
    points, cells = np.vstack([ball.points, ball.points[inner] + 1e-3]), ball.cells.copy()
    cells[cell, column] = len(ball.points)
    with pytest.raises(
        MeshError, match=rf"do not share the nodes on their sides: cell {cell} has node .* cell \d+ has"
    ):
        read_mesh(write_nastran(tmp_path / "it.bdf", points, cells), order=2)
    hanging = np.array([[0, 0], [2, 0], [1, -2], [1, 0], [1.5, -1], [0.5, -1], [0.5, 1], [0.5, 0], [0.75, 0.5],
                        [0.25, 0.5]], dtype=float)  # fmt: skip
    cells = np.array([[0, 2, 1, 5, 4, 3], [0, 3, 6, 7, 8, 9]])
    with pytest.raises(MeshError, match="1 cells have corners of cells as nodes on sides, first cell 0"):
        read_mesh(write_nastran(tmp_path / "it.bdf", hanging, cells), order=2)


SECTIONS = {
    "material": {"youngs_modulus": 1e6, "poisson_ratio": 0.3, "density": 1000.0},
    "schedule": {"dt": 0.01, "frames": 1},
}


@pytest.mark.parametrize("d", [2, 3])
def test_arrays_of_python_have_the_order_of_their_cells(d):
    ball = BALLS[d]
    cells = put_in_order(ball.cells, d, ORDERS["reversed"])
    for mesh in (ball, (ball.points, ball.cells), (ball.points, cells)):
        case = make_case("ball", mesh=mesh, **SECTIONS)
        built = build(case).body.mesh
        assert case.mesh.order == 2 and np.array_equal(built.cells, ball.cells)
        assert np.array_equal(built.points, ball.points)
    linear = make_case("ball", mesh=Mesh(ball.points, ball.cells[:, : d + 1]), **SECTIONS)
    assert linear.mesh.order == 1
    lower = make_case("ball", mesh=ball, **SECTIONS, variants={"one": {"mesh.order": 1}})
    with pytest.raises(
        CaseError, match=rf"mesh.order.*: 1 does not fit arrays of cells of {ball.cells.shape[1]} nodes"
    ):
        build(lower.variant("one"))
    for points, wrong, words in (
        (ball.points, cells[:, :-1], "give .n, 3. with .e, 4. or .e, 10."),
        (np.where(ball.points > 0.9, np.nan, ball.points), cells, "mesh: .* points are not finite"),
        (ball.points, cells + 1, "mesh: cell .* names node"),
    ):
        with pytest.raises(CaseError, match=words):
            make_case("ball", mesh=(points, wrong), **SECTIONS)


@pytest.mark.parametrize("d", [2, 3])
def test_the_nodes_tell_their_sides_in_every_order(d):
    ball = BALLS[d]
    for order in itertools.permutations(range(ball.cells.shape[1] - d - 1)):
        cells, notes = arrange_sides(ball.points, put_in_order(ball.cells, d, list(order)))
        assert np.array_equal(cells, ball.cells) and len(notes) == (order != tuple(sorted(order)))


def test_a_curved_file_runs_and_keeps_its_volume_at_rest(tmp_path, monkeypatch):
    """End to end: refinement keeps the curved sides, the body at rest has the volume ratio 1."""
    skip_figures(monkeypatch)
    write_ball(tmp_path / "ball.msh", 3, file_format="gmsh22")
    zero = [0.0, 0.0, 0.0]
    path = write_case(
        tmp_path, mesh={"file": "ball.msh", "order": 2, "refine": 1}, supports=[{"plane": "x", "at": 0.0}],
        loads={"gravity": zero}, initial={"velocity": zero}, schedule={"dt": 0.01, "frames": 1}, variants=None,
    )  # fmt: skip
    mesh = build(load_case(path)).body.mesh
    assert len(mesh.cells) == 8 * len(BALLS[3].cells) and not mesh.is_straight
    assert mesh.rest_volumes.sum() == pytest.approx(measure_exactly(BALLS[3].points, BALLS[3].cells), rel=1e-12)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--no-movie", "--quiet"]) == 0
    with xarray.open_dataset(tmp_path / "out" / "beam" / "default" / "statistics.nc") as found:
        assert found["total_volume"].values == pytest.approx(mesh.rest_volumes.sum(), rel=1e-12)
        assert np.abs(found["volume_ratio"].values - 1).max() < 1e-12
        assert np.abs(found["volume_ratio_min"].values - 1).max() < 1e-12


@pytest.mark.parametrize("name", ["ball", "disk"])
@pytest.mark.parametrize("suffix", [".msh", "_22.msh", ".vtk", ".inp", ".mesh", ".bdf"])
def test_files_of_gmsh_keep_their_curved_sides(name, suffix):
    """Written by gmsh 4.8.4 from the .geo files beside them, with its own order of nodes in every format."""
    d = 3 if name == "ball" else 2
    mesh = read_mesh(GMSH / f"{name}{suffix}", order=2)
    original = meshio.gmsh.read(GMSH / f"{name}.msh")
    wanted = measure_exactly(original.points[:, :d], original.cells_dict[KINDS[d]])
    volume = mesh.rest_volumes.sum()
    # short fields of Nastran hold five digits
    assert volume == pytest.approx(wanted, rel=1e-4 if suffix == ".bdf" else 1e-14 if "msh" in suffix else 1e-13)
    assert volume == pytest.approx(measure_exactly(mesh.points, mesh.cells), rel=1e-12)
    straight = read_mesh(GMSH / f"{name}{suffix}").rest_volumes.sum()
    assert SIZES[d] - volume < 0.05 * (SIZES[d] - straight)
    assert mesh.is_straight is False and len(mesh.cells) == {"ball": 50, "disk": 15}[name]


@pytest.mark.parametrize(
    ("make", "name", "volume"),
    [
        (M.formats, "ten_marked.bdf", 6), (M.formats, "ten_unmarked.bdf", 6), (M.regions_and_noise, "quadratic.vtu", 2),
    ],
)  # fmt: skip
def test_straight_quadratic_files_keep_their_nodes_without_a_note(folders, make, name, volume):
    path = folders(make) / name
    mesh, linear = read_mesh(path, order=2), read_mesh(path)
    assert mesh.is_straight and len(mesh.cells) == len(linear.cells) and not mesh.notes
    assert mesh.rest_volumes.sum() == pytest.approx(volume, rel=1e-9)
    assert len(mesh.points) == len(raise_order(linear).points)
