"""Loads in time, forces at points and vector tractions in whole runs, against closed forms; notes and messages."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline import frames
from pipeline.errors import CaseError, SolveError
from pipeline.fem.histories import ExpressionHistory, make_history
from pipeline.fem.loads import VaryingLoad
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.mesh.shapes import box
from pipeline.problem.check import check_problem, format_check
from pipeline.problem.problem import Problem
from pipeline.stepping.state import State
from tests.bodies import PLANAR, build_problem, find_equilibrium, prepare_stepper

FREE = {"supports": None, "loads": None, "initial": None}
MESHES = {
    "tetrahedra": {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 3, 1]},
    "tetrahedra of order 2": {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 2, 1], "order": 2},
    "triangles": {"shape": "rectangle", "size": [1.0, 3.0], "cells": [2, 6]},
    "triangles of order 2": {"shape": "rectangle", "size": [1.0, 3.0], "cells": [1, 3], "order": 2},
}
MESH = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
METHODS = {
    "backward_euler": {"stepper": "backward_euler"},
    "converged": {"stepper": "backward_euler", "iterations": "converged"},
    "linear": {"law": "linear"},
    "auto": {"model": "auto"},
    "bdf2": {"stepper": "bdf2"},
    "symplectic_euler": {"stepper": "symplectic_euler"},
}


def get_refusal(folder: Path, **sections: object) -> str:
    with pytest.raises(CaseError) as caught:
        build_problem(folder, **sections)
    text = str(caught.value).split(".toml: ", 1)[1]
    assert "\n" not in text
    return text


def cut(vector: list, mesh: dict) -> list:
    return vector[: len(mesh["size"])]


# Impulse


@MESH
@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_the_momentum_of_a_free_body_is_the_impulse_of_its_loads(tmp_path, method, mesh):
    """Four loads with histories: the sums of F dt over the times at which the stepper takes them, to rounding."""
    dt, count, d = 1e-3, 20, len(mesh["size"])
    loads = {
        "gravity": {"value": cut([0.0, 2.0, -9.81], mesh), "history": "sin(300*t)"},
        "body_force": {"value": cut([100.0, 0.0, 0.0], mesh), "factor": 2.0, "history": [[0.005, 0.0], [0.01, 1.0]]},
        "traction": [
            {"plane": "y", "at": 3.0, "traction": cut([50.0, -20.0, 10.0], mesh), "history": "ramp(t/0.01)"},
            {"plane": "y", "at": 0.0, "normal_traction": -30.0},
        ],
        "point": [{"at": cut([0.5, 1.4, 0.3], mesh), "force": cut([7.0, 6.0, 5.0], mesh), "history": "step(t-0.0055)"}],
    }
    one = build_problem(
        tmp_path, **FREE | {"loads": loads, "mesh": mesh, "method": method, "schedule": {"dt": dt, "frames": count}}
    )
    *_, last = frames(one)
    area, volume = 1.0, 3.0

    def force(t: float) -> np.ndarray:
        table = min(max((t - 0.005) / 0.005, 0.0), 1.0)
        return (
            1000 * volume * np.sin(300 * t) * np.array([0.0, 2.0, -9.81])
            + 200 * volume * table * np.array([1.0, 0.0, 0.0])
            + area * min(t / 0.01, 1.0) * np.array([50.0, -20.0, 10.0])
            + area * np.array([0.0, 30.0, 0.0])
            + (t >= 0.0055) * np.array([7.0, 6.0, 5.0])
        )[:d]

    begins = np.arange(count) * dt
    times = begins if method.get("stepper") == "symplectic_euler" else begins + dt
    f = np.array([force(t) for t in times])
    p = dt * f.sum(axis=0)
    if method.get("stepper") == "bdf2":
        path = [np.zeros(d), dt * f[0]]
        for n in range(1, count):
            path.append((4 * path[n] - path[n - 1]) / 3 + 2 * dt / 3 * f[n])
        p = path[-1]
    assert last.known["linear_momentum"][:d] == pytest.approx(p, abs=1e-7 * np.abs(p).max())
    # each part of the sum, as `check` prints it
    forces = {total.key: total.force for total in one.loads}
    assert forces["loads.gravity"] == pytest.approx(3000 * np.array(loads["gravity"]["value"]), abs=1e-9)
    assert forces["loads.body_force"] == pytest.approx(cut([600.0, 0.0, 0.0], mesh), abs=1e-9)
    assert forces["loads.traction.0"] == pytest.approx(cut([50.0, -20.0, 10.0], mesh), abs=1e-11)
    assert forces["loads.point.0"] == pytest.approx(cut([7.0, 6.0, 5.0], mesh), abs=1e-11)
    assert last.known["potential_energy"] == pytest.approx(
        -np.vdot(one.body.load_at(last.time), last.x - one.body.mesh.points), rel=1e-13
    )


@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2", "symplectic_euler"])
def test_a_push_of_one_step_is_work_that_the_energy_guard_knows(tmp_path, stepper):
    """An explicit step takes the load of its start: all the work of such a push is done after its end."""
    push = {"box": [[0.0, 0.0, 0.0], [1.0, 3.0, 1.0]], "force": [0.0, 0.0, 1e6], "history": "(t > 0.0095)*(t < 0.0105)"}
    sections = {"loads": {"point": [push]}, "schedule": {"dt": 1e-3, "frames": 40}, "method": {"stepper": stepper}}
    *_, last = frames(build_problem(tmp_path, **FREE | sections))
    assert last.known["linear_momentum"] == pytest.approx([0.0, 0.0, 16 * 1e6 * 1e-3], rel=1e-8, abs=1e-7)


# Equilibrium


@MESH
@pytest.mark.parametrize("history", ["min(t/0.5, 1)", "smooth(t/0.5)", [[0.0, 0.0], [0.3, 2.0], [0.5, 1.0]]], ids=str)
def test_a_load_that_rises_to_its_end_leads_to_the_equilibrium_of_the_full_load(tmp_path, mesh, history):
    end = {"plane": "y", "at": 0.0, "traction": cut([2e4, 1e4, -3e4], mesh)}
    method = {"iterations": "converged"}
    sections = FREE | {"supports": [{"plane": "y", "at": 3.0}], "mesh": mesh, "method": method}
    full = build_problem(tmp_path, **sections | {"loads": {"traction": [end]}})
    ramp = build_problem(
        tmp_path,
        **sections | {"loads": {"traction": [end | {"history": history}]}, "schedule": {"dt": 0.1, "frames": 80}},
    )
    *_, last = frames(ramp)
    rest = find_equilibrium(full.body)
    travel = np.abs(rest - full.body.mesh.points).max()
    assert travel > 0.02 and np.abs(last.x - rest).max() < 1e-6 * travel


@MESH
def test_forces_at_points_are_in_equilibrium_with_the_supports(tmp_path, mesh):
    """Forces and moments of the supports about the origin are those of the forces at their points, which moved."""
    d = len(mesh["size"])
    force, at = np.array([300.0, -200.0, 500.0])[:d], np.array([0.4, 0.7, 0.6])[:d]
    point = [{"at": at.tolist(), "force": force.tolist()}, {"plane": "y", "at": 0.0, "force": (force / 10).tolist()}]
    sections = {"supports": [{"plane": "y", "at": 3.0}], "loads": {"point": point}, "mesh": mesh}
    one = build_problem(tmp_path, "linear", **FREE | sections)
    body, X = one.body, one.body.mesh.points
    tip = X[:, 1] == 0.0
    x = find_equilibrium(body)
    reactions = -(body.force(x) + body.load)
    assert np.abs(reactions[body.free]).max() < 1e-6 * np.abs(force).max()
    total = force * (1 + tip.sum() / 10)
    assert reactions.sum(axis=0) == pytest.approx(-total, rel=1e-6)
    moments = X.T @ reactions  # of the linear law: about rest positions
    wanted = -np.outer(at, force) - np.outer(X[tip].sum(axis=0), force / 10)
    turning, wanted = moments - moments.T, wanted - wanted.T
    assert turning == pytest.approx(wanted, rel=1e-6, abs=1e-6 * np.abs(wanted).max())


def test_a_force_at_a_node_is_a_force_on_that_node(tmp_path):
    for order in (1, 2):
        mesh = {"shape": "box", "size": [1.0, 3.0, 1.0], "cells": [1, 3, 1], "order": order}
        at = {"at": [1.0, 2.0, 1.0], "force": [0.0, 0.0, 4.0]}
        X = build_problem(tmp_path, mesh=mesh).body.mesh.points
        node = int(np.flatnonzero((X == [1.0, 2.0, 1.0]).all(axis=1))[0])
        one, other = (
            build_problem(tmp_path, **FREE | {"mesh": mesh, "loads": {"point": [p]}}).body.load
            for p in (at, {"nodes": [node], "force": [0.0, 0.0, 4.0]})
        )
        assert one == pytest.approx(other, abs=1e-12) and other[node, 2] == 4.0 and np.abs(other).sum() == 4.0


# Oscillation


def drive_lowest_mode(problem: Problem, history: str, dt: float, steps: int) -> tuple[float, np.ndarray]:
    """The lowest frequency, and its mode's coordinate at every step under a force M phi f(t) from rest, by bdf2."""
    omegas, modes = find_lowest_frequencies(problem.body)
    shape = modes[0]
    p = problem.body.momentum(shape)
    mass = float(np.vdot(shape, p))
    text = history.replace("w", repr(float(omegas[0])))
    body = replace(problem.body, varying_load=VaryingLoad([(make_history(text, dt), p)]))
    stepper = prepare_stepper(body, dt, law="linear", stepper="bdf2")
    state, q = State(0, body.mesh.points, np.zeros_like(shape)), [0.0]
    for _ in range(steps):
        state, _ = stepper.step(state)
        q.append(float(np.vdot(p, state.x - body.mesh.points)) / mass)
    return float(omegas[0]), np.array(q)


