"""Faults from outside: kills, full disks, failing writers. No complete file is lost, and the run can be resumed."""

import errno
import json
import multiprocessing
import os
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest
import pyvista
import xarray

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.errors import OutputError
from pipeline.formats import atomic
from pipeline.results.case_run import CaseResult, run_case
from pipeline.series import read_series
from pipeline.sinks.netcdf import NetcdfSink
from pipeline.sinks.vtu import VtuSink
from tests.bodies import skip_figures, write_case
from tests.results.test_resume import assert_same_results

ROOT = Path(__file__).resolve().parents[2]
KILLS = int(os.environ.get("PIPELINE_KILLS", "20"))


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch):
    skip_figures(monkeypatch)


def write_one_variant(folder: Path, *, frames: int = 12, seconds: float = 1e-9) -> Path:
    """Write a case of one variant with a checkpoint every step."""
    schedule = {"dt": 0.002, "frames": frames}
    variants = {"only": {"method.stepper": "bdf2"}}
    return write_case(folder, schedule=schedule, output={"checkpoint_seconds": seconds}, variants=variants)


def solve(path: Path, out: Path, **keywords) -> CaseResult:
    return run_case(load_case(path), out, movie=False, **keywords)


def make_command(path: Path, out: Path, *more: str) -> list[str]:
    run = ["run", str(path), "--out", str(out), "--no-movie", "--quiet", *more]
    return [sys.executable, "-m", "pipeline.cli", *run]


