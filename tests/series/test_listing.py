"""Frames are files and times: equal, rounded and missing times, odd names and paths, restarts, and parts of a body."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from pipeline.cli import main
from pipeline.errors import SeriesError
from pipeline.formats.bodies import are_apart
from pipeline.formats.listed_paths import locate_file
from pipeline.formats.pvd import read_index
from pipeline.formats.times import find_resolution, find_time_field, parse_time
from pipeline.run.measures import measure
from pipeline.series import read_series
from pipeline.series.files.file_names import read_decimals
from pipeline.series.files.frame_files import read_grid, read_times
from pipeline.series.files.listing import list_frames
from tests.foreign.displacements import CELLS, POINTS, TETRAHEDRA
from tests.foreign.writers import bar, index, split, stretch, write_pvd, write_vtu

BESIDE, ABOVE = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def write_frames(folder: Path, names, factors, **options) -> list[Path]:
    """Write a frame of the bar for each name: deformed points, stretched by the factor."""
    files = [folder / name for name in names]
    for file, factor in zip(files, factors, strict=True):
        write_vtu(file, stretch(POINTS, factor), TETRAHEDRA, **options)
    return files


def write_index(folder: Path, rows) -> Path:
    """Write an index of (time, file) rows."""
    write_pvd(folder / "s.pvd", [{"timestep": t, "part": 0, "file": name} for t, name in rows])
    return folder / "s.pvd"


def list_ratios(path) -> list[float]:
    """The volume ratio of each frame, which must be that of all cells."""
    ratios = [measure(frame)["volume_ratio"] for frame in read_series(path)]
    assert all(np.ptp(ratio) < 1e-9 for ratio in ratios)
    return [float(ratio[0]) for ratio in ratios]


def assert_asked(path, *words: str) -> None:
    """The series is refused with these words in one line, and the program ends with exit code 2."""
    with pytest.raises(SeriesError) as caught:
        read_series(path)
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words), caught.value
    assert main(["analyze", str(path), "--quiet"]) == 2


# Texts of times


@pytest.mark.parametrize(
    ("text", "time", "resolution"),
    [
        ("0", 0.0, 1.0), ("0.25", 0.25, 0.01), ("8e+06", 8e6, 1e6), ("1.50e-3", 1.5e-3, 1e-5), (" 2 ", 2.0, 1.0),
        ("0,5", 0.5, 0.1), ("-1,25", -1.25, 0.01), ("2.0D-1", 0.2, 0.01), ("1d3", 1000.0, 1000.0), (".5", 0.5, 0.1),
    ],
)  # fmt: skip
def test_texts_of_times(text, time, resolution):
    assert parse_time(text) == pytest.approx(time, rel=1e-15)
    assert find_resolution(text) == pytest.approx(resolution, rel=1e-15)


@pytest.mark.parametrize("text", ["", "abc", "1,000,000", "1_0", "0x1", "1 2", "D", "1e", "0.5 s"])
def test_other_texts_are_no_times(text):
    with pytest.raises(ValueError, match="is not a number"):
        parse_time(text)


@pytest.mark.parametrize(
    ("names", "field"),
    [
        (["TimeValue", "TIME"], "TimeValue"), (["CYCLE", "TIME"], "TIME"), (["time"], "time"), (["t"], "t"),
        (["Time_Value"], "Time_Value"), (["Sim Time"], "Sim Time"), (["thickness", "timestep", "dt"], None), ([], None),
    ],
)  # fmt: skip
def test_fields_that_hold_times(names, field):
    assert find_time_field(names) == field


# Equal times


def test_rounded_times_keep_every_frame_and_are_told(tmp_path):
    factors = (1.0, 1.1, 1.2, 1.8, 1.3, 1.4)
    write_frames(tmp_path, [f"f_{k}.vtu" for k in range(6)], factors)
    texts = ["0", "4e+06", "8e+06", "8e+06", "8e+06", "1.2e7"]
    path = write_index(tmp_path, zip(texts, [f"f_{k}.vtu" for k in range(6)], strict=True))
    series = read_series(path)
    assert list_ratios(path) == pytest.approx(factors)
    third = 0.5e6 / 3
    assert series.times == pytest.approx([0, 4e6, 8e6, 8e6 + third, 8e6 + 2 * third, 1.2e7])
    assert any("3 frames have the time 8e+06, as if it had been rounded" in note for note in series.notes)


def test_the_times_in_the_files_tell_rounded_ones_apart(tmp_path):
    own = [0.0, 1.001, 1.002, 1.003, 2.0]
    for k, time in enumerate(own):
        write_vtu(tmp_path / f"f_{k}.vtu", stretch(POINTS, 1 + k), TETRAHEDRA, field_data={"TimeValue": [time]})
    path = write_index(tmp_path, [(f"{time:.2f}", f"f_{k}.vtu") for k, time in enumerate(own)])
    series = read_series(path)
    assert series.times == pytest.approx([0.0, 1.001, 1.002, 1.003, 2.0])
    assert any("told apart by the times in their files" in note for note in series.notes)


def test_times_that_are_written_in_full_are_spread_over_a_step(tmp_path):
    write_frames(tmp_path, [f"f_{k}.vtu" for k in range(4)], (1.0, 1.2, 1.3, 1.5))
    path = write_index(tmp_path, [(t, f"f_{k}.vtu") for k, t in enumerate([0.0, 1 / 3, 1 / 3, 1.0])])
    assert list_frames(path, strict=False).members[2].time == pytest.approx(0.5)
    assert list_ratios(path) == pytest.approx([1.0, 1.2, 1.3, 1.5])


@pytest.mark.parametrize("time", [0.0, 7.5])
def test_one_time_for_all_is_counted(tmp_path, time):
    names = [f"f_{k}.vtu" for k in (8, 9, 10)]
    write_frames(tmp_path, names, (1.0, 1.2, 1.5), field_data={"TimeValue": [time]})
    for path in (tmp_path, write_index(tmp_path, [(time, name) for name in names])):
        series = read_series(path)
        assert series.times == (0.0, 1.0, 2.0) and list_ratios(path) == pytest.approx([1.0, 1.2, 1.5])
        assert any("counted from 0" in note for note in series.notes)


def test_equal_files_of_one_time_are_one_frame(tmp_path):
    write_frames(tmp_path, ["f_0.vtu", "f_1.vtu", "f_2.vtu", "f_3.vtu"], (1.0, 1.2, 1.2, 1.5))
    path = write_index(tmp_path, [(0, "f_0.vtu"), (0.1, "f_1.vtu"), (0.1, "f_2.vtu"), (0.2, "f_3.vtu")])
    series = read_series(path)
    assert series.times == (0.0, 0.1, 0.2) and list_ratios(path) == pytest.approx([1.0, 1.2, 1.5])
    assert any("1 frames have the time and the content of the next one" in note for note in series.notes)


# Restarts


def test_a_restart_replaces_the_frames_after_its_begin(tmp_path):
    """0, 1, 2, 3, then again from 1.5, although no time recurs: the names go on."""
    write_frames(tmp_path, [f"f_{k}.vtu" for k in range(7)], (1.0, 1.1, 9.0, 9.0, 1.15, 1.25, 1.35))
    times = [0, 1, 2, 3, 1.5, 2.5, 3.5]
    for k, time in enumerate(times):
        factor = (1.0, 1.1, 9.0, 9.0, 1.15, 1.25, 1.35)[k]
        write_vtu(tmp_path / f"f_{k}.vtu", stretch(POINTS, factor), TETRAHEDRA, field_data={"TimeValue": [float(time)]})
    for path in (tmp_path, write_index(tmp_path, [(t, f"f_{k}.vtu") for k, t in enumerate(times)])):
        series = read_series(path)
        assert series.times == (0.0, 1.0, 1.5, 2.5, 3.5)
        assert list_ratios(path) == pytest.approx([1.0, 1.1, 1.15, 1.25, 1.35])
        assert any("2 files that it replaced" in note for note in series.notes)


def test_a_run_into_the_same_files_replaces_all(tmp_path):
    write_frames(tmp_path, [f"f_{k}.vtu" for k in range(3)], (1.0, 1.2, 1.5))
    rows = [(0, "f_0.vtu"), (1, "f_1.vtu"), (2, "f_2.vtu"), (0, "f_0.vtu"), (2, "f_1.vtu"), (4, "f_2.vtu")]
    path = write_index(tmp_path, rows)
    assert read_series(path).times == (0.0, 2.0, 4.0) and list_ratios(path) == pytest.approx([1.0, 1.2, 1.5])


def test_times_that_begin_again_in_other_files_are_asked_about(tmp_path):
    """Two steps of an analysis, each with its own clock, or two runs."""
    for k, time in enumerate([0.0, 1.0, 2.0, 0.0, 1.0, 2.0]):
        write_vtu(tmp_path / f"f_{k}.vtu", stretch(POINTS, 1 + k), TETRAHEDRA, field_data={"TimeValue": [time]})
    assert_asked(tmp_path, "begin again", "f_3.vtu", "pattern")
    path = write_index(tmp_path, [(k % 3, f"f_{k}.vtu") for k in range(6)])
    assert_asked(path, "begin again", "f_3.vtu")
    assert len(read_series(tmp_path / "f_[345].vtu")) == 3


def test_an_unsorted_index_is_sorted(tmp_path):
    """The order of names as text: f_0, f_1, f_10, f_2, and the reverse order."""
    order = sorted(range(12), key=str)
    write_frames(tmp_path, [f"f_{k}.vtu" for k in range(12)], [1 + 0.1 * k for k in range(12)])
    for rows in (order, range(11, -1, -1)):
        path = write_index(tmp_path, [(0.5 * k, f"f_{k}.vtu") for k in rows])
        series = read_series(path)
        assert series.times == tuple(0.5 * k for k in range(12))
        assert list_ratios(path) == pytest.approx([1 + 0.1 * k for k in range(12)])
        assert any("sorted by time" in note for note in series.notes)


# Missing times


def test_an_index_without_times_takes_those_of_the_files(tmp_path):
    for k in range(3):
        write_vtu(tmp_path / f"f_{k}.vtu", stretch(POINTS, 1 + k), TETRAHEDRA, field_data={"TIME": [0.5 * k]})
    write_pvd(tmp_path / "s.pvd", [{"file": f"f_{k}.vtu"} for k in range(3)])
    assert read_series(tmp_path / "s.pvd").times == (0.0, 0.5, 1.0)
    write_pvd(tmp_path / "s.pvd", [{"file": "f_0.vtu", "timestep": 0}, {"file": "f_2.vtu"}])
    assert read_series(tmp_path / "s.pvd").times == (0.0, 1.0)


def test_an_index_without_any_times_is_counted_or_asked_about(tmp_path):
    write_frames(tmp_path, [f"f_{k}.vtu" for k in range(3)], (1.0, 1.2, 1.5))
    write_pvd(tmp_path / "s.pvd", [{"file": f"f_{k}.vtu"} for k in range(3)])
    series = read_series(tmp_path / "s.pvd")
    assert series.times == (0.0, 1.0, 2.0) and any("no times" in note for note in series.notes)
    write_pvd(tmp_path / "s.pvd", [{"file": "f_0.vtu", "timestep": 0.5}, {"file": "f_1.vtu"}])
    assert_asked(tmp_path / "s.pvd", "timestep", "f_1.vtu")


def test_times_in_some_files_only_are_asked_about(tmp_path):
    write_frames(tmp_path, ["f_0.vtu", "f_1.vtu"], (1.0, 1.2), field_data={"TimeValue": [0.5]})
    write_frames(tmp_path, ["f_2.vtu"], (1.5,))
    assert_asked(tmp_path, "f_2.vtu", ".pvd")


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
@pytest.mark.parametrize("name", ["TIME", "time", "Time", "t"])
def test_times_under_other_names(tmp_path, suffix, name):
    import pyvista

    for k in range(3):
        grid = pyvista.UnstructuredGrid({10: CELLS}, stretch(POINTS, 1 + k))
        grid.field_data[name] = [0.25 * k]
        grid.save(tmp_path / f"f_{k}{suffix}", binary=k != 1)
    series = read_series(tmp_path)
    assert series.times == (0.0, 0.25, 0.5)
    assert any(f"the field {name} of the files" in note for note in series.notes)


def test_several_time_values_are_no_steps(tmp_path):
    """The times of a whole run, written into every file."""
    write_frames(tmp_path, ["f_0.vtu", "f_1.vtu"], (1.0, 1.2), field_data={"TimeValue": [0.0, 0.5]})
    series = read_series(tmp_path)
    assert series.times == (0.0, 1.0) and list_ratios(tmp_path) == pytest.approx([1.0, 1.2])


# Names


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["r-0.0005.vtu", "r-0.001.vtu", "r-0.0015.vtu", "r-0.002.vtu"], [0.0005, 0.001, 0.0015, 0.002]),
        (["r_9.5.vtu", "r_10.0.vtu", "r_10.5.vtu"], [9.5, 10.0, 10.5]),
        (["t1e-05.vtu", "t0.0001.vtu", "t0.5.vtu", "t1.vtu"], [1e-5, 1e-4, 0.5, 1.0]),
        (["0.5/f.vtu", "1/f.vtu", "1.5/f.vtu"], [0.5, 1.0, 1.5]),
        (["m_4.1.vtu", "m_4.2.vtu", "m_4.9.vtu", "m_4.10.vtu"], None),  # counters
        (["a1.0_7.vtu", "a1.0_8.vtu"], None),
        (["f_8.vtu", "f_9.vtu"], None),
        (["f.0008.vtu", "f.0009.vtu"], None),
        (["f_1.2.3.vtu", "f_1.2.4.vtu"], None),
        (["one.vtu"], None),
    ],
)
def test_decimals_in_names(names, times):
    assert read_decimals([Path(name) for name in names]) == times


def test_decimals_in_names_are_times_if_the_files_have_none(tmp_path):
    times = (0.0005, 0.001, 0.0015, 0.002, 0.01)
    write_frames(tmp_path, [f"result-{t}.vtu" for t in times], [1 + t for t in times])
    series = read_series(tmp_path)
    assert series.times == times and list_ratios(tmp_path) == pytest.approx([(1 + t) / 1.0005 for t in times])
    assert any("numbers in the names are taken as the times" in note for note in series.notes)
    for t in times:
        file = tmp_path / f"result-{t}.vtu"
        write_vtu(file, stretch(POINTS, 1 + t), TETRAHEDRA, field_data={"TimeValue": [2 * t]})
    assert read_series(tmp_path).times == tuple(2 * t for t in times)


def test_frames_in_folders_of_their_own(tmp_path):
    times = (0.5, 2, 10.25)
    write_frames(tmp_path, [f"{t}/f.vtu" for t in times], [1 + t for t in times])
    series = read_series(tmp_path / "*" / "f.vtu")
    assert series.times == (0.5, 2.0, 10.25) and list_ratios(tmp_path / "*" / "f.vtu") == pytest.approx([1, 2, 7.5])


def test_counters_after_a_point_are_in_order(tmp_path):
    write_frames(tmp_path, [f"m_4.{k}.vtu" for k in range(12)], [1 + k for k in range(12)])
    series = read_series(tmp_path)
    assert series.times == tuple(map(float, range(12))) and list_ratios(tmp_path) == pytest.approx(range(1, 13))


@pytest.mark.parametrize("suffix", [".VTU", ".Vtu"])
def test_suffixes_in_capitals(tmp_path, suffix):
    write_frames(tmp_path, [f"f_{k}{suffix}" for k in range(2)], (1.0, 1.2))
    write_pvd(tmp_path / "S.PVD", [{"timestep": k, "file": f"f_{k}{suffix}"} for k in range(2)])
    for path in (tmp_path / "S.PVD", tmp_path, tmp_path / f"f_*{suffix}"):
        assert list_ratios(path) == pytest.approx([1.0, 1.2])


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("out.pvd", "out"), ("out-0.5.pvd", "out-0.5"), ("out.vtu.series", "out"), ("out_*.vtu", "out"),
        ("*.vtu", "here"), ("series.pvd", "here"), ("out_0.vtu", "out_0"), (".", "here"),
    ],
)  # fmt: skip
def test_names_of_series(tmp_path, path, name):
    folder = tmp_path / "here"
    write_frames(folder, ["out_0.vtu"], (1.0,))
    if path.endswith("pvd"):
        write_pvd(folder / path, [{"timestep": 0, "file": "out_0.vtu"}])
    if path.endswith("series"):
        (folder / path).write_text(json.dumps({"files": [{"name": "out_0.vtu", "time": 0}]}))
    assert read_series(folder / path).name == name


def test_a_folder_tells_files_that_its_index_does_not_list(tmp_path):
    write_frames(tmp_path, ["f_0.vtu", "f_1.vtu", "other_0.vtu", "other_1.vtu"], (1.0, 1.2, 3.0, 4.0))
    write_index(tmp_path, [(0, "f_0.vtu"), (1, "f_1.vtu")])
    series = read_series(tmp_path)
    assert len(series) == 2 and any("does not list: other_*.vtu" in note for note in series.notes)
    write_pvd(tmp_path / "second.PVD", [{"timestep": 0, "file": "f_0.vtu"}])
    assert_asked(tmp_path, "several series", "s.pvd", "second.PVD")


def test_an_initial_state_beside_numbered_files_is_asked_about(tmp_path):
    write_frames(tmp_path, ["M.init.vtu", "M.dt1.vtu", "M.dt2.vtu"], (1.0, 1.2, 1.5))
    assert_asked(tmp_path, "several series", "M.dt*.vtu (2)", "M.init.vtu (1)")
    assert list_ratios(tmp_path / "M.dt*.vtu") == pytest.approx([1.0, 1.25])


# Paths


@pytest.fixture
def run(tmp_path) -> Path:
    """A folder with frames in vtu/."""
    folder = tmp_path / "run"
    write_frames(folder / "vtu", [f"f_{k}.vtu" for k in range(3)], (1.0, 1.2, 1.5))
    return folder


@pytest.mark.parametrize("pattern", ["vtu\\f_{}.vtu", ".\\vtu\\f_{}.vtu", "./vtu/f_{}.vtu", "vtu/../vtu/f_{}.vtu"])
def test_separators_and_dots(run, pattern):
    index(run, pattern=pattern)
    assert list_ratios(run / "s.pvd") == pytest.approx([1.0, 1.2, 1.5])


def test_absolute_paths_within_the_folder(run, monkeypatch):
    index(run, pattern=f"{run}/vtu/f_{{}}.vtu")
    assert list_ratios(run / "s.pvd") == pytest.approx([1.0, 1.2, 1.5])
    assert any("by absolute paths" in note for note in read_series(run / "s.pvd").notes)
    monkeypatch.chdir(run)
    assert len(read_series("s.pvd")) == 3
    (run.parent / "link").symlink_to(run)
    assert len(read_series(run.parent / "link" / "s.pvd")) == 3
    index(run, pattern=f"{run.parent}/link/vtu/f_{{}}.vtu")
    assert len(read_series(run.parent / "link" / "s.pvd")) == 3


@pytest.mark.parametrize(
    "old", ["C:\\work\\run\\vtu\\f_{}.vtu", "/home/somebody/run/vtu/f_{}.vtu", "\\\\host\\d\\vtu\\f_{}.vtu"]
)
def test_absolute_paths_of_a_folder_that_was_moved(run, old):
    index(run, pattern=old)
    series = read_series(run / "s.pvd")
    assert len(series) == 3 and any("do not exist here" in note for note in series.notes)
    index(run, pattern=old.replace("f_{}", "g_{}"))
    assert_asked(run / "s.pvd", "outside its own folder", "put it beside")


def test_a_moved_folder_does_not_hide_the_files_that_are_meant(run):
    """The absolute paths of a copy exist and mean the original's files."""
    index(run, pattern=f"{run}/vtu/f_{{}}.vtu")
    shutil.copytree(run, run.parent / "copy")
    assert_asked(run.parent / "copy" / "s.pvd", "outside its own folder")


