"""Mesh files of other programs: every format's writer, boundary cells, corrections with notes, and refusals."""

import base64
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from pipeline import build, frames, load_case
from pipeline.errors import MeshError
from pipeline.mesh.cleanup import orient_cells
from pipeline.mesh.files import read_mesh
from pipeline.mesh.shapes import box
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.mesh.surface import find_boundary_faces
from tests.bodies import BOXES, write_case
from tests.foreign.writers import quadratic

BOX = box((2.0, 3.0, 1.0), (2, 3, 1))
TETS = BOX.cells
FACES, _ = find_boundary_faces(BOX)  # 44 triangles
EDGES = FACES[:3, :2]
TWO = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
TWO_CELLS = np.array([[0, 1, 2, 3], [1, 4, 2, 3]])
HEXAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])

# Written by gmsh: a volume of two tets, three of its faces, a line, a point, with entities and physical names.
GMSH_41 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
2 1 "held"
3 2 "body"
$EndPhysicalNames
$Entities
1 1 1 1
1 0 0 0 0
1 0 0 0 1 0 0 0 2 1 -1
1 0 0 0 1 1 1 1 1 1 1
1 0 0 0 1 1 1 1 2 1 1
$EndEntities
$Nodes
2 6 1 9
0 1 0 1
9
7 7 7
3 1 0 5
1
2
3
4
5
0 0 0
1 0 0
0 1 0
0 0 1
1 1 1
$EndNodes
$Elements
4 7 1 7
0 1 15 1
1 9
1 1 1 1
2 1 2
2 1 2 3
3 1 3 2
4 1 2 4
5 1 4 3
3 1 4 2
6 1 2 3 4
7 2 5 3 4
$EndElements
"""
GMSH_22 = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
2 1 "held"
3 2 "body"
$EndPhysicalNames
$Nodes
6
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1
5 1 1 1
9 7 7 7
$EndNodes
$Elements
7
1 15 2 0 1 9
2 1 2 0 1 1 2
3 2 2 1 1 1 3 2
4 2 2 1 1 1 2 4
5 2 2 1 1 1 4 3
6 4 2 2 1 1 2 3 4
7 4 2 2 1 2 5 3 4
$EndElements
"""
XDMF = """<Xdmf Version="3.0"><Domain><Grid Name="Grid"><Geometry GeometryType="XYZ">
<DataItem DataType="Float" Dimensions="5 3" Format="XML" Precision="8">0 0 0 1 0 0 0 1 0 0 0 1 1 1 1</DataItem>
</Geometry><Topology TopologyType="Tetrahedron" NumberOfElements="2" NodesPerElement="4">
<DataItem DataType="Int" Dimensions="2 4" Format="XML" Precision="8">0 1 2 3 1 4 2 3</DataItem>
</Topology></Grid></Domain></Xdmf>
"""


def write_mesh(path: Path, points, cells, **options) -> Path:
    meshio.Mesh(points, cells).write(path, **options)
    return path


def read_with_notes(path: Path, **options) -> tuple[Mesh, list[str]]:
    mesh = read_mesh(path, **options)
    return mesh, list(mesh.notes)


# Formats


@pytest.mark.parametrize(
    ("name", "options", "dropped"),
    [
        ("it.vtu", {}, "3 line, 44 triangle, 1 vertex"),
        ("it.vtu", {"binary": False}, "3 line, 44 triangle, 1 vertex"),
        ("it.vtk", {}, "3 line, 44 triangle, 1 vertex"),
        ("it.vtk", {"file_format": "vtk42"}, "3 line, 44 triangle, 1 vertex"),
        ("it.msh", {"file_format": "gmsh22"}, "3 line, 44 triangle, 1 vertex"),
        ("it.msh", {"file_format": "gmsh22", "binary": False}, "3 line, 44 triangle, 1 vertex"),
        ("it.mesh", {}, "3 line, 44 triangle"),  # has no vertices
        ("it.meshb", {}, "3 line, 44 triangle"),
        ("it.vol", {}, "3 line, 44 triangle, 1 vertex"),
    ],
    ids=str,
)
def test_boundary_cells_of_a_file_are_dropped_with_a_note(tmp_path, name, options, dropped, capfd):
    blocks = [("vertex", [[0]]), ("line", EDGES), ("triangle", FACES), ("tetra", TETS)]
    path = write_mesh(tmp_path / name, BOX.points, blocks, **options)
    capfd.readouterr()  # discard the output of meshio's writer
    mesh, notes = read_with_notes(path, scale=0.5)
    assert np.array_equal(mesh.cells, TETS)
    assert mesh.points == pytest.approx(0.5 * BOX.points, abs=1e-15)
    assert notes == [f"{name}: cells of lower dimension were dropped: {dropped}"]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", BOXES)
