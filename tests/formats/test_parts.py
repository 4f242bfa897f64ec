"""Files that name others (.vtm, .vtpd, .pvtu ...) against VTK, joined parts, and .vtu files with several steps."""

from pathlib import Path

import numpy as np
import pytest
import pyvista
import vtk

from pipeline.errors import SeriesError
from pipeline.formats import readers
from pipeline.formats.grid import Grid, PolyhedronFaces
from pipeline.formats.multiblock import PIECEWISE_SUFFIXES, is_empty_piece, list_pieces, read_own_times
from pipeline.formats.parts import BodyPart, join_parts
from pipeline.formats.vtu_steps import cut_out_step, find_step_times
from pipeline.run.measures import measure
from pipeline.series import read_series
from pipeline.series.files.frame_files import find_fault, read_grid, read_times
from tests.foreign.displacements import CELLS, LONG_CELLS, LONG_POINTS, POINTS
from tests.foreign.partitions import write_pvtu
from tests.foreign.writers import split, stretch, write_pvd, write_vtu

A_TIME = '<DataArray type="Float64" Name="TimeValue"'
RIGHT = np.array([5.0, 0.0, 0.0])


def make_block(shift: float = 0.0, **fields) -> pyvista.UnstructuredGrid:
    """Return the bar, moved along x, with point fields."""
    grid = pyvista.UnstructuredGrid({10: CELLS}, POINTS + shift * RIGHT)
    for name, values in fields.items():
        grid.point_data[name] = values
    return grid


def make_grid(points, cells, *, nodal=None, cellular=None, whole=None, faces=None, notes=()) -> Grid:
    """Return a grid of tetrahedra with fields."""
    e = len(cells)
    return Grid(
        np.asarray(points, dtype=float), len(points), np.full(e, 10, np.uint8), np.arange(e + 1) * 4,
        np.asarray(cells).ravel(), nodal or {}, cellular or {}, whole or {}, faces, notes=notes,
    )  # fmt: skip


def write_composite(path: Path, data, mode: str = "Binary") -> None:
    """Write blocks or partitions with VTK's writer."""
    kinds = {
        ".vtm": vtk.vtkXMLMultiBlockDataWriter, ".vtmb": vtk.vtkXMLMultiBlockDataWriter,
        ".vtpd": vtk.vtkXMLPartitionedDataSetWriter, ".vtpc": vtk.vtkXMLPartitionedDataSetCollectionWriter,
    }  # fmt: skip
    writer = kinds[path.suffix]()
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    getattr(writer, f"SetDataModeTo{mode}")()
    assert writer.Write()


