"""Our own readers of meshes: Abaqus, Nastran, tetgen and Medit; known places of nodes, and all that is refused."""

import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.errors import MeshError
from pipeline.formats.meshes.mesh_readers import read_plain_mesh
from pipeline.formats.meshes.plain_mesh import PlainMesh
from pipeline.mesh.files import read_mesh

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
NODES = "*Node\n1, 0., 0., 0.\n2, 1., 0., 0.\n3, 0., 2., 0.\n4, 0., 0., 3.\n"
TET = "*Element, type=C3D4\n1, 1, 2, 3, 4\n"


def read(path, text: str) -> PlainMesh:
    path.write_text(text)
    return PlainMesh(*read_plain_mesh(path))


# Abaqus


def test_abaqus_systems_turn_nodes_until_they_end(tmp_path):
    text = f"*SYSTEM\n1, 2, 3, 1, 3, 3,\n0, 2, 3\n{NODES}*system\n*NODE\n5, 7, 8, 9\n{TET}"
    points = read(tmp_path / "it.inp", text).points
    x, y, z = np.array([0, 1.0, 0]), np.array([-1.0, 0, 0]), np.array([0, 0, 1.0])
    assert points[:4] == pytest.approx([1, 2, 3] + POINTS @ [x, y, z], abs=1e-15)
    assert points[4].tolist() == [7, 8, 9]


def test_abaqus_nodes_in_cylindrical_coordinates(tmp_path):
    text = "*Node, system=C\n1, 2., 30., 5.\n2, 1., 90.\n" + NODES.replace("\n1,", "\n11,").replace("\n2,", "\n12,")
    points = read(tmp_path / "it.inp", text + "*Element, type=C3D4\n1, 1, 2, 3, 4\n").points
    assert points[:2] == pytest.approx(np.array([[np.sqrt(3), 1, 5], [0, 1, 0]]), abs=1e-15)


def test_abaqus_instances_are_moved_and_then_turned(tmp_path):
    place = "1., 2., 3.\n1., 2., 3., 2., 4., 6., 50.\n"
    text = f'*Part, name="my part"\n{NODES}{TET}*End Part\n*Assembly, name=a\n*Instance, name=i, part=MY PART\n{place}'
    text += "*End Instance\n*Node\n1, 9., 9., 9.\n*End Assembly\n"
    mesh = read(tmp_path / "it.inp", text)
    turn = Rotation.from_rotvec(np.radians(50) * np.array([1, 2, 3]) / np.sqrt(14))
    assert mesh.points[:4] == pytest.approx(turn.apply(POINTS) + np.array([1, 2, 3]), abs=1e-14)
    assert mesh.points[4].tolist() == [9, 9, 9]  # a reference point of the assembly


def test_abaqus_nodes_and_elements_of_an_instance_itself(tmp_path):
    text = (
        f"*Part, name=p\n*End Part\n*Assembly, name=a\n*Instance, name=i, part=p\n5.,0.,0.\n{NODES}{TET}*End Instance\n"
    )
    assert read(tmp_path / "it.inp", text + "*End Assembly\n").points == pytest.approx(POINTS + np.array([5, 0, 0]))


def test_abaqus_rows_over_several_lines_and_numbers_of_fortran(tmp_path):
    text = "*Node\n" + "".join(f"{i + 1}, {x}D0, {y}, {z},\n" for i, (x, y, z) in enumerate(np.random.rand(10, 3)))
    mesh = read(tmp_path / "it.inp", text + "*Element,\n type=C3D10M\n7, 1, 2, 3, 4, 5,\n 6, 7, 8,\n9, 10\n")
    assert mesh.blocks[0][0] == "tetra10" and mesh.blocks[0][3].tolist() == [list(range(10))]


def test_abaqus_generated_nodes_lie_evenly_on_the_line(tmp_path):
    assert len(read(tmp_path / "it.inp", f"{NODES}*Ngen, nset=a\n2, 3\n{TET}").points) == 4
    text = "*Node\n1, 0.\n9, 8., 4.\n*Ngen\n9, 1, 2\n*Node\n2, 0,1\n4, 0,0,1\n*Element, type=C3D4\n1, 1, 9, 2, 4\n"
    points = read(tmp_path / "it.inp", text).points
    assert sorted(points[:, 0].tolist()) == [0, 0, 0, 2, 4, 6, 8]


@pytest.mark.parametrize("kind", ["C3D4", "C3D4H", "c3d4t", "DC3D4", "AC3D4", "C3D4P"])
def test_abaqus_types_of_linear_tetrahedra(tmp_path, kind):
    assert read(tmp_path / "it.inp", NODES + TET.replace("C3D4", kind)).blocks[0][:3] == ("tetra", 3, 1)


