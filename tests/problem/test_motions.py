"""Motions of supports in time: positions against closed forms, ends, starts, and messages."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline import frames, make_case
from pipeline.errors import CaseError
from pipeline.mesh.shapes import box
from pipeline.problem.problem import build
from tests.bodies import build_problem

FREE = {"supports": None, "loads": None, "initial": None}
HELD = {"plane": "y", "at": 3.0}
MESHES = {
    "tetrahedra": {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 3, 1]},
    "tetrahedra of order 2": {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 2, 1], "order": 2},
    "triangles": {"shape": "rectangle", "size": [1.0, 3.0], "cells": [2, 6]},
    "triangles of order 2": {"shape": "rectangle", "size": [1.0, 3.0], "cells": [1, 3], "order": 2},
}
MESH = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
STEPPERS = {
    "backward_euler": {"stepper": "backward_euler"},
    "converged": {"iterations": "converged"},
    "bdf2": {"stepper": "bdf2"},
    "symplectic_euler": {"stepper": "symplectic_euler"},
}
STEPPER = pytest.mark.parametrize("method", STEPPERS.values(), ids=STEPPERS)
# a history, its integral, and its slope at the start
HISTORIES = {
    "none": (None, lambda t: t, None),
    "ramp": ("min(t/0.01, 1)", lambda t: 50 * t * t if t < 0.01 else t - 0.005, 100.0),
    "wave": ("sin(300*t)", lambda t: (1 - np.cos(300 * t)) / 300, 300.0),
    "table": ([[0.0, 0.0], [0.01, 1.0]], lambda t: 50 * t * t if t < 0.01 else t - 0.005, 100.0),
    "backward": ("1 - 2*step(t - 0.012)", lambda t: t if t < 0.012 else 0.024 - t, None),
}
HISTORY = pytest.mark.parametrize(("history", "clock", "slope"), HISTORIES.values(), ids=HISTORIES)
DT, COUNT = 1e-3, 20


def run_motion(folder: Path, mesh: dict, method: dict, motion: dict) -> tuple[np.ndarray, np.ndarray, list]:
    """The moved nodes, their rest positions, and the frames of a beam whose end has that motion."""
    supports = [HELD, {"plane": "y", "at": 0.0, "motion": motion}]
    sections = {"supports": supports, "mesh": mesh, "method": method, "schedule": {"dt": DT, "frames": COUNT}}
    one = build_problem(folder, **FREE | sections)
    X = one.body.mesh.points
    end = X[:, 1] == 0.0
    return end, X[end], list(frames(one))


@MESH
@STEPPER
@HISTORY
@pytest.mark.parametrize("until", [None, 0.01, 0.0133])
def test_a_velocity_and_a_spin_follow_the_integral_of_their_history_and_end(
    tmp_path, mesh, method, history, clock, slope, until
):
    d = len(mesh["size"])
    velocity, center, rate = np.array([3.0, -2.0, 1.0])[:d], np.array([0.5, 0.2, 0.5])[:d], 400.0
    motion = {
        "velocity": velocity.tolist(),
        "spin": {"axis": [0.0, 0.0, 1.0], "rate": rate, "center": center.tolist()},
        **({} if history is None else {"history": history}),
        **({} if until is None else {"until": until}),
    }
    end, X, run = run_motion(tmp_path, mesh, method, motion)
    arm = np.pad(X - center, [(0, 0), (0, 3 - d)])
    for frame in run:
        s = clock(min(frame.time, until or np.inf))
        turned = Rotation.from_rotvec([0.0, 0.0, np.radians(rate) * s]).apply(arm)[:, :d]
        assert np.abs(frame.x[end] - (center + turned + s * velocity)).max() < 1e-12
        if until and frame.time >= until:
            assert np.array_equal(frame.x[end], run[-1].x[end])  # to the last bit
    start = np.cross([0.0, 0.0, np.radians(rate)], arm)[:, :d] + velocity
    factor = 1.0 if slope is None else 0.0  # of the history at t = 0
    assert run[0].v[end] == pytest.approx(factor * start, abs=1e-12)
    if until == 0.01 and method.get("stepper") != "bdf2":
        assert not run[11].v[end].any() and not run[-1].v[end].any()


@MESH
@STEPPER
@pytest.mark.parametrize(
    ("history", "factor", "slope"),
    [
        ("sin(300*t)", lambda t: np.sin(300 * t), 300.0),
        ("1 - cos(300*t)", lambda t: 1 - np.cos(300 * t), 0.0),
        ("smooth(t/0.01)", lambda t: (t / 0.01) ** 2 * (3 - 2 * t / 0.01) if t < 0.01 else 1.0, 0.0),
        ([[0.0, 0.0], [0.004, 1.0], [0.012, -1.0]], lambda t: np.interp(t, [0, 0.004, 0.012], [0, 1, -1]), 250.0),
    ],
    ids=["sine", "cosine", "smooth", "table"],
)
@pytest.mark.parametrize("until", [None, 0.0133])
def test_a_displacement_follows_its_history_and_starts_with_its_slope(
    tmp_path, mesh, method, history, factor, slope, until
):
    travel = np.array([0.05, -0.02, 0.03])[: len(mesh["size"])]
    motion = {"displacement": travel.tolist(), "history": history} | ({} if until is None else {"until": until})
    end, X, run = run_motion(tmp_path, mesh, method, motion)
    for frame in run:
        now = min(frame.time, until or np.inf)
        assert np.abs(frame.x[end] - (X + factor(now) * travel)).max() < 1e-15
        if until and frame.time >= until:
            assert np.array_equal(frame.x[end], run[-1].x[end])
    assert run[0].v[end] == pytest.approx(np.tile(slope * travel, (len(X), 1)), abs=1e-5)


def test_a_body_whose_supports_all_move_alike_is_accelerated_as_one(tmp_path):
    """A gentle start leaves a stiff body undeformed: it has the velocity of the history at the end."""
    supports = [HELD | {"motion": {"velocity": [0.0, 0.0, 1.0], "history": "smooth(t/2)"}}]
    schedule = {"dt": 0.02, "frames": 125}
    *_, last = frames(build_problem(tmp_path, **FREE | {"supports": supports, "schedule": schedule}))
    assert last.v == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(last.v), 1)), abs=0.02)
    assert last.x[:, 2].max() == pytest.approx(1.0 + 1.0 + 0.5, abs=0.01)  # the integral is 1 at t = 2


def test_a_function_from_python_can_end_and_a_support_along_one_axis_can_have_a_history(tmp_path):
    mesh = box((1.0, 3.0, 1.0), (1, 3, 1))
    still, moved = mesh.points[:, 1] == 3.0, mesh.points[:, 1] == 0.0

    def swing(X, t):
        return np.outer(np.sin(20 * t) * X[:, 0], [0.1, 0.0, 0.0])

    one = make_case(
        "swing",
        mesh=mesh,
        material={"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0},
        supports=[{"nodes": still}, {"nodes": moved, "motion": {"displacement": swing, "until": 0.05}}],
        schedule={"dt": 0.02, "frames": 5},
    )
    for frame in frames(build(one)):
        wanted = mesh.points[moved] + swing(mesh.points[moved], min(frame.time, 0.05))
        assert np.array_equal(frame.x[moved], wanted)
    push = {"displacement": [0.0, 0.2, 0.0], "history": "ramp(t/0.05)", "until": 0.04}
    supports = [HELD, {"plane": "y", "at": 0.0, "components": ["y"], "motion": push}]
    *_, last = frames(build_problem(tmp_path, **FREE | {"supports": supports, "schedule": {"dt": 0.01, "frames": 9}}))
    assert last.x[moved, 1] == pytest.approx(0.16, abs=1e-15)
    assert np.ptp(last.x[moved, 0]) > 1.0 + 1e-3  # it swells across


WRONG = [
    ({"displacement": [1.0, 0.0, 0.0]}, "history: missing: displacement needs it, such as "),
    ({"displacement": [1.0, 0.0, 0.0], "history": "cos(t)"}, "history: is 1 at t = 0; the nodes start at rest, so it "),
    ({"displacement": [1.0, 0.0, 0.0], "history": "sqrt(t)"}, "history: starts with a velocity that is not finite: "),
    ({"displacement": [1.0, 0.0], "history": "t"}, "displacement: [1.0, 0.0] has 2 components, the mesh has 3"),
    ({"displacement": "up", "history": "t"}, "displacement: 'up' is neither an array nor a function; only make_case"),
    ({"displacement": 1.0, "history": "t"}, "displacement: 1.0 is not a list"),
    ({"displacement": [1.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0]}, "displacement: cannot be combined with velocity"),
    ({"velocity": [1.0, 0.0, 0.0], "until": 0.0}, "until: 0.0 is not positive"),
    ({"velocity": [1.0, 0.0, 0.0], "until": "t"}, "until: 't' is not a number"),
    ({"velocity": [1.0, 0.0, 0.0], "history": "1/t"}, "history: '1/t' divides by zero at t = 0 s"),
    (
        {"velocity": [1.0, 0.0, 0.0], "history": "sin(1e9*t)"},
        "history: a history varies too fast to be ",
    ),
    ({"velocity": [1.0, 0.0, 0.0], "history": [[0, 0]]}, "history: has 1 row; a table needs two or more, each [t, val"),
    ({"history": "t"}, ": none of velocity, spin and displacement is given"),
    ({"velocity": [1.0, 0.0, 0.0], "histroy": "t"}, 'histroy: unknown key; did you mean "supports.0.motion.history"?'),
]


@pytest.mark.parametrize(("motion", "message"), WRONG, ids=[message[:40] for _, message in WRONG])
def test_a_wrong_motion_is_refused_with_its_key_its_value_and_a_remedy(tmp_path, motion, message):
    with pytest.raises(CaseError) as caught:
        build_problem(tmp_path, supports=[HELD | {"motion": motion}])
    text = str(caught.value).split(".toml: ", 1)[1]
    dot = "" if message.startswith(":") else "."
    assert text.startswith(f"supports.0.motion{dot}{message}") and "\n" not in text


def test_a_history_needs_values_only_until_the_motion_ends(tmp_path):
    motion = {"velocity": [1.0, 0.0, 0.0], "history": "sqrt(0.03 - t)", "until": 0.025}
    supports = [HELD, {"plane": "y", "at": 0.0, "motion": motion}]
    *_, last = frames(build_problem(tmp_path, **FREE | {"supports": supports}))
    assert last.x[0, 0] == pytest.approx((0.03**1.5 - 0.005**1.5) / 1.5, rel=1e-10)


def test_a_motion_that_ends_after_the_run_is_noted(tmp_path):
    motion = {"velocity": [1.0, 0.0, 0.0], "until": 2.0}
    one = build_problem(tmp_path, **FREE | {"supports": [HELD, {"plane": "y", "at": 0.0, "motion": motion}]})
    assert "supports.1.motion.until: 2 s is after the end of the run, 0.08 s" in one.notes
