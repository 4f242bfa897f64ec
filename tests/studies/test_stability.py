"""The study of extremes: nodes are moved as described, outcomes differ, and every number is finite."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.errors import CaseError, MeshError
from pipeline.fem.element import deformation_gradient
from pipeline.mesh.quadratic import raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh, signed_volumes
from pipeline.problem.problem import build_mesh
from pipeline.studies.stability import study as stability
from pipeline.studies.stability import trial
from pipeline.studies.stability.perturbations import move_apexes, scramble_nodes
from pipeline.studies.stability.slices import METHODS, SLICES, ExtremeScene, make_trial_settings
from tests.bodies import PLANAR, assert_conventional, case_document, write_case

ROOT = Path(__file__).resolve().parents[2]
BAR = box((4.0, 12.0, 4.0), (2, 8, 2))
PLATE = rectangle((1.0, 3.0), (2, 6))


# Displaced nodes


@pytest.mark.parametrize("mesh", [BAR, box((1.0, 1.0, 1.0), (1, 1, 1)), PLATE], ids=["bar", "cube", "plate"])
@pytest.mark.parametrize("part", [0.5, 0.9, 0.999, 1.2, 3.0])
def test_apexes_move_by_the_given_part_of_the_way_to_their_bases(mesh, part):
    X, free = mesh.points, np.arange(1, len(mesh.points))
    x = move_apexes(mesh, free, part, seed=0)
    ratio = signed_volumes(x, mesh.cells) / mesh.rest_volumes
    assert ratio.min() == pytest.approx(1 - part, rel=1e-9)
    moved = np.flatnonzero((x != X).any(axis=1))
    assert 1 <= len(moved) <= 8 and 0 not in moved
    assert (np.isin(mesh.cells, moved).sum(axis=1) <= 1).all()  # no two of them in a cell
    assert np.array_equal(x, move_apexes(mesh, free, part, seed=0))


@pytest.mark.parametrize("mesh", [BAR, PLATE], ids=["bar", "plate"])
@pytest.mark.parametrize("part", [0.9, 1.2])
def test_in_meshes_of_order_two_the_nodes_of_sides_follow_the_apexes(mesh, part):
    two, free = raise_order(mesh), np.arange(1, len(mesh.points))
    both = np.concatenate([free, np.arange(len(mesh.points), len(two.points))])
    x = move_apexes(two, both, part, seed=0)
    assert np.array_equal(x[: len(mesh.points)], move_apexes(mesh, free, part, seed=0))
    np.testing.assert_allclose(np.linalg.det(deformation_gradient(two, x)).min(), 1 - part, rtol=1e-9)
    held = np.setdiff1d(np.arange(len(two.points)), free)
    assert np.array_equal(move_apexes(two, free, part, seed=0)[held], two.points[held])


def test_an_apex_that_cannot_be_moved_is_an_error_but_a_single_cell_is_not():
    one = Mesh(np.concatenate([np.zeros((1, 3)), np.eye(3)]), np.arange(4)[None])
    x = move_apexes(one, np.array([3]), 1.2, seed=0)
    assert x[3, 2] == pytest.approx(-0.2)
    with pytest.raises(MeshError, match="no free node"):
        move_apexes(one, np.array([], dtype=np.int64), 0.5, seed=0)


def test_a_scramble_moves_only_free_nodes_and_only_as_far_as_given():
    free = np.arange(9, 81)
    away = scramble_nodes(BAR, free, 3.0, seed=1) - BAR.points
    assert not away[:9].any() and 2.9 < np.abs(away).max() <= 3.0
    assert not np.array_equal(away, scramble_nodes(BAR, free, 3.0, seed=2) - BAR.points)


# One trial


def make_settings(folder: Path, name: str, value: float, method: str, **sections: object) -> dict:
    case = load_case(write_case(folder, **sections))
    return make_trial_settings(
        ExtremeScene.from_mesh(case, build_mesh(case)),
        name,
        value,
        method,
        steps=sections.pop("steps", 4),
        tolerance=0.05,
    )


def assert_finite(result: dict) -> None:
    """No key is missing, and every number is finite."""
    assert set(result) == {*trial.NO_RUN, "outcome"}
    assert json.dumps(result, allow_nan=False)
    assert all(np.isfinite(result[key]) for key in trial.NO_RUN if key != "message")


@pytest.mark.parametrize(
    ("name", "value", "method", "expected"),
    [
        ("dt", 1e-6, "polar bdf2", "survives"),
        ("dt", 10.0, "polar symplectic_euler", "refused"),
        ("poisson_ratio", 0.5, "linear bdf2", "refused"),
        ("poisson_ratio", -0.99, "converged backward_euler", "survives"),
        ("spin", 50.0, "linear backward_euler", "wrong_volume"),
        ("spin", 50.0, "converged backward_euler", "survives"),
        ("spin", 50.0, "gram_schmidt symplectic_euler", "refused"),
        ("spin", 0.01, "polar symplectic_euler", "survives"),
        ("youngs_modulus", 1e13, "auto backward_euler", "survives"),
        ("density", 1e-3, "three_passes bdf2", "survives"),
        ("sliver", 1e-3, "polar symplectic_euler", "survives"),
        ("scramble", 1.0, "linear symplectic_euler", "wrong_volume"),
        ("inversion", 0.5, "polar backward_euler", "survives"),
        ("inversion", 0.8, "polar symplectic_euler", "wrong_volume"),  # it has no damping
    ],
)
def test_a_trial_has_the_outcome_of_its_method(tmp_path, name, value, method, expected):
    result = trial.run_trial(make_settings(tmp_path, name, value, method))
    assert_finite(result)
    assert result["outcome"] == expected
    assert bool(result["message"]) == (expected == "refused")


@pytest.mark.parametrize(
    ("name", "value", "method", "expected"),
    [
        ("dt", 10.0, "polar backward_euler", "survives"),
        ("dt", 10.0, "polar symplectic_euler", "refused"),
        ("poisson_ratio", 0.4999, "auto bdf2", "survives"),
        ("spin", 50.0, "linear backward_euler", "wrong_volume"),
        ("spin", 50.0, "auto backward_euler", "survives"),
        ("sliver", 1e-3, "polar symplectic_euler", "survives"),
        ("scramble", 0.1, "converged backward_euler", "survives"),
        ("inversion", 0.2, "polar backward_euler", "survives"),
    ],
)
@pytest.mark.parametrize("d", [2, 3])
def test_trials_run_on_meshes_of_order_two(tmp_path, d, name, value, method, expected):
    sections = PLANAR if d == 2 else {}
    document = case_document(**sections)
    sections = {**sections, "schedule": {"dt": 0.1, "frames": 4}, "mesh": {**document["mesh"], "order": 2}}  # type: ignore[dict-item]  # a table
    result = trial.run_trial(make_settings(tmp_path, name, value, method, **sections))
    assert_finite(result)
    assert result["outcome"] == expected, result["message"]


@pytest.mark.parametrize("name", SLICES)
@pytest.mark.parametrize("method", METHODS)
def test_every_method_at_the_extremes_of_every_slice_has_finite_numbers_in_2d_too(tmp_path, name, method):
    case = load_case(write_case(tmp_path, **PLANAR))
    scene = ExtremeScene.from_mesh(case, PLATE)
    values = SLICES[name].list_values(scene)
    for value in (values[0], values[-1]):
        result = trial.run_trial(make_trial_settings(scene, name, value, method, steps=2, tolerance=0.05))
        assert_finite(result)
        assert result["outcome"] in trial.OUTCOMES


def test_a_spinning_linear_body_swells_by_the_law(tmp_path):
    """J = 1 + (omega t)^2, with omega t = 4 steps of 2 rad."""
    result = trial.run_trial(make_settings(tmp_path, "spin", 2.0, "linear backward_euler"))
    assert result["worst_volume_ratio"] == pytest.approx(1 + 8.0**2, rel=1e-6)


def test_a_run_that_blows_up_is_a_solve_error_with_its_message_and_the_numbers_before_it(tmp_path):
    trial_settings = make_settings(tmp_path, "spin", 20.0, "gram_schmidt backward_euler")
    trial_settings["changes"]["schedule"]["frames"] = 60
    result = trial.run_trial(trial_settings)
    assert_finite(result)
    assert result["outcome"] == "solve_error" and "the step is unstable" in result["message"]
    assert 3 <= result["steps"] < 60 and result["energy_growth"] > 10


def test_a_run_without_a_reference_is_not_judged(tmp_path):
    trial_settings = make_settings(tmp_path, "dt", 0.1, "polar backward_euler")
    trial_settings["changes"]["method"] |= {"max_iterations": 1}
    result = trial.run_trial(trial_settings)
    assert_finite(result)
    assert result["outcome"] == "not_judged" and result["volume_error"] == 0.0


def test_right_volumes_in_wrong_places_are_a_wrong_motion():
    course = trial.Course(BAR, is_held=True, x=[BAR.points], energy_growth=1.0)
    for errors, growth, expected in [
        ({"volume_error": 0.04, "node_distance": 0.04}, 1.0, "survives"),
        ({"volume_error": 0.04, "node_distance": 0.06}, 1.0, "wrong_motion"),
        ({"volume_error": 0.06, "node_distance": 0.06}, 1.0, "wrong_volume"),
        ({"volume_error": 0.04, "node_distance": 0.04}, 11.0, "wrong_motion"),
        ({}, 1.0, "not_judged"),
    ]:
        course.energy_growth = growth
        assert trial._judge_outcome(course, errors, 0.05) == expected
    course.message = "no"
    assert trial._judge_outcome(course, {}, 0.05) == "solve_error"


def test_settings_are_plain_and_a_change_of_the_file_is_another_trial(tmp_path):
    trial_settings = make_settings(tmp_path, "dt", 0.1, "auto bdf2")
    assert json.loads(json.dumps(trial_settings)) == trial_settings
    other = make_settings(tmp_path, "dt", 0.1, "auto bdf2", loads={"gravity": [0.0, 0.0, -1.0]})
    assert trial_settings != other


# The whole study


@pytest.fixture
def serial(monkeypatch) -> None:
    """Points one after the other in this process: a cluster takes seconds to start, and has tests of its own."""
    monkeypatch.setattr("pipeline.studies.sweep.find_spec", lambda name: None)


@pytest.fixture
def small(monkeypatch) -> None:
    methods = {m: METHODS[m] for m in ("linear backward_euler", "auto bdf2", "polar symplectic_euler")}
    for module in ("study", "figure", "results"):
        monkeypatch.setattr(f"pipeline.studies.stability.{module}.METHODS", methods)


def test_a_study_is_a_conventional_dataset_a_picture_and_lines(tmp_path, serial, small):
    case = load_case(write_case(tmp_path))
    progress = []
    study = stability.study_stability(
        case,
        tmp_path / "out",
        slices=("poisson_ratio", "dt"),
        steps=3,
        on_point=lambda *seen: progress.append(seen[1:]),
    )
    assert progress[-1] == (57, 57)
    folder = tmp_path / "out" / "beam"
    assert sorted(p.name for p in folder.iterdir()) == ["points", "stability.nc", "stability.png", "summary.json"]
    with xarray.open_dataset(folder / "stability.nc") as dataset:
        assert_conventional(dataset)
        assert dataset.outcome_dt.dims == ("method", "dt") and dataset.outcome_dt.dtype == np.int8
        meanings = dataset.outcome_dt.attrs["flag_meanings"].split()
        assert meanings == list(trial.OUTCOMES) and list(dataset.outcome_dt.attrs["flag_values"]) == list(range(7))
        for name in dataset.data_vars:
            if dataset[name].dtype.kind == "f":
                assert np.isfinite(dataset[name]).all(), name
        refused = dataset.outcome_poisson_ratio.sel(poisson_ratio=[-1.0, 0.5]).values
        assert (refused == meanings.index("refused")).all()
        assert "not below 0.5" in str(dataset.message_poisson_ratio.values[0, -1])
        assert dataset.outcome_dt.sel(dt=1e-6).values.tolist() == [0, 0, 0]
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["trials"] == 57 == sum(summary["outcomes"].values())
    assert summary["sentences"] == study.list_sentences()
    assert study.list_sentences()[0] == "refused by every method: poisson_ratio -1, poisson_ratio 0.5"
    assert study.list_sentences()[3].endswith("refused at dt 0.01 0.1 1 10")
    assert any("is above the limit of symplectic_euler" in message for message in summary["messages"])


def test_the_picture_has_a_field_of_the_right_color_for_every_trial(tmp_path, serial, small):
    from PIL import Image

    study = stability.study_stability(load_case(write_case(tmp_path)), tmp_path, slices=("dt",), steps=2)
    pixels = np.asarray(Image.open(study.files[1]).convert("RGB")).reshape(-1, 3)
    for outcome, color in (("survives", (0xB7, 0xE3, 0xD0)), ("refused", (0xF4, 0xF5, 0xF7))):
        fields = sum(row.count(outcome) for row in study.list_outcomes("dt"))
        assert fields > 0 and (pixels == color).all(axis=1).sum() > 300 * fields


def test_a_fault_of_the_program_is_an_outcome_and_the_study_continues(tmp_path, serial, small, monkeypatch):
    def raise_fault(settings):
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("pipeline.studies.stability.study.run_trial", raise_fault)
    study = stability.study_stability(load_case(write_case(tmp_path)), tmp_path, slices=("sliver",), steps=2)
    assert {r["outcome"] for r in study.results.values()} == {"unexpected_error"}
    assert all(r["message"] == "ZeroDivisionError: by zero" for r in study.results.values())


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"slices": ("speed",)}, "slice 'speed' is not one of dt, spin, poisson_ratio"),
        ({"steps": 0}, "steps: 0 is not 1 or more"),
        ({"tolerance": 1.0}, "tolerance: 1 is not between 0 and 1"),
    ],
)
def test_wrong_options_are_errors_before_anything_is_written(tmp_path, keywords, words):
    with pytest.raises(CaseError, match=words):
        stability.study_stability(load_case(write_case(tmp_path)), tmp_path / "out", **keywords)
    assert not (tmp_path / "out").exists()


def test_the_command_prints_its_lines_and_resumes(tmp_path, capsys, serial, small, monkeypatch):
    path = write_case(tmp_path)
    command = ["study", "stability", str(path), "--out", str(tmp_path / "o"), "--slice", "sliver", "--steps", "2"]
    assert main([*command, "--quiet"]) == 0
    first = capsys.readouterr()
    assert first.out.count(" survives everything") == 3 and first.err.count("\n") <= 1
    monkeypatch.setattr("pipeline.studies.stability.study.run_trial", None)  # no point is left to compute
    assert main(command) == 0
    again = capsys.readouterr().out
    assert again.startswith(first.out) and "stability.nc" in again


def test_the_command_names_a_wrong_slice_in_one_line_and_its_help_lists_all(tmp_path, capsys):
    assert main(["study", "stability", str(write_case(tmp_path)), "--slice", "speed"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("CaseError: slice 'speed'") and error.count("\n") == 1
    with pytest.raises(SystemExit):
        main(["study", "stability", "--help"])
    words = capsys.readouterr().out.replace(",", " ").split()
    assert set(SLICES) <= set(words)