def make_composite(suffix: str, blocks):
    """Return blocks or partitions as VTK's data object for a suffix."""
    if suffix in (".vtm", ".vtmb"):
        data = vtk.vtkMultiBlockDataSet()
        inner = vtk.vtkMultiBlockDataSet()
        data.SetBlock(0, blocks[0])
        data.GetMetaData(0).Set(vtk.vtkCompositeDataSet.NAME(), "first")
        data.SetBlock(1, inner)
        data.GetMetaData(1).Set(vtk.vtkCompositeDataSet.NAME(), "others")
        for k, block in enumerate([*blocks[1:], None]):
            inner.SetBlock(k, block)
        return data
    partitions = vtk.vtkPartitionedDataSet()
    for k, block in enumerate(blocks):
        partitions.SetPartition(k, block)
    if suffix == ".vtpd":
        return partitions
    data = vtk.vtkPartitionedDataSetCollection()
    data.SetPartitionedDataSet(0, partitions)
    return data


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended"])
@pytest.mark.parametrize("suffix", [".vtm", ".vtmb", ".vtpd", ".vtpc"])
def test_blocks_are_those_of_vtk(tmp_path, suffix, mode):
    blocks = [make_block(k, u=POINTS * k, w=np.arange(12.0)) for k in range(3)]
    write_composite(tmp_path / f"b{suffix}", make_composite(suffix, blocks), mode)
    expected = pyvista.merge(blocks, merge_points=False)
    for grid in (read_grid(tmp_path / f"b{suffix}"), readers.read_grid(tmp_path / f"b{suffix}")):
        assert grid.parts == (12, 12, 12) and len(set(grid.part_names)) == 3
        assert np.array_equal(grid.points, np.concatenate([block.points for block in blocks]))
        assert np.array_equal(grid.points[grid.connectivity], expected.points[expected.cell_connectivity])
        for name in ("u", "w"):
            assert np.array_equal(grid.point_data[name], np.concatenate([block[name] for block in blocks]))
    if suffix == ".vtm":
        assert grid.part_names == ("first", "others/dataset 0", "others/dataset 1")


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended"])
def test_the_time_of_blocks(tmp_path, mode):
    for k in range(3):
        data = make_composite(".vtm", [make_block(0), make_block(1)])
        time = vtk.vtkDoubleArray()
        time.SetName("TimeValue")
        time.InsertNextValue(0.25 * k)
        data.GetFieldData().AddArray(time)
        write_composite(tmp_path / f"b_{k}.vtm", data, mode)
    assert read_own_times(tmp_path / "b_2.vtm") == (0.5,) and readers.read_times(tmp_path / "b_2.vtm") == [0.5]
    assert read_series(tmp_path).times == (0.0, 0.25, 0.5)


def test_the_time_of_pieces(tmp_path):
    for k in range(3):
        for r, cells in enumerate((CELLS[:6], CELLS[6:])):
            used, local = split(cells)
            write_vtu(tmp_path / f"p_{k}_{r}.vtu", POINTS[used], [(10, local)], {}, {}, {"TimeValue": [0.25 * k]})
        write_pvtu(tmp_path / f"p_{k}.pvtu", [f"p_{k}_{r}.vtu" for r in range(2)])
    assert read_times(tmp_path / "p_2.pvtu").values == (0.5,) and readers.read_times(tmp_path / "p_2.pvtu") == [0.5]
    assert read_series(tmp_path).times == (0.0, 0.25, 0.5)


def test_a_surface_in_pieces(tmp_path):
    for r, shift in enumerate((0.0, 1.0)):
        pyvista.Plane(center=(shift, 0, 0), i_resolution=2, j_resolution=2).triangulate().save(tmp_path / f"s{r}.vtp")
    pieces = "".join(f'<Piece Source="s{r}.vtp"/>' for r in range(2))
    (tmp_path / "s.pvtp").write_text(f'<VTKFile type="PPolyData"><PPolyData>{pieces}</PPolyData></VTKFile>')
    grid = read_grid(tmp_path / "s.pvtp")
    assert grid.parts == (9, 9) and grid.part_names == ("s0", "s1") and len(grid.types) == 16
    assert read_series(tmp_path / "s.pvtp").mesh.rest_volumes.sum() == pytest.approx(2.0)


def test_blocks_of_pieces(tmp_path):
    """A .vtm of a .pvtu and of another .vtm: the names of all parts."""
    for r, cells in enumerate((CELLS[:6], CELLS[6:])):
        used, local = split(cells)
        write_vtu(tmp_path / f"p{r}.vtu", POINTS[used], [(10, local)])
    write_pvtu(tmp_path / "p.pvtu", ["p0.vtu", "p1.vtu"])
    make_block(2).save(tmp_path / "q.vtu")
    (tmp_path / "in.vtm").write_text(
        wrap('<Block index="0" name="deep"><DataSet index="0" name="q" file="q.vtu"/></Block>')
    )
    (tmp_path / "out.vtm").write_text(wrap('<DataSet name="a" file="p.pvtu"/><DataSet name="b" file=".\\in.vtm"/>'))
    grid = read_grid(tmp_path / "out.vtm")
    assert grid.part_names == ("a/p0", "a/p1", "b") and grid.parts == (8, 8, 12) and len(grid.types) == 24


