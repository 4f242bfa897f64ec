"""Writing beside solving: the same files and failures as between steps, whatever happens to either process."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from pipeline import build, frames, load_case
from pipeline.errors import OutputError, SolveError
from pipeline.mesh.shapes import box
from pipeline.results import lock, variant_run
from pipeline.results.checkpoint import CheckpointFolder
from pipeline.results.lock import lock_folder
from pipeline.run.frame import Frame
from pipeline.run.recording import Recording, drive
from pipeline.sinks.frame_formats import FORMATS
from pipeline.sinks.netcdf import NetcdfSink
from pipeline.sinks.writer_process import WORTH_A_PROCESS, WriterProcess
from pipeline.system.child import _PIPE_BYTES
from tests.bodies import write_case
from tests.results.test_resume import (  # noqa: F401  (fixtures)
    _default_handlers,
    _no_figures,
    assert_same_results,
    solve,
    write_one_variant,
)

ROOT = Path(__file__).resolve().parents[2]
MESH = box((1.0, 1.0, 1.0), (1, 1, 1))
PATIENCE = 90.0  # seconds after which a test fails that would wait forever
WORTH = {"shape": "box", "size": [2.0, 3.0, 1.0], "cells": [5, 7, 5]}  # 1050 cells


class Unportable(Exception):
    def __init__(self, one: str, two: str) -> None:
        super().__init__(one + two)


class Notes:
    """Writes a line of a text file for each frame; subclasses do something at frame 2. It is copied to the writer."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def write(self, frame, measured):
        if frame.index == 2:
            self.second()
        with self.path.open("a") as out:
            print(frame.index, os.getpid(), measured["volume_drift"], file=out)

    def second(self):
        pass

    def close(self):
        with self.path.open("a") as out:
            print("closed", file=out)

    def lines(self):
        return [line.split()[0] for line in self.path.read_text().splitlines()]


class Full(Notes):
    def second(self):
        raise OutputError("frame 2: no room")


class Faulty(Notes):
    def second(self):
        raise ValueError("a fault of ours")


class Odd(Notes):
    def second(self):
        raise Unportable("not to be", " copied")


class Loud(Notes):
    def second(self):
        print("a library's remark", flush=True)
        os.write(1, b"another\n")


class Slow(Notes):
    def second(self):
        while not (self.path.parent / "go").exists():
            time.sleep(0.005)


class Stuck(Notes):
    def close(self):
        raise OutputError("cannot be closed")


@pytest.fixture(scope="module")
def shared():
    with WriterProcess() as process:
        yield process


def some_frames(count: int, before=lambda index: None, mesh=MESH):
    for index in range(count):
        before(index)
        yield Frame(index, 0.1 * index, mesh, mesh.points * (1 + 0.01 * index), step=index)


def test_frames_are_written_in_order_by_another_process(tmp_path, shared):
    sink, told = Notes(tmp_path / "notes"), []
    recording = shared.start_recording(
        [sink], on_frame=lambda frame, summary: told.append((frame.index, summary.frames))
    )
    drive(some_frames(30), recording)
    assert sink.lines() == [*map(str, range(30)), "closed"]
    assert told == [(i, i + 1) for i in range(30)]
    assert {line.split()[1] for line in sink.path.read_text().splitlines()[:-1]} != {str(os.getpid())}
    here = Recording([])
    drive(some_frames(30), here)
    untimed = {"writing_seconds": 0.0, "wall_seconds": 0.0}
    assert replace(recording.summary, **untimed) == replace(here.summary, **untimed)


