"""model = "auto": every accepted step keeps the tolerance on spurious volume, and takes the cheapest rung that does."""

from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import xarray

from pipeline import build, frames, load_case
from pipeline.errors import CaseError
from pipeline.fem.body import Body
from pipeline.fem.compiled_body import CompiledBody
from pipeline.fem.frame_error import spurious_volume
from pipeline.fem.supports import rotation_about
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import signed_volumes
from pipeline.results.analysis_folder import compare
from pipeline.results.case_run import run_case
from pipeline.run.frame import Frame
from pipeline.run.measures import measure_cells
from pipeline.series import read_series
from pipeline.series.xarray_plugin import make_lazy_dataset
from pipeline.stepping.energy_guard import EnergyGuard
from tests.bodies import make_solid

CASES = Path(__file__).resolve().parents[2] / "cases"
TOLERANCE = 0.01


def run(case: str, variant: str, **overrides: object):
    keys = {f"method.{key}": value for key, value in overrides.items() if key not in ("frames", "velocity")}
    if "frames" in overrides:
        keys |= {"schedule.frames": overrides["frames"]}
    if "velocity" in overrides:
        keys |= {"initial.velocity": [0.0, 0.0, overrides["velocity"]], "initial.factor": 1.0}
    problem = build(load_case(CASES / f"{case}.toml", overrides=keys).variant(variant))
    for key in ("iterations", "model", "stepper"):  # a variant's own word would win over an override
        assert getattr(problem.method, key) == overrides.get(key, getattr(problem.method, key)), key
    return frames(problem)


@pytest.mark.parametrize("d", [2, 3])
def test_spurious_volume_is_the_square_of_the_tangent_of_the_angle(d: int) -> None:
    for angle in (0.0, 0.1, 1.0, 1.5):
        turned = rotation_about(np.array([0.0, 0.0, 1.0]), angle)[:d, :d]
        assert spurious_volume(float(np.trace(turned)), d) == pytest.approx(np.tan(angle) ** 2, rel=1e-9, abs=1e-12)
    beyond = rotation_about(np.array([0.0, 0.0, 1.0]), np.pi / 2 + 0.01)[:d, :d]
    assert spurious_volume(float(np.trace(beyond)), d) == np.inf


@pytest.mark.parametrize("shake", [1e-4, 1e-2, 0.3])
@pytest.mark.parametrize("turn", [0.0, 1e-3, 0.1, 2.0])
@pytest.mark.parametrize("d", [2, 3])
def test_the_compiled_frame_error_is_the_plain_one_and_its_bound_holds(d: int, shake: float, turn: float) -> None:
    rng = np.random.default_rng(5)
    mesh = box([1.0, 2.0, 1.5], [2, 3, 2]) if d == 3 else rectangle([1.0, 2.0], [3, 5])
    compiled = make_solid(mesh, "corotational", held=[0, 1])
    plain = Body(compiled.mesh, compiled.law, compiled.supports, compiled.load, compiled.mass_model)
    X = compiled.mesh.points
    axis = np.array([1.0, 2.0, -1.0] if d == 3 else [0.0, 0.0, 1.0])
    x = X @ rotation_about(axis, turn)[:d, :d].T + shake * rng.normal(size=X.shape)
    R, S, T = np.empty((3, *plain.rotations(x).shape))
    for used in (None, plain.rotations(X + 0.05 * rng.normal(size=X.shape))):
        ours, expected = compiled.measure_frame_error(x, used, R), plain.measure_frame_error(x, used, S)
        assert ours.indicator == pytest.approx(expected.indicator, rel=1e-9, abs=1e-13)
        assert ours.from_rest == pytest.approx(expected.from_rest, rel=1e-9, abs=1e-13)
        np.testing.assert_allclose(R, S, atol=1e-9)
        assert compiled.update_rotations(x, T) == ours.from_rest and plain.update_rotations(x, T) == expected.from_rest
        np.testing.assert_array_equal(S, T)
    exact, bound = plain.measure_frame_error(x, None, S).indicator, compiled.bound_frame_error(x)
    assert exact <= bound * (1 + 1e-9)
    if turn < 0.01 and shake < 0.01:
        assert bound < 20 * exact  # of use where rotations are small


@pytest.mark.parametrize("turn", [0.1, 0.5, 1.0])
def test_the_compiled_bound_of_angles_is_that_of_its_formula(turn: float) -> None:
    body = make_solid(box([1.0, 2.0, 1.5], [2, 3, 2]), "corotational", held=[])
    assert isinstance(body, CompiledBody)
    x = body.mesh.points @ rotation_about(np.array([1.0, 2.0, -1.0]), turn).T
    (cells, G, *_), (mu, lam, _) = body._cells, body._strays
    tangent, _ = body._modules.frame_errors.bound_frame_error(x, cells, G, mu, lam)
    assert tangent == pytest.approx(np.tan(turn) / 2, rel=1e-6)  # |a| / (2 (tr S - s)) with s = 1, the axis


@pytest.mark.parametrize("d", [2, 3])
def test_the_frame_error_of_nan_is_infinite(d: int) -> None:
    body = make_solid(
        box([1.0, 1.0, 1.0], [2, 2, 2]) if d == 3 else rectangle([1.0, 1.0], [3, 3]), "corotational", held=[]
    )
    x = body.mesh.points.copy()
    x[-1, 0] = np.nan
    R, S = np.empty((2, *body.rotations(x).shape))
    assert body.bound_frame_error(x) == np.inf
    for used in (None, R):
        turned = body.measure_frame_error(x, used, S)
        assert turned.indicator == turned.from_rest == np.inf


