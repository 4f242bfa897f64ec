"""analyze and compare on the command line: two lines of decisions, folders, and messages that say what to do."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.cli import main
from tests.bodies import skip_figures, write_case
from tests.foreign.writers import STRETCHES, bar, stretch, write_vtu


@pytest.fixture(autouse=True)
def _in_a_folder_without_figures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    skip_figures(monkeypatch)


def write_pvd(name: str, write_frame) -> str:
    """Write frames through a function of (path, number) and their index; return its path."""
    Path(name).mkdir()
    for k in range(3):
        write_frame(Path(name) / f"f_{k}.vtu", k)
    lines = "".join(f'<DataSet timestep="{0.1 * k:g}" part="0" file="f_{k}.vtu"/>' for k in range(3))
    index = f'<VTKFile type="Collection"><Collection>{lines}</Collection></VTKFile>'
    (Path(name) / f"{name}.pvd").write_text(index)
    return f"{name}/{name}.pvd"


def write_displaced(path: Path, k: int) -> None:
    points, cells = bar()
    moved = stretch(points, STRETCHES[k]) - points
    write_vtu(path, points, [(10, cells), (5, [[0, 1, 2]])], {"displacement": moved})


def write_moving(path: Path, k: int) -> None:
    points, cells = bar()
    write_vtu(path, stretch(points, STRETCHES[k]), [(10, cells)])


def write_larger(path: Path, k: int) -> None:
    points, cells = bar()
    write_vtu(path, 10 * stretch(points, STRETCHES[k] ** 2), [(10, cells)])


def test_two_lines_say_what_was_decided_and_what_was_left_out(capsys):
    assert main(["analyze", write_pvd("rests", write_displaced)]) == 0
    output = capsys.readouterr()
    first, second, worst, *files = output.out.splitlines()
    assert first == "points: rest points + displacement; rest state: the points, without the displacement"
    assert second.startswith("cells: 12 tetrahedra in 3D")
    assert "; left out: 1 cell of lower dimension (no volume); times: 3 " in second
    assert second.endswith("from 0 to 0.2 s")
    assert worst == "rests: 3 frames; worst volume ratio 1.5000 (cell 0, t = 0.2 s)"
    assert files == ["  outputs/analysis/rests/statistics.nc", "  outputs/analysis/rests/volume.png"]
    assert "note: " in output.err
    assert main(["analyze", write_pvd("moves", write_moving), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert main(["analyze", "moves/moves.pvd"]) == 0
    line = "points: deformed points; rest state: the points of the first frame"
    assert capsys.readouterr().out.splitlines()[0] == line


def test_every_series_has_a_folder_of_its_own(capsys):
    first, second = write_pvd("first", write_displaced), write_pvd("second", write_moving)
    assert main(["analyze", first]) == main(["analyze", second]) == main(["compare", first, second]) == 0
    assert sorted(path.name for path in Path("outputs/analysis").iterdir()) == ["first", "first_and_second", "second"]
    assert Path("outputs/analysis/first_and_second/comparison.nc").is_file()


def test_files_of_one_name_are_told_apart_by_their_folders(capsys):
    for name, write in (("a", write_displaced), ("b", write_larger)):
        write_pvd(name, write)
        Path(f"{name}/{name}.pvd").rename(f"{name}/out.pvd")
    assert main(["compare", "a/out.pvd", "b/out.pvd"]) == 0
    assert sorted(path.name for path in Path("outputs/analysis/a_and_b").iterdir() if path.is_dir()) == ["a", "b"]


def test_results_of_another_series_are_removed_from_a_named_folder(capsys):
    first, second = write_pvd("first", write_displaced), write_pvd("second", write_larger)
    assert main(["analyze", first, "--out", "out", "--report"]) == 0
    assert main(["analyze", second, "--out", "out"]) == 0
    assert "report.html of another analysis removed" in capsys.readouterr().err
    assert not Path("out/report.html").exists()


def test_folders_that_are_something_else_say_what_to_do(tmp_path, capsys):
    assert main(["run", str(write_case(tmp_path)), "--no-movie", "--quiet", "--steps", "2"]) == 0
    assert main(["analyze", "outputs/beam/polar", "--quiet"]) == 0
    capsys.readouterr()
    for words, wanted in (
        (["analyze", "outputs/beam"], "3 variants: give one, outputs/beam/gram_schmidt, outputs/beam/linear"),
        (["compare", "outputs/beam", "outputs/beam/polar"], "give one, outputs/beam/gram_schmidt"),
        (["movie", "outputs/beam/polar"], "it holds one variant: give outputs/beam"),
        (["report", "outputs/beam/polar"], "it holds one variant: give outputs/beam"),
        (
            ["report", "outputs/analysis/polar"],
            "it holds an analysis: repeat pipeline analyze with --movie and --report",
        ),
        (["movie", "outputs/analysis/polar"], "it holds an analysis: repeat pipeline analyze"),
        (["report", "outputs"], "it holds other results: outputs/beam"),
    ):
        assert main(words) == 2, words
        message = capsys.readouterr().err
        assert message.count("\n") == 1 and wanted in message, (words, message)
    kept = Path("outputs/beam/polar/statistics.nc").read_bytes()
    for folder in ("outputs/beam/polar", "outputs/beam"):
        assert main(["analyze", "outputs/beam/linear", "--out", folder, "--quiet"]) == 4
        assert "results of a run, which would be overwritten" in capsys.readouterr().err
    assert Path("outputs/beam/polar/statistics.nc").read_bytes() == kept


def test_a_series_without_any_measurable_frame_is_an_error(capsys):
    def write_nothing(path: Path, k: int) -> None:
        points, cells = bar()
        field = np.full_like(points, np.nan)
        write_vtu(path, points, [(10, cells)], {"displacement": field, "rest_position": points})

    index = write_pvd("lost", write_nothing)
    assert main(["analyze", index, "--displacement", "displacement"]) == 2
    message = capsys.readouterr().err
    assert message.splitlines()[-1].startswith("SeriesError: ")
    assert not Path("outputs/analysis/lost/statistics.nc").exists()
