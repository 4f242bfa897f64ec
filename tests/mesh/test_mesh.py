"""Meshes: structured, from files of several formats, their quality and boundary, and every refusal."""

import meshio
import numpy as np
import pytest

from pipeline.errors import MeshError
from pipeline.mesh import shapes
from pipeline.mesh.files import read_mesh
from pipeline.mesh.quadratic import raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh, label_components, measure_quality
from pipeline.mesh.surface import find_boundary_faces, outward_areas
from tests.bodies import BOXES, make_thesis_bar

TET = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
ONE = np.array([[0, 1, 2, 3]])


@pytest.mark.parametrize("split", ["kuhn", "alternating"])
def test_the_thesis_bar_has_its_counts_and_tets_of_one_cubic_meter(split):
    mesh = make_thesis_bar(split)
    assert mesh.points.shape == (81, 3) and mesh.cells.shape == (192, 4)
    assert mesh.rest_volumes == pytest.approx(np.ones(192), rel=1e-14)


@pytest.mark.parametrize("name", BOXES)
def test_cells_fill_the_box_and_meet_face_to_face(name):
    mesh = BOXES[name]
    d = mesh.dimension
    assert mesh.rest_volumes.sum() == pytest.approx(6.0, rel=1e-14)
    assert mesh.node_volumes.sum() == pytest.approx(6.0, rel=1e-14)
    faces, owners = find_boundary_faces(mesh)
    areas = outward_areas(mesh.points, faces)
    # a split that does not match across two cells would count inner faces as boundary
    assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(22.0 if d == 3 else 10.0, rel=1e-14)
    assert np.abs(areas.sum(axis=0)).max() < 1e-14  # closed
    centers = mesh.points[mesh.cells[owners]].mean(axis=1)
    assert (((mesh.points[faces].mean(axis=1) - centers) * areas).sum(axis=1) > 0).all()  # outward


def test_kuhn_cuts_every_cell_along_one_diagonal():
    mesh = box((1.0, 1.0, 1.0), (1, 1, 1))
    assert all({0, 7} <= set(cell) for cell in mesh.cells.tolist())
    assert len(mesh.cells) == 6


@pytest.mark.parametrize(
    ("points", "wanted"),
    [
        (np.array([[0.0, 0], [1, 0], [0.5, 3**0.5 / 2]]), 1.0),
        (np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]), 1.0),
        (TET, 3**0.5 - 1),  # 3r/R of the corner of a cube: r = (3 - sqrt 3)/6, R = sqrt 3 / 2
        (np.array([[0.0, 0], [1, 0], [0, 1]]), 2 * (2**0.5 - 1)),
    ],
    ids=["regular_triangle", "regular_tet", "corner_tet", "right_triangle"],
)
def test_quality_is_the_ratio_of_the_radii(points, wanted):
    cells = np.arange(len(points))[None]
    if np.linalg.det(points[1:] - points[0]) < 0:
        cells[:, -2:] = cells[:, :-3:-1].copy()
    for scale in (1e-6, 1.0, 1e6):
        assert measure_quality(Mesh(scale * points, cells)) == pytest.approx([wanted], rel=1e-12)


def test_components_are_distinguished():
    two = Mesh(np.concatenate([TET, TET + 5]), np.concatenate([ONE, ONE + 4]))
    count, labels = label_components(two)
    assert count == 2 and labels.tolist() == [0] * 4 + [1] * 4
    assert label_components(make_thesis_bar())[0] == 1


def test_a_mesh_cannot_be_changed():
    mesh = box((1.0, 1.0, 1.0), (1, 1, 1))
    for array in (mesh.points, mesh.cells):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@pytest.mark.parametrize(
    ("points", "cells", "words"),
    [
        (TET, ONE[:, [1, 0, 2, 3]], "1 inverted or flat tetrahedron cells, first 0 with volume -0.167"),
        (TET * [1, 1, 0], ONE, "inverted or flat"),
        (TET, ONE + 1, "a cell names node 4 of 4"),
        (TET, ONE - 1, "a cell names node"),
        (np.where(TET == 1, np.nan, TET), ONE, "a point is not finite"),
        (TET, ONE[:0], "no tetrahedron"),
        (TET, ONE[:, :3], "not a simplex mesh"),
        (TET[:, :1], ONE[:, :2], "not a simplex mesh"),
    ],
    ids=["inverted", "flat", "too_high", "negative", "nan", "none", "surface", "line"],
)
def test_a_mesh_that_cannot_be_simulated_is_refused(points, cells, words):
    with pytest.raises(MeshError, match=words):
        Mesh(points, cells, name="it")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: box((1.0, 1.0), (1, 1)), "a box takes 3 sizes and 3 cell counts"),
        (lambda: rectangle((1.0, 1.0, 1.0), (1, 1, 1)), "a rectangle takes 2 sizes"),
        (lambda: box((1.0, 1.0, 1.0), (1, 1, 1), "delaunay"), "'delaunay' is not one of kuhn, alternating"),
    ],
    ids=["planar_box", "solid_rectangle", "split"],
)
def test_a_wrong_argument_of_a_shape_is_named(make, words):
    with pytest.raises(MeshError, match=words):
        make()


