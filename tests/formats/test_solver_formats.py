"""Solvers' files that VTK reads: hand-written in the documented layouts, with known points, cells and displacements."""

import h5py
import numpy as np
import pytest
import pyvista

from pipeline.errors import SeriesError
from pipeline.mesh.shapes import box
from pipeline.run.measures import measure
from pipeline.series import read_series
from pipeline.series.files.frame_files import read_grid, read_times
from tests.formats.solver_files import write_cgns, write_d3plot, write_ensight, write_exodus, write_openfoam

MESH = box((2.0, 1.0, 1.0), (2, 1, 1))
X, CELLS = MESH.points, MESH.cells
HALF = len(CELLS) // 2
HEX_POINTS = np.array([(i, j, k) for k in range(2) for j in range(2) for i in range(3)], dtype=float)
HEXAHEDRA = np.array([[0, 1, 4, 3, 6, 7, 10, 9], [1, 2, 5, 4, 7, 8, 11, 10]])
TIMES = [0.0, 0.125, 0.25]
STRETCHES = (0.0, 0.25, 0.5)  # exact in single precision


def stretch(points):
    """Return the displacements of all times."""
    return [s * points * [1, 0, 0] for s in STRETCHES]


def list_hexahedron_faces(c):
    return [(c[0], c[3], c[2], c[1]), (c[4], c[5], c[6], c[7]), (c[0], c[1], c[5], c[4]),
            (c[3], c[7], c[6], c[2]), (c[0], c[4], c[7], c[3]), (c[1], c[2], c[6], c[5])]  # fmt: skip


def write_foam(folder):
    """Write two hexahedra, the second with a face cut in two: a polyhedron of seven faces."""
    owners = {}
    for cell, nodes in enumerate(HEXAHEDRA.tolist()):
        for face in list_hexahedron_faces(nodes):
            owners.setdefault(frozenset(face), []).append((face, cell))
    inner = [pair for pair in owners.values() if len(pair) == 2]
    outer = [pair[0] for pair in owners.values() if len(pair) == 1]
    (a, b, c, d), cell = outer.pop()
    outer += [((a, b, c), cell), ((a, c, d), cell)]
    faces = [pair[0] for pair in inner] + outer
    displacements = {str(t): u for t, u in zip(TIMES, stretch(HEX_POINTS), strict=True)}
    neighbors = [pair[1][1] for pair in inner]
    return write_openfoam(
        folder, HEX_POINTS, [face for face, _ in faces], [owner for _, owner in faces], neighbors, displacements
    )


def write_parts(folder):
    blocks = [("tetra4", np.unique(cells), cells) for cells in (CELLS[:HALF], CELLS[HALF:])]
    return write_ensight(folder, X, blocks, TIMES, {"disp": stretch(X)})


def write_states(folder):
    positions = [HEX_POINTS + u for u in stretch(HEX_POINTS)]
    return write_d3plot(folder, HEX_POINTS, HEXAHEDRA, positions, TIMES)


def write_blocks(path, kinds=("TETRA", "TETRA4")):
    u = np.array(stretch(X))
    nodal = {f"DISPL{axis}": u[:, :, i] for i, axis in enumerate("XYZ")} | {"T": [X[:, 1]] * 3}
    fields = {"e": [np.arange(len(CELLS)) + 100.0 * k for k in range(3)]}
    return write_exodus(path, X, [(kinds[0], CELLS[:HALF]), (kinds[1], CELLS[HALF:])], TIMES, nodal, fields)