@pytest.mark.parametrize("mesh", [MESHES["tetrahedra"], MESHES["triangles of order 2"]], ids=["order 1", "order 2"])
def test_a_mode_that_is_driven_follows_the_solution_of_its_oscillator(tmp_path, mesh):
    """At resonance q = (sin wt - wt cos wt)/(2 w^2); below it, at w/2, q = (sin(wt/2) - sin(wt)/2)/(3 w^2/4)."""
    one = build_problem(tmp_path, "linear", **FREE | {"supports": [{"plane": "y", "at": 3.0}], "mesh": mesh})
    omega = check_problem(one).omega_1
    errors = {}
    for n in (100, 200):  # steps in a period
        dt = 2 * np.pi / omega / n
        wt = omega * dt * np.arange(5 * n + 1)
        for name, text, exact in (
            ("resonance", "sin(w*t)", (np.sin(wt) - wt * np.cos(wt)) / (2 * omega**2)),
            ("below", "sin(w*t/2)", (np.sin(wt / 2) - np.sin(wt) / 2) / (0.75 * omega**2)),
        ):
            _, q = drive_lowest_mode(one, text, dt, 5 * n)
            errors[name, n] = np.abs(q - exact).max() / np.abs(exact).max()
    for name in ("resonance", "below"):
        assert errors[name, 200] < 0.02
        assert 3.5 < errors[name, 100] / errors[name, 200] < 4.5  # order 2 in time


