"""Series of one body on different meshes, in other orders, units and places: matched, sampled, or refused."""

import numpy as np
import pytest
import xarray

from pipeline.cli import main
from pipeline.errors import SeriesError
from pipeline.results.analysis_folder import compare
from pipeline.series import read_series
from tests.bodies import assert_conventional, skip_figures
from tests.foreign.writers import bar, write_vtu

TIMES = (0.0, 0.1, 0.2)


def shear(points, t):
    """A linear motion, which every mesh represents exactly: volumes grow by (1 + t)."""
    return points * [1 + t, 1.0, 1.0] + np.outer(points[:, 1], [0.0, 0.0, 2 * t])


def bend(points, t):
    """A motion that is linear in the two halves of the bar, which meet at x = 1."""
    beyond = np.maximum(points[:, 0] - 1, 0)
    return points + np.outer(beyond, [t, 0.0, t])


def write(folder, points, cells, motion=shear, name=None, times=TIMES):
    """A series with rest points and displacement."""
    folder.mkdir(parents=True)
    lines = []
    for k, t in enumerate(times):
        write_vtu(folder / f"f_{k}.vtu", points, [(10, cells)], {"displacement": motion(points, t) - points})
        lines.append(f'<DataSet timestep="{t}" part="0" file="f_{k}.vtu"/>')
    index = f'<VTKFile type="Collection"><Collection>{"".join(lines)}</Collection></VTKFile>'
    (folder / "s.pvd").write_text(index)
    return read_series(folder / "s.pvd", name=name or folder.name)


@pytest.fixture(autouse=True)
def _without_figures(monkeypatch):
    skip_figures(monkeypatch)


def test_another_order_is_matched_cell_by_cell(tmp_path):
    points, cells = bar((4, 2, 2))
    rng = np.random.default_rng(3)
    places, order = rng.permutation(len(points)), rng.permutation(len(cells))
    numbers = np.argsort(places)
    a = write(tmp_path / "a", points, cells, bend)
    b = write(tmp_path / "b", points[places], numbers[cells][order], lambda p, t: bend(p, 2 * t))
    result = compare([a, b], tmp_path / "out", difference=True)
    assert any("b has the mesh of a in another order" in note for note in result.notes)
    with xarray.open_dataset(result.files[0]) as dataset:
        assert_conventional(dataset)
        beyond = a.mesh.centers[:, 0] > 1
        expected = np.array([[np.where(beyond, t, 0) for t in TIMES]] * 2) * np.array([0, 1])[:, None, None]
        assert dataset["volume_ratio_difference"].values == pytest.approx(expected, abs=1e-12)
        moved = bend(points, 0.2) - bend(points, 0.1)
        assert dataset["displacement_difference"][1, 1].values == pytest.approx(moved, abs=1e-12)


@pytest.mark.parametrize("motion", [shear, bend])
def test_different_meshes_of_one_body_are_sampled(tmp_path, motion):
    """The motion is the same function of rest positions, which both meshes represent: no difference remains."""
    a = write(tmp_path / "a", *bar((2, 2, 2)), motion)
    b = write(tmp_path / "b", *bar((6, 3, 1)), motion)
    result = compare([a, b], tmp_path / "out", difference=True)
    note = next(note for note in result.notes if "another mesh" in note)
    assert note.endswith("all 48 cells and 27 nodes have a partner")
    with xarray.open_dataset(result.files[0]) as dataset:
        assert_conventional(dataset)
        assert dataset.sizes["cell"] == 48 and dataset.sizes["node"] == 27
        assert dataset["rest_volume"].dims == ("cell",)
        assert dataset["volume_ratio_difference"].values == pytest.approx(0, abs=1e-12)
        assert dataset["rotation_angle_difference"].values == pytest.approx(0, abs=1e-6)
        assert dataset["displacement_difference"].values == pytest.approx(0, abs=1e-12)
        assert dataset["node_distance_worst"].values == pytest.approx(0, abs=1e-12)
    assert result.node_distances[0].worst == pytest.approx(0, abs=1e-12)


