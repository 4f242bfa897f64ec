"""Files of a run, read back by foreign readers, and the files of a run that breaks off."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista
import xarray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from pipeline import build, frames, load_case, read_series, record
from pipeline.errors import OutputError, SeriesError
from pipeline.formats.atomic import write_whole
from pipeline.formats.netcdf import read_dataset
from pipeline.run.measures import QUANTILES, VARIABLES, measure, pad_to_space
from pipeline.sinks.netcdf import NetcdfSink
from pipeline.sinks.vtu import VtuSink
from tests.bodies import PLANAR, assert_conventional, write_case
from tests.measured import measure_series

SCENES = {"3D": {}, "2D": PLANAR}
ROOT = os.path.dirname(os.path.dirname(os.path.dirname(__file__)))

# a fixed model has none of the variables that model = "auto" adds
FIXED_MODEL = VARIABLES.keys() - {"rung", "indicator", "volume_ratio_min", "volume_ratio_max"}


def sinks(folder):
    return [VtuSink(folder), NetcdfSink(folder / "statistics.nc", title="beam: polar")]


def problem_of(folder, **sections):
    return build(load_case(write_case(folder, **sections)).variant("polar"))


@pytest.fixture(scope="module", params=SCENES)
def run(request, tmp_path_factory):
    """A recorded run, and the frames that were recorded."""
    folder = tmp_path_factory.mktemp("run")
    problem = problem_of(folder, **SCENES[request.param])
    given = list(frames(problem))
    record(iter(given), sinks(folder))
    return SimpleNamespace(folder=folder, problem=problem, frames=given, d=problem.body.mesh.dimension)


def vtk_read(path):
    reader = vtkXMLUnstructuredGridReader()
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.Update()
    assert reader.GetErrorCode() == 0
    return reader.GetOutput()


def arrays(data) -> dict[str, np.ndarray]:
    found = [data.GetAbstractArray(i) for i in range(data.GetNumberOfArrays())]
    return {one.GetName(): vtk_to_numpy(one) for one in found}


def frame_files(folder):
    return sorted((folder / "frames").iterdir())


def leftovers(folder):
    return [path for path in folder.rglob("*") if path.name.startswith(".") or "tmp" in path.suffixes]


# ParaView files


def test_vtk_reads_the_deformed_points_and_the_cells(run):
    for file, frame in zip(frame_files(run.folder), run.frames, strict=True):
        grid = vtk_read(file)
        points = vtk_to_numpy(grid.GetPoints().GetData())
        assert points.dtype == np.float64 and np.array_equal(points, pad_to_space(frame.x))
        cells = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, run.d + 1)
        assert np.array_equal(cells, frame.mesh.cells)
        assert {grid.GetCellType(i) for i in range(grid.GetNumberOfCells())} == {{2: 5, 3: 10}[run.d]}


def test_vtk_finds_every_field_under_its_name_as_doubles(run):
    for file, frame in zip(frame_files(run.folder), run.frames, strict=True):
        grid, measured, X = vtk_read(file), measure(frame), frame.mesh.points
        nodal = arrays(grid.GetPointData())
        wanted = {"displacement": frame.x - X, "rest_position": X, "velocity": frame.v}
        assert nodal.keys() == wanted.keys()
        for name, value in wanted.items():
            assert nodal[name].dtype == np.float64 and nodal[name].shape == (len(X), 3)
            assert np.array_equal(nodal[name], pad_to_space(value))
        cellular = arrays(grid.GetCellData())
        assert cellular.keys() == {"volume_ratio", "rotation_angle", "volume"}
        for name, value in cellular.items():
            assert value.dtype == np.float64 and value.shape == (len(frame.mesh.cells),)
            if name in measured:
                assert np.array_equal(value, measured[name])
        assert cellular["volume"] == pytest.approx(measured["volume_ratio"] * frame.mesh.rest_volumes, rel=1e-14)


def test_every_number_of_the_frame_is_field_data(run):
    for file, frame in zip(frame_files(run.folder), run.frames, strict=True):
        found, measured = arrays(vtk_read(file).GetFieldData()), measure(frame)
        of_frame = {name for name in measured if VARIABLES[name].dims != ("cell",)}
        assert found.keys() == of_frame | {"TimeValue", "step"}
        assert found["TimeValue"].tolist() == [frame.time] and found["step"].tolist() == [frame.step]
        for name in of_frame:
            assert found[name].dtype == np.float64 and np.array_equal(found[name].ravel(), measured[name].ravel())
            assert found[name].shape == {"axis": (1, 3), "quantile": (1, len(QUANTILES))}.get(
                next(iter(VARIABLES[name].dims), ""), (1,)
            )


def test_no_file_has_appended_data(run):
    for file in frame_files(run.folder):
        assert b"<AppendedData" not in file.read_bytes()  # which the ParaView of several distributions cannot read


def test_the_index_has_the_true_times(run):
    times = [i * 0.02 for i in range(5)]  # index * dt, never accumulated
    entries = ET.parse(run.folder / "series.pvd").getroot().findall("./Collection/DataSet")
    assert [float(one.attrib["timestep"]) for one in entries] == times
    assert [one.attrib["file"] for one in entries] == [f"frames/frame_{i:06d}.vtu" for i in range(5)]
    reader = pyvista.PVDReader(run.folder / "series.pvd")
    assert reader.time_values == times
    for time, frame in zip(times, run.frames, strict=True):
        reader.set_active_time_value(time)
        assert np.array_equal(reader.read()[0].points, pad_to_space(frame.x))


# Statistics


def test_statistics_hold_the_measured_values(run):
    with xarray.open_dataset(run.folder / "statistics.nc") as dataset:
        assert dataset.sizes == {"time": 5, "cell": len(run.problem.body.mesh.cells), "axis": 3, "quantile": 9}
        assert dataset["quantile"].values.tolist() == list(QUANTILES)
        assert dataset["axis"].values.tolist() == ["x", "y", "z"]
        assert dataset["time"].values.tolist() == [frame.time for frame in run.frames]
        assert set(dataset.data_vars) == {*FIXED_MODEL, "rest_volume"}
        assert np.array_equal(dataset["rest_volume"], run.problem.body.mesh.rest_volumes)
        for i, frame in enumerate(run.frames):
            for name, value in measure(frame).items():
                assert dataset[name].dtype == np.float64 and dataset[name].dims == ("time", *VARIABLES[name].dims)
                assert np.array_equal(dataset[name][i], value)


def test_statistics_follow_the_conventions(run):
    with xarray.open_dataset(run.folder / "statistics.nc") as dataset:
        assert_conventional(dataset)
        volume = "m3" if run.d == 3 else "m2"
        assert dataset["total_volume"].units == dataset["rest_volume"].units == volume
        assert dataset["kinetic_energy"].units == ("J" if run.d == 3 else "J m-1")
        assert dataset["rotation_angle"].units == "degree" and dataset["volume_ratio"].units == "1"
        assert dataset["time"].units == "s" and dataset["time"].dtype == np.float64


def test_statistics_of_the_frames_on_disk_are_statistics_nc(run):
    again, written = measure_series(read_series(run.folder)), read_dataset(run.folder / "statistics.nc")
    xarray.testing.assert_equal(again, written)


def test_a_dataset_of_a_series_has_the_attributes_of_statistics_nc(run):
    again, written = measure_series(read_series(run.folder)), read_dataset(run.folder / "statistics.nc")
    assert_conventional(again)
    for name in written.variables:
        for key in ("units", "long_name"):
            assert again[name].attrs.get(key) == written[name].attrs.get(key)


def test_kinematic_numbers_follow_from_the_points_alone(run):
    """Every kinematic number again, from frames without the values that only the solver knows."""
    written = read_dataset(run.folder / "statistics.nc")
    for i, frame in enumerate(read_series(run.folder)):
        for name, value in measure(replace(frame, known={})).items():
            # sums over an array that lies differently in memory may round otherwise
            assert written[name][i].values == pytest.approx(value, rel=1e-13, abs=1e-13), name


def test_statistics_are_measured_again_if_points_were_moved(run, tmp_path):
    for file in frame_files(run.folder):
        grid = pyvista.read(file)
        grid.points = grid.points * 2.0
        (tmp_path / "frames").mkdir(exist_ok=True)
        grid.save(tmp_path / "frames" / file.name, binary=True)
    (tmp_path / "series.pvd").write_text((run.folder / "series.pvd").read_text())
    before, after = (measure_series(read_series(folder)) for folder in (run.folder, tmp_path))
    for name in ("volume_ratio", "total_volume", "volume_ratio_mean", "volume_ratio_quantile"):
        assert after[name].values == pytest.approx(2**run.d * before[name].values, rel=1e-12), name
    assert after["center_of_mass"].values == pytest.approx(2 * before["center_of_mass"].values, rel=1e-12)


def test_a_foreign_series_has_the_kinematic_part_under_the_same_names(run, tmp_path):
    rows = []
    for i, file in enumerate(frame_files(run.folder)):
        grid = pyvista.read(file)
        grid.clear_data()
        grid.save(tmp_path / f"f{i}.vtu")
        rows.append(f'<DataSet timestep="{i * 0.02!r}" file="f{i}.vtu"/>')
    (tmp_path / "theirs.pvd").write_text(
        f'<VTKFile type="Collection"><Collection>{"".join(rows)}</Collection></VTKFile>'
    )
    theirs = measure_series(read_series(tmp_path / "theirs.pvd", name="theirs"))
    ours = read_dataset(run.folder / "statistics.nc")
    assert set(theirs.data_vars) == {"rest_volume", *FIXED_MODEL} - {
        "kinetic_energy", "elastic_energy", "potential_energy", "linear_momentum", "angular_momentum",
        "newton_iterations",
    }  # fmt: skip
    for name in theirs.data_vars:  # its first frame is the rest state here
        assert theirs[name].values == pytest.approx(ours[name].values, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("none.pvd", None, "no series there"),
        ("bad.pvd", "<VTKFile", "not a ParaView index"),
        ("empty.pvd", '<VTKFile type="Collection"><Collection/></VTKFile>', "lists no frame"),
        ("key.pvd", "<VTKFile><Collection><DataSet file='a'/></Collection></VTKFile>", "at t = 0 s is missing"),
    ],
)
def test_a_path_that_is_no_series_is_refused_by_name(tmp_path, name, text, words):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(SeriesError, match=words) as caught:
        read_series(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value) and "\n" not in str(caught.value)


# Runs that break off


def assert_complete(folder, count: int) -> None:
    """All files of `count` frames can be read and agree."""
    assert [file.name for file in frame_files(folder)] == [f"frame_{i:06d}.vtu" for i in range(count)]
    for file in frame_files(folder):
        vtk_read(file)
    written = read_dataset(folder / "statistics.nc")
    assert written.sizes["time"] == count and np.isfinite(written["volume_ratio"].values).all()
    assert leftovers(folder) == []


@pytest.mark.parametrize("error", [RuntimeError("in the middle"), KeyboardInterrupt()], ids=["error", "interrupt"])
def test_every_file_is_complete_after_an_exception_in_the_middle(tmp_path, error):
    def source(problem):
        for frame in frames(problem):
            if frame.index == 3:
                raise error
            yield frame

    with pytest.raises(type(error)):
        record(source(problem_of(tmp_path)), sinks(tmp_path))
    assert_complete(tmp_path, 3)
    xarray.testing.assert_equal(measure_series(read_series(tmp_path)), read_dataset(tmp_path / "statistics.nc"))


def test_a_sink_that_fails_leaves_the_files_of_the_others_complete(tmp_path):
    class Full:
        def write(self, frame, measured):
            if frame.index == 2:
                raise OutputError("disk full")

        def close(self):
            raise OutputError("and cannot be closed")

    first, second = sinks(tmp_path)
    with pytest.raises(OutputError):
        record(frames(problem_of(tmp_path)), [first, second, Full()])
    assert_complete(tmp_path, 3)
    assert len(read_series(tmp_path)) == 3


def test_a_killed_run_keeps_the_frames_that_it_wrote(tmp_path):
    """The process ends without closing anything; only the index may be a second behind."""
    write_case(tmp_path)
    code = """
import os
from pathlib import Path
from tests.sinks.test_files import problem_of, sinks
from pipeline import frames, record
folder = Path(os.environ["FOLDER"])
record(frames(problem_of(folder)), sinks(folder), on_frame=lambda frame, *_: frame.index == 3 and os._exit(9))
"""
    environment = os.environ | {"FOLDER": str(tmp_path), "PYTHONPATH": ROOT}
    assert subprocess.run([sys.executable, "-c", code], env=environment).returncode == 9
    assert_complete(tmp_path, 4)
    assert len(read_series(tmp_path)) >= 1


def test_a_file_is_the_old_one_or_the_new_one(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    write_whole(path, "old")

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OutputError, match=r"a.txt: cannot be written \(No space left on device\)"):
        write_whole(path, "new")
    assert path.read_text() == "old" and leftovers(tmp_path) == []


@pytest.mark.parametrize("make", [VtuSink, lambda folder: NetcdfSink(folder / "statistics.nc", title="x")])
def test_a_folder_that_cannot_be_made_is_an_output_error(tmp_path, make):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be written"):
        record(frames(problem_of(tmp_path)), [make(tmp_path / "file" / "run")])
