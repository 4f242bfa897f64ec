"""The cost of a step against the size of the mesh: every row has its numbers, and a point that fails is a row."""

import json
import subprocess
import sys
from importlib.metadata import version

import numpy as np
import pytest

from pipeline import load_case
from pipeline.cli import main
from pipeline.errors import CaseError, MeshError
from pipeline.studies.scaling import peers
from pipeline.studies.scaling import step_cost as cost
from pipeline.studies.scaling.peers import PEERS, capture_warnings, list_installed, make_flex
from pipeline.studies.scaling.peers import measure_peer as measured_peer
from pipeline.studies.scaling.step_cost import METHODS, measure_step_cost
from pipeline.studies.scaling.study import Scaling, study_scaling

NUMBERS = ("tets", "nodes", "dt", "ms", "ns_per_tet", "setup_s", "peak_MB", "bytes", "bound_ms")


@pytest.mark.slow
def test_every_method_has_a_row_with_its_numbers(cases_folder, tmp_path, capsys) -> None:
    arguments = ["study", "scaling", str(cases_folder / "bar_as_printed.toml"), "--cells", "1x3x1", "--quiet"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    said = json.loads((tmp_path / "bench.json").read_text())
    assert [row["method"] for row in said["rows"]] == [*METHODS, *list_installed()]
    for row in said["rows"][: len(METHODS)]:
        assert row["error"] is None and row["tets"] == 18 and all(row[name] > 0 for name in NUMBERS)
        assert (row["baseline_ms"] is not None) == (row["method"] == "one_solve")
    assert (tmp_path / "scaling.png").stat().st_size > 10_000
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) >= 1 + len(METHODS) and " x)" in lines[2]
    ms, newton = ({row["method"]: row.get(name) for row in said["rows"]} for name in ("ms", "iterations"))
    ratio = ms["converged"] / newton["converged"] / ms["one_solve"]
    assert newton["one_solve"] == 1 <= newton["converged"]
    assert lines[1 + len(METHODS)] == f"converged, 18 tets: an iteration costs {ratio:.1f} x one solve"


def test_a_point_says_what_it_solved_with(cases_folder) -> None:
    point = {"case": str(cases_folder / "bar_as_printed.toml"), "variant": "polar", "rtol": 1e-6, "baseline": False}
    row = measure_step_cost(point | {"method": "one_solve", "cells": [1, 3, 1]})
    assert row["linear_solver"] == ["banded"] and row["solves"] == 1 and row["linear_iterations"] == 0
    assert row["ns_per_tet"] == pytest.approx(1e6 * row["ms"] / 18)