WRITERS = {
    "exodus": (lambda folder: write_blocks(folder / "bar.e"), X, CELLS, "DISPL"),
    "exodus by another suffix": (lambda folder: write_blocks(folder / "bar.exo"), X, CELLS, "DISPL"),
    "ensight": (write_parts, X, CELLS, "disp"),
    "cgns": (
        lambda folder: write_cgns(folder / "bar.cgns", X, CELLS, TIMES, {"Displacement": stretch(X)}),
        X, CELLS, "Displacement",
    ),
    "openfoam": (write_foam, HEX_POINTS, None, "pointDisplacement"),
    "d3plot": (write_states, HEX_POINTS, HEXAHEDRA, "Deflection"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_points_cells_times_and_displacements(tmp_path, name):
    write, points, cells, field = WRITERS[name]
    path = write(tmp_path)
    assert list(read_times(path).values) == TIMES
    for k, u in enumerate(stretch(points)):
        grid = read_grid(path, k)
        shift = u if name == "d3plot" else 0 * u  # its points move
        corners = grid.points[grid.connectivity]
        if cells is not None:
            assert np.allclose(corners, (points + shift)[cells].reshape(-1, 3), atol=1e-6)
        rest = grid.points - (grid.point_data[field] if name == "d3plot" else 0)
        nodes = [int(np.flatnonzero(np.abs(points - x).max(axis=1) < 1e-6)[0]) for x in rest]
        assert np.allclose(grid.point_data[field], u[nodes], atol=1e-6)


def test_blocks_of_exodus_share_their_points(tmp_path):
    """Points are told by their numbers: two at one place stay two, which a position could not tell."""
    points = np.concatenate([X, X])  # a second body at the same place
    cells = [("TETRA", CELLS), ("TETRA", CELLS + len(X))]
    grid = read_grid(write_exodus(tmp_path / "a.e", points, cells, [0.0], {"T": [points[:, 0]]}), 0)
    assert grid.count == 2 * len(X) and np.array_equal(grid.points, points) and grid.parts == ()
    assert np.array_equal(grid.connectivity.reshape(-1, 4), np.concatenate([CELLS, CELLS + len(X)]))
    assert grid.point_data["GlobalNodeId"].tolist() == list(range(500, 500 + len(points)))
    assert grid.cell_data["GlobalElementId"].tolist() == list(range(100, 100 + 2 * len(CELLS)))
    assert grid.cell_data["ObjectId"].tolist() == [10] * len(CELLS) + [20] * len(CELLS)


def test_parts_of_ensight_are_told(tmp_path):
    grid = read_grid(write_parts(tmp_path), 0)
    assert grid.parts == (8, 8) and grid.part_names == ("block1", "block2")


def test_polyhedra_of_openfoam_have_their_faces(tmp_path):
    grid = read_grid(write_foam(tmp_path), 1)
    assert sorted(grid.types.tolist()) == [12, 42] and np.diff(grid.offsets).tolist() == [8, 8]
    faces = grid.faces
    assert faces is not None and np.diff(faces.cell_offsets).tolist() == [0, 7]
    assert sorted(np.diff(faces.offsets).tolist()) == [3, 3, 4, 4, 4, 4, 4]
    area = np.zeros(3)
    volume = 0.0
    for start, end in zip(faces.offsets[:-1], faces.offsets[1:], strict=True):
        corners = grid.points[faces.connectivity[start:end]]
        for i in range(1, len(corners) - 1):
            normal = np.cross(corners[i] - corners[0], corners[i + 1] - corners[0]) / 2
            area += normal
            volume += normal @ corners[0] / 3
    assert area == pytest.approx(np.zeros(3), abs=1e-12) and volume == pytest.approx(1)


def test_polyhedra_of_vtu_files_have_their_faces(tmp_path):
    cube = pyvista.ImageData(dimensions=(2, 2, 2)).cast_to_unstructured_grid()
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    cells = np.array([31, 6, *[n for face in faces for n in (4, *face)], 4, 0, 1, 2, 4])
    grid = pyvista.UnstructuredGrid(cells, np.array([42, 10], dtype=np.uint8), np.array(cube.points, dtype=float))
    grid.save(tmp_path / "a.vtu")
    read = read_grid(tmp_path / "a.vtu")
    assert read.types.tolist() == [42, 10] and read.faces is not None
    assert read.faces.cell_offsets.tolist() == [0, 6, 6]
    assert read.faces.connectivity.tolist() == [n for face in faces for n in face]


@pytest.mark.parametrize("suffix", ["vti", "vtr", "vts"])
def test_structured_grids_have_cells(tmp_path, suffix):
    image = pyvista.ImageData(dimensions=(3, 2, 2), spacing=(1.0, 1.0, 1.0))
    grids = {"vti": image, "vtr": image.cast_to_rectilinear_grid(), "vts": image.cast_to_structured_grid()}
    grids[suffix]["n"] = np.arange(12.0)
    grids[suffix].save(tmp_path / f"a.{suffix}")
    grid = read_grid(tmp_path / f"a.{suffix}")
    assert grid.points == pytest.approx(HEX_POINTS) and grid.point_data["n"].tolist() == list(range(12))
    order = [0, 1, 3, 2, 4, 5, 7, 6] if grid.types[0] == 11 else range(8)
    assert np.array_equal(grid.connectivity.reshape(-1, 8)[:, list(order)], HEXAHEDRA)


def write_vtkhdf(path, parts):
    """Write one instant of tetrahedra in partitions, as VTK documents it."""
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF", track_order=True)
        root.attrs["Version"] = np.array([2, 0], dtype="i8")
        kind = np.array(b"UnstructuredGrid", dtype="S16")
        root.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", 16))
        root["NumberOfPoints"] = np.array([len(points) for points, _ in parts], dtype="i8")
        root["NumberOfCells"] = np.array([len(cells) for _, cells in parts], dtype="i8")
        root["NumberOfConnectivityIds"] = np.array([cells.size for _, cells in parts], dtype="i8")
        root["Points"] = np.concatenate([points for points, _ in parts])
        root["Connectivity"] = np.concatenate([cells.ravel() for _, cells in parts])
        root["Offsets"] = np.concatenate([4 * np.arange(len(cells) + 1) for _, cells in parts])
        root["Types"] = np.full(sum(len(cells) for _, cells in parts), 10, dtype="u1")
    return path


@pytest.mark.parametrize("suffix", ["vtkhdf", "hdf"])
def test_partitions_of_vtkhdf(tmp_path, suffix):
    halves = [(X[np.unique(c)], np.searchsorted(np.unique(c), c)) for c in (CELLS[:HALF], CELLS[HALF:])]
    grid = read_grid(write_vtkhdf(tmp_path / f"a.{suffix}", halves))
    assert grid.parts == (8, 8)
    assert np.array_equal(grid.points[grid.connectivity], X[CELLS.ravel()])


def test_trees_of_blocks_in_vtkhdf(tmp_path):
    from vtkmodules.vtkIOHDF import vtkHDFWriter

    halves = [(X[np.unique(c)], np.searchsorted(np.unique(c), c)) for c in (CELLS[:HALF], CELLS[HALF:])]
    blocks = pyvista.MultiBlock({
        name: pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells}, points)
        for name, (points, cells) in zip(("left", "right"), halves, strict=True)
    })  # fmt: skip
    writer = vtkHDFWriter()
    writer.SetFileName(str(tmp_path / "a.vtkhdf"))
    writer.SetInputData(blocks)
    writer.Write()
    grid = read_grid(tmp_path / "a.vtkhdf")
    assert grid.parts == (8, 8) and grid.part_names == ("left", "right")
    assert np.array_equal(grid.points[grid.connectivity], X[CELLS.ravel()])


