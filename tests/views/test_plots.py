"""Figures of a comparison dataset: written whole or not at all, and not trivial."""

import numpy as np
import pytest
import xarray

from pipeline.errors import OutputError
from pipeline.views.plots import write_distance_figure, write_energy_figure, write_volume_figure


def make_dataset(cells=40, variants=("linear", "polar"), times=30) -> xarray.Dataset:
    t = np.linspace(0, 3, times)
    strength = np.linspace(0, 0.4, cells)
    ratio = np.stack([1 + (m + 1) * np.sin(t)[:, None] * strength for m in range(len(variants))])
    data = {
        "volume_ratio": (("variant", "time", "cell"), ratio),
        "rest_volume": ("cell", np.full(cells, 0.5), {"units": "m3"}),
    }
    for k, name in enumerate(("kinetic", "elastic", "potential")):
        wave = np.stack([1e5 * np.cos(t * (k + 1)) ** 2 for _ in variants])
        data[f"{name}_energy"] = (("variant", "time"), wave, {"units": "J"})
    return xarray.Dataset(data, coords={"variant": list(variants), "time": ("time", t, {"units": "s"})})


def read_pixels(path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


def count_colored(picture, *, warm: bool) -> int:
    """Return the number of pixels that are distinctly orange (the worst cell) or blue (all cells)."""
    difference = picture[..., 0] - picture[..., 2]
    return int((difference > 80).sum() if warm else (difference < -20).sum())


@pytest.mark.parametrize("variants", [("one",), ("a", "b"), ("a", "b", "c"), ("a", "b", "c", "d", "e")])
def test_volume_figure_shows_cells_and_the_worst_of_them(tmp_path, variants):
    path = tmp_path / "figures" / "volume.png"
    write_volume_figure(make_dataset(variants=variants), path, title="Bar")
    picture = read_pixels(path)
    assert count_colored(picture, warm=False) > 1000 * len(variants)
    assert count_colored(picture, warm=True) > 300 * len(variants)
    assert [f.name for f in path.parent.iterdir()] == ["volume.png"]


def test_many_cells_become_bands(tmp_path):
    write_volume_figure(make_dataset(cells=2001), tmp_path / "bands.png", title="Bar")
    write_volume_figure(make_dataset(cells=200), tmp_path / "lines.png", title="Bar")
    assert count_colored(read_pixels(tmp_path / "bands.png"), warm=False) > 20000


def test_the_same_dataset_gives_the_same_bytes(tmp_path):
    for name in ("a.png", "b.png"):
        write_volume_figure(make_dataset(), tmp_path / name, title="Bar")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_nan_after_a_failure_is_left_out(tmp_path):
    data = make_dataset()
    for name in ("volume_ratio", "kinetic_energy", "elastic_energy", "potential_energy"):
        data[name][0, 10:] = np.nan
    write_volume_figure(data, tmp_path / "volume.png", title="Bar")
    write_energy_figure(data, tmp_path / "energy.png", title="Bar")
    data["volume_ratio"][:] = np.nan
    data["kinetic_energy"][:] = np.nan
    write_volume_figure(data, tmp_path / "nothing.png", title="Bar")
    write_energy_figure(data[["kinetic_energy"]], tmp_path / "none.png", title="Bar")
    whole = make_dataset()
    write_volume_figure(whole, tmp_path / "whole.png", title="Bar")
    count = [count_colored(read_pixels(tmp_path / f"{n}.png"), warm=False) for n in ("nothing", "volume", "whole")]
    assert count[0] < count[1] < count[2]


def test_unequal_rest_volumes_have_no_volume_axis(tmp_path):
    data = make_dataset()
    write_volume_figure(data, tmp_path / "equal.png", title="Bar")
    data["rest_volume"][0] = 0.7
    write_volume_figure(data, tmp_path / "unequal.png", title="Bar")
    dark = [(read_pixels(tmp_path / f"{n}.png")[:, -100:].max(axis=-1) < 140).sum() for n in ("equal", "unequal")]
    assert dark[0] > dark[1] + 300


def test_energy_figure_draws_the_energies_present(tmp_path):
    write_energy_figure(make_dataset(), tmp_path / "all.png", title="Bar")
    write_energy_figure(make_dataset()[["kinetic_energy"]], tmp_path / "kinetic.png", title="Bar")
    warm = [count_colored(read_pixels(tmp_path / f"{name}.png"), warm=True) for name in ("all", "kinetic")]
    assert warm[0] > warm[1]
    with pytest.raises(OutputError, match="no energies"):
        write_energy_figure(make_dataset()[["volume_ratio", "rest_volume"]], tmp_path / "none.png", title="Bar")


def test_a_path_that_cannot_be_written_is_an_output_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        write_volume_figure(make_dataset(), tmp_path / "file" / "volume.png", title="Bar")


def test_a_single_frame(tmp_path):
    write_volume_figure(make_dataset(times=1), tmp_path / "volume.png", title="Bar")
    write_energy_figure(make_dataset(times=1), tmp_path / "energy.png", title="Bar")
    assert (tmp_path / "energy.png").stat().st_size > 5000


def test_distance_figure_has_a_panel_for_each_but_the_first(tmp_path):
    t = np.linspace(0, 3, 30)
    distance = np.stack([0 * t, t, 1 - np.cos(t)])
    data = {
        "node_distance_worst": (("variant", "time"), distance),
        "node_distance_rms": (("variant", "time"), distance / 2),
    }
    distances = xarray.Dataset(data, coords={"variant": ["a", "b", "c"], "time": t})
    write_distance_figure(distances, tmp_path / "three.png", title="a, b and c")
    write_distance_figure(distances.isel(variant=[0, 1]), tmp_path / "two.png", title="a and b")
    three, two = read_pixels(tmp_path / "three.png"), read_pixels(tmp_path / "two.png")
    assert three.shape[1] > two.shape[1]
    assert (
        count_colored(three, warm=True) > count_colored(two, warm=True) > 300 and count_colored(two, warm=False) > 300
    )
