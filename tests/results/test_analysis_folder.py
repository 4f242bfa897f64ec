"""Folders of analyze and compare: datasets, figures, notes and memory."""

import tracemalloc

import numpy as np
import pytest
import pyvista
import xarray

from pipeline.errors import SeriesError
from pipeline.results.analysis_folder import analyze, compare
from pipeline.series import Series, read_series
from tests.bodies import assert_conventional, skip_figures
from tests.measured import measure_series
from tests.series.test_series import CELLS, GROWTH, POINTS, TIMES, make_grid, move_points, write_pvd, write_series


def make_series(folder, times, name="their", grow=lambda t: t):
    folder.mkdir(exist_ok=True)
    for i, t in enumerate(times):
        make_grid(grow(t)).save(folder / f"f{i}.vtu")
    return read_series(write_pvd(folder, [(t, f"f{i}.vtu") for i, t in enumerate(times)]), name=name)


def test_analyze_writes_the_numbers_of_the_series(tmp_path):
    seen = []
    source = write_series(tmp_path)
    result = analyze(source, tmp_path / "out", on_frame=lambda *args: seen.append(args))
    assert [path.name for path in result.files] == ["statistics.nc", "volume.png"]
    assert all(path.stat().st_size for path in result.files)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["statistics.nc", "volume.png"]
    assert seen == [(read_series(source).name, i + 1, 3) for i in range(3)]
    assert result.worst_volume_ratio == pytest.approx((1 + GROWTH * TIMES[-1]) ** 3)
    assert (result.frames, result.worst_time) == (3, TIMES[-1])
    with xarray.open_dataset(result.files[0]) as dataset:
        assert_conventional(dataset)
        xarray.testing.assert_equal(dataset, measure_series(read_series(source)))


def test_a_number_that_a_frame_lacks_is_nan_there(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    for i, t in enumerate(TIMES):
        grid = make_grid(t)
        if i != 1:
            grid.field_data["kinetic_energy"] = [2.0]
        grid.save(tmp_path / f"f{i}.vtu")
    result = analyze(write_pvd(tmp_path, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)]), tmp_path / "out")
    with xarray.open_dataset(result.files[0]) as dataset:
        np.testing.assert_equal(dataset["kinetic_energy"].values, [2.0, np.nan, 2.0])


def test_a_failing_analysis_leaves_no_partial_file(tmp_path, monkeypatch):
    source = write_series(tmp_path)
    read = Series.read_frame

    def fail_in_the_second(self, index, grid=None):
        if index == 1:
            raise SeriesError("f1.vtu: damaged")
        return read(self, index, grid)

    monkeypatch.setattr(Series, "read_frame", fail_in_the_second)
    with pytest.raises(SeriesError, match="damaged"):
        analyze(source, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


def test_a_changing_mesh_keeps_the_volume_of_the_whole_body(tmp_path):
    """The second frame has another mesh of the same body: its cells have no numbers, and the curve goes on."""
    source = write_series(tmp_path)
    pyvista.UnstructuredGrid({10: CELLS[:-1]}, move_points(TIMES[1])).save(tmp_path / "f1.vtu")
    result = analyze(source, tmp_path / "out")
    (note,) = [note for note in result.notes if "no cell has numbers" in note]
    assert note.startswith(
        f"in the frame of t = {TIMES[1]:.4g} s no cell has numbers; the volume of the whole body goes on"
    )
    assert result.worst_volume_ratio == pytest.approx((1 + GROWTH * TIMES[2]) ** 3)
    with xarray.open_dataset(result.files[0]) as dataset:
        assert dataset["volume_ratio"].isnull().all("cell").values.tolist() == [False, True, False]
        rest = float(dataset["rest_volume"].sum())
        part = float(dataset["rest_volume"][:-1].sum())
        assert dataset["total_volume"].values == pytest.approx(
            [rest, part * (1 + GROWTH * TIMES[1]) ** 3, rest * (1 + GROWTH * TIMES[2]) ** 3]
        )


def write_gap(folder, lost):
    """A series whose points are not finite in some nodes of some frames."""
    for i, t in enumerate(TIMES):
        grid = make_grid(t)
        grid.points[lost.get(i, slice(0, 0))] = np.nan
        grid.save(folder / f"f{i}.vtu")
    return write_pvd(folder, [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)])