# Resume, cost, failures


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_a_run_that_goes_on_in_the_middle_of_a_history_is_the_same_to_the_last_bit(tmp_path, method):
    sections = {
        "loads": {
            "gravity": {"value": [0.0, 0.0, -9.81], "history": "exp(-t)*sin(20*t)"},
            "traction": [{"plane": "y", "at": 0.0, "normal_traction": 1e4, "history": [[0.003, 0.0], [0.0051, 1.0]]}],
        },
        "supports": [
            {"plane": "y", "at": 3.0},
            {
                "plane": "y",
                "at": 0.0,
                "motion": {"velocity": [1.0, 0.0, 0.0], "history": "sin(500*t)", "until": 7.3e-3},
            },
        ],
        "method": method,
        "schedule": {"dt": 1e-3, "frames": 10},
    }
    whole = list(frames(build_problem(tmp_path, **sections)))
    for index in (3, 7, 8):
        again = list(frames(build_problem(tmp_path, **sections), whole[index].state))
        for one, other in zip(whole[index:], again, strict=True):
            assert np.array_equal(one.x, other.x) and np.array_equal(one.v, other.v)
            assert one.known["potential_energy"] == other.known["potential_energy"]


def test_histories_are_evaluated_once_a_step_and_not_at_all_in_scenes_without(tmp_path, monkeypatch):
    asked = []
    evaluate = ExpressionHistory.__call__
    monkeypatch.setattr(ExpressionHistory, "__call__", lambda self, time: asked.append(time) or evaluate(self, time))
    schedule = {"dt": 1e-3, "frames": 20}
    plain = build_problem(tmp_path, schedule=schedule)
    list(frames(plain))
    assert asked == [] and plain.body.varying_load is None and plain.body.load_at(0.3) is plain.body.load
    tractions = [{"plane": "y", "at": 0.0, "normal_traction": p, "history": "sin(t)"} for p in (1.0, 2.0)]
    one = build_problem(tmp_path, loads={"traction": tractions}, schedule=schedule)
    assert len(one.body.varying_load.parts) == 1  # of one history
    asked.clear()
    list(frames(one))
    assert asked == [k * 1e-3 for k in range(21)]


