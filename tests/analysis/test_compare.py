"""comparison.nc of variants and of series: streaming in blocks, early stops, missing numbers, refusals."""

import numpy as np
import pytest
import xarray

from pipeline.analysis.compare import join_series, join_variants, plan_comparison
from pipeline.analysis.statistics import write_statistics
from pipeline.errors import OutputError, SeriesError
from pipeline.formats.netcdf import read_dataset
from tests.bodies import assert_conventional
from tests.results.test_analysis_folder import make_series
from tests.series.test_series import CELLS, GROWTH, TIMES


def write_variant(folder, times, name, *, grow=lambda t: t):
    path = folder / name / "statistics.nc"
    write_statistics(make_series(folder / name, times, name, grow), path)
    return path


@pytest.fixture(params=[1, 3, 1000], ids="{} frames in a block".format)
def block(request, monkeypatch):
    monkeypatch.setattr("pipeline.analysis.compare._BLOCK_BYTES", 8 * len(CELLS) * request.param)


@pytest.mark.usefixtures("block")
def test_variants_are_joined_and_an_early_stop_is_nan(tmp_path):
    times = [0.1 * k for k in range(8)]
    paths = {
        "short": write_variant(tmp_path, times[:4], "short"),
        "long": write_variant(tmp_path, times, "long", grow=lambda t: 2 * t),
        "first": write_variant(tmp_path, times[:1], "first"),
        "rounded": write_variant(tmp_path, [t * (1 + 1e-14) for t in times], "rounded"),
    }
    assert join_variants(paths, tmp_path / "comparison.nc", title="all") == ()
    joined = read_dataset(tmp_path / "comparison.nc")
    assert_conventional(joined)
    assert joined["variant"].values.tolist() == list(paths) and joined.attrs["title"] == "all"
    assert joined["time"].values.tolist() == times and joined["rest_volume"].dims == ("cell",)
    for name, path in paths.items():
        own, part = read_dataset(path), joined.sel(variant=name, drop=True)
        frames = own.sizes["time"]
        for variable in own.data_vars:
            assert part[variable].attrs == own[variable].attrs
            recorded = part[variable] if variable == "rest_volume" else part[variable][:frames]
            assert np.array_equal(recorded.values, own[variable].values)
        assert part["volume_ratio"][frames:].isnull().all() and part["volume_drift"][frames:].isnull().all()


def test_a_number_that_a_variant_lacks_is_nan(tmp_path):
    paths = {name: write_variant(tmp_path, TIMES, name) for name in "ab"}
    with xarray.open_dataset(paths["b"]) as dataset:
        more = dataset.assign(rung=("time", np.arange(3.0), {"units": "1", "long_name": "model"})).load()
    more.to_netcdf(paths["b"])
    join_variants(paths, tmp_path / "comparison.nc", title="all")
    rung = read_dataset(tmp_path / "comparison.nc")["rung"]
    np.testing.assert_equal(rung.values, [[np.nan] * 3, [0, 1, 2]])
    assert rung.attrs["long_name"] == "model"


def test_variants_of_another_mesh_or_other_times_are_left_out(tmp_path):
    paths = {"a": write_variant(tmp_path, TIMES, "a"), "b": write_variant(tmp_path, [0.0, 0.2], "b")}
    with xarray.open_dataset(paths["a"]) as dataset:
        other = dataset.isel(cell=slice(1, None)).load()
    (tmp_path / "c").mkdir()
    paths["c"] = tmp_path / "c" / "statistics.nc"
    other.to_netcdf(paths["c"])
    assert join_variants(paths, tmp_path / "comparison.nc", title="all") == (
        "b is left out of the comparison: its frame times are not those of a",
        "c is left out of the comparison: its mesh is not that of a",
    )
    assert read_dataset(tmp_path / "comparison.nc")["variant"].values.tolist() == ["a"]


@pytest.mark.usefixtures("block")
def test_series_are_interpolated_between_their_frames(tmp_path):
    fine = [0.15 * k for k in range(9)]
    series = [
        make_series(tmp_path / "coarse", [0.0, 0.3, 0.6, 1.0], "coarse"),
        make_series(tmp_path / "fine", fine, "fine", lambda t: 2 * t),
    ]
    statistics = [tmp_path / one.name / "statistics.nc" for one in series]
    for one, path in zip(series, statistics, strict=True):
        write_statistics(one, path)
    plan = plan_comparison(series, difference=True)
    assert plan.interpolated and plan.same_cells and plan.title == "coarse and fine"
    (distance,) = join_series(plan, statistics, tmp_path / "comparison.nc")
    assert distance.name == "fine" and distance.time == 1.0
    joined = read_dataset(tmp_path / "comparison.nc")
    assert_conventional(joined)
    ratios = (1 + 2 * GROWTH * np.array(fine)) ** 3
    expected = np.interp([0.0, 0.3, 0.6, 1.0], fine, ratios)
    assert joined["volume_ratio"].sel(variant="fine")[:, 0].values == pytest.approx(expected)
    assert joined["volume_ratio_quantile"].sel(variant="fine")[:, 4].values == pytest.approx(expected)
    own = (1 + GROWTH * np.array([0.0, 0.3, 0.6, 1.0])) ** 3
    assert joined["volume_ratio_difference"].sel(variant="fine")[:, 0].values == pytest.approx(expected - own)


def test_a_last_frame_that_is_a_rounding_error_later_is_compared(tmp_path):
    late = float(np.nextafter(0.3, 1))
    series = [make_series(tmp_path / "a", [0.0, late], "a"), make_series(tmp_path / "b", [0.0, 0.1, 0.3], "b")]
    assert plan_comparison(series, difference=False).times.tolist() == [0.0, late]


def test_a_damaged_file_is_named(tmp_path):
    paths = {name: write_variant(tmp_path, TIMES, name) for name in "ab"}
    paths["b"].write_bytes(paths["b"].read_bytes()[:100])
    with pytest.raises(SeriesError, match=r"b/statistics\.nc: cannot be read"):
        join_variants(paths, tmp_path / "comparison.nc", title="all")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match=r"folder: cannot be written"):
        join_variants({"a": paths["a"]}, tmp_path / "folder", title="all")
    assert not list(tmp_path.glob(".*"))