def test_a_difference_between_meshes_is_measured(tmp_path):
    a = write(tmp_path / "a", *bar((2, 2, 2)))
    b = write(tmp_path / "b", *bar((6, 3, 1)), lambda p, t: shear(p, 2 * t))
    result = compare([a, b], tmp_path / "out", difference=True)
    with xarray.open_dataset(result.files[0]) as dataset:
        for k, t in enumerate(TIMES):
            assert dataset["volume_ratio_difference"][1, k].values == pytest.approx(t)
            difference = shear(a.mesh.points, 2 * t) - shear(a.mesh.points, t)
            assert dataset["displacement_difference"][1, k].values == pytest.approx(difference, abs=1e-12)
            far = np.linalg.norm(difference, axis=1)
            assert float(dataset["node_distance_worst"][1, k]) == pytest.approx(far.max(), abs=1e-12)
    assert result.node_distances[0].worst == pytest.approx(far.max())


def test_the_share_without_a_partner_is_told_and_nan(tmp_path):
    """The bodies share half of the first one."""
    a = write(tmp_path / "a", *bar((2, 1, 1), (2.0, 1.0, 1.0)))
    b = write(tmp_path / "b", *bar((1, 2, 1), (1.0, 2.0, 1.0)))
    result = compare([a, b], tmp_path / "out", difference=True)
    note = next(note for note in result.notes if "another mesh" in note)
    assert "50 % of the volume (6 of 12 cells) and 4 of 12 nodes have no partner and are NaN" in note
    with xarray.open_dataset(result.files[0]) as dataset:
        lost = dataset["volume_ratio"][1, 0].isnull().values
        assert np.array_equal(lost, a.mesh.centers[:, 0] > 1)
        outside = dataset["displacement_difference"][1, 0].isnull().all("axis").values
        assert np.array_equal(outside, a.mesh.points[:, 0] > 1)
        assert np.isfinite(dataset["node_distance_rms"]).all()


def test_equal_connectivity_is_not_the_same_mesh(tmp_path):
    """Every cell has its own points, so that the connectivity of all such meshes is 0, 1, 2, …"""
    series = []
    for name, counts, size in (("a", (2, 1, 1), (2.0, 1.0, 1.0)), ("b", (1, 2, 1), (1.0, 2.0, 1.0))):
        points, cells = bar(counts, size)
        own = points[cells].reshape(-1, 3)
        series.append(write(tmp_path / name, own, np.arange(len(own)).reshape(-1, 4)))
    result = compare(series, tmp_path / "plain")
    assert any("whole bodies only" in note for note in result.notes)
    result = compare(series, tmp_path / "out", difference=True)
    assert any("50 % of the volume" in note for note in result.notes)


@pytest.mark.parametrize(("factor", "units"), [(1000.0, "m and mm"), (0.001, "m and mm"), (100.0, "m and cm")])
@pytest.mark.parametrize("difference", [False, True], ids=["plain", "difference"])
def test_other_units_are_refused(tmp_path, capsys, factor, units, difference):
    points, cells = bar()
    a = write(tmp_path / "a", points, cells)
    b = write(tmp_path / "b", factor * points, cells)
    with pytest.raises(SeriesError, match=f"times as large as .* units of length seem to be {units}"):
        compare([a, b], tmp_path / "out", difference=difference)
    words = ["compare", str(tmp_path / "a" / "s.pvd"), str(tmp_path / "b" / "s.pvd"), "--out", str(tmp_path / "cli")]
    assert main([*words, *(["--difference"] if difference else [])]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_another_size_is_noted(tmp_path):
    a = write(tmp_path / "a", *bar((2, 1, 1), (2.0, 1.0, 1.0)))
    b = write(tmp_path / "b", *bar((2, 1, 1), (1900.0, 1000.0, 1100.0)))
    assert any("b is 985 times as large as a: check" in note for note in compare([a, b], tmp_path / "out").notes)


def test_bodies_elsewhere_have_no_difference(tmp_path):
    points, cells = bar()
    a, b = write(tmp_path / "a", points, cells), write(tmp_path / "b", np.add(points, (10.0, 0.0, 0.0)), cells)
    with pytest.raises(SeriesError, match=r"no cell of a has its center in b at rest \(a: x 0 to 2, .*b: x 10 to 12"):
        compare([a, b], tmp_path / "out", difference=True)