def test_a_history_without_a_value_stops_the_build_or_else_the_step_and_names_the_time(tmp_path):
    loads = {"gravity": {"value": [0.0, 0.0, -9.81], "history": "1/(t - 0.04)"}}
    message = get_refusal(tmp_path, loads=loads)
    assert message == "loads.gravity.history: '1/(t - 0.04)' divides by zero at t = 0.04 s"
    loads = {"gravity": {"value": [0.0, 0.0, -9.81], "history": "sqrt(abs(t - 0.4321) - 1e-6)"}}
    schedule = {"dt": 1e-4, "frames": 1, "steps_per_frame": 5000}  # more steps than the build looks at
    one = build_problem(tmp_path, loads=loads, schedule=schedule)
    start = State(4315, one.start.x, one.start.v)
    with pytest.raises(
        SolveError, match=r"has no value: log, sqrt .* at t = 0\.4321 s \(at step 4321, t = 0\.4321 s\)"
    ):
        list(frames(one, start))


# What a user is told


def test_check_prints_resultants_and_the_factors_of_the_run(tmp_path):
    loads = {
        "gravity": {"value": [0.0, 0.0, -10.0], "history": "min(t/0.04, 1)"},
        "traction": [{"plane": "y", "at": 0.0, "traction": [5.0, 0.0, 1.0], "history": [[0.0, 2.0], [0.08, 0.0]]}],
        "point": [{"at": [0.5, 0.5, 0.5], "force": [0.0, 3.0, 0.0]}],
    }
    one = build_problem(tmp_path, loads=loads)
    lines = [line for line in format_check(check_problem(one), one) if line.startswith("load ")]
    assert lines == [
        'load         gravity: [0, 0, -30000] N times "min(t/0.04, 1)", which is 0 at t = 0 and 1 at 0.08 s, '
        "within 0 to 1",
        "load         traction.0: [5, 0, 1] N times a table, which is 2 at t = 0 and 0 at 0.08 s, within 0 to 2",
        "load         point.0: [0, 3, 0] N",
    ]
    whole = {"traction": [{"box": [[0.0, 0.0, 0.0], [1.0, 3.0, 1.0]], "normal_traction": 1e5}]}
    one = build_problem(tmp_path, loads=whole)
    assert "load         traction.0: [0, 0, 0] N" in format_check(check_problem(one), one)
    two = build_problem(tmp_path, **PLANAR)
    assert "load         gravity: [0, -29430] N/m" in format_check(check_problem(two), two)