@pytest.mark.parametrize(
    ("suffix", "options"), [("inp", {}), ("msh", {"file_format": "gmsh"}), ("msh", {"binary": False})]
)
def test_cells_alone_come_back_without_a_note(tmp_path, name, suffix, options):
    mesh = BOXES[name]
    points = np.pad(mesh.points, [(0, 0), (0, 3 - mesh.dimension)])
    kind = {3: "tetra", 2: "triangle"}[mesh.dimension]
    back, notes = read_with_notes(write_mesh(tmp_path / f"it.{suffix}", points, [(kind, mesh.cells)], **options))
    assert np.array_equal(back.cells, mesh.cells) and back.points == pytest.approx(mesh.points, abs=1e-14)
    assert notes == []


@pytest.mark.parametrize("text", [GMSH_22, GMSH_41], ids=["2.2", "4.1"])
def test_gmsh_files_with_names_boundary_and_a_geometry_point(tmp_path, text, capfd):
    path = tmp_path / "it.msh"
    path.write_text(text)
    mesh, notes = read_with_notes(path)
    assert mesh.points.tolist() == TWO.tolist() and mesh.cells.tolist() == TWO_CELLS.tolist()
    assert notes[0] == "it.msh: cells of lower dimension were dropped: 1 line, 3 triangle, 1 vertex"
    assert "1 nodes that belong to no tetrahedron were removed" in notes[1] and len(notes) == 2
    assert capfd.readouterr() == ("", "")


def test_the_package_that_a_format_needs_is_named(tmp_path, in_process, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    path = tmp_path / "it.h5m"
    path.write_text("HDF5")
    with pytest.raises(MeshError, match=r"pip install h5py$"):
        read_mesh(path)


def test_xdmf_with_its_numbers_in_the_file(tmp_path):
    path = tmp_path / "it.xdmf"
    path.write_text(XDMF)
    mesh, notes = read_with_notes(path)
    assert mesh.points.tolist() == TWO.tolist() and mesh.cells.tolist() == TWO_CELLS.tolist() and notes == []


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "ascii"])
@pytest.mark.parametrize("suffix", ["vtu", "vtk"])
def test_files_written_by_pyvista(tmp_path, suffix, binary):
    import pyvista

    kinds = {pyvista.CellType.TETRA: TETS, pyvista.CellType.TRIANGLE: FACES}
    pyvista.UnstructuredGrid(kinds, BOX.points).save(tmp_path / f"it.{suffix}", binary=binary)
    mesh, notes = read_with_notes(tmp_path / f"it.{suffix}")
    assert np.array_equal(mesh.cells, TETS) and np.array_equal(mesh.points, BOX.points)
    assert notes == [f"it.{suffix}: cells of lower dimension were dropped: 44 triangle"]


# Corrections


def test_nodes_without_a_cell_are_removed_and_the_note_explains_the_numbering(tmp_path):
    points = np.insert(TWO, [0, 2], [[9.0, 9, 9], [np.nan, 0, 0]], axis=0)  # nodes 0 and 3; unused
    cells = np.array([1, 2, 4, 5, 6])[TWO_CELLS]
    mesh, notes = read_with_notes(write_mesh(tmp_path / "it.vtu", points, [("tetra", cells)]))
    assert np.array_equal(mesh.points, TWO) and np.array_equal(mesh.cells, TWO_CELLS)
    assert notes == [
        "it.vtu: 2 nodes that belong to no tetrahedron were removed, first 0; node numbers in the case and in the "
        "results count the remaining 5 from 0, in the file's order"
    ]