@pytest.mark.parametrize(
    ("kind", "count", "cell", "dimension"),
    [
        ("CPS3", 3, "triangle", 2), ("CPE4RH", 4, "quad", 2), ("CPEG6", 6, "triangle6", 2), ("DC2D8", 8, "quad8", 2),
        ("S3R", 3, "triangle", 2), ("S8R5", 8, "quad8", 2), ("STRI65", 6, "triangle6", 2), ("R3D4", 4, "quad", 2),
        ("M3D3", 3, "triangle", 2), ("C3D8R", 8, "hexahedron", 3), ("C3D20RH", 20, "hexahedron20", 3),
        ("C3D15", 15, "wedge15", 3), ("SC6R", 6, "wedge", 3), ("COH3D8", 8, "COH3D8", 3), ("B31H", 2, "line", 1),
        ("B22", 3, "line3", 1), ("T3D2", 2, "line", 1), ("SPRINGA", 2, "line", 1), ("MASS", 1, "vertex", 0),
        ("CONN3D2", 2, "line", 1),
    ],
)  # fmt: skip
def test_abaqus_types_of_other_elements(tmp_path, kind, count, cell, dimension):
    nodes = "".join(f"{i}, {i}.\n" for i in range(1, count + 1))
    row = ", ".join(map(str, range(1, count + 1)))
    mesh = read(tmp_path / "it.inp", f"*Node\n{nodes}*Element, type={kind}\n1, {row}\n")
    assert mesh.blocks[0][:3] == (cell, dimension, 1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{NODES}*Nfill\n1, 2, 3\n{TET}", r"line 6: \*NFILL is not read, and it changes the mesh"),
        (f"{NODES}*Ncopy, change number=5\n{TET}", r"\*NCOPY is not read"),
        (f"{NODES}{TET}*Elgen\n1, 3\n", r"\*ELGEN is not read"),
        (f"{NODES}{TET}*El copy, old set=a\n", r"\*ELCOPY is not read"),
        (f"{NODES}{TET}*Imperfection, file=a\n", r"\*IMPERFECTION is not read"),
        (f"*Parameter\na = 1\n{NODES}{TET}", r"\*PARAMETER is not read"),
        (f"*Node, system=S\n1, 1, 2, 3\n{TET}", "spherical"),
        (f"{NODES}*Element, type=CAX3\n1, 1, 2, 3\n", r"axisymmetric elements \(CAX3\)"),
        (f"{NODES}*Element, type=XYZ3\n1, 1, 2, 3\n", "type XYZ3, which is not known"),
        (f"{NODES}*Element\n1, 1, 2, 3\n", "type none"),
        (f"*Part, name=a\n{NODES}{TET}*End Part\n", r"1 parts, but no \*INSTANCE"),
        (f"*Instance, name=i, part=b\n{NODES}{TET}", "of part B, which is not defined"),
        (f"*Instance, library=old, instance=b\n{NODES}{TET}", "another analysis"),
        ("*Include, input=none.inp\n", "needs none.inp, which is not there"),
        (f"*Include, input=it.inp\n{NODES}{TET}", "more than 10 deep"),
        (f"{NODES}*Include, input=b.inp\n5, 1., 1., 1.\n{TET}", "among the data lines"),
        (f"{NODES}*Node\n2, 5., 5., 5.\n{TET}", "node 2 is defined twice, at different places"),
        (f"{NODES}{TET}2, 1, 2, 3, 9\n", "C3D4 element of the file names node 9, which is not defined"),
        (f"{NODES}{TET}2, 1, 2, 3\n", "ends within a row of 5 numbers"),
        (f"{NODES}{TET}2, 1, 2, 3, 4, 1\n", "a row of 6 numbers; 5 are needed"),
        (f"{NODES}5, 1., abc\n{TET}", "not numbers: 5, 1., abc"),
        (f"{NODES}*Ngen, line=C\n1, 3\n{TET}", "along a curve"),
        (f"{NODES}*Ngen\n1, 4, 2\n{TET}", "from 1 to 4 in steps of 2 is not possible"),
        (f"*System\n0, 0, 0, 1, 0, 0, 2, 0, 0\n{NODES}{TET}", "points on one line"),
        (f"{NODES}*Element, type=C3D4\n1, a-1.1, a-1.2, a-1.3, a-1.4\n", "names nodes of instances"),
        ("1, 2, 3\n", "comes before any keyword"),
    ],
)  # fmt: skip
def test_abaqus_files_that_are_not_understood_are_refused(tmp_path, text, words):
    (tmp_path / "b.inp").write_text("5, 0., 0., 0.\n")
    with pytest.raises(MeshError, match=words) as caught:
        read(tmp_path / "it.inp", text)
    assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)