END = np.flatnonzero(box((1.0, 3.0, 1.0), (1, 3, 1)).points[:, 1] == 0.0).tolist()


@pytest.mark.parametrize(
    ("loads", "note"),
    [
        (
            {"traction": [{"nodes": [*END, 15], "normal_traction": 1.0}]},
            "loads.traction.0: 1 of its 5 corners on the boundary belong to no face of which all nodes are selected:",
        ),
        (
            {"traction": [{"plane": "y", "at": 3.0, "normal_traction": 1.0}]},
            "loads.traction.0: its forces are on held nodes only: it moves nothing",
        ),
        (
            {"gravity": {"value": [0.0, 0.0, -9.81], "history": "sin(100*pi*t)"}},
            "loads.gravity.history: below 1e-9 at every step: it moves nothing",
        ),
    ],
)
def test_a_load_that_has_less_effect_than_it_seems_is_noted(tmp_path, loads, note):
    one = build_problem(tmp_path, loads=loads)
    assert [text for text in one.notes if text.startswith(note)]
    assert not [text for text in build_problem(tmp_path).notes if "loads." in text]


AT = {"at": [0.5, 1.0, 0.5]}
FORCE = {"force": [0.0, 0.0, 1.0]}
PLANE = {"plane": "y", "at": 0.0}
DOWN = [0.0, 0.0, -9.81]


def fall(history):
    return {"gravity": {"value": DOWN, "history": history}}


