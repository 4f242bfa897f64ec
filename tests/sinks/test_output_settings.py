"""Every format and precision of the frames: run, resumed, compared and killed like the default."""

import random
import signal
import subprocess
import time

import numpy as np
import pytest
import xarray

from pipeline.results import variant_run
from pipeline.series import read_series
from pipeline.sinks.frame_formats import FORMATS
from tests.results.test_faults import ROOT, make_command
from tests.results.test_resume import (  # noqa: F401  (fixtures)
    _default_handlers,
    _no_figures,
    assert_same_datasets,
    solve,
    stop_after,
    write_one_variant,
)

OUTPUTS = {
    "vtu": {},
    "vtu_float32": {"precision": "float32"},
    "vtkhdf": {"format": "vtkhdf"},
    "vtkhdf_float32": {"format": "vtkhdf", "precision": "float32"},
}


@pytest.fixture
def _beside(monkeypatch):
    """Lets a separate process write small meshes too."""
    monkeypatch.setattr(variant_run, "WORTH_A_PROCESS", 0)


def case(folder, output, *, seconds=1e9, **sections):
    return write_one_variant(folder, **{"output": {**OUTPUTS[output], "checkpoint_seconds": seconds}, **sections})


def assert_same_series(one, other):
    """Assert the same datasets to the bit, and the same arrays in every frame."""
    assert_same_datasets(one, other)
    series = [read_series(folder) for folder in (one, other)]
    assert series[0].times == series[1].times
    for i in range(len(series[0])):
        grids = [one.read_grid(i) for one in series]
        assert np.array_equal(grids[0].points, grids[1].points)
        for data in ("point_data", "cell_data", "field_data"):
            first, second = (getattr(grid, data) for grid in grids)
            assert first.keys() == second.keys()
            assert all(np.array_equal(first[name], second[name]) for name in first)


@pytest.mark.parametrize("stop", [5, 8], ids=["between_frames", "at_a_frame"])
@pytest.mark.parametrize("output", OUTPUTS)
def test_a_resumed_run_is_bit_identical(tmp_path, monkeypatch, output, stop):
    path = case(tmp_path, output)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "parts", stop, monkeypatch)
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0]
    assert resumed.run["resumed_after_steps"] == [stop]
    assert_same_series(whole.folder, folder)


@pytest.mark.usefixtures("_beside")
@pytest.mark.parametrize("output", OUTPUTS)
def test_the_dataset_is_float64_whatever_the_frames_are(tmp_path, output):
    found = solve(case(tmp_path, output), tmp_path / "out").variants[0]
    usual = solve(write_one_variant(tmp_path), tmp_path / "usual").variants[0]
    with (
        xarray.open_dataset(found.folder / "statistics.nc") as ours,
        xarray.open_dataset(usual.folder / "statistics.nc") as theirs,
    ):
        xarray.testing.assert_identical(ours, theirs)
    assert any("statistics.nc cannot be rebuilt" in note for note in found.run["notes"]) == ("float32" in output)
    assert (found.folder / FORMATS[OUTPUTS[output].get("format", "vtu")].index).exists()
    points = {folder: read_series(folder).read_grid(5).points for folder in (found.folder, usual.folder)}
    assert points[found.folder] == pytest.approx(points[usual.folder], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("harm", ["dataset_half", "dataset_other", "dataset_short", "frames_missing", "frames_short"])
def test_a_run_that_cannot_be_resumed_is_solved_from_the_start(tmp_path, monkeypatch, output, harm, vtk_errors):
    path = case(tmp_path, output)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "out", 7, monkeypatch)
    harm_files(folder, harm, output)
    resumed = solve(path, tmp_path / "out", resume=True)
    vtk_errors.clear()
    needed = harm.startswith("frames") or "float32" in output
    assert any("solved from the start" in note for note in resumed.notes) == needed
    assert resumed.variants[0].run.get("resumed_after_steps", []) == ([] if needed else [7])
    assert_same_series(whole.folder, folder)


def harm_files(folder, harm, output):
    dataset = folder / "statistics.nc"
    if harm == "dataset_half":
        dataset.write_bytes(dataset.read_bytes()[: dataset.stat().st_size // 2])
    elif harm.startswith("dataset"):
        with xarray.open_dataset(dataset) as opened:
            changed = opened.load()
        if harm == "dataset_short":
            changed = changed.isel(time=slice(2))
        changed["volume_ratio"][1, 3] *= 1 + 1e-6
        changed.to_netcdf(dataset)
    elif "vtkhdf" in output:
        file = folder / "series.vtkhdf"
        file.unlink() if harm == "frames_missing" else shorten_listing(file)
    else:
        file = folder / "frames" / "frame_000001.vtu"
        file.unlink() if harm == "frames_missing" else file.write_bytes(file.read_bytes()[:500])


def shorten_listing(path):
    import h5py

    with h5py.File(path, "r+") as file:
        file["VTKHDF/Steps/Values"].resize((2,))
        file["VTKHDF/Steps"].attrs.modify("NSteps", np.int64(2))
        file["VTKHDF/FieldData/step"][2:] = 0


def last_step(folder) -> int:
    """Return the step of the last checkpoint, 0 if there is none."""
    return max((int(file.stem[5:]) for file in folder.glob("checkpoints/step_*.checkpoint")), default=0)


@pytest.mark.slow
@pytest.mark.usefixtures("_beside")
@pytest.mark.parametrize("output", OUTPUTS)
def test_kill_9_at_random_moments_can_be_resumed(tmp_path, output):
    mesh = {"shape": "box", "size": [2.0, 3.0, 1.0], "cells": [6, 7, 4]}  # enough cells for a thread, in the child too
    path = case(tmp_path, output, seconds=1e-9, schedule={"dt": 0.02, "frames": 80}, mesh=mesh)
    out, moments = tmp_path / "parts", random.Random(1)
    folder = out / "beam" / "only"
    for _ in range(2):
        until = last_step(folder) + moments.randint(2, 20)
        child = subprocess.Popen(make_command(path, out, "--resume"), cwd=ROOT, stderr=subprocess.PIPE)
        while last_step(folder) < until and child.poll() is None:
            time.sleep(0.001)
        time.sleep(moments.random() * 0.05)
        child.send_signal(signal.SIGKILL)
        _, err = child.communicate()
        assert child.returncode == -signal.SIGKILL, err
        series = read_series(folder)
        assert all(np.isfinite(series.read_frame(i).x).all() for i in range(len(series)))
    resumed = solve(path, out, resume=True).variants[0]
    assert len(resumed.run["resumed_after_steps"]) == 2
    assert_same_series(solve(path, tmp_path / "whole").variants[0].folder, folder)
