"""One file for all frames, read back by VTK; if the writer is killed, the frames before are readable."""

import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader

from pipeline import build, frames, load_case, read_series, record
from pipeline.errors import OutputError
from pipeline.formats.vtkhdf import VtkhdfFile
from pipeline.run.measures import VARIABLES, measure, pad_to_space
from pipeline.series.xarray_plugin import SeriesBackend
from pipeline.sinks import frame_formats as formats
from pipeline.sinks.fields import make_frame_fields
from pipeline.sinks.vtkhdf import VtkhdfSink
from pipeline.sinks.vtu import VtuSink
from tests.bodies import PLANAR, write_case
from tests.measured import measure_series
from tests.sinks.test_files import arrays

ROOT = Path(__file__).resolve().parents[2]
SCENES = {"3D": {}, "2D": PLANAR}


@pytest.fixture(scope="module", params=SCENES)
def given(request, tmp_path_factory):
    path = write_case(tmp_path_factory.mktemp("case"), **SCENES[request.param])
    return list(frames(build(load_case(path).variant("polar"))))


def read(path, step):
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.SetStep(step)
    reader.Update()
    assert reader.GetErrorCode() == 0
    return reader.GetOutputDataObject(0)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("room", [5, 64, 1], ids=["as_many", "more", "fewer"])
def test_vtk_finds_every_frame_and_field_as_in_the_vtu(given, tmp_path, room, precision):
    record(iter(given), [VtkhdfSink(tmp_path, frames=room, precision=precision)])
    record(iter(given), [VtuSink(tmp_path / "vtu", precision=precision)])
    series, other = read_series(tmp_path), read_series(tmp_path / "vtu")
    assert series.times == other.times == tuple(frame.time for frame in given) and series.notes == ()
    for i, frame in enumerate(given):
        grid, fields = read(tmp_path / "series.vtkhdf", i), make_frame_fields(frame, measure(frame), precision)
        points = vtk_to_numpy(grid.GetPoints().GetData())
        assert points.dtype == precision and np.array_equal(points, fields.points)
        wanted = {**fields.nodal, "rest_position": pad_to_space(frame.mesh.points).astype(precision)}
        for data, expected in ((grid.GetPointData(), wanted), (grid.GetCellData(), fields.cellular)):
            found = arrays(data)
            assert found.keys() == expected.keys()
            assert all(found[name].dtype == precision for name in found)
            assert all(np.array_equal(found[name], expected[name]) for name in found)
        numbers = arrays(grid.GetFieldData())
        assert numbers.keys() == {*fields.numbers, "Time"}  # VTK adds the last one
        for name, value in fields.numbers.items():
            assert numbers[name].dtype == value.dtype and np.array_equal(numbers[name].ravel(), value.ravel())
        assert series.read_grid(i).types.tolist() == other.read_grid(i).types.tolist()
        assert np.array_equal(series.read_grid(i).connectivity, other.read_grid(i).connectivity)
        assert series.read_frame(i).step == frame.step


def test_a_kill_before_the_first_frame_is_appended_leaves_that_frame(given, tmp_path, monkeypatch):
    def kill(*_):
        raise KeyboardInterrupt

    moved = given[2]
    monkeypatch.setattr(VtkhdfFile, "append", kill)
    with pytest.raises(KeyboardInterrupt):
        VtkhdfSink(tmp_path).write(moved, measure(moved))
    points = vtk_to_numpy(read(tmp_path / "series.vtkhdf", 0).GetPoints().GetData())
    assert np.array_equal(points, pad_to_space(moved.x))


def test_the_dataset_is_rebuilt_from_the_file(given, tmp_path):
    record(iter(given), [VtkhdfSink(tmp_path), VtuSink(tmp_path / "vtu")])
    ours, theirs = (measure_series(read_series(folder)) for folder in (tmp_path, tmp_path / "vtu"))
    xarray.testing.assert_equal(ours, theirs)
    with xarray.open_dataset(tmp_path / "series.vtkhdf", engine=SeriesBackend) as dataset:
        assert dataset.sizes["time"] == len(given)


def test_cells_are_stored_once_and_a_frame_takes_only_its_numbers(tmp_path):
    path = write_case(tmp_path, mesh={"shape": "box", "size": [2.0, 3.0, 1.0], "cells": [8, 12, 4]})
    problem = build(load_case(path).variant("polar"))
    given = [replace(frame, index=i) for i, frame in enumerate(list(frames(problem)) * 4)]
    sizes = []
    for count in (4, 16):
        record(iter(given[:count]), [VtkhdfSink(tmp_path / str(count), frames=count)])
        sizes.append((tmp_path / str(count) / "series.vtkhdf").stat().st_size)
    n, e = len(problem.body.mesh.points), len(problem.body.mesh.cells)
    numbers = sum(np.prod([{"axis": 3, "quantile": 9}[d] for d in v.dims] or [1]) for v in VARIABLES.values() if
                  v.dims != ("cell",))  # fmt: skip
    assert (sizes[1] - sizes[0]) / 12 < 8 * (9 * n + 3 * e + numbers) + 512
    assert sizes[0] < 4 * 8 * (9 * n + 3 * e + numbers) + 8 * 4 * e