def start_warm_child(arguments: list[str]) -> BaseProcess:
    """Start the command in a process that has its imports already."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["pipeline.results.case_run", "pipeline.cli", "pipeline.fem.kernels.tetrahedron", "pyvista", "netCDF4"]
    )
    child = context.Process(target=main, args=(arguments,))
    child.start()
    return child


def assert_readable(folder: Path) -> int:
    """Check that VTK reads every frame and that the index lists existing frames; return the number of frames."""
    files = sorted((folder / "frames").glob("frame_*.vtu"))
    assert [file.name for file in files] == [f"frame_{i:06d}.vtu" for i in range(len(files))]
    for file in files:
        grid = pyvista.read(file)
        assert grid.n_cells == 18 and "volume_ratio" in grid.cell_data
    if (folder / "series.pvd").exists():
        listed = re.findall(r'file="(.*?)"', (folder / "series.pvd").read_text())
        assert listed == [f"frames/{file.name}" for file in files[: len(listed)]]
        assert len(read_series(folder)) >= len(listed)
    return len(files)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(max(1, KILLS // 20)))
def test_kill_9_at_random_moments_loses_at_most_one_frame_and_the_run_can_be_resumed(tmp_path, number):
    """Each child continues from where the previous one was killed; the last one may finish."""
    kills = min(KILLS, 20)
    path, out = write_one_variant(tmp_path, frames=30 * kills), tmp_path / "parts"
    folder = out / "beam" / "only"
    before, moments = 0, random.Random(number)
    for _ in range(kills):
        child = start_warm_child(make_command(path, out, "--resume")[3:])
        deadline = time.monotonic() + 300
        while not (folder / f"frames/frame_{before + 1:06d}.vtu").exists() and child.is_alive():
            assert time.monotonic() < deadline
            time.sleep(0.001)
        time.sleep(moments.random() * 0.06)
        child.kill()
        child.join()
        assert child.exitcode == -signal.SIGKILL
        run = json.loads((folder / "run.json").read_text())
        assert run["status"] == "running"
        if before:  # a checkpoint every step: at most the step of the last frame is solved again
            assert run["resumed_after_steps"][-1] >= before - 1
        before = assert_readable(folder)
    resumed = solve(path, out, resume=True).variants[0]
    assert resumed.run["resumed_after_steps"][-1] >= before - 1 and len(resumed.run["resumed_after_steps"]) == kills
    assert_same_results(solve(path, tmp_path / "whole").variants[0].folder, folder)


@pytest.mark.parametrize("limit", [4_000, 60_000, 120_000], ids=["frame", "dataset", "later"])
def test_a_full_disk_is_an_error_of_one_line_and_the_run_can_be_resumed(tmp_path, limit):
    """The size of files is limited, which stops frames at once, or statistics.nc after a while."""
    path, out = write_one_variant(tmp_path, frames=60), tmp_path / "parts"
    folder = out / "beam" / "only"
    full = subprocess.run(
        make_command(path, out),
        cwd=ROOT,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert full.returncode == 4 and full.stdout == ""
    assert full.stderr.count("\n") == 1 and full.stderr.startswith("OutputError: ") and "cannot be" in full.stderr
    count = assert_readable(folder)
    assert count == 0 if limit == 4_000 else 0 < count < 61
    assert main(["run", str(path), "--out", str(out), "--no-movie", "--quiet", "--resume"]) == 0
    assert_same_results(solve(path, tmp_path / "whole").variants[0].folder, folder)


@pytest.mark.parametrize("suffix", [".vtu", ".pvd", ".checkpoint", ".json"])
def test_no_space_for_one_kind_of_file_corrupts_nothing(tmp_path, monkeypatch, suffix):
    path, out = write_one_variant(tmp_path), tmp_path / "parts"
    genuine, calls = os.replace, []

    def fail(source, target):
        calls.extend([1] if str(target).endswith(suffix) else [])
        if str(target).endswith(suffix) and len(calls) > 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        genuine(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(atomic.os, "replace", fail)
        with pytest.raises(OutputError, match=r"cannot be written \(No space left on device\)"):
            solve(path, out)
    folder = out / "beam" / "only"
    assert assert_readable(folder) > 0
    assert list(folder.rglob(".*")) == [] and list((out / "beam").glob(".lock")) == []
    assert solve(path, out, resume=True).variants[0].status == "finished"
    assert_same_results(solve(path, tmp_path / "whole").variants[0].folder, folder)


@pytest.mark.parametrize("sink", [VtuSink, NetcdfSink])
@pytest.mark.parametrize("at", [0, 5])
def test_a_run_whose_writer_failed_can_be_resumed(tmp_path, monkeypatch, sink, at):
    path, out = write_one_variant(tmp_path), tmp_path / "parts"
    genuine = sink.write

    def fail(self, frame, measured):
        if frame.index == at:
            raise OutputError(f"{frame.index}: the writer broke")
        genuine(self, frame, measured)

    with monkeypatch.context() as patch:
        patch.setattr(sink, "write", fail)
        with pytest.raises(OutputError, match="the writer broke"):
            solve(path, out)
    folder = out / "beam" / "only"
    run = json.loads((folder / "run.json").read_text())
    assert run["status"] == "interrupted" and "the writer broke" in run["message"]
    assert solve(path, out, resume=True).variants[0].status == "finished"
    assert_same_results(solve(path, tmp_path / "whole").variants[0].folder, folder)


@pytest.mark.parametrize("harm", ["missing", "half", "empty", "junk"])
def test_a_damaged_dataset_is_rebuilt_from_the_frames(tmp_path, monkeypatch, harm):
    path, out = write_one_variant(tmp_path), tmp_path / "parts"

    def interrupt(name, problem, frame, summary):
        if frame.index == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(path, out, on_frame=interrupt)
    dataset = out / "beam" / "only" / "statistics.nc"
    data = dataset.read_bytes()
    dataset.unlink()
    if harm != "missing":
        dataset.write_bytes({"half": data[: len(data) // 2], "empty": b"", "junk": b"junk" * 999}[harm])
    resumed = solve(path, out, resume=True).variants[0]
    assert resumed.run["resumed_after_steps"] == [7]
    assert_same_results(solve(path, tmp_path / "whole").variants[0].folder, resumed.folder)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_folder_without_permission_is_an_error_of_one_line():
    """As nobody, in a folder of root; a run as root comes first, since nobody may be unable to import modules."""
    code = (
        "import os, sys\nfrom pipeline.cli import main\n"
        "assert main([*sys.argv[1:], '--out', sys.argv[2] + '.warm']) == 0\n"
        "os.setuid(65534)\nsys.exit(main(sys.argv[1:]))"
    )
    with tempfile.TemporaryDirectory() as name:  # other users cannot enter the folders above tmp_path
        folder = Path(name)
        folder.chmod(0o755)
        arguments = make_command(write_one_variant(folder, frames=2), folder / "out")[3:]
        refused = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True)
        assert sorted(path.name for path in folder.iterdir()) == ["beam.toml", "beam.toml.warm"]
    assert refused.returncode == 4 and refused.stderr.count("\n") == 1, refused.stderr
    assert refused.stderr.startswith("OutputError: ") and "Permission denied" in refused.stderr


def test_the_dataset_of_an_interrupted_run_can_be_read_while_it_is_unfinished(tmp_path):
    def interrupt(name, problem, frame, summary):
        if frame.index == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve(write_one_variant(tmp_path), tmp_path / "out", on_frame=interrupt)
    with xarray.open_dataset(tmp_path / "out" / "beam" / "only" / "statistics.nc") as dataset:
        assert dataset.sizes["time"] == 4


def test_force_respects_the_lock_of_another_run(tmp_path, capfd):
    path, out = write_one_variant(tmp_path), tmp_path / "out"
    solve(path, out)
    before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
    code = "import sys\nfrom pathlib import Path\nfrom pipeline.results.lock import lock_folder\n" + (
        "with lock_folder(Path(sys.argv[1])):\n    print('held', flush=True)\n    sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(out / "beam")], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert holder.stdout.readline() == b"held\n"
        for option in ("--force", "--resume"):
            assert main(["run", str(path), "--out", str(out), "--quiet", option]) == 2
            assert "another run is writing to it" in capfd.readouterr().err
        assert {file: file.read_bytes() for file in before} == before
    finally:
        holder.communicate()
    assert main(["run", str(path), "--out", str(out), "--quiet", "--no-movie", "--force"]) == 0


@pytest.mark.opengl
@pytest.mark.parametrize("script", ["exit 3", "head -c 3000000 >/dev/null; exit 1", "sleep 0.2; kill -9 $$"])
def test_a_failing_encoder_costs_only_the_movie(tmp_path, monkeypatch, capfd, script):
    broken = tmp_path / "ffmpeg"
    broken.write_text(f"#!/bin/sh\necho 'no such codec' >&2\n{script}\n")
    broken.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(broken))
    path, out = write_one_variant(tmp_path), tmp_path / "out"
    assert main(["run", str(path), "--out", str(out)]) == 0
    shown = capfd.readouterr()
    assert re.search(r"note: .*comparison\.mp4: the encoder failed \(exit code .*\): no such codec", shown.err)
    assert "Traceback" not in shown.err
    assert not (out / "beam" / "comparison.mp4").exists() and list(out.rglob(".*.tmp*")) == []
    assert (out / "beam" / "comparison.nc").exists() and assert_readable(out / "beam" / "only") == 13
    monkeypatch.delenv("IMAGEIO_FFMPEG_EXE")
    assert main(["movie", str(out / "beam"), "--quiet"]) == 0 and (out / "beam" / "comparison.mp4").exists()


def test_reproduce_passes_resume_and_force_on(tmp_path, monkeypatch, capfd):
    calls = []

    def stop(case, out, **keywords):
        calls.append((case.name, keywords["resume"], keywords["force"]))
        raise OutputError("stop here")

    monkeypatch.setattr("pipeline.studies.thesis.run_case", stop)
    for options in ([], ["--resume"], ["--force"]):
        assert main(["reproduce", "--cases", str(ROOT / "cases"), "--out", str(tmp_path), *options]) == 4
    assert [call[1:] for call in calls] == [(False, False), (True, False), (False, True)]


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.7, 0.99])
def test_a_half_written_dataset_is_an_error_of_one_line(tmp_path, capfd, share):
    path, out = write_one_variant(tmp_path, frames=6), tmp_path / "out"
    folder = solve(path, out).variants[0].folder
    data = (folder / "statistics.nc").read_bytes()
    (folder / "statistics.nc").write_bytes(data[: int(share * len(data))])
    (out / "beam" / "comparison.nc").unlink()
    assert main(["run", str(path), "--out", str(out), "--no-movie", "--quiet"]) == 2
    err = capfd.readouterr().err
    assert err.count("\n") == 1 and "statistics.nc: cannot be read" in err
    assert main(["run", str(path), "--out", str(out), "--no-movie", "--quiet", "--force"]) == 0
    assert (folder / "statistics.nc").read_bytes() == data


THREADS = """
import shutil, sys
from pathlib import Path
from threading import Thread
from pipeline import load_case
from pipeline.results import variant_run
from pipeline.results.analysis_folder import compare
from pipeline.results.case_run import run_case
from pipeline.series import read_series

