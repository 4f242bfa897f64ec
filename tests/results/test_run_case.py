"""From a case to its result folder: its files, and results that are neither overwritten nor solved again."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray

from pipeline.case import load_case
from pipeline.errors import CaseError, OutputError, SolveError
from pipeline.problem.problem import Problem
from pipeline.results import case_run, comparison, variant_run
from pipeline.results.case_run import CaseResult, run_case
from pipeline.stepping.backward_euler import BackwardEuler
from tests.bodies import PLANAR, assert_conventional, skip_figures, write_case

VARIANTS = ["linear", "gram_schmidt", "polar"]
SOLVED = {"finished"}


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch):
    skip_figures(monkeypatch)


def solve(out: Path, *, overrides=None, sections=None, **keywords) -> CaseResult:
    out.mkdir(exist_ok=True)
    case = load_case(write_case(out.parent, **(sections or {})), overrides=overrides)
    return run_case(case, out, movie=False, **keywords)


def list_statuses(result: CaseResult) -> dict[str, str]:
    return {variant.name: variant.status for variant in result.variants}


def read_files(folder: Path, *patterns: str) -> dict[str, bytes]:
    paths = [path for pattern in patterns or ("*",) for path in folder.rglob(pattern) if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def read_comparison(out: Path) -> xarray.Dataset:
    with xarray.open_dataset(out / "beam" / "comparison.nc") as dataset:
        return dataset.load()


@pytest.fixture(scope="module", params=["3D", "2D"])
def done(request, tmp_path_factory):
    """The result of three variants; tests must not change it."""
    out = tmp_path_factory.mktemp(request.param) / "outputs"
    with pytest.MonkeyPatch.context() as patch:
        skip_figures(patch)
        return solve(out, sections=PLANAR if request.param == "2D" else {})


@pytest.fixture(scope="module")
def _finished_folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("finished") / "outputs"
    with pytest.MonkeyPatch.context() as patch:
        skip_figures(patch)
        solve(out)
    return out


@pytest.fixture
def out(tmp_path, _finished_folder) -> Path:
    """A finished result folder that a test may change."""
    return Path(shutil.copytree(_finished_folder, tmp_path / "outputs"))


# The files of a result


def test_every_variant_has_its_files(done):
    names = {"comparison.nc", "volume.png", "energy.png", "open_in_paraview.py", "case.toml", *VARIANTS}
    assert {path.name for path in done.folder.iterdir()} == names
    assert list_statuses(done) == dict.fromkeys(VARIANTS, "finished") and done.exit_code == 0
    for name in VARIANTS:
        files = {path.name for path in (done.folder / name).iterdir()}
        assert files == {"case.toml", "run.json", "series.pvd", "statistics.nc", "frames"}
        assert len(list((done.folder / name / "frames").iterdir())) == 5
    assert set(done.files) == {done.folder / name for name in names if "." in name} - {done.folder / "case.toml"}


def test_run_json_has_the_work_and_the_seconds(done):
    for name in VARIANTS:
        run = json.loads((done.folder / name / "run.json").read_text())
        assert (run["name"], run["variant"], run["status"], run["frames"]) == ("beam", name, "finished", 5)
        assert run["last_frame"] == {"index": 4, "step": 4, "time": 0.08}
        assert run["work"]["steps"] == run["work"]["solves"] == run["work"]["iterations"] == 4
        assert (run["work"]["rotations"], run["work"]["factorizations"]) == ((0, 1) if name == "linear" else (4, 4))
        assert run["seconds"].keys() == {"setup", "solving", "writing", "wall"}
        assert all(seconds > 0 for seconds in run["seconds"].values())
        assert run["real_time_factor"] == pytest.approx(0.02 / run["seconds_per_step"])
        assert {"pipeline", "python", "numpy", "vtk", "netCDF4"} <= run["versions"].keys()
        assert "message" not in run


def test_the_worst_ratio_of_run_json_is_that_of_the_statistics(done):
    for name in VARIANTS:
        worst = json.loads((done.folder / name / "run.json").read_text())["worst"]
        with xarray.open_dataset(done.folder / name / "statistics.nc") as dataset:
            J = dataset["volume_ratio"].values
            step, cell = np.unravel_index(np.abs(J - 1).argmax(), J.shape)
            assert worst == {"volume_ratio": J[step, cell], "cell": cell, "time": dataset["time"].values[step]}


def test_the_resolved_case_in_a_result_gives_the_result_again(done, tmp_path):
    again = run_case(load_case(done.folder / "polar" / "case.toml"), tmp_path, movie=False)
    patterns = ("*.vtu", "*.pvd")
    assert read_files(again.folder / "default", *patterns) == read_files(done.folder / "polar", *patterns)


def test_the_same_case_twice_gives_the_same_bytes(done, tmp_path):
    again = run_case(load_case(done.folder / "case.toml"), tmp_path, movie=False)
    patterns = ("*.vtu", "*.pvd", "*.nc")
    first, second = read_files(done.folder, *patterns), read_files(again.folder, *patterns)
    assert len(first) == 3 * (5 + 1 + 1) + 1 and first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []


def test_the_comparison_joins_the_statistics_of_all_variants(done):
    with xarray.open_dataset(done.folder / "comparison.nc") as joined:
        assert joined["variant"].values.tolist() == VARIANTS
        assert joined["volume_ratio"].dims == ("variant", "time", "cell") and joined["rest_volume"].dims == ("cell",)
        for name in VARIANTS:
            with xarray.open_dataset(done.folder / name / "statistics.nc") as own:
                xarray.testing.assert_equal(joined.sel(variant=name).drop_vars("variant"), own)


def test_the_comparison_follows_the_conventions(done):
    with xarray.open_dataset(done.folder / "comparison.nc") as joined:
        assert_conventional(joined)
        with xarray.open_dataset(done.folder / "linear" / "statistics.nc") as own:
            for name in own.data_vars:
                assert joined[name].attrs == own[name].attrs


# Results that are not solved again, and never overwritten


def test_a_finished_variant_of_the_same_case_is_up_to_date(out, monkeypatch):
    before = read_files(out)

    def refuse(problem):
        raise AssertionError("solved again")

    monkeypatch.setattr(variant_run, "frames", refuse)
    again = solve(out)
    assert list_statuses(again) == dict.fromkeys(VARIANTS, "up to date") and again.exit_code == 0
    assert read_files(out) == before


def test_a_changed_movie_table_is_drawn_without_solving(out, tmp_path, monkeypatch):
    drawn = []

    def draw(case, folder, shown, *, on_drawing):
        drawn.append((case.movie.speed, case.movie.title))
        for name in comparison.MOVIE_FILES:
            (folder / name).touch()

    monkeypatch.setattr(comparison, "draw_movie", draw)
    monkeypatch.setattr(BackwardEuler, "step", None)

    def run_again(**movie):
        case = load_case(write_case(tmp_path, movie=movie))
        return run_case(case, out).files

    assert run_again() and drawn == [(1.0, None)]  # none was there
    assert run_again() == () and len(drawn) == 1
    assert run_again(speed=0.5) and drawn[1:] == [(0.5, None)]
    assert run_again(speed=0.5, title="t") and drawn[2:] == [(0.5, "t")]
    assert run_again(speed=0.5, title="t") == () and len(drawn) == 3


def test_an_outdated_movie_is_gone_after_an_interruption(out, tmp_path, monkeypatch):
    movie = out / "beam" / "comparison.mp4"
    movie.touch()

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(case_run, "compare_variants", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_case(load_case(write_case(tmp_path, movie={"fps": 10})), out)
    assert not movie.exists()


def test_another_movie_is_not_another_case(out):
    again = solve(out, sections={"movie": {"variants": ["polar"], "fps": 24}})
    assert set(list_statuses(again).values()) == {"up to date"}


def test_a_result_of_another_case_is_refused_with_the_difference(out):
    before = read_files(out)
    with pytest.raises(CaseError) as caught:
        solve(out, overrides={"schedule.dt": 0.01, "material.poisson_ratio": 0.25})
    text = str(caught.value)
    assert text.startswith(f"{out / 'beam' / 'linear'}: ") and "--force" in text and "\n" not in text
    assert "schedule.dt: 0.02 there, 0.01 here" in text and "material.poisson_ratio: 0.3 there, 0.25 here" in text
    assert read_files(out) == before
    with pytest.raises(CaseError):
        solve(out, overrides={"schedule.frames": 3})


def test_force_replaces_the_result_of_another_case(out):
    forced = solve(out, overrides={"schedule.frames": 2}, force=True)
    assert set(list_statuses(forced).values()) == SOLVED
    assert len(list((out / "beam" / "polar" / "frames").iterdir())) == 3  # the five old frames are gone
    assert read_comparison(out).sizes["time"] == 3


def test_force_solves_the_same_case_again(out):
    before = read_files(out, "*.vtu", "*.nc")
    assert set(list_statuses(solve(out, force=True)).values()) == SOLVED
    assert read_files(out, "*.vtu", "*.nc") == before


def test_another_version_of_the_program_solves_again(out, monkeypatch):
    monkeypatch.setattr(case_run, "VERSION", "99.0")
    assert set(list_statuses(solve(out)).values()) == SOLVED


@pytest.mark.parametrize("force", [False, True])
def test_an_unfinished_result_is_not_overwritten_without_force(out, force):
    path = out / "beam" / "polar" / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"status": "running"}))
    if force:
        assert set(list_statuses(solve(out, force=True)).values()) == SOLVED
        return
    before = read_files(out)
    with pytest.raises(CaseError, match=r"unfinished run of this case.*--force"):
        solve(out)
    assert read_files(out) == before
    assert list_statuses(solve(out, variants=["linear"])) == {"linear": "up to date"}  # the others do not matter


def test_solving_one_variant_keeps_the_others(out):
    before = read_files(out / "beam" / "linear")
    result = solve(out, variants=["polar"], force=True)
    assert list_statuses(result) == {"polar": "finished"}
    assert read_files(out / "beam" / "linear") == before
    assert read_comparison(out)["variant"].values.tolist() == VARIANTS


def test_variants_solved_one_by_one_are_compared_in_the_order_of_the_case(tmp_path):
    for name, wanted in (("polar", ["polar"]), ("linear", ["linear", "polar"])):
        solve(tmp_path / "outputs", variants=[name])
        assert read_comparison(tmp_path / "outputs")["variant"].values.tolist() == wanted


def test_a_variant_of_another_case_stays_out_of_the_comparison(out):
    solve(out, overrides={"schedule.dt": 0.01}, variants=["polar"], force=True)
    assert read_comparison(out)["variant"].values.tolist() == ["polar"]


@pytest.mark.parametrize("text", ["", "{", "null", "[1]", "3"])
def test_a_damaged_run_json_is_a_clear_error_and_force_replaces_it(out, text):
    path = out / "beam" / "polar" / "run.json"
    path.write_text(text)
    with pytest.raises(OutputError, match=r"run.json: cannot be read .*--force") as caught:
        solve(out)
    assert "\n" not in str(caught.value)
    assert set(list_statuses(solve(out, force=True)).values()) == SOLVED


def test_foreign_files_in_the_folder_stay(out):
    notes = out / "beam" / "polar" / "notes.txt"
    notes.write_text("mine")
    solve(out, force=True)
    assert notes.read_text() == "mine"


# Failures


def fail_at(monkeypatch, step: int, method: str = "Linear") -> None:
    """Make the steppers of one law fail at a step, counted from 1."""
    genuine = BackwardEuler.step

    def fail(self, state):
        if state.step + 1 == step and type(self.body.law).__name__ == method:
            raise SolveError("it broke")
        return genuine(self, state)

    monkeypatch.setattr(BackwardEuler, "step", fail)


def test_a_failed_variant_is_recorded_and_the_others_are_solved(tmp_path, monkeypatch):
    fail_at(monkeypatch, 3)
    result = solve(tmp_path / "outputs")
    assert list_statuses(result) == {"linear": "failed", "gram_schmidt": "finished", "polar": "finished"}
    assert result.exit_code == 3
    run = json.loads((result.folder / "linear" / "run.json").read_text())
    assert run["status"] == "failed" and run["frames"] == 3
    assert run["message"].startswith("it broke (at step 3, t = 0.06 s); after step 2 0 of 18 cells are inverted")
    assert run["last_frame"] == {"index": 2, "step": 2, "time": 0.04}
    joined = read_comparison(tmp_path / "outputs")
    assert joined["variant"].values.tolist() == VARIANTS and joined.sizes["time"] == 5
    finite = np.isfinite(joined["volume_ratio"].values).all(axis=2)
    assert finite.tolist() == [[True] * 3 + [False] * 2, [True] * 5, [True] * 5]
    assert joined["time"].values.tolist() == [i * 0.02 for i in range(5)]


def test_a_failed_variant_is_solved_again_and_the_others_are_not(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        fail_at(patch, 3)
        solve(tmp_path / "outputs")
    again = solve(tmp_path / "outputs")
    assert list_statuses(again) == {"linear": "finished", "gram_schmidt": "up to date", "polar": "up to date"}
    assert np.isfinite(read_comparison(tmp_path / "outputs")["volume_ratio"].values).all()


def test_a_variant_that_fails_in_its_first_step_has_one_frame(tmp_path, monkeypatch):
    fail_at(monkeypatch, 1)
    result = solve(tmp_path / "outputs")
    assert result.variants[0].run["frames"] == 1 and result.variants[0].run["seconds_per_step"] is None
    assert np.isfinite(read_comparison(tmp_path / "outputs")["volume_ratio"].values[0]).all(axis=1).sum() == 1


def test_a_variant_that_cannot_start_is_recorded_without_frames(tmp_path, monkeypatch):
    def fail(self):
        raise SolveError("no factor")

    monkeypatch.setattr(Problem, "prepare", fail)
    result = solve(tmp_path / "outputs")
    assert set(list_statuses(result).values()) == {"failed"} and result.exit_code == 3
    assert json.loads((result.folder / "polar" / "run.json").read_text())["message"] == "no factor"
    assert result.notes and result.files == ()


def test_a_run_that_is_interrupted_stays_marked_as_running_with_its_frames(tmp_path, monkeypatch):
    def interrupt(name, problem, frame, summary):
        if name == "polar" and frame.index == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(tmp_path / "outputs", on_frame=interrupt)
    folder = tmp_path / "outputs" / "beam" / "polar"
    assert json.loads((folder / "run.json").read_text())["status"] == "running"
    assert len(list((folder / "frames").iterdir())) == 3
    with xarray.open_dataset(folder / "statistics.nc") as dataset:
        assert dataset.sizes["time"] == 3


def test_a_motion_too_large_for_floats_is_a_failed_step(tmp_path, monkeypatch):
    """Positions of 1e150 m are finite, their volumes are not."""
    genuine = BackwardEuler.step

    def leap(self, state):
        new, work = genuine(self, state)
        return replace(new, x=1e150 * new.x), work

    monkeypatch.setattr(BackwardEuler, "step", leap)
    result = solve(tmp_path / "outputs")
    assert set(list_statuses(result).values()) == {"failed"} and result.exit_code == 3


@pytest.mark.parametrize(
    "sections",
    [
        {"supports": [{"plane": "y", "at": 99.0}]},
        {"variants": {"linear": {}, "odd": {"method.law": "plastic"}}},
        {"mesh": {"file": "none.vtu"}},
    ],
    ids=["support", "variant", "mesh"],
)
def test_nothing_is_written_for_a_case_that_cannot_be_built(tmp_path, sections):
    with pytest.raises(CaseError):
        solve(tmp_path / "outputs", sections=sections)
    assert list((tmp_path / "outputs").iterdir()) == []


def test_an_output_folder_that_is_a_file_is_an_output_error(tmp_path):
    (tmp_path / "file").write_text("in the way")
    for force in (False, True):
        with pytest.raises(OutputError, match=r"Not a directory|is a file, not a folder") as caught:
            run_case(load_case(write_case(tmp_path)), tmp_path / "file", movie=False, force=force)
        assert str(caught.value).startswith(f"{tmp_path / 'file' / 'beam'}")


# Variants that differ in more than their method


def test_variants_with_the_same_frame_times_are_joined_whatever_their_dt(tmp_path):
    variants = {"coarse": {}, "fine": {"schedule.dt": 0.005, "schedule.steps_per_frame": 4}}
    result = solve(tmp_path / "outputs", sections={"variants": variants})
    assert read_comparison(tmp_path / "outputs")["variant"].values.tolist() == ["coarse", "fine"] and not result.notes
    assert read_comparison(tmp_path / "outputs")["newton_iterations"].values[:, 1].tolist() == [1.0, 4.0]


@pytest.mark.parametrize(
    ("own", "words"),
    [
        ({"schedule.dt": 0.01}, "other is left out of the comparison: its frame times are not those of"),
        ({"mesh.cells": [1, 6, 1]}, "other is left out of the comparison: its mesh is not that of"),
        ({"mesh.size": [1.0, 3.0, 2.0]}, "other is left out of the comparison: its mesh is not that of"),
    ],
    ids=["times", "cells", "size"],
)
def test_variants_that_cannot_be_joined_are_left_out_with_a_note(tmp_path, own, words):
    result = solve(tmp_path / "outputs", sections={"variants": {"first": {}, "other": own}})
    assert set(list_statuses(result).values()) == SOLVED
    assert [note for note in result.notes if note.startswith(words)]
    assert read_comparison(tmp_path / "outputs")["variant"].values.tolist() == ["first"]


def test_a_result_folder_can_be_moved(out, tmp_path):
    shutil.move(out, tmp_path / "elsewhere")
    assert set(list_statuses(solve(tmp_path / "elsewhere")).values()) == {"up to date"}