def test_a_folder_beside_that_of_the_index(run):
    index(run / "pvd", pattern="../vtu/f_{}.vtu")
    series = read_series(run / "pvd" / "s.pvd")
    assert list_ratios(run / "pvd" / "s.pvd") == pytest.approx([1.0, 1.2, 1.5])
    assert any("a folder beside that of the index" in note for note in series.notes)


@pytest.mark.parametrize(
    "name", ["../../x/f_0.vtu", "../passwd", "../vtu/f_0.txt", "/etc/passwd", "..", "../vtu/\0.vtu"]
)
def test_other_places_are_refused(run, name):
    with pytest.raises(SeriesError, match="outside its own folder"):
        locate_file(run / "pvd" / "s.pvd", name)


def test_a_link_to_another_disk_is_followed(run):
    (run / "vtu").rename(run.parent / "scratch")
    (run / "vtu").symlink_to(run.parent / "scratch")
    index(run, pattern="vtu/f_{}.vtu")
    assert len(read_series(run / "s.pvd")) == 3


# Damaged and hostile indices


@pytest.mark.parametrize("end", ["</Collection>", '<DataSet timestep="0.2" part', '"f_2.vtu"', 'ile="f_2'])
def test_a_killed_index_gives_its_complete_entries(tmp_path, end):
    write_frames(tmp_path, [f"f_{k}.vtu" for k in range(3)], (1.0, 1.2, 1.5))
    index(tmp_path)
    text = (tmp_path / "s.pvd").read_text()
    (tmp_path / "s.pvd").write_text(text[: text.index(end)])
    count = 3 if end == "</Collection>" else 2
    series = read_series(tmp_path / "s.pvd")
    assert len(series) == count and any(
        f"too early, as if its program had been stopped; {count}" in n for n in series.notes
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not a ParaView index"),
        (b"\0\1\2" * 1000, "UTF-16"),
        (b"<VTKFile><Collection>", "not a ParaView index"),
        (b"<a><Collection><DataSet timestep='x' file='f.vtu'/></Collection></a>", "the time 'x' is not a number"),
        (b"<a><Collection><DataSet timestep='nan' file='f.vtu'/></Collection></a>", "nan is not a number"),
        (b"<a><Collection><DataSet timestep='1e999' file='f.vtu'/></Collection></a>", "inf is not a number"),
        (b"<a><Collection><DataSet timestep='1'/></Collection></a>", "not a ParaView index"),
        (b"<VTKFile><Collection></Collection></VTKFile>", "lists no frames"),
        (b"<a><Collection><DataSet timestep='1' file='\xe4.vtu'/></Collection></a>", "not a ParaView index"),
        (b"<!DOCTYPE a [<!ENTITY b 'c'>]><VTKFile>&b;</VTKFile>", "entities"),
        (b"<a>" * 200_000, "not a ParaView index"),
    ],
)  # fmt: skip
def test_hostile_indices_are_one_line(tmp_path, content, words):
    (tmp_path / "s.pvd").write_bytes(content)
    assert_asked(tmp_path / "s.pvd", words)