case, out, done = load_case(sys.argv[1]), Path(sys.argv[2]), []
{work}
threads = [Thread(target=work, args=(name,)) for name in "abc"]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(done)
"""


def run_on_three_threads(work: str, case: Path, out: Path) -> subprocess.CompletedProcess[str]:
    """Run `work(name)` on three threads of a new process, which netCDF kills if two threads enter it."""
    arguments = [sys.executable, "-c", THREADS.format(work=work), str(case), str(out)]
    return subprocess.run(arguments, capture_output=True, text=True, cwd=ROOT, timeout=300)


SOLVED = """
def work(name):
    for k in range(3):
        done.append(run_case(case, out / f"{name}-{k}", movie=False).exit_code)
"""


@pytest.mark.slow
def test_threads_of_one_process_may_each_run_a_case(tmp_path):
    ran = run_on_three_threads(SOLVED, write_one_variant(tmp_path, frames=40, seconds=30), tmp_path)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, f"{[0] * 9}\n", "")
    folders = list(tmp_path.glob("[abc]-*/*/only"))
    assert len(folders) == 9
    for folder in folders:
        assert assert_readable(folder) == 41
        with xarray.open_dataset(folder / "statistics.nc") as dataset:
            assert dataset.sizes["time"] == 41 and not dataset.volume_ratio.isnull().any()


INTERRUPTED = """
def interrupt(self, state, work, writer):
    genuine(self, state, work, writer)
    if state.step == 30:
        raise KeyboardInterrupt