def test_cells_listed_twice_count_once(tmp_path):
    cells = np.concatenate([TWO_CELLS[:1], TWO_CELLS[:, [1, 2, 0, 3]], TWO_CELLS[1:]])
    mesh, notes = read_with_notes(write_mesh(tmp_path / "it.vtu", TWO, [("tetra", cells)]))
    assert mesh.rest_volumes.sum() == pytest.approx(0.5, rel=1e-14) and len(mesh.cells) == 2
    assert notes == ["it.vtu: 2 cells were listed twice and count once"]


@pytest.mark.parametrize("name", BOXES)
def test_a_mesh_that_is_mirrored_as_a_whole_is_reoriented(tmp_path, name):
    mesh = BOXES[name]
    kind = {3: "tetra", 2: "triangle"}[mesh.dimension]
    points = np.pad(mesh.points, [(0, 0), (0, 3 - mesh.dimension)])
    path = write_mesh(tmp_path / "it.vtu", points * [-1, 1, 1], [(kind, mesh.cells)])
    back, notes = read_with_notes(path)
    assert back.rest_volumes == pytest.approx(mesh.rest_volumes, rel=1e-14)
    assert np.array_equal(np.sort(back.cells, axis=1), np.sort(mesh.cells, axis=1))
    assert len(notes) == 1 and f"all {len(mesh.cells)} " in notes[0] and "reoriented" in notes[0]


@pytest.mark.parametrize("name", BOXES)
def test_cells_mirrored_by_their_numbering_are_told_from_inverted_ones(name):
    mesh = BOXES[name]
    points, cells = mesh.points.copy(), np.sort(mesh.cells, axis=1)  # as legacy FEniCS and scikit-fem number corners
    assert 0 < (signed_volumes(points, cells) < 0).sum() < len(cells)
    found, notes = orient_cells(points, cells)
    assert (signed_volumes(points, found) > 0).all() and np.array_equal(np.sort(found, axis=1), cells)
    assert len(notes) == 1 and "by their numbering" in notes[0]
    own = points[cells].reshape(-1, mesh.dimension)  # every cell with points of its own
    numbers = np.arange(len(own)).reshape(cells.shape)
    assert (signed_volumes(own, orient_cells(own, numbers)[0]) > 0).all()
    inner = np.argmin(np.abs(points - points.mean(axis=0)).max(axis=1))
    points[inner] = points[0] - 0.3 * (points.mean(axis=0) - points[0])  # a node pulled through its neighbors
    inverted = signed_volumes(points, mesh.cells) < 0
    assert inverted.any()
    found, _ = orient_cells(points, cells)
    assert (signed_volumes(points, found) < 0).any()


@pytest.mark.parametrize("bend", [0.0, 0.05])
@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh", "inp", "bdf", "xdmf"])
def test_ten_node_tetrahedra_are_read_by_their_corners_and_the_note_says_how_curved_they_are(tmp_path, suffix, bend):
    points, cells = quadratic(BOX.points, TETS)
    length = np.linalg.norm(points[cells[0, 1]] - points[cells[0, 0]])
    points[cells[0, 4], 0] += bend * length
    options = {"file_format": "gmsh"} if suffix == "msh" else {}
    mesh, notes = read_with_notes(write_mesh(tmp_path / f"it.{suffix}", points, [("tetra10", cells)], **options))
    assert np.array_equal(mesh.cells, TETS) and mesh.points == pytest.approx(BOX.points, abs=1e-11)
    assert f"{len(TETS)} tetrahedron cells of 10 nodes are simulated by their corners" in notes[0]
    assert ("lie up to 5 % of a side's length" in notes[0]) == (bend > 0)
    assert "nodes that belong to no tetrahedron were removed" in notes[1] and len(notes) == 2


