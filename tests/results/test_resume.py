"""A resumed run gives the results of an uninterrupted one, bit for bit, with every method."""

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
from pipeline.results import case_run, lock, variant_run
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
    """Restore the defaults: a shell that runs the tests in the background ignores SIGINT."""
    defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in defaults.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def write_one_variant(folder: Path, method: str = "polar", *, seconds: float = 1e9, **sections: object) -> Path:
    """Write a case of one variant and ten steps, two per frame; for `inversion`, thrown so hard that cells invert."""
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


def stop_after(path: Path, out: Path, step: int, monkeypatch, **keywords) -> Path:
    """Run a case that gets SIGINT during a step; return the variant's folder."""
    genuine = variant_run.VariantRun._after_step

    def request_end(self, state, work, writer):
        if state.step == step:
            signal.raise_signal(signal.SIGINT)
        genuine(self, state, work, writer)

    with monkeypatch.context() as patch:
        patch.setattr(variant_run.VariantRun, "_after_step", request_end)
        with pytest.raises(Interrupted, match=rf"interrupted after step {step} of only; .*--resume"):
            solve(path, out, **keywords)
    return out / "beam" / "only"


def assert_same_results(one: Path, other: Path) -> None:
    """Compare frames and index byte by byte, and the data in statistics.nc bit by bit."""
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


# Bit for bit


@pytest.mark.parametrize("stop", [5, 8], ids=["between_frames", "at_a_frame"])
@pytest.mark.parametrize("method", METHODS)
def test_a_resumed_run_is_bit_identical(tmp_path, monkeypatch, method, stop):
    path = write_one_variant(tmp_path, method)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "parts", stop, monkeypatch)
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0]
    assert (resumed.status, whole.status) == ("finished", "finished")
    assert resumed.run["resumed_after_steps"] == [stop]
    assert_same_results(whole.folder, folder)


@pytest.mark.parametrize("method", ["last", "crossing"])
def test_the_cases_of_inversion_treatments_invert_cells(tmp_path, method):
    result = solve(write_one_variant(tmp_path, method), tmp_path / "whole")
    with xarray.open_dataset(result.variants[0].folder / "statistics.nc") as dataset:
        assert dataset["inverted_count"].values[1:].max() > 0


def test_a_planar_run_with_moving_supports_stopped_twice_is_bit_identical(tmp_path, monkeypatch):
    motion = [{"plane": "y", "at": 3.0, "motion": {"velocity": [1.0, 0.0]}}]
    path = write_one_variant(tmp_path, "bdf2", supports=motion, **PLANAR)
    whole = solve(path, tmp_path / "whole").variants[0]
    stop_after(path, tmp_path / "parts", 1, monkeypatch)
    folder = stop_after(path, tmp_path / "parts", 7, monkeypatch, resume=True)
    resumed = solve(path, tmp_path / "parts", resume=True).variants[0]
    assert resumed.run["resumed_after_steps"] == [1, 7]
    assert_same_results(whole.folder, folder)


def test_a_lost_memory_would_be_noticed(tmp_path, monkeypatch):
    path = write_one_variant(tmp_path, "bdf2")
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "parts", 5, monkeypatch)
    genuine = BDF2.step

    def step_without_memory(self, state):
        return genuine(self, replace(state, memory=Memory({"x_before": state.x, "v_before": state.v})))

    monkeypatch.setattr(BDF2, "step", step_without_memory)
    solve(path, tmp_path / "parts", resume=True)
    with pytest.raises(AssertionError):
        assert_same_results(whole.folder, folder)


def test_run_json_after_a_resume_describes_the_whole_run(tmp_path, monkeypatch):
    path = write_one_variant(tmp_path)
    whole = solve(path, tmp_path / "whole").variants[0].run
    stop_after(path, tmp_path / "parts", 5, monkeypatch)
    run = solve(path, tmp_path / "parts", resume=True).variants[0].run
    for key in ("frames", "last_frame", "worst", "work", "case", "status"):
        assert run[key] == whole[key], key
    assert run["seconds"]["solving"] > 0 and run["seconds_per_step"] > 0