@pytest.mark.parametrize("name", FORMATS)
def test_files_equal_those_written_between_steps(tmp_path, shared, name):
    case = load_case(write_case(tmp_path, schedule={"dt": 0.01, "frames": 8}))
    for folder, record in ((tmp_path / "a", Recording), (tmp_path / "b", shared.start_recording)):
        folder.mkdir()
        sinks = [FORMATS[name].make_sink(folder, [], "float64", 9), NetcdfSink(folder / "statistics.nc", title="same")]
        drive(frames(build(case.variant("polar"))), record(sinks))
    assert len(contents(tmp_path / "a")) == (11 if name == "vtu" else 2)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def contents(folder: Path) -> dict[str, object]:
    """Return the bytes of every file, but every array of a .vtkhdf, which contains the time of its creation."""

    def arrays(path: Path) -> dict[str, bytes]:
        with h5py.File(path) as file:
            found = {}
            file.visititems(
                lambda name, one: found.update({name: one[()].tobytes()}) if hasattr(one, "dtype") else None
            )
        assert len(found) > 20
        return found

    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {
        str(path.relative_to(folder)): arrays(path) if path.suffix == ".vtkhdf" else path.read_bytes() for path in paths
    }


def test_it_runs_ahead_by_a_bounded_number_of_frames(tmp_path, shared):
    mesh, solved = box((1.0, 1.0, 1.0), (15, 15, 15)), []  # a frame is more than a pipe holds
    sink = Slow(tmp_path / "notes")
    run = threading.Thread(target=lambda: drive(some_frames(40, solved.append, mesh), shared.start_recording([sink])))
    run.start()
    try:
        deadline = time.monotonic() + PATIENCE
        while len(solved) < 4 and time.monotonic() < deadline:
            time.sleep(0.01)
        run.join(0.5)
        # two written, one being written, some waiting in the pipe, one that has no room
        assert run.is_alive() and 4 <= len(solved) <= 5 + _PIPE_BYTES // mesh.points.nbytes
    finally:
        (tmp_path / "go").touch()
        run.join(PATIENCE)
    assert sink.lines() == [*map(str, range(40)), "closed"]


def test_drain_returns_after_all_writes_and_calls(tmp_path, shared):
    sink, told = Notes(tmp_path / "notes"), []
    recording = shared.start_recording([sink], on_frame=lambda frame, summary: told.append(frame.index))
    for count, frame in enumerate(some_frames(5), 1):
        recording.take(frame)
        recording.drain()
        assert len(sink.lines()) == count == len(told) == recording.summary.frames
    recording.close()


@pytest.mark.parametrize(
    "kind, error, message",
    [
        (Full, OutputError, "frame 2: no room"),
        (Faulty, ValueError, "ours"),
        (Odd, OutputError, "Unportable: not to be copied"),
    ],
)
def test_a_writer_that_fails_stops_the_run_with_its_own_message(tmp_path, shared, kind, error, message):
    sink, other = kind(tmp_path / "notes"), Notes(tmp_path / "other")
    recording, after = shared.start_recording([other, sink]), []

    def solve(index):
        if index == 3:  # the failure, at frame 2, is heard of before the next is handed over
            deadline = time.monotonic() + PATIENCE
            while not recording._failed and time.monotonic() < deadline:
                time.sleep(0.001)
        after.append(index)

    with pytest.raises(error, match=message) as caught:
        drive(some_frames(9, solve), recording)
    assert after == [0, 1, 2, 3] and sink.lines() == ["0", "1", "closed"] and other.lines() == ["0", "1", "2", "closed"]
    if kind is Faulty:
        assert "in second" in caught.value.__notes__[0]
    # and it is there for the next run
    drive(some_frames(3), shared.start_recording([again := Notes(tmp_path / "again")]))
    assert again.lines() == ["0", "1", "2", "closed"]


def test_a_failure_at_the_last_frame_is_raised_on_closing_and_by_drain(tmp_path, shared):
    with pytest.raises(OutputError, match="no room"):
        drive(some_frames(3), shared.start_recording([Full(tmp_path / "notes")]))
    recording = shared.start_recording([Full(tmp_path / "drained")])
    for frame in some_frames(3):
        recording.take(frame)
    with pytest.raises(OutputError, match="no room"):
        recording.drain()
    recording.close()  # told once