@pytest.mark.parametrize(
    "content",
    [
        b"", b"[]", b"{}", b"\xff\xfe", b"[" * 100_000, b'{"files": 5}', b'{"files": [5]}', b'{"files": [{"time": 0}]}',
        b'{"files": [{"name": "a.vtu", "time": true}]}', b'{"files": [{"name": "a.vtu", "time": null}]}',
        b'{"files": [{"name": 7, "time": 1}]}', b'{"files": [{"name": "a.vtu", "time": 1' + b"0" * 400 + b"}]}",
        b'{"files": [{"name": "a.vtu", "time": 1' + b"0" * 5000 + b"}]}",
    ],
)  # fmt: skip
def test_hostile_json_is_one_line(tmp_path, content):
    (tmp_path / "s.vtu.series").write_bytes(content)
    assert_asked(tmp_path / "s.vtu.series", "s.vtu.series")


def test_an_index_that_is_too_large_is_not_read(tmp_path):
    with (tmp_path / "s.pvd").open("wb") as stream:
        os.truncate(stream.fileno(), 1 << 30)
    with pytest.raises(SeriesError, match="more than"):
        read_index(tmp_path / "s.pvd")


# Parts


def write_halves(folder: Path, pattern: str, factors, *, cells=(CELLS[:6], CELLS[6:]), **options) -> None:
    """Write the halves of the bar into files named by time and part, with rest points and displacement."""
    for k, factor in enumerate(factors):
        for r, own in enumerate(cells):
            used, local = split(own)
            u = (stretch(POINTS, factor) - POINTS)[used]
            name = pattern.format(t=k, r=r)
            write_vtu(folder / name, POINTS[used], [(10, local)], {"u": u}, **options)


