"""A failed step is a result: failure.vtu shows where, the message has remedies, and earlier frames remain."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import pyvista

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.formats import atomic
from pipeline.results.case_run import run_case
from pipeline.results.failure import examine_failure
from pipeline.run.frame_iterator import frames
from pipeline.run.measures import measure
from pipeline.series import read_series
from pipeline.stepping.backward_euler import BackwardEuler
from pipeline.stepping.state import State
from tests.bodies import PLANAR, build_problem, make_rotation, skip_figures, write_case
from tests.results.test_run_case import fail_at

ONE = {"only": {}}
# thrown so hard that three Newton iterations are too few
HARD = {
    "method": {"iterations": "converged", "max_iterations": 3},
    "initial": {"velocity": [0.0, 300.0, -200.0]},
    "schedule": {"dt": 0.002, "frames": 20},
}


@pytest.fixture(autouse=True)
def _no_figures(monkeypatch):
    skip_figures(monkeypatch)


def run(folder: Path, **sections: object) -> tuple[int, Path]:
    case = write_case(folder, variants=ONE, **sections)
    return main(["run", str(case), "--out", str(folder / "out"), "--no-movie", "--quiet"]), folder / "out/beam/only"


def test_a_failed_newton_step_leaves_a_file_that_shows_where(tmp_path, capfd):
    code, folder = run(tmp_path, **HARD)
    err = capfd.readouterr().err
    assert code == 3 and err.count("\n") == 1
    run_record = json.loads((folder / "run.json").read_text())
    assert run_record["status"] == "failed" and run_record["frames"] >= 1 and run_record["message"] in err
    failure = run_record["failure"]
    assert f"at step {failure['step'] + 1}," in err and "try schedule.dt = " in err
    assert "method.max_iterations = 30" in err and "failure.vtu shows where" in err
    grid = pyvista.read(folder / "failure.vtu")
    series = read_series(folder)
    assert len(series) == run_record["frames"] and "failure" not in (folder / "series.pvd").read_text()
    last = series.read_frame(len(series) - 1)
    assert grid.field_data["step"][0] == failure["step"] == last.step
    assert np.array_equal(grid.points, last.x) and grid.field_data["TimeValue"][0] == last.time
    assert grid.cell_data["volume_ratio"] == pytest.approx(measure(last)["volume_ratio"], rel=1e-12)
    assert grid.cell_data["rotation_angle"] == pytest.approx(measure(last)["rotation_angle"], abs=1e-9)
    volumes = series.mesh.rest_volumes
    assert volumes @ grid.cell_data["energy_density"] == pytest.approx(last.known["elastic_energy"], rel=1e-9, abs=1e-9)
    assert grid.point_data["speed"] == pytest.approx(np.linalg.norm(last.v, axis=1))
    worst = failure["worst"]
    assert abs(worst["volume_ratio"] - 1) == np.abs(grid.cell_data["volume_ratio"] - 1).max()
    assert grid.field_data["message"][0] == run_record["message"] and "\n" not in run_record["message"]


def test_the_remedies_in_the_message_work(tmp_path, capfd):
    code, _ = run(tmp_path, **HARD)
    dt = float(re.search(r"try schedule.dt = ([\d.e-]+)", capfd.readouterr().err)[1])
    assert code == 3 and dt < 0.002
    case = load_case(tmp_path / "beam.toml", overrides={"schedule.dt": dt, "method.max_iterations": 30})
    assert run_case(case, tmp_path / "again", movie=False).variants[0].status == "finished"


def test_the_state_is_the_one_before_the_step_also_between_frames(tmp_path, monkeypatch):
    fail_at(monkeypatch, 4, "Corotational")
    code, folder = run(tmp_path, **PLANAR, schedule={"dt": 0.001, "steps_per_frame": 2, "frames": 4})
    grid = pyvista.read(folder / "failure.vtu")
    assert code == 3 and len(read_series(folder)) == 2
    assert grid.field_data["step"][0] == 3 and grid.celltypes[0] == pyvista.CellType.TRIANGLE
    monkeypatch.undo()
    whole = frames(build_problem(tmp_path, "only", variants=ONE, **PLANAR, schedule={"dt": 0.001, "frames": 4}))
    assert np.array_equal(grid.points[:, :2], list(whole)[3].x)


def test_a_new_run_removes_failure_vtu(tmp_path, monkeypatch, capfd):
    with monkeypatch.context() as patch:
        fail_at(patch, 3, "Corotational")
        _, folder = run(tmp_path)
    assert (folder / "failure.vtu").exists()
    code, _ = run(tmp_path)
    assert code == 0 and not (folder / "failure.vtu").exists() and len(read_series(folder)) == 5


def test_the_error_is_reported_even_if_failure_vtu_cannot_be_written(tmp_path, monkeypatch, capfd):
    fail_at(monkeypatch, 3, "Corotational")
    genuine = atomic.os.replace

    def fail(source, target):
        if str(target).endswith("failure.vtu"):
            raise OSError(28, "No space left on device")
        genuine(source, target)

    monkeypatch.setattr(atomic.os, "replace", fail)
    code, folder = run(tmp_path)
    assert code == 3 and "it broke (at step 3" in capfd.readouterr().err
    assert json.loads((folder / "run.json").read_text())["status"] == "failed"


def test_remedies_have_numbers(tmp_path):
    problem = build_problem(tmp_path, method={"stepper": "symplectic_euler"}, schedule={"dt": 1e-4, "frames": 3})
    assert re.fullmatch(
        r"symplectic_euler is stable below 0\.00\d+ s at rest: .*",
        examine_failure(problem, problem.start).list_remedies()[0],
    )
    problem = build_problem(tmp_path, initial={"spin": {"axis": [0.0, 1.0, 0.0], "rate": 2000.0}}, supports=None)
    failure = examine_failure(problem, problem.start)
    # a spin at rate w turns x + dt v by atan(w dt)
    assert failure.rotation_per_step == pytest.approx(np.degrees(np.arctan(np.radians(2000.0) * 0.02)))
    assert failure.list_remedies() == [
        f"try schedule.dt = {0.02 * 10 / failure.rotation_per_step[0]:.2g}",
        'method.iterations = "converged" with method.rotation = "polar"',
    ]
    turned = State(7, problem.body.mesh.points @ make_rotation(3, [0.0, 0.0, 1.0], 0.5).T, 0 * problem.start.v)
    assert examine_failure(problem, turned).rotation_angle == pytest.approx(np.degrees(0.5))
    assert examine_failure(problem, turned).rotation_per_step == pytest.approx(0, abs=1e-5)


def test_a_poor_cell_is_named(tmp_path):
    mesh = {"shape": "box", "size": [1.0, 3.0, 0.002], "cells": [1, 3, 1]}
    problem = build_problem(tmp_path, mesh=mesh)
    last = examine_failure(problem, problem.start).list_remedies()[-1]
    assert re.fullmatch(r"a better mesh: the quality of cell \d+ is 0\.00\d+ \(1 is regular\)", last)


def test_a_failure_before_the_first_frame_leaves_no_failure_vtu(tmp_path, monkeypatch):
    def fail(self, state):
        raise AssertionError

    monkeypatch.setattr(BackwardEuler, "step", fail)
    from pipeline.errors import SolveError
    from pipeline.problem.problem import Problem

    def no_factor(self):
        raise SolveError("no factor")

    monkeypatch.setattr(Problem, "prepare", no_factor)
    _, folder = run(tmp_path)
    assert json.loads((folder / "run.json").read_text())["message"] == "no factor"
    assert not (folder / "failure.vtu").exists()
