"""The process that writes: it starts in any surroundings, and ends even if its parent does not wait for it."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from pipeline.errors import OutputError
from pipeline.run.recording import drive
from pipeline.sinks.writer_process import WriterProcess
from tests.sinks.test_writer_process import PATIENCE, ROOT, Notes, Slow, some_frames


class Erring(Notes):
    def second(self):
        os.write(1, b"a remark")
        os.write(2, b"a warning")


class Senseless(Notes):
    def second(self):
        for number in map(int, os.listdir("/proc/self/fd")):
            with suppress(OSError):
                os.write(number, b"none of ours") if number > 2 else None
        time.sleep(PATIENCE)


class Importing(Notes):
    def second(self):
        import of_the_sink

        assert of_the_sink.LINES == 3


@pytest.mark.parametrize("way", ["SIGINT", "SIGTERM"])
def test_signals_do_not_stop_a_starting_process(tmp_path, way):
    """A terminal's Ctrl-C can reach it in its first second, before it runs a line of this package."""
    with WriterProcess() as process:
        recording = process.start_recording([sink := Notes(tmp_path / "notes")])
        os.kill(process._child.process.pid, getattr(signal, way))
        drive(some_frames(3), recording)
    assert sink.lines() == ["0", "1", "2", "closed"]
    assert not {signal.SIGINT, signal.SIGTERM} & signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_the_process_imports_this_package(tmp_path, monkeypatch):
    """A working folder may contain another pipeline.py; sys.path may contain colons and entries that are no text."""
    for name in ("pipeline.py", "signal.py"):
        (tmp_path / name).write_text("raise SystemExit(7)")
    (tmp_path / "a:b").mkdir()
    (tmp_path / "a:b" / "of_the_sink.py").write_text("LINES = 3")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(ROOT), Path("/nowhere"), str(tmp_path / "a:b"), *sys.path[1:]])
    with WriterProcess() as process:
        drive(some_frames(3), process.start_recording([sink := Importing(tmp_path / "notes")]))
    assert sink.lines() == ["0", "1", "2", "closed"]


@pytest.mark.parametrize("words", ["from site\\n", "X" + "y" * 40])
def test_prints_before_the_begin_are_no_answers(tmp_path, monkeypatch, words):
    (tmp_path / "sitecustomize.py").write_text(f"import os; os.write(1, b'{words}')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    with WriterProcess() as process:
        drive(some_frames(3), process.start_recording([sink := Notes(tmp_path / "notes")]))
    assert sink.lines() == ["0", "1", "2", "closed"]


def test_senseless_answers_end_the_process(tmp_path):
    with WriterProcess() as process:
        with pytest.raises(OutputError, match="that writes frames make no sense"):
            drive(some_frames(1000), process.start_recording([Senseless(tmp_path / "notes")]))
        drive(some_frames(3), process.start_recording([sink := Notes(tmp_path / "again")]))
    assert sink.lines() == ["0", "1", "2", "closed"]


def test_nothing_is_written_after_an_interrupted_close(tmp_path, monkeypatch):
    """The folder's lock is released next: a process that continued would write beside another run."""
    process = WriterProcess()
    recording = process.start_recording([Slow(tmp_path / "notes")])
    for frame in some_frames(5):
        recording.take(frame)
    child, genuine = process._child.process, subprocess.Popen.wait

    def impatient(self, timeout=None):
        if timeout is not None:
            raise KeyboardInterrupt
        return genuine(self)

    monkeypatch.setattr(subprocess.Popen, "wait", impatient)
    with pytest.raises(KeyboardInterrupt):
        process.close()
    assert child.returncode == -signal.SIGKILL


@pytest.mark.parametrize("closed", ["0", "1", "2", "0, 1", "1, 2", "0, 1, 2"])
def test_closed_standard_streams_are_neither_the_lock_nor_the_answers(tmp_path, closed):
    code = f"""
import os, pathlib
for number in [{closed}]:
    os.close(number)
from pipeline.results.lock import lock_folder
from pipeline.sinks.writer_process import WriterProcess
from tests.sinks.test_writer_process import some_frames
from tests.sinks.test_writer_start import Erring
folder = pathlib.Path({str(tmp_path)!r})
with lock_folder(folder) as lock, WriterProcess(keep=lock) as process:
    recording = process.start_recording([Erring(folder / "notes")])
    for frame in some_frames(3):
        recording.take(frame)
    recording.close()
    held = [os.path.realpath(one) for one in pathlib.Path(f"/proc/{{process._child.process.pid}}/fd").glob("*")]
    (folder / "held").write_text(str(held.count(str(folder / ".lock"))))
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, stderr=subprocess.DEVNULL, timeout=PATIENCE)
    assert Erring(tmp_path / "notes").lines() == ["0", "1", "2", "closed"]
    if sys.platform == "linux":
        assert (tmp_path / "held").read_text() == "1"


def test_python_warns_of_nothing(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("PYTHONWARNINGS", "always::ResourceWarning")
    with WriterProcess() as process:
        drive(some_frames(3), process.start_recording([Notes(tmp_path / "notes")]))
    assert capfd.readouterr() == ("", "")