def wrap(content: str) -> str:
    """Return the text of a .vtm."""
    return f'<VTKFile type="vtkMultiBlockDataSet"><vtkMultiBlockDataSet>{content}</vtkMultiBlockDataSet></VTKFile>'


def test_the_boundary_of_a_body_is_not_measured(tmp_path):
    """A solver's .vtm: the body and its patches, which lack the displacement."""
    for k, s in enumerate((1.0, 1.2, 1.5)):
        body = make_block(u=stretch(POINTS, s) - POINTS)
        patch = make_block().extract_surface(algorithm=None)
        patch.clear_data()
        patch.point_data["damage"] = np.ones(patch.n_points)
        pyvista.MultiBlock({"internal": body, "wall": patch}).save(tmp_path / f"b_{k}.vtm")
    series = read_series(tmp_path)
    ratios = [measure(frame)["volume_ratio"] for frame in series]
    assert [len(ratio) for ratio in ratios] == [12] * 3
    assert any("fewer dimensions than those of the body: wall" in note for note in series.notes)
    for ratio, s in zip(ratios, (1.0, 1.2, 1.5), strict=True):
        assert ratio == pytest.approx(s)


# Pieces that are empty, missing, damaged, or of other kinds


def test_pieces_without_cells_are_skipped(tmp_path):
    write_vtu(tmp_path / "a.vtu", POINTS, [(10, CELLS)])
    pyvista.UnstructuredGrid().save(tmp_path / "empty.vtu")
    pyvista.PolyData().save(tmp_path / "empty.vtp")
    write_pvtu(tmp_path / "p.pvtu", ["empty.vtu", "a.vtu"])
    (tmp_path / "p.vtm").write_text(wrap('<DataSet file="empty.vtp"/><DataSet file="a.vtu"/><DataSet/>'))
    for name in ("p.pvtu", "p.vtm"):
        grid = read_grid(tmp_path / name)
        assert grid.count == 12 and grid.parts == () and find_fault(tmp_path / name) is None
    assert is_empty_piece(tmp_path / "empty.vtu") and not is_empty_piece(tmp_path / "a.vtu")
    write_pvtu(tmp_path / "p.pvtu", ["empty.vtu"])
    with pytest.raises(SeriesError, match="none of its 1 pieces can be read"):
        read_grid(tmp_path / "p.pvtu")


@pytest.mark.parametrize("damage", ["missing", "empty", "cut"])
@pytest.mark.parametrize("suffix", [".pvtu", ".vtm"])
def test_a_frame_with_a_damaged_piece_is_left_out(tmp_path, suffix, damage):
    for k, s in enumerate((1.0, 1.2, 1.5)):
        for r, cells in enumerate((CELLS[:6], CELLS[6:])):
            used, local = split(cells)
            write_vtu(tmp_path / f"f{r}_{k}.vtu", stretch(POINTS, s)[used], [(10, local)])
        if suffix == ".pvtu":
            write_pvtu(tmp_path / f"f_{k}.pvtu", [f"f{r}_{k}.vtu" for r in range(2)])
        else:
            (tmp_path / f"f_{k}.vtm").write_text(wrap(f'<DataSet file="f0_{k}.vtu"/><DataSet file="f1_{k}.vtu"/>'))
    piece = tmp_path / "f1_1.vtu"
    content = piece.read_bytes()
    piece.unlink() if damage == "missing" else piece.write_bytes(b"" if damage == "empty" else content[:-300])
    series = read_series(tmp_path)
    assert series.times == (0.0, 2.0)
    assert series.notes[0].startswith(f"left out: f_1{suffix} ") and "has a piece, f1_1.vtu, that is" in series.notes[0]
    with pytest.raises(SeriesError, match="1 frames cannot be read"):
        read_series(tmp_path, strict=True)
    with pytest.raises(SeriesError, match=r"f1_1\.vtu"):
        read_series(tmp_path / f"f_1{suffix}")