genuine, variant_run.VariantRun._after_step = variant_run.VariantRun._after_step, interrupt
try:
    run_case(case, out / "base", movie=False)
except KeyboardInterrupt:
    variant_run.VariantRun._after_step = genuine

def work(name):
    for k in range(4):
        shutil.copytree(out / "base", out / f"{name}-{k}")
        resumed = run_case(case, out / f"{name}-{k}", movie=False, resume=True)
        twice = [read_series(resumed.variants[0].folder, name=label) for label in "ab"]
        compare(twice, out / f"{name}-{k}" / "compared", difference=True)
        done.extend(resumed.variants[0].run["resumed_after_steps"])
"""


@pytest.mark.slow
def test_threads_may_resume_and_compare(tmp_path):
    """float32: the frames are compared with statistics.nc."""
    output, schedule = {"checkpoint_seconds": 1e-9, "precision": "float32"}, {"dt": 0.002, "frames": 40}
    case = write_case(tmp_path, schedule=schedule, output=output, variants={"only": {}})
    ran = run_on_three_threads(INTERRUPTED, case, tmp_path)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, f"{[30] * 12}\n", "")


@pytest.mark.skipif(sys.platform == "win32", reason="the names of files have no locale on Windows: NOT tested there")
def test_a_folder_that_the_locale_cannot_encode_is_an_error_of_one_line(tmp_path):
    bare = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    arguments = make_command(write_one_variant(tmp_path), tmp_path / "Bär")
    ran = subprocess.run(arguments, env=os.environ | bare, capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert ran.returncode == OutputError.exit_code and len(ran.stderr.splitlines()) == 1
    assert "statistics.nc: the locale's encoding" in ran.stderr and "PYTHONUTF8=1" in ran.stderr
    encoded = subprocess.run(
        [*arguments, "--force"], env=os.environ | bare | {"PYTHONUTF8": "1"}, cwd=ROOT, timeout=300
    )
    (folder,) = tmp_path.glob("Bär/*/only")
    assert encoded.returncode == 0 and assert_readable(folder) == 13
