"""A run that stopped and goes on ends as one that never stopped: to the bit, by every method."""

import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.errors import CaseError
from pipeline.linear.work import Work
from pipeline.results import case_run as campaign
from pipeline.results import lock, variant_run
from pipeline.results.case_run import CaseResult, run_case
from pipeline.results.checkpoint import Checkpoint, CheckpointFolder, decode_checkpoint, encode_checkpoint
from pipeline.results.interrupt import Interrupted
from pipeline.results.lock import LOCK, lock_folder
from pipeline.run.recording import RunSummary
from pipeline.series import read_series
from pipeline.stepping.bdf2 import BDF2
from pipeline.stepping.report import Effort, ModelChoice
from pipeline.stepping.state import EnergyRecord, Memory, State
from tests.bodies import PLANAR, case_document, skip_figures, write_case
from tests.measured import measure_series

ONE = {"only": {}}
EXPLICIT = {"stepper": "symplectic_euler", "mass": "lumped"}
METHODS = {
    "linear": {"law": "linear"},
    "polar": {},
    "gram_schmidt": {"rotation": "gram_schmidt"},
    "three": {"iterations": 3},
    "converged": {"iterations": "converged"},
    "bdf2": {"stepper": "bdf2"},
    "bdf2_converged": {"stepper": "bdf2", "iterations": "converged"},
    "symplectic_euler": EXPLICIT,
    "auto": {"model": "auto"},
    "auto_bdf2": {"model": "auto", "stepper": "bdf2"},
    "last": {"inversion": "last"},
    "crossing": {"inversion": "crossing"},
    "crossing_explicit": EXPLICIT | {"inversion": "crossing"},
    "cg": {"linear_solver": "cg"},
    "superlu": {"linear_solver": "superlu"},
    "warped": {"linear_solver": "warped"},
    "warped_bdf2_converged": {"linear_solver": "warped", "stepper": "bdf2", "iterations": "converged"},
    "warped_auto": {"linear_solver": "warped", "model": "auto"},
}


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch):
    skip_figures(monkeypatch)


@pytest.fixture(autouse=True)
def _default_handlers():
    """A shell that runs the tests in the background has SIGINT ignored."""
    defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in defaults.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def written(folder: Path, method: str = "polar", *, seconds: float = 1e9, **sections: object) -> Path:
    """A case of one variant, two steps a frame, thrown so hard that cells turn over; ten steps."""
    folder.mkdir(exist_ok=True)
    dt = 2e-4 if "symplectic_euler" in METHODS[method].values() else 0.02
    start = {"velocity": [0.0, 300.0, -200.0]} if "inversion" in METHODS[method] else {"velocity": [0.0, 0.0, -20.0]}
    return write_case(
        folder,
        **{
            "method": METHODS[method],
            "initial": start,
            "schedule": {"dt": dt, "steps_per_frame": 2, "frames": 5},
            "output": {"checkpoint_seconds": seconds},
            "variants": ONE,
            **sections,
        },
    )


def solve(path: Path, out: Path, **keywords) -> CaseResult:
    return run_case(load_case(path), out, movie=False, **keywords)


def stopped_after(path: Path, out: Path, step: int, monkeypatch, **keywords) -> Path:
    """The variant's folder of a run that got SIGINT while a step was under way."""
    genuine = variant_run.VariantRun._after_step

    def asking(self, state, work, writer):
        if state.step == step:
            signal.raise_signal(signal.SIGINT)
        genuine(self, state, work, writer)

    with monkeypatch.context() as patch:
        patch.setattr(variant_run.VariantRun, "_after_step", asking)
        with pytest.raises(Interrupted, match=rf"interrupted after step {step} of only; .*--resume"):
            solve(path, out, **keywords)
    return out / "beam" / "only"


def assert_same_results(one: Path, other: Path) -> None:
    """The same frames and index, byte by byte, and the same data in statistics.nc, bit by bit."""
    files = [
        {p.relative_to(folder): p.read_bytes() for pattern in ("*.vtu", "*.pvd") for p in folder.rglob(pattern)}
        for folder in (one, other)
    ]
    assert files[0] and files[0].keys() == files[1].keys()
    assert [str(name) for name in files[0] if files[0][name] != files[1][name]] == []
    assert_same_datasets(one, other)


def assert_same_datasets(one: Path, other: Path) -> None:
    with xarray.open_dataset(one / "statistics.nc") as a, xarray.open_dataset(other / "statistics.nc") as b:
        assert a.attrs == b.attrs and a.variables.keys() == b.variables.keys()
        for name in a.variables:
            assert a[name].attrs == b[name].attrs and a[name].dtype == b[name].dtype
            assert a[name].values.tobytes() == b[name].values.tobytes() or a[name].dtype == object, name