def test_blocks_of_other_kinds_are_told(tmp_path):
    make_block().save(tmp_path / "a.vtu")
    (tmp_path / "b.xyz").write_text("?")
    (tmp_path / "m.vtm").write_text(wrap('<DataSet name="body" file="a.vtu"/><DataSet name="grid" file="b.xyz"/>'))
    series = read_series(tmp_path / "m.vtm")
    assert any("1 blocks of a kind that is not read are left out: grid (b.xyz)" in note for note in series.notes)
    (tmp_path / "m.vtm").write_text(wrap('<DataSet name="grid" file="b.xyz"/>'))
    with pytest.raises(SeriesError, match=r"there is no reader for \.xyz"):
        read_series(tmp_path / "m.vtm")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "is empty"),
        (wrap(""), "names no pieces"),
        (wrap('<DataSet file="../../x.vtu"/>'), "outside its own folder"),
        (wrap('<DataSet file="/etc/passwd"/>'), "outside its own folder"),
        (wrap('<DataSet file="m.vtm"/>'), "deep"),
        (wrap("<Block>" * 100_000), "cannot be read"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]>" + wrap("&b;"), "entities"),
        (wrap("&nothing;"), "cannot be read"),
        ("no XML </VTKFile>", "not XML"),
        (wrap('<DataSet file="a.vtu"/>')[:-5], "truncated"),
        (wrap(f'{A_TIME} format="binary">AAAA</DataArray><DataSet file="a.vtu"/>'), "cannot be read"),
        (wrap(f'{A_TIME} format="ascii">x</DataArray><DataSet file="a.vtu"/>'), "cannot be read"),
    ],
)  # fmt: skip
def test_hostile_blocks_are_one_line(tmp_path, content, words):
    make_block().save(tmp_path / "a.vtu")
    (tmp_path / "m.vtm").write_text(content)
    with pytest.raises(SeriesError) as caught:
        read_series(tmp_path / "m.vtm")
    assert words in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 1000


def test_every_suffix_of_pieces_has_a_reader():
    assert set(PIECEWISE_SUFFIXES) <= set(readers.SUFFIXES)
    assert all(not readers.READERS[suffix].has_steps for suffix in PIECEWISE_SUFFIXES)


def test_pieces_in_a_folder_beside_it(tmp_path):
    make_block().save(tmp_path / "a.vtu")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "m.vtm").write_text(wrap('<DataSet name="body" file="../a.vtu"/>'))
    assert [piece.name for piece in list_pieces(tmp_path / "sub" / "m.vtm")] == ["body"]
    assert any("a folder beside" in note for note in read_grid(tmp_path / "sub" / "m.vtm").notes)


# Joined parts


def test_fields_of_joined_parts():
    a = make_grid(POINTS, CELLS, nodal={"u": POINTS, "id": np.arange(12), "s": np.ones(12)}, notes=("from a",))
    b = make_grid(
        POINTS + RIGHT, CELLS, nodal={"u": 2 * POINTS, "s": np.ones((12, 3))},
        cellular={"vtkGhostType": np.ones(12, np.uint8)}, whole={"TimeValue": np.array([1.0]), "rank": np.array([1])},
    )  # fmt: skip
    c = make_grid(POINTS + 2 * RIGHT, CELLS, nodal={"u": POINTS}, whole={"rank": np.array([2])})
    grid = join_parts([BodyPart("a", a), BodyPart("b", b), BodyPart("c", c)], "here")
    assert grid.parts == (12, 12, 12) and grid.part_names == ("a", "b", "c") and grid.offsets[-1] == 144
    assert np.array_equal(grid.point_data["u"], np.concatenate([POINTS, 2 * POINTS, POINTS]))
    assert np.array_equal(np.isnan(grid.point_data["id"]), np.arange(36) >= 12)
    assert "s" not in grid.point_data  # a scalar here, a vector there
    assert grid.cell_data["vtkGhostType"].dtype == np.uint8 and grid.cell_data["vtkGhostType"].sum() == 12
    assert list(grid.field_data) == ["TimeValue"]
    assert grid.notes[0] == "from a"
    for word in ("s differs in shape", "id is missing in 2 of 3 parts", "rank differ between parts"):
        assert any(word in note for note in grid.notes), grid.notes


