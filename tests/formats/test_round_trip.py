"""Each format that we write, read back by its reader: the same points, cells, fields and times, bit for bit."""

import numpy as np
import pytest

from pipeline.errors import SeriesError
from pipeline.formats import readers
from pipeline.formats.atomic import write_whole
from pipeline.formats.cell_types import CELL_TYPES, CORNERS
from pipeline.formats.grid import CellArray
from pipeline.formats.netcdf import NetcdfVariable, create_dataset, open_dataset, read_dataset, write_dataset
from pipeline.formats.pvd import complete_pvd, encode_pvd, encode_pvd_rows, read_index
from pipeline.formats.vtkhdf import VtkhdfFile, lay_out_file
from pipeline.formats.vtu_read import read_inline
from pipeline.formats.vtu_write import encode_static_parts, encode_vtu

REST = np.random.default_rng(1).normal(size=(6, 3))
CELLS = {2: np.array([[0, 1, 2], [2, 3, 4]]), 3: np.array([[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]])}


def make_cell_array(dimension):
    cells = CELLS[dimension]
    types = np.full(len(cells), CELL_TYPES[dimension], dtype=np.uint8)
    return CellArray(types, np.arange(0, cells.size + 1, dimension + 1), cells.ravel())


def make_fields(dimension, time, dtype):
    rng = np.random.default_rng(int(100 * time))
    n, e = len(REST), len(CELLS[dimension])
    points = rng.normal(size=(n, 3)).astype(dtype)
    point_data = {"displacement": (points - REST).astype(dtype), "speed": rng.normal(size=n).astype(dtype)}
    cell_data = {"volume_ratio": rng.normal(size=e).astype(dtype)}
    field_data = {"TimeValue": np.array([[time]]), "step": np.array([[7]]), "momentum": rng.normal(size=(1, 3))}
    return points, point_data, cell_data, field_data


def assert_holds(grid, dimension, fields):
    points, point_data, cell_data, field_data = fields
    np.testing.assert_array_equal(grid.points, points.astype(np.float64))
    assert set(grid.types) == {CELL_TYPES[dimension]} and grid.count == len(REST)
    np.testing.assert_array_equal(grid.select_cells(CELL_TYPES[dimension]), CELLS[dimension])
    point_data = point_data | {"rest_position": REST.astype(points.dtype)}
    for read, written in ((grid.point_data, point_data), (grid.cell_data, cell_data), (grid.field_data, field_data)):
        assert set(read) - {"Time"} == set(written)  # VTK adds Time to a .vtkhdf
        for name, values in written.items():
            assert read[name].dtype == values.dtype
            np.testing.assert_array_equal(read[name].ravel(), values.ravel())


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_vtu(tmp_path, dimension, dtype):
    fields = make_fields(dimension, 0.3, dtype)
    content = encode_vtu(*fields, encode_static_parts(make_cell_array(dimension), REST.astype(dtype)))
    write_whole(tmp_path / "f.vtu", content)
    assert_holds(read_inline(tmp_path / "f.vtu"), dimension, fields)
    assert_holds(readers.read_grid(tmp_path / "f.vtu"), dimension, fields)
    assert readers.read_times(tmp_path / "f.vtu") == [0.3]


def test_texts_in_a_vtu(tmp_path):
    points, point_data, cell_data, field_data = make_fields(3, 0.0, "float64")
    field_data |= {"message": np.array(["wörds <&>".encode(), b"two"])}
    static = encode_static_parts(make_cell_array(3), REST)
    write_whole(tmp_path / "f.vtu", encode_vtu(points, point_data, cell_data, field_data, static))
    for grid in (read_inline(tmp_path / "f.vtu"), readers.read_grid(tmp_path / "f.vtu")):
        assert grid.field_data["message"].tolist() == ["wörds <&>", "two"]


def test_pvd(tmp_path):
    frames = [(0.1 * i, f"frames/<{i}>&.vtu") for i in range(5)]
    (tmp_path / "s.pvd").write_bytes(encode_pvd(frames))
    entries, notes = read_index(tmp_path / "s.pvd")
    assert [(entry.time, entry.file) for entry in entries] == [(time, tmp_path / name) for time, name in frames]
    assert notes == []
    rows = encode_pvd_rows(frames[:2]) + encode_pvd_rows(frames[2:])
    assert complete_pvd(rows) == encode_pvd(frames)
    (tmp_path / "s.pvd").write_bytes(encode_pvd([]))
    with pytest.raises(SeriesError, match="lists no frame"):
        read_index(tmp_path / "s.pvd")


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_vtkhdf(tmp_path, dimension, dtype):
    """Two frames, then more room and a third."""
    path, rest = tmp_path / "s.vtkhdf", REST.astype(dtype)
    frames = {time: make_fields(dimension, time, dtype) for time in (0.0, 0.25, 0.5)}

    def name_arrays(fields):
        points, *sections = fields
        kinds = ("PointData", "CellData", "FieldData")
        named = {f"{kind}/{name}": a for kind, s in zip(kinds, sections, strict=True) for name, a in s.items()}
        return {"Points": points, **named}

    first = name_arrays(frames[0.0])
    lay_out_file(path, make_cell_array(dimension), rest, first, times=[0.0], room=2)
    file = VtkhdfFile(path, first, [])
    for time in (0.0, 0.25):
        file.append(time, name_arrays(frames[time]))
    assert file.room == 2
    lay_out_file(path, make_cell_array(dimension), rest, first, times=[0.0, 0.25], room=4, before=file)
    file.close()
    file = VtkhdfFile(path, first, [0.0, 0.25])
    file.append(0.5, name_arrays(frames[0.5]))
    file.close()
    assert readers.read_times(path) == list(frames)
    for step, fields in enumerate(frames.values()):
        assert_holds(readers.read_grid(path, step), dimension, fields)


def test_netcdf(tmp_path):
    variables = {
        "time": NetcdfVariable(("time",), {"units": "s", "axis": "T"}, chunks=(4,)),
        "axis": NetcdfVariable(("axis",), {"long_name": "axis"}, np.array(["x", "y"], dtype=object), dtype=str),
        "force": NetcdfVariable(("time", "axis"), {"units": "N"}, [[1.0, 2.0], [3.0, 4.0]], chunks=(4, 2)),
    }
    out = create_dataset(
        tmp_path / "a.nc", title="two <&> forces", sizes={"time": None, "axis": 2}, variables=variables
    )
    out["time"][:] = [0.0, 0.5]
    out.close()
    dataset = read_dataset(tmp_path / "a.nc")
    assert dataset.attrs == {"Conventions": "CF-1.11", "title": "two <&> forces"}
    assert dataset["force"].values.tolist() == [[1, 2], [3, 4]] and dataset["force"].attrs == {"units": "N"}
    assert dataset["axis"].values.tolist() == ["x", "y"] and dataset["time"].attrs["axis"] == "T"
    write_dataset(dataset, tmp_path / "b.nc")
    with open_dataset(tmp_path / "b.nc") as again:
        assert again.identical(dataset)
        assert "_FillValue" not in again["time"].encoding or np.isnan(again["time"].encoding["_FillValue"])
    (tmp_path / "c.nc").write_bytes(b"junk")
    with pytest.raises(SeriesError, match=r"c\.nc: cannot be read"):
        read_dataset(tmp_path / "c.nc")


def test_corners_are_those_of_vtk():
    from vtkmodules.vtkCommonDataModel import vtkGenericCell

    cell = vtkGenericCell()
    for cell_type, corners in CORNERS.items():
        cell.SetCellType(cell_type)
        assert cell.GetNumberOfPoints() == corners
