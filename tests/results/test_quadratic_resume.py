"""Runs on meshes of order 2 that were stopped or killed give the results of uninterrupted ones, bit for bit."""

import signal
import time
from pathlib import Path

import numpy as np
import pytest

from pipeline.case import load_case
from pipeline.errors import CaseError
from pipeline.results.case_run import run_case
from pipeline.series import read_series
from tests.bodies import PLANAR, case_document, skip_figures, write_case
from tests.results.test_faults import make_command, start_warm_child
from tests.results.test_resume import METHODS, assert_same_datasets, assert_same_results, solve, stop_after

FORMATS = [{"format": "vtkhdf"}, {"precision": "float32"}]
KEYS = [{"stepper": "bdf2"}, {"rotation_at": "element"}, {"model": "auto", "mass": "lumped"}]
MEAN = [{"volumetric": "mean", **keys} for keys in ({}, {"iterations": "converged"}, {"model": "auto"})]
CHOSEN = ("linear", "polar", "converged", "bdf2_converged", "symplectic_euler", "auto_bdf2", "crossing", "warped_auto")
MOVED = {
    "velocity": {"velocity": [1.0, 0.0, 0.0]},
    "spin": {"spin": {"axis": [0.0, 1.0, 0.0], "rate": 200.0, "center": [0.5, 3.0, 0.5]}},
}


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch):
    skip_figures(monkeypatch)


def write_one_variant(folder: Path, keys: dict[str, object], *, order: int = 2, **sections: object) -> Path:
    """Write a case of one variant and ten steps, two per frame; for `inversion`, thrown so hard that cells invert."""
    folder.mkdir(exist_ok=True)
    of_mesh = dict(case_document(**sections)["mesh"])  # type: ignore[call-overload]  # a table
    dt = 1e-4 if "symplectic_euler" in keys.values() else 0.02
    start = {"velocity": [0.0, 300.0, -200.0]} if "inversion" in keys else {"velocity": [0.0, 0.0, -20.0]}
    changes: dict[str, object] = {
        "method": keys,
        "initial": start,
        "schedule": {"dt": dt, "steps_per_frame": 2, "frames": 5},
        "output": {"checkpoint_seconds": 1e9},
        "variants": {"only": {}},
    }
    return write_case(folder, **{**changes, **sections, "mesh": {**of_mesh, "order": order}})


def assert_same_frames(one: Path, other: Path) -> None:
    """Compare positions, velocities and cell values of every frame bit for bit, whatever the format of the files."""
    a, b = read_series(one), read_series(other)
    assert a.times == b.times and len(a) > 3
    for frame, twin in zip(a, b, strict=True):
        assert frame.x.tobytes() == twin.x.tobytes() and frame.known.keys() == twin.known.keys()
        assert all(np.asarray(frame.known[k]).tobytes() == np.asarray(twin.known[k]).tobytes() for k in frame.known)


@pytest.mark.parametrize("method", CHOSEN)
def test_a_resumed_run_of_order_two_is_bit_identical(tmp_path, monkeypatch, method):
    path = write_one_variant(tmp_path, METHODS[method])
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "parts", 5, monkeypatch)
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0]
    assert (resumed.status, whole.status) == ("finished", "finished")
    assert resumed.run["resumed_after_steps"] == [5]
    assert_same_results(whole.folder, folder)


@pytest.mark.parametrize(
    "keys", [*({"linear_solver": name} for name in ("multigrid", "cg", "superlu", "pardiso")), *MEAN], ids=str
)
def test_other_solvers_and_mean_dilatation_resume_bit_identically(tmp_path, monkeypatch, keys):
    path = write_one_variant(tmp_path, keys)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "parts", 5, monkeypatch)
    solve(path, tmp_path / "parts", resume=True)
    assert_same_results(whole.folder, folder)