def test_equal_parts_are_one_with_the_fields_of_both():
    a, b = (make_grid(POINTS, CELLS, nodal={name: np.ones(12)}) for name in "xy")
    grid = join_parts([BodyPart("a", a), BodyPart("b", b)], "here")
    assert grid.count == 12 and set(grid.point_data) == {"x", "y"} and grid.parts == ()
    c = make_grid(POINTS, CELLS, nodal={"x": np.zeros(12)})
    with pytest.raises(SeriesError, match="here: a and c have the same points and cells but different values of x"):
        join_parts([BodyPart("a", a), BodyPart("c", c)], "here")
    marked = make_grid(POINTS, CELLS, cellular={"vtkGhostType": np.ones(12, np.uint8)})
    assert join_parts([BodyPart("a", a), BodyPart("m", marked)], "here").count == 24  # the layout drops marked copies


def test_polyhedra_of_joined_parts():
    corners = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    faces = PolyhedronFaces(corners.ravel(), np.arange(5) * 3, np.array([0, 4]))
    points = POINTS[[0, 1, 2, 4]]
    solid = Grid(points, 4, np.array([42], np.uint8), np.array([0, 4]), np.arange(4), {}, {}, {}, faces)
    plain = make_grid(POINTS + RIGHT, CELLS)
    grid = join_parts([BodyPart("a", plain), BodyPart("b", solid)], "here")
    assert grid.faces is not None
    assert grid.faces.cell_offsets.tolist() == [0] * 13 + [4] and grid.faces.offsets.tolist() == [0, 3, 6, 9, 12]
    assert np.array_equal(grid.faces.connectivity, 12 + corners.ravel())


def test_marked_copies_of_pieces_are_dropped(tmp_path):
    """Two ranks overlap by six cells, marked by vtkGhostType: the pieces are inline, ASCII or appended."""
    for k, encoding in enumerate(("Ascii", "Binary", "Appended")):
        for r, (first, last) in enumerate(((0, 12), (6, 18))):
            used, local = split(LONG_CELLS[first:last])
            grid = pyvista.UnstructuredGrid({10: local}, LONG_POINTS[used])
            grid.cell_data["vtkGhostType"] = (np.arange(first, last) < (12 if r else 0)).astype(np.uint8)
            writer = vtk.vtkXMLUnstructuredGridWriter()
            writer.SetFileName(str(tmp_path / f"g_{k}_{r}.vtu"))
            writer.SetInputData(grid)
            getattr(writer, f"SetDataModeTo{encoding}")()
            assert writer.Write()
        write_pvtu(tmp_path / f"g_{k}.pvtu", [f"g_{k}_{r}.vtu" for r in range(2)])
        series = read_series(tmp_path / f"g_{k}.pvtu")
        assert len(series.mesh.rest_volumes) == 18 and series.mesh.rest_volumes.sum() == pytest.approx(3.0)


# Several steps in one .vtu


def write_steps(path: Path, mode: str, *, moves: bool, raw: bool = False) -> None:
    """Write three steps as VTK's writer does: a displacement, or moving points."""
    grid = make_block(displacement=0 * POINTS)
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(str(path))
    writer.SetNumberOfTimeSteps(3)
    getattr(writer, f"SetDataModeTo{mode}")()
    writer.SetEncodeAppendedData(not raw)
    writer.Start()
    for k, s in enumerate((1.0, 1.2, 1.5)):
        if moves:
            grid.points[:] = stretch(POINTS, s)
            grid.GetPoints().Modified()
        else:
            grid["displacement"][:] = stretch(POINTS, s) - POINTS
            grid.GetPointData().GetArray("displacement").Modified()
        grid.Modified()
        writer.WriteNextTime(0.1 * k)
    writer.Stop()