UNEQUAL = (CELLS[:4], CELLS[4:])


@pytest.mark.parametrize("cells", [(CELLS[:6], CELLS[6:]), UNEQUAL])
@pytest.mark.parametrize("pattern", ["f_{t}_{r}.vtu", "f_{r}_{t}.vtu", "p{r}/f_{t}.vtu", "t{t}/p{r}.vtu"])
def test_parts_in_numbered_files(tmp_path, pattern, cells):
    """Two numbers in the names, no times: the cells, or the places of equal ones, tell which number is the part."""
    write_halves(tmp_path, pattern, (1.0, 1.2, 1.5), cells=cells)
    path = tmp_path / pattern.format(t="*", r="*")
    series = read_series(path)
    assert series.times == (0.0, 1.0, 2.0) and len(series.mesh.rest_volumes) == 12
    assert list_ratios(path) == pytest.approx([1.0, 1.2, 1.5])
    assert [len(member.others) for member in series.members] == [1, 1, 1]


@pytest.mark.parametrize("cells", [(CELLS[:6], CELLS[6:]), UNEQUAL])
@pytest.mark.parametrize("pattern", ["f_{t}_{r}.vtu", "f_{r}_{t}.vtu"])
def test_parts_in_numbered_files_with_times(tmp_path, pattern, cells):
    for k, factor in enumerate((1.0, 1.2, 1.5)):
        for r, own in enumerate(cells):
            used, local = split(own)
            x = stretch(POINTS, factor)[used]
            write_vtu(tmp_path / pattern.format(t=k, r=r), x, [(10, local)], {}, {}, {"TimeValue": [0.1 * k]})
    if pattern == "f_{r}_{t}.vtu":  # all times of one part come first
        assert len(read_series(tmp_path)) == 3
    series = read_series(tmp_path)
    assert series.times == pytest.approx([0.0, 0.1, 0.2]) and list_ratios(tmp_path) == pytest.approx([1.0, 1.2, 1.5])