@pytest.mark.parametrize("output", FORMATS, ids=str)
@pytest.mark.parametrize(
    "method", [{"stepper": "bdf2"}, {"rotation_at": "element"}, {"model": "auto", "mass": "lumped"}], ids=str
)
def test_every_format_resumes_bit_identically(tmp_path, monkeypatch, method, output):
    path = write_one_variant(tmp_path, method, output={"checkpoint_seconds": 1e9, **output})
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "parts", 5, monkeypatch)
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0]
    assert resumed.run["resumed_after_steps"] == [5]
    assert_same_frames(whole.folder, folder)
    assert_same_datasets(whole.folder, folder)


@pytest.mark.parametrize("motion", MOVED)
def test_moving_supports_of_order_two_stopped_twice_are_bit_identical(tmp_path, monkeypatch, motion):
    supports = [{"plane": "y", "at": 3.0, "motion": MOVED[motion]}]
    path = write_one_variant(tmp_path, METHODS["auto_bdf2"], supports=supports)
    whole = solve(path, tmp_path / "whole").variants[0]
    stop_after(path, tmp_path / "parts", 1, monkeypatch)
    folder = stop_after(path, tmp_path / "parts", 7, monkeypatch, resume=True)
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0]
    assert resumed.run["resumed_after_steps"] == [1, 7]
    assert_same_results(whole.folder, folder)


def test_a_planar_run_of_order_two_is_bit_identical(tmp_path, monkeypatch):
    path = write_one_variant(tmp_path, METHODS["bdf2"], **PLANAR)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "parts", 7, monkeypatch)
    solve(path, tmp_path / "parts", resume=True)
    assert_same_results(whole.folder, folder)


@pytest.mark.parametrize("method", ["polar", "bdf2_converged", "auto_bdf2", "symplectic_euler"])
def test_damped_runs_on_rollers_resume_bit_identically(tmp_path, monkeypatch, method):
    material = {**case_document()["material"], "mass_damping": 0.5}  # type: ignore[dict-item]  # a table
    if method != "symplectic_euler":
        material["stiffness_damping"] = 1e-3
    supports = [{"plane": "y", "at": 3.0, "components": ["y"]}, {"nodes": [0]}]
    path = write_one_variant(tmp_path, METHODS[method], material=material, supports=supports)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "parts", 5, monkeypatch)
    solve(path, tmp_path / "parts", resume=True)
    assert_same_results(whole.folder, folder)


def test_another_order_is_not_resumed(tmp_path, monkeypatch):
    path = write_one_variant(tmp_path, {})
    stop_after(path, tmp_path / "parts", 5, monkeypatch)
    with pytest.raises(CaseError, match=r"mesh\.order: 2 there, 1 here"):
        solve(write_one_variant(tmp_path / "other", {}, order=1), tmp_path / "parts", resume=True)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["vtu", "vtkhdf"])
@pytest.mark.parametrize("method", [{"stepper": "bdf2"}, {"model": "auto"}], ids=str)
def test_kill_9_of_a_run_of_order_two_loses_nothing(tmp_path, method, form):
    """Three kills, each after some more frames; then the run ends as if nothing had happened."""
    path = write_one_variant(
        tmp_path,
        method,
        output={"format": form, "checkpoint_seconds": 1e-9},
        schedule={"dt": 0.005, "steps_per_frame": 2, "frames": 150},
    )
    whole = run_case(load_case(path), tmp_path / "whole", movie=False).variants[0].folder
    folder, kills = tmp_path / "parts" / "beam" / "only", 0
    for step in (40, 100, 180):
        child = start_warm_child(make_command(path, tmp_path / "parts", "--resume")[3:])
        deadline = time.monotonic() + 300
        while child.is_alive() and find_last_step(folder) < step:
            assert time.monotonic() < deadline
            time.sleep(0.001)
        child.kill()
        child.join()
        kills += child.exitcode == -signal.SIGKILL
    assert kills >= 2  # the last one may have finished
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0].run["resumed_after_steps"]
    assert len(resumed) >= 2 and resumed == sorted(resumed)
    assert_same_frames(whole, folder)
    assert_same_datasets(whole, folder)


def find_last_step(folder: Path) -> int:
    names = [file.stem for file in (folder / "checkpoints").glob("step_*.checkpoint")]
    return max((int(name.removeprefix("step_")) for name in names), default=0)