def test_unused_room_takes_no_disk_space(given, tmp_path):
    record(iter(given), [VtkhdfSink(tmp_path, frames=100_000)])
    told = (tmp_path / "series.vtkhdf").stat()
    assert told.st_blocks * 512 < told.st_size / 10


def test_a_resumed_file_equals_one_written_in_one_go(given, tmp_path):
    record(iter(given), [VtkhdfSink(tmp_path / "whole", frames=5)])
    record(iter(given[:4]), [VtkhdfSink(tmp_path / "parts", frames=5)])  # one more than the checkpoint knows of
    record(iter(given[3:]), [VtkhdfSink(tmp_path / "parts", frames=5, earlier=[f.time for f in given[:3]])])
    whole, parts = (read_series(tmp_path / name) for name in ("whole", "parts"))
    assert whole.times == parts.times
    xarray.testing.assert_equal(measure_series(whole), measure_series(parts))


def test_a_frame_is_listed_by_a_write_of_a_few_bytes(given, tmp_path, monkeypatch):
    """All other changes are at places that readers do not see yet: a kill between two writes harms nothing."""
    path, seen = tmp_path / "series.vtkhdf", []
    sink = VtkhdfSink(tmp_path, frames=5)
    genuine = h5py.File.flush

    def flushed(self):
        genuine(self)
        seen.append(path.read_bytes())

    sink.write(given[0], measure(given[0]))
    monkeypatch.setattr(h5py.File, "flush", flushed)
    for frame in given[1:]:
        sink.write(frame, measure(frame))
    sink.close()
    assert len(seen) == 2 * len(given[1:])
    for before, after in zip(seen[0::2], seen[1::2], strict=True):
        changed = np.flatnonzero(np.frombuffer(before, np.uint8) != np.frombuffer(after, np.uint8))
        entry = changed[: np.searchsorted(changed, changed[0] + 40)]
        # one entry of a symbol table, and how many links each group has, which no reader asks for
        assert len(entry) > 0 and len(changed) - len(entry) <= 2
    for i, image in enumerate(seen):
        (tmp_path / "image.vtkhdf").write_bytes(image)
        series = read_series(tmp_path / "image.vtkhdf")
        assert len(series) == 1 + (i + 1) // 2
        assert np.array_equal(series.read_frame(len(series) - 1).x, given[len(series) - 1].x)


WRITER = """
import sys
from dataclasses import replace
from itertools import count
from pathlib import Path
from pipeline import build, frames, load_case
from pipeline.run.measures import measure
from pipeline.sinks.vtkhdf import VtkhdfSink
frame = next(frames(build(load_case(sys.argv[1]).variant("polar"))))
sink = VtkhdfSink(Path(sys.argv[2]), frames=int(sys.argv[3]))
for i in count():
    sink.write(replace(frame, index=i, step=i, time=float(i), x=frame.x + i), measure(frame))
    if not i % 50:
        print(i, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("room", [8, 1_000_000], ids=["growing", "room"])
def test_kill_9_leaves_every_listed_frame(tmp_path, room):
    case = write_case(tmp_path)
    for moment in range(3):
        folder = tmp_path / str(moment)
        child = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(case), str(folder), str(room)],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        assert child.stdout is not None and child.stdout.readline() == "0\n"
        time.sleep(0.05 + 0.07 * moment)
        child.kill()
        told = [int(line) for line in child.communicate()[0].split()]
        series = read_series(folder)
        assert series.times == tuple(float(i) for i in range(len(series))) and len(series) > max(told, default=0)
        for i in {0, len(series) // 2, len(series) - 1}:
            assert series.read_frame(i).step == i and series.read_frame(i).x.min() == pytest.approx(
                series.read_frame(0).x.min() + i
            )


def test_a_missing_package_is_reported_before_solving(tmp_path, monkeypatch, capfd):
    from pipeline.cli import main

    monkeypatch.setattr(formats, "find_spec", lambda name: None)
    path = write_case(tmp_path, output={"format": "vtkhdf"})
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 4
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and "needs h5py" in err and "corotational-pipeline[series]" in err
    assert not (tmp_path / "out").exists()


def test_a_file_that_cannot_be_written_is_an_output_error(given, tmp_path):
    (tmp_path / "series.vtkhdf").write_bytes(b"junk")
    sink = VtkhdfSink(tmp_path, earlier=[0.0])
    with pytest.raises(OutputError, match="cannot be written"):
        sink.write(given[1], measure(given[1]))
    sink.close()


@pytest.mark.parametrize("name", formats.FORMATS)
def test_a_case_can_name_every_format(tmp_path, name):
    assert load_case(write_case(tmp_path, output={"format": name})).output.format == name