@pytest.mark.parametrize(
    "attributes",
    [
        lambda k, r: {"part": r}, lambda k, r: {}, lambda k, r: {"part": 0}, lambda k, r: {"group": "ab"[r], "part": 0},
        lambda k, r: {"group": ""}, lambda k, r: {"group": "ab"[r]},
    ],
)  # fmt: skip
@pytest.mark.parametrize("pattern", ["f_{t}_{r}.vtu", "{r}/f_{t}.vtu", "f_{t}{r}.vtu"])
@pytest.mark.parametrize("outer", ["time", "part"])
def test_parts_in_an_index(tmp_path, attributes, pattern, outer):
    write_halves(tmp_path, pattern, (1.0, 1.2, 1.5))
    rows = [
        {"timestep": 0.1 * k, **attributes(k, r), "file": pattern.format(t=k, r=r)} for k in range(3) for r in range(2)
    ]
    if outer == "part":
        rows = rows[::2] + rows[1::2]
        if pattern == "f_{t}{r}.vtu" and not any(attributes(0, 1).values()):
            write_pvd(tmp_path / "s.pvd", rows)  # nothing but the order says that 00, 10, 20, 01, 11, 21 are two parts
            with pytest.raises(SeriesError, match="begin again"):
                read_series(tmp_path / "s.pvd")
            return
    write_pvd(tmp_path / "s.pvd", rows)
    series = read_series(tmp_path / "s.pvd")
    assert series.times == pytest.approx([0.0, 0.1, 0.2]) and len(series.mesh.rest_volumes) == 12
    assert list_ratios(tmp_path / "s.pvd") == pytest.approx([1.0, 1.2, 1.5])
    assert any("2 parts of the body" in note for note in series.notes)