@pytest.mark.parametrize(("velocity", "rungs"), [(-1.0, {(0, 1): 40}), (-20.0, {(0, 1): 36, (1, 1): 3, (1, 2): 1})])
def test_a_calm_bar_is_solved_linearly_and_a_faster_one_by_higher_rungs(velocity: float, rungs: dict) -> None:
    # (rung, solves) of 40 steps
    _, *steps = run("bar", "polar", model="auto", frames=40, velocity=velocity)
    assert Counter((frame.known["rung"].item(), frame.work.iterations) for frame in steps) == rungs


@pytest.mark.slow
@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2"])
@pytest.mark.parametrize("case", sorted(path.stem for path in CASES.glob("*.toml")))
def test_no_step_exceeds_the_tolerance_and_the_error_not_twice_that(case: str, stepper: str) -> None:
    """Every scene, from its first frame to its last."""
    names = load_case(CASES / f"{case}.toml").variant_names
    variant = "converged" if "converged" in names else stepper
    pairs = zip(
        run(case, variant, model="auto", volume_tolerance=TOLERANCE, stepper=stepper),
        run(case, variant, iterations="converged", stepper=stepper),
        strict=True,
    )
    worst = 0.0
    for frame, reference in pairs:
        assert frame.known["indicator"] <= TOLERANCE
        worst = max(worst, float(np.abs(ratios(frame) - ratios(reference)).max()))
    print(f"{case} {stepper}: largest |J - J_converged| {worst:.2e}")
    assert worst <= 2 * TOLERANCE


def ratios(frame: Frame) -> np.ndarray:
    return measure_cells(frame.mesh, frame.x).volumes / frame.mesh.rest_volumes


def test_a_step_beyond_a_quarter_turn_is_finished_by_newton() -> None:
    # 10 rad/s at dt .5: 5 rad a step
    overrides = {
        "method.model": "auto", "method.stepper": "backward_euler", "schedule.dt": 0.5, "schedule.frames": 2,
        "schedule.steps_per_frame": 1, "initial.spin.rate": float(np.degrees(10.0)),
    }  # fmt: skip
    seen = list(frames(build(load_case(CASES / "spin.toml", overrides=overrides).variant("converged"))))
    assert seen[1].known["rung"] == 2
    assert np.abs(signed_volumes(seen[-1].x, seen[-1].mesh.cells) / seen[-1].mesh.rest_volumes - 1).max() < 0.05


def test_auto_needs_an_implicit_stepper() -> None:
    with pytest.raises(CaseError, match=r"method\.model: 'auto' works only with implicit"):
        list(run("beam2d", "explicit", model="auto"))


def test_auto_is_guarded_whatever_the_iterations_of_the_case() -> None:
    case = load_case(CASES / "twisted_bar.toml", overrides={"method.model": "auto"}).variant("converged")
    assert isinstance(build(case).prepare(), EnergyGuard)


def test_the_choice_of_every_step_is_recorded_plotted_and_read_back_from_frames(tmp_path) -> None:
    overrides = {"method.model": "auto", "schedule.steps_per_frame": 3, "schedule.frames": 8}
    case = load_case(CASES / "bar.toml", overrides=overrides)
    result = run_case(case, tmp_path, variants=["polar", "linear"], movie=False)
    folder = result.folder / "polar"
    with xarray.open_dataset(folder / "statistics.nc") as dataset:
        assert dataset["step"].values.tolist() == list(range(1, 25))
        assert dataset["step_rung"].attrs["long_name"].startswith("model")
        whole = {"rung": "step_rung", "newton_iterations": "step_solves", "indicator": "step_indicator"}
        by_frame = {frame: dataset[step].values.reshape(8, 3) for frame, step in whole.items()}
        assert np.array_equal(by_frame["rung"].max(axis=1), dataset["rung"].values[1:])
        assert np.array_equal(by_frame["indicator"].max(axis=1), dataset["indicator"].values[1:])
        assert np.array_equal(by_frame["newton_iterations"].sum(axis=1), dataset["newton_iterations"].values[1:])
        assert len(set(dataset["step_rung"].values)) > 1 and 0 < dataset["step_indicator"].max() <= TOLERANCE
        again = [frame.known["step_indicator"] for frame in read_series(folder)]
        assert np.isnan(again[0]).all() and np.array_equal(np.concatenate(again[1:]), dataset["step_indicator"])
    with xarray.open_dataset(result.folder / "comparison.nc") as comparison:
        assert "step" not in comparison.dims and "rung" in comparison
    assert result.folder / "effort.png" in result.files


def test_recorded_choices_do_not_disturb_readers_of_frames(tmp_path) -> None:
    overrides = {"method.model": "auto", "schedule.steps_per_frame": 3, "schedule.frames": 4}
    case = load_case(CASES / "bar.toml", overrides=overrides)
    folder = run_case(case, tmp_path, variants=["polar", "linear"], movie=False).folder
    found = compare([folder / "polar", folder / "linear"], tmp_path / "compared")
    with xarray.open_dataset(found.folder / "comparison.nc") as joined:
        assert "rung" in joined and "step" not in joined.dims and joined.sizes["time"] == 5
    steps = make_lazy_dataset(read_series(folder / "polar"))["step_rung"]
    assert steps.dims == ("time", "step_of_frame") and steps.shape == (5, 3)


def test_the_plot_of_efforts_is_removed_with_the_variants_that_it_shows(tmp_path) -> None:
    keys = {"schedule.frames": 2, "mesh.cells": [1, 2, 1]}
    run = partial(run_case, out=tmp_path, variants=["polar"], movie=False, force=True)
    folder = run(load_case(CASES / "bar.toml", overrides=keys | {"method.model": "auto"})).folder
    assert (folder / "effort.png").is_file()
    run(load_case(CASES / "bar.toml", overrides=keys))
    assert not (folder / "effort.png").exists()