@pytest.mark.parametrize("name", WRITERS)
def test_volume_ratios_are_the_stretches(tmp_path, name):
    series = read_series(WRITERS[name][0](tmp_path))
    assert series.times == tuple(TIMES)
    for frame, s in zip(series, STRETCHES, strict=True):
        measured = measure(frame)
        assert measured["volume_ratio"] == pytest.approx(1 + s, rel=2e-6)
        assert measured["total_volume"] == pytest.approx(2 * (1 + s), rel=2e-6)


@pytest.mark.parametrize(("name", "file"), [("openfoam", "0.125/pointDisplacement"), ("ensight", "disp.0001")])
def test_an_instant_without_its_displacement_has_no_numbers(tmp_path, name, file):
    path = WRITERS[name][0](tmp_path)
    stray = np.random.default_rng(1).bytes((tmp_path / file).stat().st_size)
    (tmp_path / file).write_bytes(stray)
    frames = list(read_series(path))
    assert "no point field" in frames[1].fault and np.isnan(frames[1].x).all()
    assert measure(frames[2])["volume_ratio"] == pytest.approx(1.5, rel=2e-6)


def test_a_series_of_exodus_is_measured(tmp_path):
    series = read_series(write_blocks(tmp_path / "bar.e"), displacement="DISPL")
    assert series.times == tuple(TIMES) and series.name == "bar"
    for frame, s in zip(series, STRETCHES, strict=True):
        assert np.allclose(frame.x, X * [1 + s, 1, 1])