# To the bit


@pytest.mark.parametrize("stop", [5, 8], ids=["between_frames", "at_a_frame"])
@pytest.mark.parametrize("method", METHODS)
def test_a_resumed_run_is_bit_identical(tmp_path, monkeypatch, method, stop):
    path = written(tmp_path, method)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stopped_after(path, tmp_path / "parts", stop, monkeypatch)
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0]
    assert (resumed.status, whole.status) == ("finished", "finished")
    assert resumed.run["resumed_after_steps"] == [stop]
    assert_same_results(whole.folder, folder)


@pytest.mark.parametrize("method", ["last", "crossing"])
def test_the_motions_of_the_inversion_treatments_do_invert(tmp_path, method):
    result = solve(written(tmp_path, method), tmp_path / "whole")
    with xarray.open_dataset(result.variants[0].folder / "statistics.nc") as dataset:
        assert dataset["inverted_count"].values[1:].max() > 0


def test_a_planar_run_with_moving_supports_stopped_twice_is_bit_identical(tmp_path, monkeypatch):
    motion = [{"plane": "y", "at": 3.0, "motion": {"velocity": [1.0, 0.0]}}]
    path = written(tmp_path, "bdf2", supports=motion, **PLANAR)
    whole = solve(path, tmp_path / "whole").variants[0]
    stopped_after(path, tmp_path / "parts", 1, monkeypatch)
    folder = stopped_after(path, tmp_path / "parts", 7, monkeypatch, resume=True)
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0]
    assert resumed.run["resumed_after_steps"] == [1, 7]
    assert_same_results(whole.folder, folder)


def test_a_bug_that_forgets_the_memory_would_be_seen(tmp_path, monkeypatch):
    path = written(tmp_path, "bdf2")
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stopped_after(path, tmp_path / "parts", 5, monkeypatch)
    genuine = BDF2.step

    def forgetful(self, state):
        return genuine(self, replace(state, memory=Memory({"x_before": state.x, "v_before": state.v})))

    monkeypatch.setattr(BDF2, "step", forgetful)
    solve(path, tmp_path / "parts", resume=True)
    with pytest.raises(AssertionError):
        assert_same_results(whole.folder, folder)


def test_run_json_after_a_resume_tells_of_the_whole_run(tmp_path, monkeypatch):
    path = written(tmp_path)
    whole = solve(path, tmp_path / "whole").variants[0].run
    stopped_after(path, tmp_path / "parts", 5, monkeypatch)
    run = solve(path, tmp_path / "parts", resume=True).variants[0].run
    for key in ("frames", "last_frame", "worst", "work", "case", "status"):
        assert run[key] == whole[key], key
    assert run["seconds"]["solving"] > 0 and run["seconds_per_step"] > 0


# What an interruption leaves


def test_an_interrupted_run_has_complete_files_and_says_so(tmp_path, monkeypatch):
    folder = stopped_after(written(tmp_path), tmp_path / "out", 5, monkeypatch)
    run = json.loads((folder / "run.json").read_text())
    assert run["status"] == "interrupted" and run["frames"] == 3 and "--resume" in run["message"]
    assert len(list((folder / "frames").iterdir())) == 3
    assert (folder / "series.pvd").read_text().count("<DataSet") == 3
    with xarray.open_dataset(folder / "statistics.nc") as dataset:
        assert dataset.sizes["time"] == 3 and np.isfinite(dataset["volume_ratio"].values).all()
    assert [p.name for p in (folder / "checkpoints").iterdir()] == ["step_000000005.checkpoint"]