def test_parts_that_never_share_a_time_are_asked_about(tmp_path):
    """A part that counts the frames is none."""
    write_halves(tmp_path, "f_{t}_{r}.vtu", (1.0, 1.2, 1.5))
    rows = [{"timestep": k + 0.01 * r, "part": r, "file": f"f_{k}_{r}.vtu"} for k in range(3) for r in range(2)]
    write_pvd(tmp_path / "s.pvd", rows)
    assert_asked(tmp_path / "s.pvd", "2 parts", "never two at one time")
    write_pvd(tmp_path / "s.pvd", [{"timestep": k, "part": k, "file": f"f_{k}_0.vtu"} for k in range(3)])
    assert list_ratios(tmp_path / "s.pvd") == pytest.approx([1.0, 1.2, 1.5])


@pytest.mark.parametrize("part", [lambda r: {"part": r}, lambda _: {}])
def test_times_of_parts_that_differ_by_rounding(tmp_path, part):
    """The clocks of two ranks: without a decision, halves of a body would be frames of one."""
    write_halves(tmp_path, "f_{t}_{r}.vtu", (1.0, 1.2, 1.5))
    rows = [{"timestep": k + 1e-7 * r, **part(r), "file": f"f_{k}_{r}.vtu"} for k in range(3) for r in range(2)]
    write_pvd(tmp_path / "s.pvd", rows)
    series = read_series(tmp_path / "s.pvd")
    assert series.times == (0.0, 1.0, 2.0) and len(series.mesh.rest_volumes) == 12
    assert any("differ by rounding" in note for note in series.notes)


def test_frames_in_pairs_keep_their_times(tmp_path):
    """A frame before and one after each impact."""
    write_frames(tmp_path, [f"f_{k}.vtu" for k in range(6)], [1 + 0.1 * k for k in range(6)])
    times = [0.0, 1e-7, 1.0, 1.0 + 1e-7, 2.0, 2.0 + 1e-7]
    path = write_index(tmp_path, [(t, f"f_{k}.vtu") for k, t in enumerate(times)])
    assert read_series(path).times == tuple(times) and list_ratios(path) == pytest.approx(
        [1 + 0.1 * k for k in range(6)]
    )


RUNS = [(0, 1.0), (1, 1.1), (2, 9.0), (1, 1.15), (2, 1.25), (3, 1.35)]  # times and stretches of a run and its restart


