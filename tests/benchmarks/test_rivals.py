"""Other programs beside ours: each one that is installed computes what the table says, and none is ever needed."""

import json
from importlib.metadata import version

import numpy as np
import pytest

from benchmarks import peers, scaling
from benchmarks.peers import PEERS, capture_warnings, list_installed, make_flex, make_rival, measure_peer
from benchmarks.plain_scipy import list_starts
from pipeline.errors import MeshError
from pipeline.studies.scaling import step_cost
from pipeline.studies.scaling.rival import import_task
from pipeline.studies.scaling.step_cost import METHODS, build_point


def make_point(cases_folder, method: str, case: str = "bar_as_printed.toml", variant: str = "polar"):
    return {"case": str(cases_folder / case), "variant": variant, "rtol": 1e-6, "method": method, "cells": [1, 3, 1]}


@pytest.mark.slow
def test_the_benchmark_has_a_row_for_every_method_and_installed_program(cases_folder, tmp_path, capsys) -> None:
    case = str(cases_folder / "bar_as_printed.toml")
    assert scaling.main([case, "--cells", "1x3x1", "--quiet", "--out", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "bench.json").read_text())["rows"]
    assert [row["method"] for row in rows] == [*METHODS, *list_installed()]
    assert all(row["error"] is None for row in rows)
    for row in rows[: len(METHODS)]:
        assert ((row["baseline_ms"] or 0) > row["ms"]) == (row["method"] in {"one_solve", "order_two"})
    assert (tmp_path / "scaling.png").stat().st_size > 10_000
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("plain scipy") and " x)" in lines[2]


def test_the_tasks_of_rivals_can_be_imported(cases_folder) -> None:
    assert import_task(scaling.PLAIN_SCIPY.task) is list_starts
    assert all(import_task(make_rival(name).task) is measure_peer for name in PEERS)


@pytest.mark.parametrize("method", ["one_solve", "order_two"])
def test_plain_scipy_moves_as_ours(cases_folder, method: str) -> None:
    problem = build_point(make_point(cases_folder, method))
    stepper, state = problem.prepare(), problem.start
    for _ in range(3):
        state, _ = stepper.step(state)
    moved = np.abs(state.x - problem.body.mesh.points).max()
    for start in list_starts(problem):
        step = start()
        for _ in range(3):
            step()
        x = step.__closure__[step.__code__.co_freevars.index("x")].cell_contents
        assert np.abs(x - state.x).max() < 1e-5 * moved  # conjugate gradients stop at 1e-6


def test_felupe_assembles_the_matrix_that_is_ours_at_rest(cases_folder, monkeypatch) -> None:
    import felupe

    bodies = []
    make_body = felupe.SolidBody

    def record_body(law, field):
        bodies.append(make_body(law, field))
        return bodies[0]

    monkeypatch.setattr(felupe, "SolidBody", record_body)
    monkeypatch.setattr(step_cost, "_MOST_STEPS", 3)
    row = measure_peer(make_point(cases_folder, "felupe"))
    assert row["tets"] == 18 and row["version"] == version("felupe") and "no step" in row["differs"]
    assert row["ms"] > 0 and row["ours_ms"] > 0 and row["ns_per_tet"] == pytest.approx(1e6 * row["ms"] / 18)
    body = build_point(make_point(cases_folder, "one_solve")).body
    ours = body.pattern.matrix(body.linearize(body.mesh.points)[1])
    assert abs(bodies[0].assemble.matrix() - ours).max() < 1e-12 * abs(ours).max()


def test_mujoco_hangs_as_deep_as_ours(cases_folder, tmp_path, monkeypatch) -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (extra bench): this peer is NOT tested")
    monkeypatch.setattr(step_cost, "_MOST_STEPS", 3)
    monkeypatch.chdir(tmp_path)
    row = measure_peer(make_point(cases_folder, "mujoco"))
    assert row["tets"] == 18 and row["ms"] > 0 and row["ours_ms"] > 0 and "Saint Venant" in row["differs"]
    problem = build_point(make_point(cases_folder, "one_solve"))
    with capture_warnings():
        model, data = make_flex(problem)
    assert model.nflexelem == 18 and model.nv == 3 * len(problem.body.free) and model.opt.timestep == problem.dt
    stepper, state = problem.prepare(), problem.start
    for _ in range(100):  # both are damped by their step, and come to rest
        mujoco.mj_step(model, data)
        state, _ = stepper.step(state)
    # small strains, for which the two models agree
    assert np.abs(data.flexvert_xpos - state.x).max() < 0.01 * np.abs(state.x - problem.body.mesh.points).max()
    assert list(tmp_path.iterdir()) == []  # no MUJOCO_LOG.TXT


def test_no_other_program_is_needed(cases_folder, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(peers, "find_spec", lambda name: None)
    case = str(cases_folder / "bar_as_printed.toml")
    arguments = [case, "--cells", "1x1x1", "--quiet", "--out", str(tmp_path), "--no-baseline"]
    assert scaling.main([*arguments, "--method", "linear"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].startswith("not compared with felupe, mujoco: pip install 'corotational-pipeline[bench]'")
    assert scaling.main([*arguments, "--method", "mujoco"]) == 2
    assert "--method mujoco: is not installed: pip install" in capsys.readouterr().err


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_takes_no_planar_body(cases_folder, name) -> None:
    with pytest.raises(MeshError, match=f"{name} is measured with tetrahedra only"):
        measure_peer(make_point(cases_folder, name, "beam2d.toml", "explicit") | {"cells": None})
