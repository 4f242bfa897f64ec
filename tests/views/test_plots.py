"""Figures of a comparison dataset: made, not trivial, whole or not at all."""

import numpy as np
import pytest
import xarray

from pipeline.errors import OutputError
from pipeline.views.plots import write_distance_figure, write_energy_figure, write_volume_figure


def dataset(cells=40, methods=("linear", "polar"), times=30) -> xarray.Dataset:
    t = np.linspace(0, 3, times)
    strength = np.linspace(0, 0.4, cells)
    ratio = np.stack([1 + (m + 1) * np.sin(t)[:, None] * strength for m in range(len(methods))])
    data = {
        "volume_ratio": (("variant", "time", "cell"), ratio),
        "rest_volume": ("cell", np.full(cells, 0.5), {"units": "m3"}),
    }
    for k, name in enumerate(("kinetic", "elastic", "potential")):
        wave = np.stack([1e5 * np.cos(t * (k + 1)) ** 2 for _ in methods])
        data[f"{name}_energy"] = (("variant", "time"), wave, {"units": "J"})
    return xarray.Dataset(data, coords={"variant": list(methods), "time": ("time", t, {"units": "s"})})


def pixels(path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


def colored(picture, *, warm: bool) -> int:
    """Return the number of pixels that are distinctly orange (the worst cell) or blue (all cells)."""
    difference = picture[..., 0] - picture[..., 2]
    return int((difference > 80).sum() if warm else (difference < -20).sum())


@pytest.mark.parametrize("methods", [("one",), ("a", "b"), ("a", "b", "c"), ("a", "b", "c", "d", "e")])
def test_volume_figure_shows_cells_and_the_worst_of_them(tmp_path, methods):
    path = tmp_path / "figures" / "volume.png"
    write_volume_figure(dataset(methods=methods), path, title="Bar")
    picture = pixels(path)
    assert colored(picture, warm=False) > 1000 * len(methods)
    assert colored(picture, warm=True) > 300 * len(methods)
    assert [f.name for f in path.parent.iterdir()] == ["volume.png"]


def test_many_cells_become_bands(tmp_path):
    write_volume_figure(dataset(cells=2001), tmp_path / "bands.png", title="Bar")
    write_volume_figure(dataset(cells=200), tmp_path / "lines.png", title="Bar")
    assert colored(pixels(tmp_path / "bands.png"), warm=False) > 20000


def test_the_same_dataset_gives_the_same_bytes(tmp_path):
    for name in ("a.png", "b.png"):
        write_volume_figure(dataset(), tmp_path / name, title="Bar")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_nan_after_a_failure_is_left_out(tmp_path):
    data = dataset()
    for name in ("volume_ratio", "kinetic_energy", "elastic_energy", "potential_energy"):
        data[name][0, 10:] = np.nan
    write_volume_figure(data, tmp_path / "volume.png", title="Bar")
    write_energy_figure(data, tmp_path / "energy.png", title="Bar")
    data["volume_ratio"][:] = np.nan
    data["kinetic_energy"][:] = np.nan
    write_volume_figure(data, tmp_path / "nothing.png", title="Bar")
    write_energy_figure(data[["kinetic_energy"]], tmp_path / "none.png", title="Bar")
    whole = dataset()
    write_volume_figure(whole, tmp_path / "whole.png", title="Bar")
    count = [colored(pixels(tmp_path / f"{n}.png"), warm=False) for n in ("nothing", "volume", "whole")]
    assert count[0] < count[1] < count[2]


def test_unequal_rest_volumes_have_no_volume_axis(tmp_path):
    data = dataset()
    write_volume_figure(data, tmp_path / "equal.png", title="Bar")
    data["rest_volume"][0] = 0.7
    write_volume_figure(data, tmp_path / "unequal.png", title="Bar")
    dark = [(pixels(tmp_path / f"{n}.png")[:, -100:].max(axis=-1) < 140).sum() for n in ("equal", "unequal")]
    assert dark[0] > dark[1] + 300


def test_energies(tmp_path):
    write_energy_figure(dataset(), tmp_path / "all.png", title="Bar")
    write_energy_figure(dataset()[["kinetic_energy"]], tmp_path / "kinetic.png", title="Bar")
    assert colored(pixels(tmp_path / "all.png"), warm=True) > colored(pixels(tmp_path / "kinetic.png"), warm=True)
    with pytest.raises(OutputError, match="no energies"):
        write_energy_figure(dataset()[["volume_ratio", "rest_volume"]], tmp_path / "none.png", title="Bar")


def test_a_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        write_volume_figure(dataset(), tmp_path / "file" / "volume.png", title="Bar")


def test_one_instant(tmp_path):
    write_volume_figure(dataset(times=1), tmp_path / "volume.png", title="Bar")
    write_energy_figure(dataset(times=1), tmp_path / "energy.png", title="Bar")
    assert (tmp_path / "energy.png").stat().st_size > 5000


def test_distance_figure_has_a_panel_for_each_but_the_first(tmp_path):
    t = np.linspace(0, 3, 30)
    distance = np.stack([0 * t, t, 1 - np.cos(t)])
    data = {
        "node_distance_worst": (("variant", "time"), distance),
        "node_distance_rms": (("variant", "time"), distance / 2),
    }
    apart = xarray.Dataset(data, coords={"variant": ["a", "b", "c"], "time": t})
    write_distance_figure(apart, tmp_path / "three.png", title="a, b and c")
    write_distance_figure(apart.isel(variant=[0, 1]), tmp_path / "two.png", title="a and b")
    three, two = pixels(tmp_path / "three.png"), pixels(tmp_path / "two.png")
    assert three.shape[1] > two.shape[1]
    assert colored(three, warm=True) > colored(two, warm=True) > 300 and colored(two, warm=False) > 300