def write_run_of_halves(folder: Path, times, *, numbered: bool, killed: bool = False) -> Path:
    """Write the halves of the bar for RUNS and an index at these times; killed: one file of the first is missing."""
    for k, (_, factor) in enumerate(RUNS):
        for r, own in enumerate((CELLS[:6], CELLS[6:])):
            used, local = split(own)
            write_vtu(folder / f"g_{k}_{r}.vtu", stretch(POINTS, factor)[used], [(10, local)])
    part = (lambda r: {"part": r}) if numbered else (lambda _: {})
    rows = [{"timestep": t, **part(r), "file": f"g_{k}_{r}.vtu"} for k, t in enumerate(times) for r in range(2)]
    write_pvd(folder / "s.pvd", rows[:5] + rows[6:] if killed else rows)
    return folder / "s.pvd"


@pytest.mark.parametrize(("numbered", "killed"), [(True, False), (False, False), (True, True)])
def test_a_restart_of_parts_is_that_of_all(tmp_path, numbered, killed):
    path = write_run_of_halves(tmp_path, [t for t, _ in RUNS], numbered=numbered, killed=killed)
    series = read_series(path)
    assert series.times == (0.0, 1.0, 2.0, 3.0) and list_ratios(path) == pytest.approx([1.0, 1.15, 1.25, 1.35])
    assert len(series.mesh.rest_volumes) == 12


@pytest.mark.parametrize("numbered", [True, False])
def test_rounded_times_of_parts(tmp_path, numbered):
    path = write_run_of_halves(tmp_path, [0, 1, 2, 2, 2, 3], numbered=numbered)
    assert list_ratios(path) == pytest.approx([factor for _, factor in RUNS])
    assert read_series(path).times == pytest.approx([0, 1, 2, 2 + 1 / 6, 2 + 1 / 3, 3])


def test_one_time_for_all_frames_of_parts(tmp_path):
    """Equal cells in both halves: only their places tell parts from frames."""
    path = write_run_of_halves(tmp_path, [0] * 6, numbered=False)
    assert list_ratios(path) == pytest.approx([factor for _, factor in RUNS])
    assert read_series(path).times == tuple(map(float, range(6)))


def test_parts_that_restart_in_part_are_asked_about(tmp_path):
    path = write_run_of_halves(tmp_path, [t for t, _ in RUNS], numbered=True)
    rows = path.read_text().splitlines()
    first, second = ([row for row in rows if f'part="{r}"' in row] for r in range(2))
    path.write_text("\n".join([*rows[:3], *first, *second[:2], *second[3:], *rows[-2:]]))
    assert_asked(path, "t = 1 s", "more often than others")