# The files after an interruption


def test_an_interrupted_run_has_complete_files_and_its_status(tmp_path, monkeypatch):
    folder = stop_after(write_one_variant(tmp_path), tmp_path / "out", 5, monkeypatch)
    run = json.loads((folder / "run.json").read_text())
    assert run["status"] == "interrupted" and run["frames"] == 3 and "--resume" in run["message"]
    assert len(list((folder / "frames").iterdir())) == 3
    assert (folder / "series.pvd").read_text().count("<DataSet") == 3
    with xarray.open_dataset(folder / "statistics.nc") as dataset:
        assert dataset.sizes["time"] == 3 and np.isfinite(dataset["volume_ratio"].values).all()
    assert [p.name for p in (folder / "checkpoints").iterdir()] == ["step_000000005.checkpoint"]


def test_an_interrupted_run_is_not_overwritten_and_not_compared(tmp_path, monkeypatch):
    path = write_one_variant(tmp_path, variants={"only": {}, "other": {}})
    stop_after(path, tmp_path / "out", 5, monkeypatch, variants=["only"])
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
    path = write_one_variant(tmp_path, schedule={"dt": 0.002, "frames": 100000})
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
    def signal_twice(self, state, work, writer):
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(variant_run.VariantRun, "_after_step", signal_twice)
    with pytest.raises(KeyboardInterrupt) as caught:
        solve(write_one_variant(tmp_path), tmp_path / "out")
    assert not isinstance(caught.value, Interrupted)


def test_earlier_signal_handlers_are_restored(tmp_path):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    solve(write_one_variant(tmp_path), tmp_path / "out")
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


# Runs that can be resumed, and others


def test_resume_runs_in_an_empty_folder_and_does_nothing_after_a_finished_run(tmp_path):
    path = write_one_variant(tmp_path)
    first = solve(path, tmp_path / "out", resume=True)
    assert first.variants[0].status == "finished" and not first.notes
    assert solve(path, tmp_path / "out", resume=True).variants[0].status == "up to date"
    assert not (first.variants[0].folder / "checkpoints").exists()


def test_another_case_version_or_mesh_is_not_resumed_and_the_error_shows_the_difference(tmp_path, monkeypatch):
    path = write_one_variant(tmp_path)
    folder = stop_after(path, tmp_path / "out", 5, monkeypatch)
    with pytest.raises(CaseError, match=r"schedule.frames: 5 there, 6 here"):
        schedule = case_document()["schedule"] | {"steps_per_frame": 2, "frames": 6}
        solve(write_one_variant(tmp_path / "other", schedule=schedule), tmp_path / "out", resume=True)
    with monkeypatch.context() as patch, pytest.raises(CaseError, match=r"pipeline: .* there, 99.0 here"):
        patch.setattr(case_run, "VERSION", "99.0")
        solve(path, tmp_path / "out", resume=True)
    with monkeypatch.context() as patch, pytest.raises(CaseError, match=r"mesh: .* there, changed here"):
        patch.setattr(case_run, "digest_body", lambda body: "changed")
        solve(path, tmp_path / "out", resume=True)
    assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"
    assert solve(path, tmp_path / "out", resume=True).variants[0].status == "finished"


def test_other_packages_resume_with_a_note(tmp_path, monkeypatch):
    path = write_one_variant(tmp_path)
    run = stop_after(path, tmp_path / "out", 5, monkeypatch) / "run.json"
    run.write_text(run.read_text().replace('"numpy": "', '"numpy": "0.'))
    assert [n for n in solve(path, tmp_path / "out", resume=True).notes if "versions.numpy: 0." in n]