def test_planar_triangles_lie_anywhere_along_z_beside_stray_nodes(tmp_path):
    points = np.array([[0.0, 0, 7], [1, 0, 7], [0, 1, 7], [3, 3, 3]])
    mesh, notes = read_with_notes(
        write_mesh(tmp_path / "it.vtu", points, [("triangle", [[0, 1, 2]]), ("line", [[0, 1]])])
    )
    assert mesh.dimension == 2 and mesh.points.tolist() == [[0, 0], [1, 0], [0, 1]]
    assert len(notes) == 2


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_planarity_does_not_depend_on_the_unit(tmp_path, scale):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0.01]])
    with pytest.raises(MeshError, match="are a surface"):
        read_mesh(write_mesh(tmp_path / "it.vtu", points * scale, [("triangle", [[0, 1, 2]])]))


def test_notes_of_the_file_reach_the_problem_and_supports_count_cleaned_nodes(tmp_path):
    points = np.insert(TWO, 0, [[9.0, 9, 9]], axis=0)
    write_mesh(tmp_path / "m.vtu", points, [("tetra", TWO_CELLS + 1), ("triangle", [[1, 2, 3]])])
    path = write_case(tmp_path, mesh={"file": "m.vtu"}, supports=[{"nodes": [4]}])
    problem = build(load_case(path).variant("polar"))
    assert [note.split(": ")[0] for note in problem.notes] == ["m.vtu", "m.vtu"]
    assert problem.body.supports.nodes.tolist() == [4]
    assert np.array_equal(problem.body.mesh.points, TWO)
    assert len(list(frames(problem))) == 5


# Refusals