def test_parts_with_counting_names(tmp_path):
    """Files 0 to 5 in order, two a time: their cells recur, so they are parts."""
    for cells in ((CELLS[:6], CELLS[6:]), UNEQUAL):
        write_halves(tmp_path, "f_{t}_{r}.vtu", (1.0, 1.2, 1.5), cells=cells)
        rows = [(0.1 * (n // 2), f"g_{n}.vtu") for n in range(6)]
        for n in range(6):
            (tmp_path / f"f_{n // 2}_{n % 2}.vtu").rename(tmp_path / f"g_{n}.vtu")
        assert list_ratios(write_index(tmp_path, rows)) == pytest.approx([1.0, 1.2, 1.5])


def test_a_time_without_all_parts_is_left_out(tmp_path):
    write_halves(tmp_path, "f_{t}_{r}.vtu", (1.0, 1.1, 1.2, 1.5))
    rows = [{"timestep": k, "part": r, "file": f"f_{k}_{r}.vtu"} for k in range(4) for r in range(2)]
    write_pvd(tmp_path / "s.pvd", rows[:3] + rows[4:7])
    series = read_series(tmp_path / "s.pvd")
    assert series.times == (0.0, 2.0)
    assert [note for note in series.notes if "has 1 of 2 parts" in note] == [
        f"left out: t = {k} s has 1 of 2 parts of the body" for k in (1, 3)
    ]
    with pytest.raises(SeriesError, match="2 frames cannot be read"):
        read_series(tmp_path / "s.pvd", strict=True)
    write_pvd(tmp_path / "s.pvd", rows)
    (tmp_path / "f_1_1.vtu").unlink()
    series = read_series(tmp_path / "s.pvd")
    assert series.times == (0.0, 2.0, 3.0) and "f_1_1.vtu at t = 1 s is missing" in series.notes[0]


def test_files_of_one_body_and_one_time_share_their_fields(tmp_path):
    """One file for each field, as some programs write: they are one body, not two."""
    for k, factor in enumerate((1.0, 1.2, 1.5)):
        write_vtu(tmp_path / f"u_{k}.vtu", POINTS, TETRAHEDRA, {"u": stretch(POINTS, factor) - POINTS})
        write_vtu(tmp_path / f"p_{k}.vtu", POINTS, TETRAHEDRA, {"damage": np.full(len(POINTS), float(k))})
    rows = [{"timestep": k, "file": f"{name}_{k}.vtu"} for k in range(3) for name in "pu"]
    write_pvd(tmp_path / "s.pvd", rows)
    series = read_series(tmp_path / "s.pvd")
    assert len(series.mesh.rest_volumes) == 12 and list_ratios(tmp_path / "s.pvd") == pytest.approx([1.0, 1.2, 1.5])
    assert series.read_grid(2).point_data["damage"].tolist() == [2.0] * len(POINTS)
    assert any("have the same cells: one part" in note for note in series.notes)


def test_two_states_of_one_body_are_no_parts(tmp_path):
    """The initial and the deformed body at every time would have twice the volume."""
    for k, factor in enumerate((1.01, 1.2, 1.5)):
        write_vtu(tmp_path / f"initial_{k}.vtu", POINTS, TETRAHEDRA)
        write_vtu(tmp_path / f"deformed_{k}.vtu", stretch(POINTS, factor), TETRAHEDRA)
    rows = [
        {"timestep": k, "part": r, "file": f"{n}_{k}.vtu"}
        for k in range(3)
        for r, n in enumerate(["initial", "deformed"])
    ]
    write_pvd(tmp_path / "s.pvd", rows)
    assert_asked(tmp_path / "s.pvd", "the same body in almost the same place", "pattern")
    for k, factor in enumerate((1.01, 1.2, 1.5)):  # the same with displacements
        for name, s in (("initial", 1.0), ("deformed", factor)):
            write_vtu(tmp_path / f"{name}_{k}.vtu", POINTS, TETRAHEDRA, {"u": stretch(POINTS, s) - POINTS})
    assert_asked(tmp_path / "s.pvd", "different values of u")


def test_frames_with_other_cells_and_one_time_are_asked_about(tmp_path):
    for k, counts in enumerate([(2, 1, 1), (3, 1, 1), (4, 1, 1)]):
        points, cells = bar(counts)
        write_vtu(tmp_path / f"f_{k}.vtu", points, [(10, cells)])
    assert_asked(write_index(tmp_path, [(0, "f_0.vtu"), (1, "f_1.vtu"), (1, "f_2.vtu")]), "parts of a body, or frames")
    assert_asked(write_index(tmp_path, [(0, "f_0.vtu"), (0, "f_1.vtu")]), "parts of a body, or frames")


def test_bodies_of_one_instant(tmp_path):
    """Two different bodies side by side, without times or parts."""
    points, cells = bar((1, 2, 1), (1.0, 2.0, 1.0))
    write_vtu(tmp_path / "f_0.vtu", POINTS, TETRAHEDRA)
    write_vtu(tmp_path / "f_1.vtu", points + 5 * BESIDE, [(10, cells)])
    write_pvd(tmp_path / "s.pvd", [{"file": f"f_{k}.vtu"} for k in range(2)])
    assert len(read_series(tmp_path / "s.pvd").mesh.rest_volumes) == 12 + len(cells)


def test_places_of_bodies(tmp_path):
    def place(points, cells=CELLS, kind=10):
        write_vtu(tmp_path / "f.vtu", points, [(kind, cells)])
        return read_grid(tmp_path / "f.vtu")

    body = place(POINTS)
    assert not are_apart(body, body) and not are_apart(body, place(stretch(POINTS, 1.5)))
    assert are_apart(body, place(POINTS + 2 * BESIDE)) and are_apart(body, place(POINTS + 1.5 * BESIDE))
    flat = place(POINTS * [1, 1, 0], CELLS[:, :3], 5)
    assert not are_apart(flat, flat) and are_apart(flat, place(POINTS * [1, 1, 0] + ABOVE, CELLS[:, :3], 5))


def test_frames_named_by_step_and_increment(tmp_path):
    """Two numbers that both count frames."""
    names = [f"step_{s}_{i}.vtu" for s in (1, 2) for i in range(3)]
    write_frames(tmp_path, names, [1 + 0.1 * k for k in range(6)])
    series = read_series(tmp_path)
    assert series.times == tuple(map(float, range(6))) and list_ratios(tmp_path) == pytest.approx(
        [1 + 0.1 * k for k in range(6)]
    )


def test_numbers_that_tell_neither_parts_nor_frames_are_asked_about(tmp_path):
    for a in range(2):
        for b in range(2):
            points, cells = bar((1 + a, 1 + b, 1))
            write_vtu(tmp_path / f"f_{a}_{b}.vtu", points, [(10, cells)])
    assert_asked(tmp_path, "two numbers vary in the names", "pattern")
    assert len(read_series(tmp_path / "f_0_0.vtu")) == 1


# Steps in one file


def test_an_index_of_files_with_steps_takes_the_step_of_its_time(tmp_path):
    from tests.foreign.listings import steps_in_one_vtu

    steps_in_one_vtu(tmp_path)
    assert list_ratios(tmp_path / "all.vtu") == pytest.approx([1.0, 1.2, 1.5])
    assert read_times(tmp_path / "all.vtu").values == (0.0, 0.1, 0.2)
    path = write_index(tmp_path, [(0.0, "all.vtu"), (0.2, "all.vtu")])
    assert list_ratios(path) == pytest.approx([1.0, 1.5])
    assert_asked(write_index(tmp_path, [(0.0, "all.vtu"), (0.7, "all.vtu")]), "3 steps, none of them at t = 0.7 s")
