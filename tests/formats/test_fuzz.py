"""Any file gives a result, or one line and the right exit code; no traceback, nothing written elsewhere.

`make fuzz` tries 10 000 (PIPELINE_FUZZ); tests/fuzzing.py makes them.
"""

import os
import resource
import shutil
import signal
from collections import Counter
from pathlib import Path

import meshio  # noqa: F401  (before the memory is limited)
import numpy as np
import pytest

from pipeline.cli import main
from pipeline.errors import MeshError, PipelineError, SeriesError
from pipeline.formats import sandbox as reader
from pipeline.mesh.files import read_mesh
from pipeline.series import read_series
from tests import fuzzing
from tests.bodies import skip_figures

SECONDS = 60  # an example that takes longer hangs
BYTES = 4 * 10**9
FIGURES = os.environ.get("PIPELINE_FUZZ_FIGURES")  # a file: how each example ended, a line a batch


@pytest.fixture(autouse=True)
def _bounded(monkeypatch):
    """Limits the memory that an example may add to this process; figures are left out."""
    skip_figures(monkeypatch)
    monkeypatch.setattr(reader, "_LEAST_SECONDS", 5.0)
    before = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + BYTES, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.fixture
def clock():
    """Starts a clock that raises TimeoutError in an example that hangs."""

    def late(*_):
        raise TimeoutError(f"more than {SECONDS} s")

    before = signal.signal(signal.SIGALRM, late)
    yield lambda: signal.alarm(SECONDS)
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def tally(request):
    """Counts how examples ended, in the file named by PIPELINE_FUZZ_FIGURES."""
    counts = Counter()
    yield counts
    if FIGURES:
        with open(FIGURES, "a") as opened:
            opened.write(f"{request.node.originalname} {dict(counts)}\n")


def one_line(text: str) -> bool:
    """Whether a text can be printed on one line of a terminal."""
    text.encode("utf-8")
    return bool(text) and text.count("\n") == 0 and len(text) < 2000


def seen(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def identity(numbers) -> str:
    return f"{numbers.start}-{numbers.stop - 1}"


@pytest.mark.parametrize("numbers", fuzzing.batches("case"), ids=identity)
def test_case_files(tmp_path, capfd, clock, tally, numbers):
    for number in numbers:
        clock()
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "it.toml").write_text(fuzzing.case_text(number), encoding="utf-8", errors="replace")
        before = seen(tmp_path)
        arguments = [
            "run",
            str(folder / "it.toml"),
            "--out",
            str(folder / "out"),
            "--no-movie",
            "--quiet",
            "--steps",
            "2",
        ]
        code = main(arguments)
        out, err = capfd.readouterr()
        assert code in (0, 2, 3, 4) and out == "", (number, code, out)
        errors = [line for line in err.splitlines() if not line.startswith("note: ")]
        assert len(errors) == (code != 0) or (code == 3 and errors), (number, err)
        assert all(one_line(line) and line.split(":")[0].endswith("Error") for line in errors), (number, err)
        assert all(folder / "out" in (path, *path.parents) for path in seen(tmp_path) - before), number
        tally[code] += 1
        shutil.rmtree(folder)


@pytest.mark.parametrize("numbers", fuzzing.batches("mesh"), ids=identity)
def test_mesh_files(tmp_path, capfd, clock, tally, numbers):
    for number in numbers:
        clock()
        folder = tmp_path / str(number)
        folder.mkdir()
        path = fuzzing.mesh_file(number, folder)
        capfd.readouterr()
        before = seen(tmp_path)
        try:
            mesh = read_mesh(path)
        except MeshError as error:
            assert one_line(str(error)) and str(error).startswith(str(path)), number
            tally["the reader died" if "the reader" in str(error) else "refused"] += 1
        else:
            assert np.isfinite(mesh.points).all() and (mesh.rest_volumes > 0).all(), number
            tally["read"] += 1
        assert seen(tmp_path) == before and capfd.readouterr() == ("", ""), number
        shutil.rmtree(folder)


@pytest.mark.parametrize("numbers", fuzzing.batches("series"), ids=identity)
def test_series_files(tmp_path, capfd, clock, tally, numbers, vtk_errors):
    for number in numbers:
        clock()
        folder = tmp_path / str(number)
        folder.mkdir()
        path = fuzzing.series_index(number, folder)
        before = seen(tmp_path)
        try:
            series = read_series(path)
            for frame in series:
                assert np.isfinite(frame.x).all() or frame.fault, number
        except SeriesError as error:
            assert one_line(str(error)), number
            tally["the reader died" if "the reader" in str(error) else "refused"] += 1
        else:
            tally["read, some frames left out" if len(series) < 3 else "read"] += 1
        assert seen(tmp_path) == before and capfd.readouterr() == ("", ""), number
        shutil.rmtree(folder)
    assert vtk_errors == []


def test_the_errors_are_those_that_end_with_a_code_of_their_own():
    assert issubclass(MeshError, PipelineError) and SeriesError.exit_code == MeshError.exit_code == 2