def test_abaqus_materials_sets_and_connections_are_told(tmp_path):
    path = tmp_path / "it.inp"
    two = NODES + "*Element, type=C3D4, elset=A\n1, 1, 2, 3, 4\n*Node\n5, 1, 1, 1\n"
    two += "*Element, type=C3D4, elset=B\n2, 2, 5, 3, 4\n*Tie, name=t\na, b\n"
    path.write_text(two)
    assert read_mesh(path).notes == (
        "it.inp: connections are not read: *TIE",
        "it.inp: 2 regions (A, B) get the one material of the case",
    )
    path.write_text(two + "*Solid section, elset=A, material=STEEL\n*Solid Section, elset=B, material=RUBBER\n")
    assert "it.inp: 2 regions (STEEL, RUBBER) get the one material of the case" in read_mesh(path).notes


# Nastran

GRIDS = "GRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\nGRID,3,,0.,2.,0.\nGRID,4,,0.,0.,3.\n"
CTETRA = "CTETRA,1,7,1,2,3,4\n"


@pytest.mark.parametrize(
    "text",
    [
        "GRID    1               0.      0.      0.\nGRID    2               1.      0.      0.\n"
        "grid    3               .0      2.+0    0.\nGRID    4               0.      0.      3.0\n"
        "CTETRA  1       7       1       2       3       4\n",
        GRIDS + CTETRA,
        f"$ comment\nSOL 101\nBEGIN BULK\n{GRIDS}{CTETRA}ENDDATA\njunk\n",
        "GRID*                  1                              0.              0.*\n*                     0.\n"
        "GRID*                  2                             1.0              0.*\n*                     0.\n"
        "GRID*                  3                              0.           2.0D0*\n*                     0.\n"
        "GRID*                  4                              0.              0.*\n*                   30-1\n"
        + CTETRA,
    ],
    ids=["small", "free", "head", "large"],
)  # fmt: skip
def test_nastran_fields_of_every_form(tmp_path, text):
    mesh = read(tmp_path / "it.bdf", text)
    assert mesh.points == pytest.approx(POINTS, abs=1e-15)
    assert mesh.blocks[0][0] == "tetra" and mesh.blocks[0][3].tolist() == [[0, 1, 2, 3]]


def test_nastran_coordinate_systems_are_understood(tmp_path):
    turned = "CORD2R,1,,1.,2.,3.,1.,2.,4.\n,1.,3.,3.\n"  # origin 1 2 3, z along z, x along global y
    ring = "CORD2C,2,1,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"  # cylindrical in system 1
    ball = "CORD2S,3,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
    grids = "GRID,1,1,1.,0.,0.\nGRID,2,2,2.,90.,5.\nGRID,3,3,2.,90.,90.\nGRID,4,0,0.,0.,0.,3\n"
    points = read(tmp_path / "it.bdf", turned + ring + ball + grids + CTETRA).points
    assert points == pytest.approx(np.array([[1, 3, 3], [-1, 2, 8], [0, 2, 0], [0, 0, 0]]), abs=1e-14)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GRIDS.replace("GRID,2,,", "GRID,2,5,") + CTETRA, "coordinate system 5 is missing"),
        ("CORD2R,5,5,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\nGRID,1,5,1.,0.,0.\n", "refers to itself"),
        ("CORD1R,5,1,2,3\n" + GRIDS + CTETRA, "CORD1R is not read"),
        ("GRDSET,,5\n" + GRIDS + CTETRA, "GRDSET is not read"),
        ("CORD2R,5,,0.,0.,0.,0.,0.,1.\n,0.,0.,2.\n" + GRIDS + CTETRA, "points on one line"),
        (GRIDS + "CTETRA,1,7,1,2,3\n", "CTETRA 1 has 3 nodes"),
        (GRIDS + "CTETRA,1,7,1,2,3,9\n", "names node 9, which is not defined"),
        (GRIDS + "GRID,2,,5.,0.,0.\n" + CTETRA, "GRID 2 is defined twice"),
        (GRIDS + "CTRIAX6,1,7,1,2,3\n", "axisymmetric"),
        (GRIDS + "INCLUDE 'none.bdf'\n", "needs none.bdf, which is not there"),
        ("+,1,2\n" + GRIDS, "continues nothing"),
        ("GRID,1,,a,0.,0.\n", "3 numbers are needed"),
        (CTETRA, "has no GRID card"),
    ],
)  # fmt: skip
def test_nastran_files_that_are_not_understood_are_refused(tmp_path, text, words):
    with pytest.raises(MeshError, match=words):
        read(tmp_path / "it.bdf", text)