def test_a_frame_without_positions_ends_the_numbers_of_its_cells(tmp_path):
    result = analyze(write_gap(tmp_path, {2: slice(None)}), tmp_path / "out")
    (note,) = [note for note in result.notes if "no cell has numbers" in note]
    assert f"t = {TIMES[2]:.4g} s" in note and "not finite" in note and "whole body" not in note
    assert result.worst_volume_ratio == pytest.approx((1 + GROWTH * TIMES[1]) ** 3)
    with xarray.open_dataset(result.files[0]) as dataset:
        assert dataset["total_volume"].isnull().values.tolist() == [False, False, True]


def test_a_node_without_position_takes_only_its_cells(tmp_path):
    result = analyze(write_gap(tmp_path, {1: [0], 2: [0]}), tmp_path / "out")
    touched = int((CELLS == 0).any(axis=1).sum())
    (note,) = [note for note in result.notes if "cells have no numbers" in note]
    assert note.startswith(
        f"in 2 frames from t = {TIMES[1]:.4g} to {TIMES[2]:.4g} s up to {touched} of {len(CELLS)} cells"
    )
    assert result.worst_volume_ratio == pytest.approx((1 + GROWTH * TIMES[2]) ** 3)
    assert not (CELLS[result.worst_cell] == 0).any()