def test_a_sink_that_cannot_be_closed_is_reported(tmp_path, shared):
    with pytest.raises(OutputError, match="cannot be closed"):
        drive(some_frames(3), shared.start_recording([Stuck(tmp_path / "notes"), other := Notes(tmp_path / "other")]))
    assert other.lines() == ["0", "1", "2", "closed"]


def test_a_solver_that_fails_leaves_the_frames_before_it(tmp_path, shared):
    def broken(index):
        if index == 3:
            raise SolveError("diverged")

    with pytest.raises(SolveError, match="diverged"):
        drive(some_frames(9, broken), shared.start_recording([sink := Notes(tmp_path / "notes")]))
    assert sink.lines() == ["0", "1", "2", "closed"]


def test_errors_in_on_frame_are_raised(tmp_path, shared):
    def impatient(frame, summary):
        if frame.index == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive(some_frames(1000), shared.start_recording([sink := Notes(tmp_path / "notes")], on_frame=impatient))
    assert sink.lines()[-1] == "closed"


def test_prints_of_the_process_are_no_answers(tmp_path, shared):
    drive(some_frames(5), shared.start_recording([sink := Loud(tmp_path / "notes")]))
    assert sink.lines() == ["0", "1", "2", "3", "4", "closed"]


def test_closing_without_frames_does_nothing(tmp_path, shared):
    shared.start_recording([Notes(tmp_path / "notes")]).close()
    assert not (tmp_path / "notes").exists()


def test_a_killed_process_is_reported_and_the_next_run_starts_another(tmp_path):
    with WriterProcess() as process:
        recording = process.start_recording([Notes(tmp_path / "notes")])

        def kill(index):
            if index == 3:
                recording.drain()
                os.kill(process._child.process.pid, signal.SIGKILL)

        with pytest.raises(OutputError, match=r"ended unexpectedly \(exit code -9; out of memory\?\)"):
            drive(some_frames(1000, kill), recording)
        drive(some_frames(3), process.start_recording([sink := Notes(tmp_path / "again")]))
        assert sink.lines() == ["0", "1", "2", "closed"]


def test_a_process_that_cannot_be_started_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no_python"))
    with WriterProcess() as process, pytest.raises(OutputError, match=r"cannot be started \(No such file"):
        process.start_recording([])


def test_an_interruption_within_a_message_does_not_wait(tmp_path, monkeypatch):
    """A second signal raises anywhere in the solver's process."""
    with WriterProcess() as process:
        recording = process.start_recording([Slow(tmp_path / "notes")])

        def interrupted(index):
            if index == 5:
                monkeypatch.setattr(recording, "_sending", True)
                raise KeyboardInterrupt

        began = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            drive(some_frames(9, interrupted), recording)
        assert time.monotonic() - began < PATIENCE / 3