# Files


def write_mesh(path, points, cells):
    meshio.Mesh(points, cells).write(path)
    return path


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh", "inp", "mesh"])
@pytest.mark.parametrize("name", BOXES)
def test_files_written_by_meshio_are_read_back(tmp_path, name, suffix):
    mesh = BOXES[name]
    kind = {3: "tetra", 2: "triangle"}[mesh.dimension]
    points = np.pad(mesh.points, [(0, 0), (0, 3 - mesh.dimension)])
    back = read_mesh(write_mesh(tmp_path / f"it.{suffix}", points, [(kind, mesh.cells)]), scale=2.0)
    assert np.array_equal(back.cells, mesh.cells)
    assert back.points == pytest.approx(2 * mesh.points, abs=1e-14)


def test_boundary_triangles_lines_and_vertices_of_a_tet_mesh_are_dropped(tmp_path):
    blocks = [("vertex", [[0]]), ("line", [[0, 1]]), ("triangle", [[0, 1, 2]]), ("tetra", ONE)]
    assert np.array_equal(read_mesh(write_mesh(tmp_path / "it.vtu", TET, blocks)).cells, ONE)


def test_triangles_in_a_plane_off_zero_are_planar(tmp_path):
    points = np.array([[0.0, 0, 7], [1, 0, 7], [0, 1, 7]])
    mesh = read_mesh(write_mesh(tmp_path / "it.vtu", points, [("triangle", [[0, 1, 2]])]))
    assert mesh.dimension == 2 and mesh.points.tolist() == [[0, 0], [1, 0], [0, 1]]


HEXAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])


@pytest.mark.parametrize(
    ("points", "blocks", "words"),
    [
        (TET, [("triangle", [[0, 1, 2], [0, 1, 3]])], "surface; fill it with tetrahedron cells"),
        (TET, [("tetra", ONE[:, [1, 0, 2, 3]])], "1 inverted or flat tetrahedron cells"),
        (np.concatenate([TET, TET + 5]), [("tetra", [[0, 1, 2, 3], [5, 4, 6, 7]])], "1 inverted or flat"),
        (HEXAHEDRON, [("hexahedron", [list(range(8))])], "has hexahedron; tetrahedra"),
        (np.random.default_rng(0).random((20, 3)), [("hexahedron20", [list(range(20))])], "has hexahedron20"),
        (TET, [("line", [[0, 1]])], "has line; tetrahedra or planar triangles are needed"),
    ],
    ids=["surface", "inverted", "one_of_two_inverted", "hexahedra", "quadratic", "lines"],
)
def test_a_mesh_file_that_cannot_be_simulated_is_refused_by_name(tmp_path, points, blocks, words):
    path = write_mesh(tmp_path / "it.vtu", points, blocks)
    with pytest.raises(MeshError, match=words) as caught:
        read_mesh(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["junk.vtu", "junk.vtk", "junk.msh", "junk.stl", "junk.xdmf", "junk.what", "none.vtu"])
def test_a_file_that_is_no_mesh_gives_a_one_line_error_and_no_output(tmp_path, name, capfd):
    path = tmp_path / name
    if "junk" in name:
        path.write_text("this is no mesh\n")
    with pytest.raises(MeshError) as caught:
        read_mesh(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_shape_larger_than_the_memory_is_refused_before_it_is_built(monkeypatch):
    monkeypatch.setattr("pipeline.system.memory.read_free_bytes", lambda: 1e6)
    with pytest.raises(MeshError, match=r"6000 cells take 0.00162 GB to build and more to solve; 0.001 GB of memory"):
        shapes.box((1, 1, 1), (10, 10, 10))
    monkeypatch.undo()
    with pytest.raises(MeshError, match="take fewer cells"):
        shapes.box((1, 1, 1), (2**31 - 1, 2**31 - 1, 1))


@pytest.mark.parametrize("size", [1e40, 1e200, np.inf, np.nan])
def test_a_mesh_too_large_for_its_numbers_is_refused(size):
    with pytest.raises(MeshError, match=r"not finite, or farther than 1e\+30"):
        Mesh(np.array([[0, 0, 0], [size, 0, 0], [0, 1, 0], [0, 0, 1.0]]), np.array([[0, 1, 2, 3]]))


def test_a_mesh_of_order_two_larger_than_the_memory_is_refused(monkeypatch):
    mesh = box((1, 1, 1), (2, 2, 2))
    monkeypatch.setattr("pipeline.system.memory.read_free_bytes", lambda: 5e4)
    with pytest.raises(MeshError, match=r"48 cells take 9.12e-05 GB .*; take fewer cells or mesh.order = 1"):
        raise_order(mesh)