@pytest.mark.parametrize("name", WRITERS)
def test_damaged_files_are_one_line_or_read_as_they_were(tmp_path, name):
    """A field that is missing as a whole is told later: where it is needed."""
    path = WRITERS[name][0](tmp_path)
    files = [file for file in sorted(tmp_path.rglob("*")) if file.is_file() and file.stat().st_size]
    right = {step: read_grid(path, step) for step in (0, 2)}
    refused = 0
    for file in files:
        whole = file.read_bytes()
        stray = np.random.default_rng(1).bytes(len(whole))
        for content in (whole[: len(whole) // 2], whole[: len(whole) * 9 // 10], b"", stray):
            file.write_bytes(content)
            for step in (0, 2):
                try:
                    grid = read_grid(path, step)
                except SeriesError as error:
                    refused += 1
                    assert str(error).startswith(str(path)) and "\n" not in str(error)
                    continue
                assert np.array_equal(grid.points, right[step].points)
                assert np.array_equal(grid.connectivity, right[step].connectivity)
                for field, values in grid.point_data.items():
                    assert np.array_equal(values, right[step].point_data[field]), file
        file.write_bytes(whole)
    assert refused > 2
    read_grid(path, 2)


def test_restarts_of_exodus_are_told(tmp_path):
    """With another mesh from some time on, MOOSE begins another file."""
    path = write_blocks(tmp_path / "out.e")
    assert read_grid(path, 0).notes == ()
    restart = write_blocks(tmp_path / "out.e-s002")
    assert any("out.e-s002" in note for note in read_grid(path, 0).notes)
    assert np.array_equal(read_grid(restart, 2).point_data["DISPL"], read_grid(path, 2).point_data["DISPL"])
    assert len(read_series(restart, displacement="DISPL")) == 3


def test_a_decomposed_case_of_openfoam(tmp_path):
    for number in range(2):
        part = tmp_path / f"processor{number}"
        part.mkdir()
        write_foam(part)
        points = part / "constant" / "polyMesh" / "points"
        points.write_text(points.read_text().replace("(2.0 ", f"({2.0 + number} "))
    (tmp_path / "processor0" / "system").rename(tmp_path / "system")
    (tmp_path / "bar.foam").write_text("")
    grid = read_grid(tmp_path / "bar.foam", 1)
    assert sorted(grid.types.tolist()) == [12, 12, 42, 42] and grid.count == 24
    assert grid.points[:, 0].max() == 3 and grid.point_data["pointDisplacement"].max() == 0.5


def test_ensight_files_outside_the_folder_are_refused(tmp_path):
    path = write_parts(tmp_path)
    path.write_text(path.read_text().replace("bar.geo", "../other/bar.geo"))
    with pytest.raises(SeriesError, match="outside"):
        read_grid(path, 0)


def test_hdf5_that_is_no_vtkhdf_is_one_line(tmp_path):
    with h5py.File(tmp_path / "a.hdf", "w") as file:
        file["x"] = np.arange(3)
    with pytest.raises(SeriesError, match=r"a\.hdf: cannot be read"):
        read_grid(tmp_path / "a.hdf")