@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended"])
def test_steps_of_one_vtu(tmp_path, mode, moves):
    write_steps(tmp_path / "all.vtu", mode, moves=moves)
    assert find_step_times(tmp_path / "all.vtu") == [0.0, 0.1, 0.2]
    series = read_series(tmp_path / "all.vtu")
    assert series.times == (0.0, 0.1, 0.2)
    for frame, s in zip(series, (1.0, 1.2, 1.5), strict=True):
        assert measure(frame)["volume_ratio"] == pytest.approx(s)


def test_steps_that_cannot_be_told_apart_are_refused(tmp_path):
    write_steps(tmp_path / "all.vtu", "Appended", moves=True, raw=True)
    with pytest.raises(SeriesError, match="raw appended data"):
        read_series(tmp_path / "all.vtu")
    write_steps(tmp_path / "all.vtu", "Ascii", moves=True)
    text = (tmp_path / "all.vtu").read_text()
    piece = text[text.index("<Piece") : text.index("</Piece>") + 8]
    (tmp_path / "all.vtu").write_text(text.replace(piece, ""))
    with pytest.raises(SeriesError, match="its 2 pieces are not those of 3 steps"):
        cut_out_step(tmp_path / "all.vtu", 0)
    (tmp_path / "all.vtu").write_text(text.replace("0.1 ", "x "))
    with pytest.raises(SeriesError, match="TimeValues are not numbers"):
        find_step_times(tmp_path / "all.vtu")
    (tmp_path / "all.vtu").write_text(text)
    with pytest.raises(SeriesError, match="there is no step 3; it has 3"):
        cut_out_step(tmp_path / "all.vtu", 3)


@pytest.mark.parametrize("kind", ["pvd", "vtm", "pvtu", "series", "steps"])
def test_damaged_files_that_name_others_are_one_line(tmp_path, kind):
    """Bytes of the file are changed, cut out or doubled: it is read, or refused in one line."""
    rng = np.random.default_rng(16)
    for r, cells in enumerate((CELLS[:6], CELLS[6:])):
        used, local = split(cells)
        write_vtu(tmp_path / f"p{r}.vtu", POINTS[used], [(10, local)])
    path = (
        tmp_path / {"pvd": "s.pvd", "vtm": "s.vtm", "pvtu": "s.pvtu", "series": "s.vtu.series", "steps": "s.vtu"}[kind]
    )
    if kind == "pvd":
        write_pvd(path, [{"timestep": 0.5, "group": "", "part": r, "file": f"p{r}.vtu"} for r in range(2)])
    elif kind == "vtm":
        path.write_text(wrap('<Block name="a"><DataSet index="0" file="p0.vtu"/></Block><DataSet file="p1.vtu"/>'))
    elif kind == "pvtu":
        write_pvtu(path, ["p0.vtu", "p1.vtu"])
    elif kind == "series":
        path.write_text('{"files": [{"name": "p0.vtu", "time": 0.5}, {"name": "p1.vtu", "time": 0.75}]}')
    else:
        write_steps(path, "Ascii", moves=True)
    content = path.read_bytes()
    outcomes = set[str]()
    for _ in range(12 if kind == "steps" else 150):
        at, length = int(rng.integers(len(content))), int(rng.integers(1, 12))
        middle = [rng.bytes(length), b"", content[at : at + length] * 2][int(rng.integers(3))]
        path.write_bytes(content[:at] + middle + content[at + length :])
        try:
            series = read_series(path)
            outcomes.add("read")
            assert len(series) >= 1
        except SeriesError as error:
            outcomes.add("refused")
            assert "\n" not in str(error) and len(str(error)) < 1500
    assert outcomes == {"read", "refused"} or kind == "steps"