def test_the_peak_of_memory_is_the_point_s_own_and_not_of_plain_scipy(cases_folder, monkeypatch) -> None:
    here = np.ones(60_000_000)  # what the process that starts it holds is not its own
    code = (
        "from pipeline.studies.scaling.step_cost import read_peak_megabytes as p; a = p(); "
        "b = b'1' * 10**8; print(a, p())"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    before, after = map(float, said.split())
    assert before < here.nbytes / 1e6 and after - before == pytest.approx(100, rel=0.1)
    asked: list[str] = []
    monkeypatch.setattr(cost, "read_peak_megabytes", lambda: asked.append("peak"))
    monkeypatch.setattr(cost, "_race_plain", lambda *_: (1.0, asked.append("plain")))
    measure_step_cost(point(cases_folder, "one_solve") | {"baseline": True})
    assert asked == ["peak", "plain"]


def test_wrong_input_is_an_error_and_nothing_measured_too(cases_folder, tmp_path) -> None:
    with pytest.raises(CaseError, match="--method 'quick': is not one of linear, one_solve"):
        study_scaling([load_case(cases_folder / "bar.toml")], tmp_path, methods=["quick"])
    arguments = ["study", "scaling", str(cases_folder / "bar.toml"), "--out", str(tmp_path), "--method", "linear"]
    assert main([*arguments, "--cells", "2by8"]) == 2
    assert main([*arguments, "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert main([*arguments, "--cells", "0x1x1"]) == 4


# Other programs


def point(cases_folder, method: str, case: str = "bar_as_printed.toml", variant: str = "polar") -> dict[str, object]:
    return {"case": str(cases_folder / case), "variant": variant, "rtol": 1e-6, "method": method, "cells": [1, 3, 1]}


def test_felupe_assembles_the_matrix_that_is_ours_at_rest(cases_folder, monkeypatch) -> None:
    import felupe

    seen = []
    plain = felupe.SolidBody

    def watched(law, field):
        seen.append(plain(law, field))
        return seen[0]

    monkeypatch.setattr(felupe, "SolidBody", watched)
    monkeypatch.setattr(cost, "_MOST_STEPS", 3)
    row = measured_peer(point(cases_folder, "felupe"))
    assert row["tets"] == 18 and row["version"] == version("felupe") and "no step" in row["differs"]
    assert row["ms"] > 0 and row["ours_ms"] > 0 and row["ns_per_tet"] == pytest.approx(1e6 * row["ms"] / 18)
    body = cost.build_point(point(cases_folder, "one_solve")).body
    ours = body.pattern.matrix(body.linearize(body.mesh.points)[1])
    assert abs(seen[0].assemble.matrix() - ours).max() < 1e-12 * abs(ours).max()


def test_mujoco_hangs_as_deep_as_ours(cases_folder, tmp_path, monkeypatch) -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed (extra bench): this peer is NOT tested")
    monkeypatch.setattr(cost, "_MOST_STEPS", 3)
    monkeypatch.chdir(tmp_path)
    row = measured_peer(point(cases_folder, "mujoco"))
    assert row["tets"] == 18 and row["ms"] > 0 and row["ours_ms"] > 0 and "Saint Venant" in row["differs"]
    problem = cost.build_point(point(cases_folder, "one_solve"))
    with capture_warnings():
        model, data = make_flex(problem)
    assert model.nflexelem == 18 and model.nv == 3 * len(problem.body.free) and model.opt.timestep == problem.dt
    stepper, state = problem.prepare(), problem.start
    for _ in range(100):  # both are damped by their step, and come to rest
        mujoco.mj_step(model, data)
        state, _ = stepper.step(state)
    # small strains, where the two models are one
    assert np.abs(data.flexvert_xpos - state.x).max() < 0.01 * np.abs(state.x - problem.body.mesh.points).max()
    assert list(tmp_path.iterdir()) == []  # no MUJOCO_LOG.TXT


def test_a_peer_is_never_needed(cases_folder, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr(peers, "find_spec", lambda name: None)
    case = str(cases_folder / "bar_as_printed.toml")
    arguments = ["study", "scaling", case, "--cells", "1x1x1", "--quiet", "--out", str(tmp_path), "--no-baseline"]
    assert main([*arguments, "--method", "linear"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("not compared with felupe, mujoco: pip install 'corotational-pipeline[bench]'")
    assert main([*arguments, "--method", "mujoco"]) == 2
    assert "--method mujoco: is not installed: pip install" in capsys.readouterr().err


@pytest.mark.parametrize("name", PEERS)
def test_a_peer_takes_no_planar_body(cases_folder, name) -> None:
    with pytest.raises(MeshError, match=f"{name} is measured with tetrahedra only"):
        measured_peer(point(cases_folder, name, "beam2d.toml", "explicit") | {"cells": None})


def test_peers_stand_in_a_table_of_their_own() -> None:
    row = {"method": "mujoco", "version": "4", "cells": [1, 1, 1], "error": None}
    row |= {"tets": 6, "ms": 3.0, "ns_per_tet": 1.0, "setup_s": 0.1, "ours_ms": 1.5}
    lines = Scaling(({"method": "linear", "cells": None, "error": "broke"}, row), 10.0, ()).lines()
    assert lines[1] == "linear     None: broke" and lines[2].startswith("other programs")
    assert lines[3].startswith("mujoco 4") and lines[3].endswith("1.500 (2.0 x)")
    assert lines[-1] == f"mujoco: {PEERS['mujoco'].differs}"