def test_nastran_included_files_properties_and_connections(tmp_path):
    (tmp_path / "grids.bdf").write_text(GRIDS + "GRID,5,,1.,1.,1.\n")
    path = tmp_path / "it.bdf"
    path.write_text(
        f"INCLUDE 'grids.bdf'\n{CTETRA}CTETRA,2,8,2,5,3,4\nCBAR,3,1,1,2\nRBE2,9,1,123,2,3\nCELAS1,4,1,1,1\n"
    )
    assert read_mesh(path).notes == (
        "it.bdf: connections are not read: 1 CELAS1, 1 RBE2",
        "it.bdf: 2 regions (property 7, property 8) get the one material of the case",
        "it.bdf: cells of lower dimension were dropped: 1 line",
    )


# tetgen and Medit


def test_medit_cells_of_second_order_are_read_with_all_nodes(tmp_path):
    vertices = "Vertices 10\n" + "".join(f"{x} {y} {z} 0\n" for x, y, z in np.random.default_rng(0).random((10, 3)))
    text = f"MeshVersionFormatted 2\nDimension 3\n{vertices}TetrahedraP2 1\n1 2 3 4 5 6 7 8 9 10 3\nEnd\n"
    mesh = read(tmp_path / "it.mesh", text)
    assert mesh.blocks[0][0] == "tetra10" and mesh.blocks[0][3].tolist() == [list(range(10))] and not mesh.notes


@pytest.mark.parametrize(
    ("node", "ele", "words"),
    [
        ("4 3 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n", "0 4 0\n", "declares 4 rows and has 3"),
        ("1 3 0 0\n5 0 0 0\n", "1 4 0\n5 5 5 5 5\n", "not counted from 0 or 1"),
        ("1 3 0 0\n0 0 0 0\n", "1 8 0\n0 0 0 0 0 0 0 0 0\n", "cells of 8 nodes"),
        ("no table\n", "0 4 0\n", "not a table of tetgen"),
        ("1 3 0 0\n0 0 0 0\n", None, "is missing; tetgen's meshes are pairs"),
    ],
)
def test_tetgen_files_that_do_not_fit_are_refused(tmp_path, node, ele, words):
    (tmp_path / "it.node").write_text(node)
    if ele:
        (tmp_path / "it.ele").write_text(ele)
    with pytest.raises(MeshError, match=words):
        read_plain_mesh(tmp_path / "it.node")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("4\n0 0 0 7", "5\n0 0 0 7"), "5 Vertices need 20 numbers; there are 16"),
        (("Tetrahedra 1", "TetrahedraP3 1"), "TETRAHEDRAP3 are not read"),
        (("End", ""), "cut off"),
        (("Vertices", "Points"), "not Medit's"),
        (("Tetrahedra 1", "Vertices 1"), "Vertices twice"),
    ],
)  # fmt: skip
def test_medit_files_that_do_not_fit_are_refused(tmp_path, change, words):
    text = "MeshVersionFormatted 2 # comment\nDimension\n3\nVertices\n4\n0 0 0 7\n1 0 0 7\n0 2 0 7\n0 0 3 7\n"
    text += "Tetrahedra 1\n1 2 3 4 5\nEnd\n"
    assert read(tmp_path / "it.mesh", text).points.tolist() == POINTS.tolist()
    with pytest.raises(MeshError, match=words):
        read(tmp_path / "it.mesh", text.replace(*change))


# Formats that meshio reads only in part


@pytest.mark.parametrize(
    ("suffix", "change", "words"),
    [
        ("tec", lambda text: text + text[text.index("ZONE") :], "has 2 zones, of which meshio reads one"),
        ("su2", lambda text: text + text, "has 2 zones, of which meshio reads one"),
        ("dato", lambda text: text.replace("$COOR", "$COOR\n1 0 0 0\n$COOR", 1), r"has 2 \$COOR sections"),
        ("mdpa", lambda text: text.replace("\n 2 ", "\n 5 ", 1), "node 2 has the number 5"),
    ],
)
def test_files_that_meshio_reads_only_in_part_are_refused(tmp_path, suffix, change, words):
    path = tmp_path / f"it.{suffix}"
    points = np.vstack([POINTS, [[1, 2, 3]]])
    meshio.Mesh(points, [("tetra", [[0, 1, 2, 3], [1, 4, 2, 3]])]).write(path)
    text = path.read_text()
    assert len(read(path, text).points) == 5
    assert change(text) != text
    with pytest.raises(MeshError, match=words):
        read(path, change(text))