@pytest.mark.parametrize(
    ("points", "blocks", "words"),
    [
        (
            TWO,
            [("triangle", [[0, 1, 2], [0, 1, 3]])],
            "triangles that do not lie in a plane of constant z are a surface",
        ),
        (
            np.random.default_rng(0).random((20, 3)),
            [("hexahedron20", [list(range(20))])],
            "has hexahedron20; tetrahedra or planar triangles are needed; split the others into tetra cells",
        ),
        (
            np.random.default_rng(0).random((6, 3)),
            [("triangle6", [list(range(6))]), ("line3", [[0, 1, 3]])],
            "are a surface",
        ),
        (
            np.concatenate([HEXAHEDRON, TWO + 4]),
            [("hexahedron", [list(range(8))]), ("tetra", TWO_CELLS + 8)],
            "has hexahedron, tetra; .* needed; split the others into tetra cells",
        ),
        (HEXAHEDRON, [("wedge", [[0, 1, 3, 4, 5, 7]])], "has wedge; .* split"),
        (HEXAHEDRON, [("quad", [[0, 1, 2, 3]])], "has quad; .* split the others into triangle cells"),
        (TWO, [("vertex", [[0]]), ("line", [[0, 1]])], "has line, vertex; tetrahedra .* are needed$"),
        (
            np.concatenate([TWO, TWO[:2] + 0.0]),
            [("tetra", [[0, 1, 2, 3], [6, 4, 2, 3], [5, 2, 1, 4]])],
            r"2 nodes lie exactly on others, first 5 on 0 at \[0.0, 0.0, 0.0\]: .* merge them",
        ),
        (
            TWO * [[1], [1], [1], [1], [0.2]],
            [("tetra", TWO_CELLS)],
            "1 inverted or flat tetrahedron cells, first 1 with",
        ),
        (TWO, [("tetra", [TWO_CELLS[0], [1, 1, 2, 3]])], "1 inverted or flat tetrahedron cells, first 1 with volume 0"),
        (np.where(TWO == 1, np.inf, TWO), [("tetra", TWO_CELLS)], r"4 points are not finite, first 1: \[inf, 0"),
        (np.where(TWO == 1, np.nan, TWO), [("tetra", TWO_CELLS)], r"4 points are not finite, first 1: \[nan, 0"),
        (TWO, [("tetra", [TWO_CELLS[0], [1, 7, 2, 3]])], "a cell refers to point 7 of 5"),
        (TWO, [("tetra", [TWO_CELLS[0], [1, -2, 2, 3]])], "a cell refers to point -2 of 5"),
    ],
    ids="surface quadratic quadratic_planar mixed wedge quad lines duplicates one_inverted repeated_node "
    "infinite nan too_high negative".split(),
)
def test_a_mesh_that_cannot_be_simulated_is_refused_in_one_line(tmp_path, points, blocks, words, capfd):
    path = write_mesh(tmp_path / "it.vtu", points, [(kind, np.array(cells)) for kind, cells in blocks])
    capfd.readouterr()
    with pytest.raises(MeshError, match=words) as caught:
        read_mesh(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh", "mesh", "inp", "bdf", "xdmf", "stl", "ply", "med", "what", ""])
@pytest.mark.parametrize("content", [b"", b"\x00\xff" * 40, b"no mesh\n"], ids=["empty", "binary", "text"])
def test_an_invalid_file_gives_a_one_line_error_and_no_output(tmp_path, suffix, content, capfd):
    path = tmp_path / (f"it.{suffix}" if suffix else "it")
    path.write_bytes(content)
    with pytest.raises(MeshError) as caught:
        read_mesh(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text and len(text) < 500 + len(str(path))
    assert content or "the file is empty" in text
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("it.vtu", {}),
        ("it.vtu", {"binary": False}),
        ("it.vtk", {}),
        ("it.msh", {"file_format": "gmsh22"}),
        ("it.msh", {"file_format": "gmsh"}),
        ("it.mesh", {}),
    ],
    ids=str,
)
def test_a_file_cut_off_anywhere_is_refused_or_still_a_mesh(tmp_path, name, options, capfd):
    data = write_mesh(tmp_path / name, BOX.points, [("tetra", TETS)], **options).read_bytes()
    capfd.readouterr()
    refused = 0
    for length in np.linspace(1, len(data) - 2, 25).astype(int):
        (tmp_path / f"cut{name}").write_bytes(data[:length])
        try:
            read_mesh(tmp_path / f"cut{name}")
        except MeshError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused >= 24  # a text file whose last digit is missing may still be one
    assert capfd.readouterr() == ("", "")


def test_points_without_cells_are_no_mesh(tmp_path):
    path = tmp_path / "it.mesh"
    path.write_text("MeshVersionFormatted 2\nDimension 3\nVertices\n1\n0 0 0 1\nEnd\n")
    with pytest.raises(MeshError, match=r"has no cells; tetrahedra or planar triangles are needed$"):
        read_mesh(path)


def test_a_folder_and_a_missing_file_are_no_mesh(tmp_path):
    for path in (tmp_path, tmp_path / "none.vtu"):
        with pytest.raises(MeshError, match="no such mesh file"):
            read_mesh(path)


def test_output_of_meshio_becomes_a_note(tmp_path, in_process, monkeypatch, capfd):
    path = write_mesh(tmp_path / "it.vol", TWO, [("tetra", TWO_CELLS)])
    real = meshio.read

    def loud(name):
        print("watch\nout")
        return real(name)

    monkeypatch.setattr(meshio, "read", loud)
    assert read_with_notes(path)[1] == ["it.vol: meshio says: watch out"]
    assert capfd.readouterr() == ("", "")


def test_a_file_that_needs_more_than_the_available_memory_is_refused(tmp_path):
    header = base64.b64encode(np.array([1 << 60], dtype=np.uint64).tobytes()).decode()
    path = write_mesh(tmp_path / "it.vtu", TWO, [("tetra", TWO_CELLS)], compression=None)
    text = path.read_text()
    start = text.index("\n", text.index("<DataArray")) + 1
    path.write_text(text[:start] + header + text[start + len(header) :])
    with pytest.raises(MeshError, match="may be too short"):
        read_mesh(path)