def test_the_lock_outlives_the_parent_until_the_last_write(tmp_path, monkeypatch):
    code = f"""
import os, pathlib, signal, sys, time
from pipeline.results.lock import lock_folder
from pipeline.sinks.writer_process import WriterProcess
from tests.sinks.test_writer_process import Slow, some_frames
folder = pathlib.Path({str(tmp_path)!r})
with lock_folder(folder) as lock:
    recording = WriterProcess(keep=lock).start_recording([Slow(folder / "notes")])
    for frame in some_frames(5):
        recording.take(frame)
    while recording.summary.frames < 2:  # it told of two, and waits in the third
        time.sleep(0.001)
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == -signal.SIGKILL
    with pytest.raises(Exception, match="another run is writing to it"), lock_folder(tmp_path):
        pass
    (tmp_path / "go").touch()
    deadline = time.monotonic() + PATIENCE
    while "closed" not in (lines := Slow(tmp_path / "notes").lines()) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert lines == ["0", "1", "2", "closed"]  # what waited is left out
    monkeypatch.setattr(lock, "_WAIT_SECONDS", PATIENCE)
    with lock_folder(tmp_path):  # after a moment
        pass


# In a run


def test_a_checkpoint_waits_for_the_frames_before_it(tmp_path, monkeypatch):
    genuine, seen = CheckpointFolder.write, []

    def looking(self, checkpoint):
        seen.append((checkpoint.summary.frames, len(list(self.folder.parent.glob("frames/frame_*.vtu")))))
        genuine(self, checkpoint)

    monkeypatch.setattr(CheckpointFolder, "write", looking)
    monkeypatch.setattr(variant_run, "WORTH_A_PROCESS", 0)
    solve(write_one_variant(tmp_path, seconds=1e-9), tmp_path / "out")
    assert len(seen) == 10 and all(frames == files for frames, files in seen)


def test_small_meshes_are_written_between_steps(tmp_path, monkeypatch):
    genuine, remote = WriterProcess.start_recording, []
    monkeypatch.setattr(
        WriterProcess, "start_recording", lambda self, *a, **k: remote.append(a) or genuine(self, *a, **k)
    )
    solve(write_one_variant(tmp_path), tmp_path / "small")
    assert remote == []
    path = write_one_variant(tmp_path / "large", mesh=WORTH)
    assert len(build(load_case(path).variant("only")).body.mesh.cells) >= WORTH_A_PROCESS
    run = solve(path, tmp_path / "out").variants[0].run
    assert len(remote) == 1 and run["frames"] == 6
    seconds = run["seconds"]
    assert all(value > 0 for value in seconds.values())
    assert seconds["solving"] <= seconds["wall"]


@pytest.mark.slow
@pytest.mark.parametrize("way", ["SIGKILL", "SIGINT to all", "SIGTERM to all"])
def test_a_run_that_was_ended_resumes_to_the_same_files(tmp_path, way):
    """A terminal's Ctrl-C, and a queue that ends a job, reach all its processes."""
    path = write_one_variant(tmp_path, mesh=WORTH, schedule={"dt": 0.002, "frames": 150}, seconds=1e-9)
    command = [sys.executable, "-m", "pipeline.cli", "run", str(path), "--no-movie", "--quiet", "--resume"]
    child = subprocess.Popen(
        [*command, "--out", str(tmp_path / "out")],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    folder = tmp_path / "out" / "beam" / "only"
    while child.poll() is None and not (folder / "frames" / "frame_000020.vtu").exists():
        time.sleep(0.001)
    if way == "SIGKILL":
        child.kill()
    else:
        os.killpg(child.pid, getattr(signal, way.split()[0]))
    err = child.communicate(timeout=PATIENCE)[1]
    assert (child.returncode, err) == (-9, "") if way == "SIGKILL" else err.startswith("interrupted after step ")
    assert json.loads((folder / "run.json").read_text())["status"] == ("running" if way == "SIGKILL" else "interrupted")
    resumed = solve(path, tmp_path / "out", resume=True).variants[0]
    assert resumed.run["resumed_after_steps"][0] >= 15
    assert_same_results(solve(path, tmp_path / "whole").variants[0].folder, folder)


def test_numbers_arrive_unchanged(tmp_path, shared):
    """Nothing of a frame is rounded or reordered on the way, not even the values that only the solver knows."""
    problem = build(load_case(write_case(tmp_path, schedule={"dt": 0.01, "frames": 4})).variant("polar"))
    import netCDF4

    kept = list(frames(problem))
    drive(iter(kept), shared.start_recording([NetcdfSink(tmp_path / "s.nc", title="sent")]))
    with netCDF4.Dataset(tmp_path / "s.nc") as dataset:
        for name in ("kinetic_energy", "elastic_energy", "newton_iterations"):
            assert np.array_equal(dataset[name][:], [frame.known[name] for frame in kept])