def test_an_interrupted_run_is_not_overwritten_and_not_compared(tmp_path, monkeypatch):
    path = written(tmp_path, variants={"only": {}, "other": {}})
    stopped_after(path, tmp_path / "out", 5, monkeypatch, variants=["only"])
    with pytest.raises(CaseError, match=r"unfinished run of this case; --resume .*--force") as caught:
        solve(path, tmp_path / "out")
    assert "\n" not in str(caught.value)
    solve(path, tmp_path / "out", variants=["other"])
    with xarray.open_dataset(tmp_path / "out" / "beam" / "comparison.nc") as joined:
        assert joined["variant"].values.tolist() == ["other"]
    forced = solve(path, tmp_path / "out", force=True)
    assert "resumed_after_steps" not in forced.variants[0].run


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_ends_the_command_with_one_line_and_130(tmp_path, name):
    path = written(tmp_path, schedule={"dt": 0.002, "frames": 100000})
    command = [sys.executable, "-m", "pipeline.cli", "run", str(path), "--no-movie", "--quiet"]
    child = subprocess.Popen(
        [*command, "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).resolve().parents[2],
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # else a background job ignores it
    )
    frames = tmp_path / "out" / "beam" / "only" / "frames"
    while child.poll() is None and not (frames / "frame_000003.vtu").exists():
        os.sched_yield()
    child.send_signal(getattr(signal, name))
    _, err = child.communicate(timeout=120)
    assert child.returncode == 130 and err.count("\n") == 1
    assert err.startswith("interrupted after step ") and "--resume" in err
    assert json.loads((frames.parent / "run.json").read_text())["status"] == "interrupted"
    assert not (tmp_path / "out" / "beam" / LOCK).exists()


def test_a_second_signal_does_not_wait_for_the_step(tmp_path, monkeypatch):
    def impatient(self, state, work, writer):
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(variant_run.VariantRun, "_after_step", impatient)
    with pytest.raises(KeyboardInterrupt) as caught:
        solve(written(tmp_path), tmp_path / "out")
    assert not isinstance(caught.value, Interrupted)


def test_the_handlers_of_before_are_put_back(tmp_path):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    solve(written(tmp_path), tmp_path / "out")
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


# What resumes, and what does not


def test_resume_in_an_empty_folder_just_runs_and_over_a_finished_run_does_nothing(tmp_path):
    path = written(tmp_path)
    first = solve(path, tmp_path / "out", resume=True)
    assert first.variants[0].status == "finished" and not first.notes
    assert solve(path, tmp_path / "out", resume=True).variants[0].status == "up to date"
    assert not (first.variants[0].folder / "checkpoints").exists()


def test_another_case_or_version_or_mesh_refuses_to_resume_and_shows_the_difference(tmp_path, monkeypatch):
    path = written(tmp_path)
    folder = stopped_after(path, tmp_path / "out", 5, monkeypatch)
    with pytest.raises(CaseError, match=r"schedule.frames: 5 there, 6 here"):
        schedule = case_document()["schedule"] | {"steps_per_frame": 2, "frames": 6}
        solve(written(tmp_path / "other", schedule=schedule), tmp_path / "out", resume=True)
    with monkeypatch.context() as patch, pytest.raises(CaseError, match=r"pipeline: .* there, 99.0 here"):
        patch.setattr(campaign, "VERSION", "99.0")
        solve(path, tmp_path / "out", resume=True)
    with monkeypatch.context() as patch, pytest.raises(CaseError, match=r"mesh: .* there, changed here"):
        patch.setattr(campaign, "digest_mesh", lambda mesh: "changed")
        solve(path, tmp_path / "out", resume=True)
    assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"
    assert solve(path, tmp_path / "out", resume=True).variants[0].status == "finished"


def test_other_packages_resume_with_a_note(tmp_path, monkeypatch):
    path = written(tmp_path)
    run = stopped_after(path, tmp_path / "out", 5, monkeypatch) / "run.json"
    run.write_text(run.read_text().replace('"numpy": "', '"numpy": "0.'))
    assert [n for n in solve(path, tmp_path / "out", resume=True).notes if "versions.numpy: 0." in n]


def test_the_seconds_between_checkpoints_are_not_part_of_the_case(tmp_path):
    solve(written(tmp_path), tmp_path / "out")
    again = solve(written(tmp_path, seconds=3.0), tmp_path / "out")
    assert again.variants[0].status == "up to date"


@pytest.mark.parametrize("damaged", [1, 2])
def test_a_damaged_checkpoint_falls_back_to_the_one_before_and_then_to_the_start(tmp_path, monkeypatch, damaged):
    path = written(tmp_path, seconds=1e-9)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stopped_after(path, tmp_path / "out", 7, monkeypatch)
    kept = sorted((folder / "checkpoints").iterdir(), reverse=True)
    assert [p.name for p in kept] == ["step_000000007.checkpoint", "step_000000006.checkpoint"]
    kept[0].write_bytes(kept[0].read_bytes()[:-1000])
    if damaged == 2:
        data = bytearray(kept[1].read_bytes())
        data[len(data) // 2] ^= 1
        kept[1].write_bytes(data)
    resumed = solve(path, tmp_path / "out", resume=True)
    assert len([note for note in resumed.notes if "damaged (its checksum is wrong)" in note]) == damaged
    assert any("solved from the start" in note for note in resumed.notes) == (damaged == 2)
    assert resumed.variants[0].run.get("resumed_after_steps", []) == ([6] if damaged == 1 else [])
    assert_same_results(whole.folder, folder)


@pytest.mark.parametrize("harm", ["missing", "cut"])
def test_frames_that_are_gone_are_solved_again_from_the_start(tmp_path, monkeypatch, harm, vtk_errors):
    path = written(tmp_path)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stopped_after(path, tmp_path / "out", 7, monkeypatch)
    frame = folder / "frames" / "frame_000001.vtu"
    frame.unlink() if harm == "missing" else frame.write_bytes(frame.read_bytes()[:500])
    resumed = solve(path, tmp_path / "out", resume=True)
    vtk_errors.clear()
    assert any("solved from the start" in note for note in resumed.notes)
    assert_same_results(whole.folder, folder)


# The checkpoint file


def test_a_checkpoint_comes_back_to_the_bit():
    generator = np.random.default_rng(0)
    x, v, R = (generator.standard_normal(shape) for shape in ((4, 3), (4, 3), (2, 3, 3)))
    work = Work(steps=3, iterations=7, seconds=0.1)
    effort = Effort(work, (ModelChoice(0, 1, 0.1), ModelChoice(2, 9, np.inf)))
    summary = RunSummary(4, 9, 0.1 + 0.2, work, 1 / 3, 2 / 3, 4 / 3, -0.1, 5, 0.7)
    memory = Memory({"x_before": x}, {"rotation_before": R.transpose(0, 2, 1)}, EnergyRecord(0.1 + 0.2, 5e-324, 2))
    read = decode_checkpoint(encode_checkpoint(Checkpoint(State(12, x, v, memory), effort, summary)))
    assert read.state.step == 12 and (read.effort, read.summary) == (effort, summary)
    assert read.state.x.tobytes() == x.tobytes() and read.state.v.tobytes() == v.tobytes()
    assert read.state.memory.energy == memory.energy
    for owner in ("stepper", "inversion"):
        arrays, before = getattr(read.state.memory, owner), getattr(memory, owner)
        assert arrays.keys() == before.keys()
        assert all(arrays[name].tobytes() == before[name].tobytes() for name in before)


def test_no_byte_of_a_checkpoint_can_change_unseen():
    summary = RunSummary(1, 0, 0.0, Work(), 0.0, 0.0, 0.0, 1.0, 0, 0.0)
    data = encode_checkpoint(Checkpoint(State(1, np.zeros((1, 2)), np.ones((1, 2))), Effort(Work()), summary))
    for place in range(0, len(data), 7):
        changed = bytearray(data)
        changed[place] ^= 4
        with pytest.raises(ValueError, match="checksum"):
            decode_checkpoint(bytes(changed))


def test_short_runs_write_no_checkpoint_and_long_ones_keep_two(tmp_path, monkeypatch):
    written_steps = []
    genuine = CheckpointFolder.write

    def counting(self, checkpoint):
        genuine(self, checkpoint)
        written_steps.append((checkpoint.state.step, len(list(self.folder.iterdir()))))

    monkeypatch.setattr(CheckpointFolder, "write", counting)
    solve(written(tmp_path), tmp_path / "short")
    assert written_steps == []
    solve(written(tmp_path, seconds=1e-9), tmp_path / "long")
    assert written_steps == [(step, min(step, 2)) for step in range(1, 11)]


# The lock


def test_a_second_run_into_a_folder_is_refused_on_one_line(tmp_path, capfd):
    path = written(tmp_path)
    with lock_folder(tmp_path / "out" / "beam"):
        assert main(["run", str(path), "--out", str(tmp_path / "out"), "--no-movie", "--quiet"]) == 2
        assert (tmp_path / "out" / "beam" / LOCK).exists()
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and err.startswith("CaseError: ") and "another run is writing there" in err
    assert solve(path, tmp_path / "out").variants[0].status == "finished"
    assert not (tmp_path / "out" / "beam" / LOCK).exists()


def test_the_lock_dies_with_its_holder(tmp_path):
    code = f"""
import sys, time
from pathlib import Path
from pipeline.results.lock import lock_folder
with lock_folder(Path({str(tmp_path)!r})):
    print("held", flush=True)
    time.sleep(60)
"""
    root = Path(__file__).resolve().parents[2]
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=root)
    assert child.stdout is not None and child.stdout.readline() == "held\n"
    with pytest.raises(CaseError, match="another run"), lock_folder(tmp_path):
        pass
    child.kill()
    child.wait()
    child.stdout.close()
    assert (tmp_path / LOCK).exists()
    with lock_folder(tmp_path):
        pass
    assert not (tmp_path / LOCK).exists()


def test_a_lock_file_that_was_removed_while_it_was_waited_for_is_made_again(tmp_path, monkeypatch):
    """The one who let go has removed the file that we had opened already."""
    genuine, opened = lock._open_lock_file, []

    def removed_at_first(path):
        descriptor = genuine(path)
        if not opened:
            path.unlink()
        opened.append(descriptor)
        return descriptor

    monkeypatch.setattr(lock, "_open_lock_file", removed_at_first)
    with lock_folder(tmp_path):
        assert len(opened) == 2 and (tmp_path / LOCK).exists()


@pytest.mark.parametrize("whole_case", [False, True])
def test_output_removed_while_it_is_written_is_an_error_or_made_again_never_a_traceback(
    tmp_path, monkeypatch, whole_case
):
    genuine = variant_run.VariantRun._on_frame

    def removing(self, frame, summary):
        genuine(self, frame, summary)
        if frame.index == 2:
            # the writer may put a file into a folder that is being emptied
            folder = self.folder.parent if whole_case else self.folder
            while folder.exists():
                shutil.rmtree(folder, ignore_errors=True)

    path = written(tmp_path)
    whole = solve(path, tmp_path / "whole").variants[0]
    with monkeypatch.context() as patch:
        patch.setattr(variant_run.VariantRun, "_on_frame", removing)
        code = main(["run", str(path), "--out", str(tmp_path / "out"), "--no-movie", "--quiet"])
    assert code in (2, 4)
    assert solve(path, tmp_path / "out", force=True).variants[0].status == "finished"
    assert_same_results(whole.folder, tmp_path / "out" / "beam" / "only")


# Frames that the index does not list yet


def without_last_rows(folder: Path, kept: int) -> None:
    """The index as a kill leaves it: up to a second behind."""
    index = folder / "series.pvd"
    lines = index.read_text().splitlines()
    index.write_text("\n".join([line for i, line in enumerate(lines) if "<DataSet" not in line or i < 3 + kept]))


def test_complete_frames_that_the_index_does_not_list_yet_are_read(tmp_path, monkeypatch):
    folder = stopped_after(written(tmp_path), tmp_path / "out", 8, monkeypatch)
    whole = read_series(folder)
    assert len(whole) == 4 and whole.times == pytest.approx([0.0, 0.04, 0.08, 0.12], rel=1e-15)
    without_last_rows(folder, 2)
    assert (folder / "series.pvd").read_text().count("<DataSet") == 2
    again = read_series(folder)
    assert again.times == whole.times and again.files == whole.files and again.notes == whole.notes
    xarray.testing.assert_identical(measure_series(again), measure_series(whole))
    (folder / "frames/frame_000002.vtu").unlink()  # behind a gap nothing is taken
    assert len(read_series(folder)) == 2
    (folder / "run.json").unlink()  # of others only what their index says
    assert not read_series(folder).ours


def test_a_movie_of_a_killed_run_shows_all_its_frames(tmp_path, monkeypatch):
    folder = stopped_after(written(tmp_path), tmp_path / "out", 8, monkeypatch)
    without_last_rows(folder, 1)
    run = json.loads((folder / "run.json").read_text())
    gone = ("frames", "last_frame", "worst", "work", "seconds", "seconds_per_step", "real_time_factor", "message")
    killed = {key: value for key, value in run.items() if key not in gone} | {"status": "running"}
    (folder / "run.json").write_text(json.dumps(killed))
    shown = []
    monkeypatch.setattr("pipeline.views.movie.movie.write_movie", lambda series, *_, **__: shown.extend(series))
    assert main(["movie", str(folder.parent), "--quiet"]) == 0
    assert [len(series) for series in shown] == [4]


def test_checkpoints_every_so_many_frames(tmp_path, monkeypatch):
    steps = []
    genuine = CheckpointFolder.write

    def counting(self, checkpoint):
        genuine(self, checkpoint)
        steps.append(checkpoint.state.step)

    monkeypatch.setattr(CheckpointFolder, "write", counting)
    output = {"checkpoint_frames": 2, "checkpoint_seconds": 1e9}
    solve(written(tmp_path, output=output), tmp_path / "out")
    assert steps == [4, 8]
    assert solve(written(tmp_path, output={}), tmp_path / "out").variants[0].status == "up to date"