def test_the_seconds_between_checkpoints_are_not_part_of_the_case(tmp_path):
    solve(write_one_variant(tmp_path), tmp_path / "out")
    again = solve(write_one_variant(tmp_path, seconds=3.0), tmp_path / "out")
    assert again.variants[0].status == "up to date"


@pytest.mark.parametrize("damaged", [1, 2])
def test_a_damaged_checkpoint_falls_back_to_the_one_before_and_then_to_the_start(tmp_path, monkeypatch, damaged):
    path = write_one_variant(tmp_path, seconds=1e-9)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "out", 7, monkeypatch)
    checkpoints = sorted((folder / "checkpoints").iterdir(), reverse=True)
    assert [p.name for p in checkpoints] == ["step_000000007.checkpoint", "step_000000006.checkpoint"]
    checkpoints[0].write_bytes(checkpoints[0].read_bytes()[:-1000])
    if damaged == 2:
        data = bytearray(checkpoints[1].read_bytes())
        data[len(data) // 2] ^= 1
        checkpoints[1].write_bytes(data)
    resumed = solve(path, tmp_path / "out", resume=True)
    assert len([note for note in resumed.notes if "damaged (its checksum is wrong)" in note]) == damaged
    assert any("solved from the start" in note for note in resumed.notes) == (damaged == 2)
    assert resumed.variants[0].run.get("resumed_after_steps", []) == ([6] if damaged == 1 else [])
    assert_same_results(whole.folder, folder)


@pytest.mark.parametrize("harm", ["missing", "cut"])
def test_a_run_with_missing_frames_is_solved_again_from_the_start(tmp_path, monkeypatch, harm, vtk_errors):
    path = write_one_variant(tmp_path)
    whole = solve(path, tmp_path / "whole").variants[0]
    folder = stop_after(path, tmp_path / "out", 7, monkeypatch)
    frame = folder / "frames" / "frame_000001.vtu"
    frame.unlink() if harm == "missing" else frame.write_bytes(frame.read_bytes()[:500])
    resumed = solve(path, tmp_path / "out", resume=True)
    vtk_errors.clear()
    assert any("solved from the start" in note for note in resumed.notes)
    assert_same_results(whole.folder, folder)


# The checkpoint file


def test_a_checkpoint_is_read_back_bit_for_bit():
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


def test_every_changed_byte_of_a_checkpoint_is_noticed():
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

    def count(self, checkpoint):
        genuine(self, checkpoint)
        written_steps.append((checkpoint.state.step, len(list(self.folder.iterdir()))))

    monkeypatch.setattr(CheckpointFolder, "write", count)
    solve(write_one_variant(tmp_path), tmp_path / "short")
    assert written_steps == []
    solve(write_one_variant(tmp_path, seconds=1e-9), tmp_path / "long")
    assert written_steps == [(step, min(step, 2)) for step in range(1, 11)]


# The lock


def test_a_second_run_in_a_folder_is_an_error_of_one_line(tmp_path, capfd):
    path = write_one_variant(tmp_path)
    with lock_folder(tmp_path / "out" / "beam"):
        assert main(["run", str(path), "--out", str(tmp_path / "out"), "--no-movie", "--quiet"]) == 2
        assert (tmp_path / "out" / "beam" / LOCK).exists()
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and err.startswith("CaseError: ") and "another run is writing to it" in err
    assert solve(path, tmp_path / "out").variants[0].status == "finished"
    assert not (tmp_path / "out" / "beam" / LOCK).exists()


def test_the_lock_ends_with_its_process(tmp_path):
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


def test_a_lock_file_removed_during_the_wait_is_created_again(tmp_path, monkeypatch):
    """The previous holder removed the file after we had opened it."""
    genuine, descriptors = lock._open_lock_file, []

    def remove_at_first(path):
        descriptor = genuine(path)
        if not descriptors:
            path.unlink()
        descriptors.append(descriptor)
        return descriptor

    monkeypatch.setattr(lock, "_open_lock_file", remove_at_first)
    with lock_folder(tmp_path):
        assert len(descriptors) == 2 and (tmp_path / LOCK).exists()


@pytest.mark.parametrize("whole_case", [False, True])
def test_output_removed_during_a_run_is_an_error_or_written_again_but_no_traceback(tmp_path, monkeypatch, whole_case):
    genuine = variant_run.VariantRun._on_frame

    def remove_output(self, frame, summary):
        genuine(self, frame, summary)
        if frame.index == 2:
            # the writer may put a file into a folder that is being emptied
            folder = self.folder.parent if whole_case else self.folder
            while folder.exists():
                shutil.rmtree(folder, ignore_errors=True)

    path = write_one_variant(tmp_path)
    whole = solve(path, tmp_path / "whole").variants[0]
    with monkeypatch.context() as patch:
        patch.setattr(variant_run.VariantRun, "_on_frame", remove_output)
        code = main(["run", str(path), "--out", str(tmp_path / "out"), "--no-movie", "--quiet"])
    assert code in (2, 4)
    assert solve(path, tmp_path / "out", force=True).variants[0].status == "finished"
    assert_same_results(whole.folder, tmp_path / "out" / "beam" / "only")


# Frames that the index does not list yet


def remove_last_rows(folder: Path, count: int) -> None:
    """Cut the index as a kill may leave it: up to a second behind."""
    index = folder / "series.pvd"
    lines = index.read_text().splitlines()
    index.write_text("\n".join([line for i, line in enumerate(lines) if "<DataSet" not in line or i < 3 + count]))


def test_complete_frames_that_the_index_does_not_list_yet_are_read(tmp_path, monkeypatch):
    folder = stop_after(write_one_variant(tmp_path), tmp_path / "out", 8, monkeypatch)
    whole = read_series(folder)
    assert len(whole) == 4 and whole.times == pytest.approx([0.0, 0.04, 0.08, 0.12], rel=1e-15)
    remove_last_rows(folder, 2)
    assert (folder / "series.pvd").read_text().count("<DataSet") == 2
    again = read_series(folder)
    assert again.times == whole.times and again.files == whole.files and again.notes == whole.notes
    xarray.testing.assert_identical(measure_series(again), measure_series(whole))
    (folder / "frames/frame_000002.vtu").unlink()  # frames after a gap are not read
    assert len(read_series(folder)) == 2
    (folder / "run.json").unlink()  # foreign series: only the frames of their index
    assert not read_series(folder).ours


def test_a_movie_of_a_killed_run_shows_all_its_frames(tmp_path, monkeypatch):
    folder = stop_after(write_one_variant(tmp_path), tmp_path / "out", 8, monkeypatch)
    remove_last_rows(folder, 1)
    run = json.loads((folder / "run.json").read_text())
    absent = ("frames", "last_frame", "worst", "work", "seconds", "seconds_per_step", "real_time_factor", "message")
    killed = {key: value for key, value in run.items() if key not in absent} | {"status": "running"}
    (folder / "run.json").write_text(json.dumps(killed))
    shown = []
    monkeypatch.setattr("pipeline.views.movie.movie.write_movie", lambda series, *_, **__: shown.extend(series))
    assert main(["movie", str(folder.parent), "--quiet"]) == 0
    assert [len(series) for series in shown] == [4]


def test_checkpoint_frames_sets_the_frames_between_checkpoints(tmp_path, monkeypatch):
    steps = []
    genuine = CheckpointFolder.write

    def count(self, checkpoint):
        genuine(self, checkpoint)
        steps.append(checkpoint.state.step)

    monkeypatch.setattr(CheckpointFolder, "write", count)
    output = {"checkpoint_frames": 2, "checkpoint_seconds": 1e9}
    solve(write_one_variant(tmp_path, output=output), tmp_path / "out")
    assert steps == [4, 8]
    assert solve(write_one_variant(tmp_path, output={}), tmp_path / "out").variants[0].status == "up to date"