def test_results_of_another_series_do_not_stay(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    out, (a, b) = (
        tmp_path / "out",
        (make_series(tmp_path / name, TIMES, name, lambda t, n=name: t * (1 + (n == "b"))) for name in "ab"),
    )
    analyze(a, out)
    (out / "movie.mp4").write_bytes(b"film of a")
    (out / "mine.txt").write_text("mine")
    assert not any("removed" in note for note in analyze(a, out).notes)
    assert (out / "movie.mp4").exists()  # the same series: its film is still right
    notes = analyze(b, out).notes
    assert any("movie.mp4 of another analysis removed" in note for note in notes)
    assert sorted(path.name for path in out.iterdir()) == ["mine.txt", "statistics.nc", "volume.png"]
    compare([a, b], out)
    assert sorted(path.name for path in out.iterdir()) == ["a", "b", "comparison.nc", "mine.txt", "volume.png"]


def test_memory_does_not_grow_with_the_frames(tmp_path, monkeypatch):
    """Compare peaks of Python and numpy with twenty times the frames of the same three files."""
    skip_figures(monkeypatch)
    grid = pyvista.ImageData(dimensions=(16, 16, 16)).cast_to_unstructured_grid().triangulate()
    for i, t in enumerate(TIMES):
        one = grid.copy()
        one.points = np.asarray(grid.points) * (1 + t)
        one.save(tmp_path / f"f{i}.vtu")
    monkeypatch.setattr("pipeline.results.analysis_folder._DRAWN_VALUES", 4 * grid.n_cells)
    peaks = []
    for count in (4, 4, 80):  # the first is a warm-up: imports and compiled kernels stay in memory
        source = write_pvd(tmp_path, [(float(k), f"f{k % 3}.vtu") for k in range(count)])
        tracemalloc.start()
        analyze(source, tmp_path / "out")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # the ratios of 80 frames alone would take the memory of ten more frames
    assert peaks[2] < 1.15 * peaks[1], peaks


def test_figures_of_long_series_show_some_frames_and_the_worst(tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.results.analysis_folder._DRAWN_POINTS", 3 * len(CELLS))
    times = [float(t) for t in range(9)]
    result = analyze(make_series(tmp_path / "a", times, grow=lambda t: 1.0 if t == 5 else 0.0), tmp_path / "out")
    assert any("shows 4 of 9 frames, the worst among them" in note for note in result.notes)


def test_compare_joins_the_numbers_of_each_series(tmp_path):
    a = make_series(tmp_path / "a", TIMES, "a")
    b = make_series(tmp_path / "b", TIMES, "a", grow=lambda t: 2 * t)
    result = compare([a, b], tmp_path / "out", difference=True)
    assert [path.name for path in result.files] == ["comparison.nc", "volume.png", "distance.png"]
    with xarray.open_dataset(result.files[0]) as dataset:
        assert_conventional(dataset)
        assert dataset["variant"].values.tolist() == ["a", "a_2"]
        assert dataset["volume_ratio"].dims == ("variant", "time", "cell")
        for name, one in (("a", a), ("a_2", b)):
            own = measure_series(one)
            for variable in own.data_vars:
                mine = (
                    dataset[variable].sel(variant=name, drop=True) if variable != "rest_volume" else dataset[variable]
                )
                xarray.testing.assert_equal(mine, own[variable])
        expected = (1 + GROWTH * 2 * TIMES[2]) ** 3 - (1 + GROWTH * TIMES[2]) ** 3
        assert dataset["volume_ratio_difference"].values[1, 2] == pytest.approx(expected)
        assert (dataset["volume_ratio_difference"].values[0] == 0).all()


def make_swinging_series(folder, times, name, grow, velocity=None):
    """Return a series of deformed points with a velocity, with two nodes without cells in front."""
    folder.mkdir()
    for i, t in enumerate(times):
        grid = pyvista.UnstructuredGrid({10: CELLS + 2}, np.vstack([np.full((2, 3), 9.0), move_points(grow(t))]))
        if velocity:
            grid.point_data["velocity"] = np.full((grid.n_points, 3), velocity(t))
        grid.save(folder / f"f{i}.vtu")
    return read_series(write_pvd(folder, [(t, f"f{i}.vtu") for i, t in enumerate(times)]), name=name)


def test_differences_of_nodes(tmp_path):
    a = make_swinging_series(tmp_path / "a", TIMES, "a", lambda t: t, lambda t: 1 + t)
    b = make_swinging_series(tmp_path / "b", TIMES, "b", lambda t: t * (0.25 - t) * 30, lambda t: 1 + 3 * t)
    c = make_swinging_series(tmp_path / "c", TIMES, "c", lambda t: 2 * t)
    seen = []
    result = compare([a, b, c], tmp_path / "out", difference=True, on_frame=lambda *args: seen.append(args))
    assert seen[-3:] == [("difference of nodes", k, 3) for k in (1, 2, 3)]
    far = np.linalg.norm(POINTS, axis=1)
    with xarray.open_dataset(result.files[0]) as dataset:
        assert_conventional(dataset)
        difference = dataset["displacement_difference"]
        assert difference.dims == ("variant", "time", "node", "axis") and difference.attrs["units"] == "m"
        assert (difference[0] == 0).all()
        assert difference[1, 1].values == pytest.approx(GROWTH * (0.45 - 0.1) * POINTS)
        assert difference[2].values == pytest.approx(np.stack([GROWTH * t * POINTS for t in TIMES]), abs=1e-14)
        assert dataset["velocity_difference"][1, :, 3, 0].values == pytest.approx([0, 0.2, 0.5])
        assert dataset["velocity_difference"][2].isnull().all()
        worst, rms = dataset["node_distance_worst"], dataset["node_distance_rms"]
        assert worst[1].values == pytest.approx([0, GROWTH * 0.35 * far.max(), GROWTH * 0.25 * far.max()])
        assert rms[2].values == pytest.approx([GROWTH * t * np.sqrt(np.mean(far**2)) for t in TIMES])
    assert [one.name for one in result.node_distances] == ["b", "c"]
    one = result.node_distances[0]
    assert one.worst == pytest.approx(GROWTH * 0.35 * far.max()) and one.node == far.argmax() + 2
    assert (one.time, one.rms_time) == (0.1, 0.1) and one.rms == pytest.approx(one.worst * rms[1, 1] / worst[1, 1])
    without = compare([a, b], tmp_path / "without")
    assert without.node_distances == ()
    with xarray.open_dataset(without.files[0]) as dataset:
        assert "node" not in dataset.dims


def test_differences_of_nodes_between_frames(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    a = make_swinging_series(tmp_path / "a", [0.0, 0.3, 0.9], "a", lambda t: t, lambda t: t)
    b = make_swinging_series(tmp_path / "b", [0.0, 0.1 + 0.2, 0.6, 0.8, 1.2], "b", lambda t: t, lambda t: t**2)
    result = compare([b, a], tmp_path / "out", difference=True)
    assert any("on the chord" in note for note in result.notes)
    with xarray.open_dataset(result.files[0]) as dataset:
        assert dataset["time"].values == pytest.approx([0, 0.3, 0.9])
        assert dataset["node_distance_worst"].values == pytest.approx(0, abs=1e-14)
        chord = 0.75 * 0.8**2 + 0.25 * 1.2**2
        assert dataset["velocity_difference"][1, :, 0, 0].values == pytest.approx([0, 0.3 - 0.3**2, 0.9 - chord])


def test_different_times_are_interpolated_with_a_note(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    a = make_series(tmp_path / "a", [0.0, 1.0, 2.0], "a")
    b = make_series(tmp_path / "b", [0.0, 0.5, 1.5, 2.5], "b")
    result = compare([a, b], tmp_path / "out")
    assert any("uses the 3 times of a from 0 to 2 s" in note and "interpolated" in note for note in result.notes)
    with xarray.open_dataset(result.files[0]) as dataset:
        assert dataset["time"].values.tolist() == [0.0, 1.0, 2.0]
        between = ((1 + GROWTH * 0.5) ** 3 + (1 + GROWTH * 1.5) ** 3) / 2
        assert dataset["volume_ratio"].sel(variant="b", time=1.0).values == pytest.approx(between)
        assert dataset["volume_ratio_quantile"].sel(variant="b", time=1.0).values == pytest.approx(between)
    late = make_series(tmp_path / "late", [7.0, 8.0], "late")
    with pytest.raises(SeriesError, match="late 7 to 8 s"):
        compare([a, late], tmp_path / "out2")


def test_different_cells_are_compared_as_whole_bodies(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    a = make_series(tmp_path / "a", TIMES, "a")
    (tmp_path / "b").mkdir()
    for i, t in enumerate(TIMES):
        pyvista.UnstructuredGrid({10: CELLS[:-1]}, move_points(t)).save(tmp_path / "b" / f"f{i}.vtu")
    b = read_series(write_pvd(tmp_path / "b", [(t, f"f{i}.vtu") for i, t in enumerate(TIMES)]), name="b")
    result = compare([a, b], tmp_path / "out")
    with xarray.open_dataset(result.files[0]) as dataset:
        assert "volume_ratio" not in dataset and "cell" not in dataset.dims
        drift = [(1 + GROWTH * t) ** 3 - 1 for t in TIMES]
        assert dataset["volume_drift"].values == pytest.approx(np.array([drift, drift]))
    assert any("whole bodies only; a difference" in note for note in result.notes)
    with pytest.raises(SeriesError, match="two series or more, not 1"):
        compare([a], tmp_path / "out")


@pytest.mark.opengl
def test_movies(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    monkeypatch.setattr("pipeline.results.analysis_folder._FILM_SECONDS", 2.0)
    monkeypatch.setattr("pipeline.results.analysis_folder._DRAWN_FRAMES", 3)
    a, b = (make_series(tmp_path / name, [0.0, 100.0, 200.0, 300.0], name, lambda t: t / 500) for name in "ab")
    result = compare([a, b], tmp_path / "out", movie=True)
    assert [path.name for path in result.files[-2:]] == ["movie.mp4", "movie.png"]
    assert "movie.mp4 shows 3 of the 4 frames of a" in result.notes
    assert all(path.stat().st_size > 1000 for path in result.files[-2:])