WRONG = [
    (
        {"gravity": {"value": DOWN, "history": "sine(t)"}},
        "gravity.history: 'sine(t)': 'sine' is unknown; did you mean sin?",
    ),
    (fall(2), "gravity.history: 2 is neither an expression of t in quotes, such as"),
    (
        {"gravity": {"value": DOWN, "history": []}},
        "gravity.history: has 0 rows; a table needs two or more, each [t, value]",
    ),
    (fall([[0, 1]]), "gravity.history: has 1 row; a table needs two or more"),
    (
        {"gravity": {"value": DOWN, "history": [[0, 1], [0, 2]]}},
        "gravity.history.1: t = 0 is not above t = 0 of the row",
    ),
    (
        {"gravity": {"value": DOWN, "history": [[0, 1], [1, 2], [0.5, 3]]}},
        "gravity.history.2: t = 0.5 is not above t = 1",
    ),
    (fall([[0, 1], [1, 2, 3]]), "gravity.history.1: [1, 2, 3] is not [t, value]"),
    (fall([[0, 1], [1, "x"]]), "gravity.history.1.1: 'x' is not a number"),
    (fall([[0, 1], [1, float("nan")]]), "gravity.history.1.1: nan is not finite"),
    (fall(""), "gravity.history: '': is empty"),
    (
        {"gravity": {"value": DOWN, "history": "log(t)"}},
        "gravity.history: 'log(t)' has no value: log, sqrt and powers need",
    ),
    ({"gravity": {"value": DOWN, "factor": 2.0}}, "gravity.factor: unknown key; "),
    ({"gravity": {"history": "t"}}, "gravity.value: missing"),
    (
        {"gravity": {"value": [0.0, -9.81], "history": "t"}},
        "gravity.value: [0.0, -9.81] has 2 components",
    ),
    ({"gravity": [0.0, "x", 0.0]}, "gravity.1: 'x' is not a number"),
    ({"gravity": 9.81}, "gravity: 9.81 is not a list"),
    (
        {"body_force": {"value": DOWN, "history": "t t"}},
        "body_force.history: 't t': unexpected 't'; an operator is",
    ),
    ({"traction": [PLANE]}, "traction.0.normal_traction: missing; give normal_traction, or traction as a vector"),
    (
        {"traction": [PLANE | {"normal_traction": 1.0, "traction": DOWN}]},
        "traction.0.traction: cannot be combined with normal_traction; write a second entry",
    ),
    (
        {"traction": [PLANE | {"traction": [1.0, 2.0]}]},
        "traction.0.traction: [1.0, 2.0] has 2 components",
    ),
    ({"traction": [PLANE | {"traction": 5.0}]}, "traction.0.traction: 5.0 is not a list"),
    (
        {"traction": [{"nodes": [0, 1], "traction": DOWN}]},
        "traction.0: its nodes are not the corners of any",
    ),
    ({"traction": [AT | {"traction": DOWN}]}, "traction.0.at: [0.5, 1.0, 0.5] is not a number"),
    ({"point": [AT]}, "point.0.force: missing"),
    ({"point": [FORCE]}, "point.0: no selector; give one of at, plane, box, sphere, below, above, nodes"),
    ({"point": [AT | {"force": [1.0, 0.0]}]}, "point.0.force: [1.0, 0.0] has 2 components"),
    ({"point": [FORCE | {"at": [0.5, 1.0]}]}, "point.0.at: [0.5, 1.0] has 2 components"),
    (
        {"point": [FORCE | {"at": [0.5, 1.0, 1.25]}]},
        "point.0.at: [0.5, 1.0, 1.25] is outside the body, 0.25 m from it; give a point inside, or select nodes",
    ),
    ({"point": [FORCE | {"at": 1.0}]}, "point.0.at: needs plane, which is not given"),
    ({"point": [FORCE | AT | {"nodes": [1]}]}, "point.0: at and nodes cannot be combined"),
    ({"point": [FORCE | {"plane": "y"}]}, "point.0.at: missing"),
    ({"point": [FORCE | {"plane": "y", "at": 0.1}]}, "point.0: selects no node; the mesh spans [0.0, 0.0, 0.0] to"),
    ({"point": [FORCE | {"nodes": [99]}]}, "point.0.nodes: 99 is not a node; the mesh has 16, counted from 0"),
    ({"point": FORCE | AT}, "point: {'force': [0.0, 0.0, 1.0], 'at': [0.5, 1.0, 0.5]} is not a list"),
    ({"points": [FORCE | AT]}, 'points: unknown key; did you mean "loads.point"?'),
]


@pytest.mark.parametrize(("loads", "message"), WRONG, ids=[message[:40] for _, message in WRONG])
def test_a_wrong_load_is_refused_with_its_key_its_value_and_a_remedy(tmp_path, loads, message):
    assert get_refusal(tmp_path, loads=loads).startswith(f"loads.{message}")


def test_the_examples_of_the_documentation_are_cases(tmp_path):
    page = (Path(__file__).resolve().parents[2] / "docs" / "case_files.md").read_text(encoding="utf-8")
    of_loads, of_motions = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)[:2]
    mesh = {"shape": "box", "size": [1.0, 4.0, 1.0], "cells": [1, 4, 1]}
    one = build_problem(tmp_path, mesh=mesh, supports=None, **tomllib.loads(of_loads))
    assert [total.key.removeprefix("loads.") for total in one.loads] == [
        "gravity", "body_force", "traction.0", "point.0", "point.1"
    ]  # fmt: skip
    two = build_problem(tmp_path, mesh=mesh, **tomllib.loads(of_motions))
    assert len(two.body.supports.motions) == 2
