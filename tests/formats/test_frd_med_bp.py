"""CalculiX, MED and ADIOS2: the programs' own files, cut or damaged, and layouts written by hand."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline.errors import SeriesError
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.series.files.frame_files import read_grid, read_times

PROGRAMS = Path(__file__).parents[1] / "programs"
FRD = PROGRAMS / "calculix"
BP = PROGRAMS / "adios2" / "bar.bp"
MED = PROGRAMS / "med" / "bar.rmed"


def test_text_and_binary_of_calculix_agree():
    text, binary = FRD / "c3d20.frd", FRD / "c3d20_binary.frd"
    assert read_times(text) == read_times(binary) and len(read_times(text).values) == 3
    for k in range(3):
        a, b = read_grid(text, k), read_grid(binary, k)
        assert np.array_equal(a.connectivity, b.connectivity) and a.points == pytest.approx(b.points, abs=1e-5)
        for name in ("DISP", "STRESS"):
            assert a.point_data[name] == pytest.approx(b.point_data[name], rel=1e-4, abs=1e-4)


EDGES = {
    25: [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
    26: [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    27: [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)],
    24: [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
}


NAMES = ("c3d20", "c3d20_binary", "c3d15", "c3d10")
QUADRATIC = [*(FRD / f"{name}.frd" for name in NAMES), MED.with_name("quadratic.med")]


@pytest.mark.parametrize("path", QUADRATIC, ids=lambda path: path.name)
def test_nodes_between_corners_lie_on_their_edges(path):
    """The order of nodes of quadratic cells differs from VTK's."""
    grid = read_grid(path, 0)
    for kind, start, end in zip(grid.types, grid.offsets[:-1], grid.offsets[1:], strict=True):
        x = grid.points[grid.connectivity[start:end]]
        pairs = np.array(EDGES[int(kind)])
        assert x[len(x) - len(pairs) :] == pytest.approx(x[pairs].mean(axis=1), abs=1e-5)
    volumes = CellMesh(grid.points, grid.cells, 3).rest_volumes
    assert (volumes > 0).all()
    if path.suffix == ".med":
        assert dict(zip(grid.types.tolist(), volumes, strict=True)) == pytest.approx(
            {24: 1 / 6, 27: 1 / 3, 26: 0.5, 25: 1}
        )


def test_a_step_of_calculix_that_is_cut_off_is_left_out(tmp_path):
    whole = (FRD / "c3d8.frd").read_bytes()
    path = tmp_path / "a.frd"
    path.write_bytes(whole[: whole.rindex(b" -3")])
    times = read_times(FRD / "c3d8.frd").values
    assert read_times(path).values == times[:-1]
    grid = read_grid(path, len(times) - 2)
    assert any("cut off" in note for note in grid.notes)
    assert np.array_equal(grid.point_data["DISP"], read_grid(FRD / "c3d8.frd", len(times) - 2).point_data["DISP"])


@pytest.mark.parametrize("name", ["c3d8.frd", "c3d20_binary.frd"])
def test_a_file_that_is_being_written_has_its_whole_steps(tmp_path, name):
    whole, path = (FRD / name).read_bytes(), tmp_path / "a.frd"
    times = read_times(FRD / name).values
    starts = [whole.index(b"  100CL  101"), whole.index(b"  100CL  102")]
    for end in range(starts[1] + 1, len(whole) - 6, 41):
        path.write_bytes(whole[:end])
        found = read_times(path).values
        assert found == times[: len(found)] and len(found) < 3
        for k in range(len(found)):
            grid = read_grid(path, k)
            assert np.array_equal(grid.point_data["DISP"], read_grid(FRD / name, k).point_data["DISP"])


@pytest.mark.parametrize("name", ["c3d20.frd", "c3d20_binary.frd"])
def test_damaged_files_of_calculix_are_one_line(tmp_path, name):
    whole = (FRD / name).read_bytes()
    path = tmp_path / "a.frd"
    rng = np.random.default_rng(3)
    first = whole.index(b"100CL")
    for end in [0, 1, 3, *rng.integers(4, first, 30).tolist()]:
        path.write_bytes(whole[:end])
        with pytest.raises(SeriesError) as caught:
            read_grid(path, 0)
        assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    for place in rng.integers(0, len(whole), 40).tolist():
        path.write_bytes(whole[:place] + b"?" + whole[place + 1 :])
        try:
            read_grid(path, 0)
        except SeriesError as error:
            assert "\n" not in str(error)


def test_components_that_continue_on_a_second_line(tmp_path):
    lines = ["    1C", "    2C" + 18 * " " + f"{4:12d}" + 37 * " " + "1"]
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    lines += [f" -1{i + 7:10d}" + "".join(f"{c:12.5E}" for c in x) for i, x in enumerate(points)]
    lines += [" -3", "    3C" + 18 * " " + f"{1:12d}" + 37 * " " + "1"]
    lines += [f" -1{5:10d}{3:5d}{0:5d}{1:5d}", " -2" + "".join(f"{n:10d}" for n in (7, 8, 9, 10)), " -3"]
    lines += ["  100C" + "L  101" + f"{0.5:12.5E}" + f"{2:12d}" + 20 * " " + f"{0:2d}{1:5d}" + 10 * " " + f"{1:2d}"]
    lines += [" -4  MANY        8    1", *[f" -5  C{i}          1    1    0    0" for i in range(8)]]
    for node in (8, 10):
        lines += [f" -1{node:10d}" + "".join(f"{node + i:12.5E}" for i in range(6))]
        lines += [" -2" + 10 * " " + "".join(f"{node + i:12.5E}" for i in (6, 7))]
    path = tmp_path / "a.frd"
    path.write_text("\n".join([*lines, " -3", " 9999", ""]))
    grid = read_grid(path, 0)
    assert read_times(path).values == (0.5,)
    assert grid.connectivity.tolist() == [0, 1, 2, 3] and grid.point_data["GlobalNodeId"].tolist() == [7, 8, 9, 10]
    assert np.isnan(grid.point_data["MANY"][[0, 2]]).all()
    assert grid.point_data["MANY"][[1, 3]].tolist() == [list(range(8, 16)), list(range(10, 18))]
    path.write_text(path.read_text().replace("         8" + f"{8:12.5E}", "        77" + f"{8:12.5E}"))
    with pytest.raises(SeriesError, match="77"):
        read_grid(path, 0)


