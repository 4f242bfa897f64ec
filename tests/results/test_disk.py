"""The disk space of a run is estimated before it starts; it does not start without enough space."""

import shutil
from types import SimpleNamespace

import pytest

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.problem.problem import build
from pipeline.results import disk
from pipeline.results.case_run import run_case
from tests.bodies import PLANAR, skip_figures, write_case


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch):
    skip_figures(monkeypatch)


def set_free_bytes(monkeypatch, size: float) -> None:
    monkeypatch.setattr(disk.shutil, "disk_usage", lambda path: SimpleNamespace(free=size))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("cells", "frames", "output"),
    [
        ([1, 3, 1], 60, {}),
        ([4, 12, 4], 12, {}),
        ([4, 12, 4], 12, {"precision": "float32"}),
        ([4, 12, 4], 12, {"format": "vtkhdf"}),
        ([8, 24], 20, {}),
    ],
)
def test_the_estimate_is_within_a_factor_of_two(tmp_path, cells, frames, output, order):
    planar = len(cells) == 2
    shape = {"shape": "rectangle", "size": [1.0, 3.0]} if planar else {"shape": "box", "size": [1.0, 3.0, 1.0]}
    sections = (PLANAR if planar else {}) | {"mesh": shape | {"cells": cells, "order": order}}
    case = load_case(
        write_case(tmp_path, **sections, variants={"only": {}}, output=output, schedule={"dt": 0.01, "frames": frames})
    )
    result = run_case(case, tmp_path / "out", movie=False)
    estimate = sum(disk.estimate_bytes(build(case.variant(name)), case.output) for name in case.variant_names)
    assert estimate / 2 < disk._measure_folder(result.folder) < 2 * estimate


def test_without_room_nothing_is_solved_and_the_error_has_both_numbers(tmp_path, monkeypatch, capfd):
    path = write_case(tmp_path, schedule={"dt": 0.02, "frames": 10**9})
    set_free_bytes(monkeypatch, 5e9)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--no-movie"]) == 4
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1
    assert "3000000003 frames of linear, gram_schmidt, polar need about 29.8 TB" in err and "5 GB are free" in err
    assert [file.name for file in (tmp_path / "out").rglob("*") if file.is_file()] == []


def test_existing_files_count_as_free_space(tmp_path, monkeypatch):
    case = load_case(write_case(tmp_path, schedule={"dt": 0.02, "frames": 20}))
    result = run_case(case, tmp_path / "out", movie=False)
    needed = sum(disk.estimate_bytes(build(case.variant(name)), case.output) for name in case.variant_names)
    set_free_bytes(monkeypatch, 0.7 * needed)
    assert run_case(case, tmp_path / "out", movie=False, force=True).variants[0].status == "finished"
    set_free_bytes(monkeypatch, 0.0)
    assert run_case(case, tmp_path / "out", movie=False).variants[0].status == "up to date"
    shutil.rmtree(result.folder / "polar")
    assert main(["run", str(tmp_path / "beam.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 4
