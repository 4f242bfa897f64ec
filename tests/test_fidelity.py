"""model = "auto": no accepted step has more spurious volume than asked for, and the cheapest rung that keeps it."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from pipeline import build, frames, load_case
from pipeline.errors import CaseError
from pipeline.fem.rotation import polar
from pipeline.fem.supports import rotation_about
from pipeline.mesh.simplex import signed_volumes
from pipeline.stepping.fidelity import spurious_volume
from pipeline.stepping.guard import Guarded

CASES = Path(__file__).resolve().parent.parent / "cases"
TOLERANCE = 0.01


def run(case: str, variant: str, **overrides: object):
    keys = {f"method.{key}": value for key, value in overrides.items() if key not in ("frames", "velocity")}
    if "frames" in overrides:
        keys |= {"schedule.frames": overrides["frames"]}
    if "velocity" in overrides:
        keys |= {"initial.velocity": [0.0, 0.0, overrides["velocity"]], "initial.factor": 1.0}
    return frames(build(load_case(CASES / f"{case}.toml", overrides=keys).variant(variant)))


def test_spurious_volume_is_the_square_of_the_tangent_of_the_angle_between() -> None:
    rng = np.random.default_rng(0)
    R = polar(rng.normal(size=(5, 3, 3)))
    for angle in (0.0, 0.1, 1.0, 1.5):
        turned = R @ rotation_about(np.array([1.0, 2.0, -1.0]), angle)
        assert spurious_volume(R, turned) == pytest.approx(np.tan(angle) ** 2, rel=1e-9, abs=1e-12)
        plane = rotation_about(np.array([0.0, 0.0, 1.0]), angle)[None, :2, :2]
        assert spurious_volume(np.eye(2)[None], plane) == pytest.approx(np.tan(angle) ** 2, rel=1e-9, abs=1e-12)
    assert spurious_volume(R, R @ rotation_about(np.array([0.0, 1.0, 0.0]), np.pi / 2 + 0.01)) == np.inf


@pytest.mark.parametrize(("velocity", "rungs"), [(-1.0, {(0, 1): 40}), (-20.0, {(0, 1): 36, (1, 1): 3, (1, 2): 1})])
def test_a_calm_bar_is_solved_linearly_and_a_livelier_one_where_it_must(velocity: float, rungs: dict) -> None:
    # the counts of method.md, section 3; (rung, solves) of 40 steps
    seen = [(f.work.rung, f.work.iterations) for f in run("bar", "polar", model="auto", frames=40, velocity=velocity)]
    assert Counter(seen[1:]) == rungs


# the violent spin and swing with large steps turn further a step than most: more solves, the same promise
SCENES = [
    ("bar", "polar", 40),
    ("bar_as_printed", "polar", 40),
    ("bar_small", "polar", 40),
    ("spin", "bdf2", 40),
    ("swing2d", "bdf2", 40),
    ("beam2d", "bdf2", 60),
    ("heavy_beam", "one_solve", 12),
    ("traction_block", "polar", 20),
    ("twisted_bar", "one_solve", 8),
]
# loads or velocities so sudden that strain and turning within one step act on each other: the indicator holds, the
# error was .043 (bar, bdf2) and .039, .037 (heavy_beam)
VIOLENT = {("bar", "bdf2"), ("heavy_beam", "backward_euler"), ("heavy_beam", "bdf2")}


@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2"])
@pytest.mark.parametrize(("case", "variant", "count"), SCENES, ids=lambda value: str(value))
def test_no_step_exceeds_the_tolerance_and_neither_does_the_error_by_much(
    case: str, variant: str, count: int, stepper: str
) -> None:
    keys = {"stepper": stepper, "frames": count, "mass": "consistent"}
    pairs = zip(
        run(case, variant, model="auto", volume_tolerance=TOLERANCE, **keys),
        run(case, variant, iterations="converged", **keys),
        strict=True,
    )
    worst = 0.0
    for frame, reference in pairs:
        assert frame.work.indicator <= TOLERANCE
        cells, V = frame.mesh.cells, frame.mesh.rest_volumes
        worst = max(
            worst, float(np.abs((signed_volumes(frame.x, cells) - signed_volumes(reference.x, cells)) / V).max())
        )
    print(f"{case} {stepper}: largest |J - J_converged| {worst:.2e}")
    assert worst <= (5 if (case, stepper) in VIOLENT else 2) * TOLERANCE


def test_a_step_beyond_a_quarter_turn_is_finished_by_newton() -> None:
    # 10 rad/s at dt .5: 5 rad a step
    overrides = {
        "method.model": "auto", "method.stepper": "backward_euler", "schedule.dt": 0.5, "schedule.frames": 2,
        "schedule.steps_per_frame": 1, "initial.spin.rate": float(np.degrees(10.0)),
    }  # fmt: skip
    seen = list(frames(build(load_case(CASES / "spin.toml", overrides=overrides).variant("converged"))))
    assert seen[1].work.rung == 2
    assert np.abs(signed_volumes(seen[-1].x, seen[-1].mesh.cells) / seen[-1].mesh.rest_volumes - 1).max() < 0.05


def test_auto_needs_an_implicit_stepper() -> None:
    with pytest.raises(CaseError, match=r"method\.model: 'auto' goes with implicit"):
        list(run("beam2d", "explicit", model="auto"))


def test_auto_is_watched_whatever_iterations_the_case_had() -> None:
    case = load_case(CASES / "twisted_bar.toml", overrides={"method.model": "auto"}).variant("converged")
    assert isinstance(build(case).prepare(), Guarded)