def test_fields_of_med_by_cells_and_profiles(tmp_path):
    path = tmp_path / "a.med"
    shutil.copy(MED, path)
    with h5py.File(path, "a") as file:
        count = len(file["ENS_MAA/bar/-0000000000000000001-0000000000000000001/MAI/TE4/FAM"])
        step = next(iter(file["CHA/resu____DEPL"]))
        field = file.create_group("CHA/temperature")
        field.attrs.update({"NCO": 1, "MAI": b"bar"})
        instant = field.create_group(step)
        instant.attrs.update({"NDT": 0, "NOR": 0, "PDT": 0.0})
        file["PROFILS/some/PFL"] = np.array([2, 4])
        part = instant.create_group("MAI.TE4/some")
        part.attrs.update({"NBR": 2, "NGA": 1})
        part["CO"] = np.array([20.0, 40.0])
        instant.create_group("NOE.TE4/x").attrs.update({"NBR": 1, "NGA": 4})
    grid = read_grid(path, 0)
    values = grid.cell_data["temperature"]
    tetrahedra = values[grid.types == 10]
    assert tetrahedra[[1, 3]].tolist() == [20, 40] and np.isnan(values).sum() == len(values) - 2 and count == 6
    assert any("NOE.TE4" in note for note in grid.notes)
    assert "temperature" not in read_grid(path, 1).cell_data


def test_damaged_files_of_med_are_one_line(tmp_path):
    path = tmp_path / "a.rmed"
    whole = MED.read_bytes()
    for content in (b"", b"junk", whole[:1000], whole[: len(whole) // 2], whole[:-100]):
        path.write_bytes(content)
        with pytest.raises(SeriesError) as caught:
            read_grid(path, 0)
        assert "\n" not in str(caught.value)
    for change, words in (
        (lambda m: m["MAI/TE4/NOD"].__setitem__(0, 99), "refers to point 99 of 16"),
        (lambda m: m["MAI"].move("TE4", "HE27"), "HE27"),
        (lambda m: m["NOE/COO"].attrs.__setitem__("NBR", 17), "17 nodes"),
    ):
        path.write_bytes(whole)
        with h5py.File(path, "a") as file:
            change(file["ENS_MAA/bar/-0000000000000000001-0000000000000000001"])
        with pytest.raises(SeriesError, match=words):
            read_grid(path, 0)


def test_a_folder_of_adios(tmp_path):
    pytest.importorskip("adios2")
    assert read_times(BP).values == (0.0, 0.25, 0.5, 1.0)
    grid = read_grid(BP, 2)
    assert set(grid.types) == {71} and grid.point_data["u"].shape == (45, 3)
    copy = tmp_path / "b.bp"
    shutil.copytree(BP, copy)
    for name in ("md.idx", "data.0", "mmd.0"):
        whole = (copy / name).read_bytes()
        # adios2 waits for the rest of data that are too short, until the time allowed has passed
        for content in (b"?" * len(whole), *([] if name == "data.0" else [b"", whole[: len(whole) // 2]])):
            (copy / name).write_bytes(content)
            try:
                damaged = read_grid(copy, 2)
            except SeriesError as error:
                assert str(error).startswith(str(copy)) and "\n" not in str(error)
            else:
                assert np.array_equal(damaged.point_data["u"], grid.point_data["u"]), (name, len(content))
        (copy / name).write_bytes(whole)


def test_blocks_of_adios_are_parts(tmp_path):
    """As two processes write: each its own nodes and cells."""
    adios2 = pytest.importorskip("adios2")
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    schema = (
        '<VTKFile type="UnstructuredGrid"><UnstructuredGrid><Piece><Points><DataArray Name="geometry"/></Points><Cells>'
        '<DataArray Name="connectivity"/><DataArray Name="types"/></Cells><PointData><DataArray Name="TIME">step'
        '</DataArray><DataArray Name="u"/></PointData></Piece></UnstructuredGrid></VTKFile>'
    )
    with adios2.Stream(str(tmp_path / "a.bp"), "w") as stream:
        for t in (0.0, 1.0):
            stream.begin_step()
            if t == 0:
                stream.write_attribute("vtk.xml", schema)
                stream.write("types", np.array(10, dtype=np.uint32))
            stream.write("step", np.array(t))
            for block in range(2):
                shift = points + np.array([2.0 * block, 0, 0])
                if t == 0:
                    stream.write("geometry", shift, [], [], list(shift.shape))
                    stream.write("connectivity", np.array([[4, 0, 1, 2, 3]]), [], [], [1, 5])
                stream.write("u", t * shift, [], [], list(shift.shape))
            stream.end_step()
    grid = read_grid(tmp_path / "a.bp", 1)
    assert grid.parts == (4, 4) and grid.connectivity.tolist() == list(range(8))
    assert np.array_equal(grid.points, np.concatenate([points, points + np.array([2, 0, 0])]))
    assert np.array_equal(grid.point_data["u"], grid.points)
