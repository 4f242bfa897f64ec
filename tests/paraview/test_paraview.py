"""Debian's ParaView: it reads the files of every writer and runs the script of each result folder."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.case import load_case
from pipeline.results.case_run import run_case
from pipeline.series import read_series
from tests.bodies import PLANAR, skip_figures, write_case

HERE = Path(__file__).resolve().parent
SCREEN = ["xvfb-run", "-a", "-s", "-noreset -screen 0 1280x800x24"]
DTYPES = {"float64": "double", "float32": "float"}
QUADRATIC = {"mesh": {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 3, 1], "order": 2}}


def run_paraview(*command, code=0):
    """The last line that a ParaView program prints; it runs in /, so that no relative path works by chance."""
    limit = ["timeout", "-k", "5", "180"]  # of the program itself: it would outlive xvfb-run
    done = subprocess.run([*SCREEN, *limit, *map(str, command)], capture_output=True, text=True, cwd="/")
    assert done.returncode == code, done.stdout + done.stderr
    return (done.stdout.strip() or done.stderr.strip()).rpartition("\n")[2]


@pytest.fixture(scope="module", params=["float64", "float32", "planar", "quadratic", "vtkhdf"])
def run(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    output = {"format": "vtkhdf"} if request.param == "vtkhdf" else {}
    output |= {"precision": request.param} if request.param in DTYPES else {}
    sections = {"planar": PLANAR, "quadratic": QUADRATIC}.get(request.param, {})
    path = write_case(folder, output=output, **sections)
    with pytest.MonkeyPatch.context() as patch:
        skip_figures(patch)
        return request.param, run_case(load_case(path), folder / "out", movie=False)


def test_it_reads_times_names_components_types_and_ranges(run):
    kind, result = run
    folder = result.variants[0].folder
    if kind == "vtkhdf":
        message = run_paraview("pvbatch", result.folder / "open_in_paraview.py", code=1)
        assert "needs ParaView 5.13 or newer" in message
        return
    content = json.loads(run_paraview("pvbatch", HERE / "read_series.py", folder / "series.pvd"))
    series = read_series(folder)
    assert content["times"] == list(series.times)
    for i, frame in enumerate(content["frames"]):
        grid = series.read_grid(i)
        assert np.array_equal(frame["points"], grid.points) and frame["cells"] == len(grid.types)
        expected = {}
        for data, values in (("point", grid.point_data), ("cell", grid.cell_data), ("field", grid.field_data)):
            expected |= {f"{data} {name}": value for name, value in values.items()}
        assert frame.keys() - {"points", "cells"} == expected.keys()
        for name, value in expected.items():
            rows = value.reshape(len(value), -1)
            components, tuples, dtype, low, high = frame[name]
            assert (components, tuples) == (rows.shape[1], len(rows)), name
            assert (low, high) == (rows[:, 0].min(), rows[:, 0].max()), name
            usual = DTYPES.get(kind, "double")
            assert dtype == ("double" if name.startswith("field") else usual) or name == "field step", name


def test_the_script_draws_the_variants(run, tmp_path):
    kind, result = run
    if kind == "vtkhdf":
        return
    moved = tmp_path / "moved"
    shutil.copytree(result.folder, moved)
    shutil.rmtree(result.folder / result.variants[0].name)  # only the files beside the script may be drawn
    picture = tmp_path / "picture.png"
    end = read_series(moved / "polar").times[-1]
    run_paraview("pvbatch", moved / "open_in_paraview.py", "--screenshot", picture, "--time", end)
    check_drawn(picture)


def test_the_script_works_in_the_window(tmp_path, monkeypatch):
    """ParaView's window hides the path of a script from it."""
    skip_figures(monkeypatch)
    folder = run_case(load_case(write_case(tmp_path)), tmp_path / "out", movie=False).folder
    script = folder / "open_in_paraview.py"
    picture = folder / "window.png"
    more = (
        f"simple.SaveScreenshot({str(picture)!r}, simple.GetActiveView(), ImageResolution=[1280, 720])\nos._exit(0)\n"
    )
    script.write_text(script.read_text() + more)
    run_paraview("paraview", "--dr", f"--script={script}")  # --dr: no settings, no welcome that waits for a click
    check_drawn(picture)


def check_drawn(picture):
    """Bodies in the middle, the blue and red of the color bar below, white around."""
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    height = len(pixels)
    assert (pixels[: height // 8] == 255).all(axis=-1).mean() > 0.95
    middle = pixels[height // 4 : 3 * height // 4]
    assert 0.02 < (middle != 255).any(axis=-1).mean() < 0.9
    # a body on each side
    half = middle.shape[1] // 2
    assert all((part != 255).any(axis=-1).mean() > 0.01 for part in (middle[:, :half], middle[:, half:]))
    bar = pixels[-height // 8 :].reshape(-1, 3)
    assert (bar[:, 2] - bar[:, 0] > 80).any() and (bar[:, 0] - bar[:, 2] > 80).any()
