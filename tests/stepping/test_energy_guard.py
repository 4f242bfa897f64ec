"""The energy guard stops runs that blow up, with numbers in the message, and never calm ones."""

import re
from pathlib import Path

import numpy as np
import pytest

from pipeline import build, load_case
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.material import Material
from pipeline.linear.work import Work
from pipeline.mesh.shapes import box
from pipeline.mesh.simplex import Mesh
from pipeline.problem.problem import Problem
from pipeline.run.frame_iterator import frames
from pipeline.stepping.energy_guard import EnergyGuard
from pipeline.stepping.report import StepReport
from pipeline.stepping.state import Memory, State
from pipeline.stepping.symplectic_euler import SymplecticEuler, true_limit
from tests.bodies import METHODS, PLANAR, build_problem, make_clamped_bar, make_solid, make_spin, prepare_stepper

BARS = sorted((Path(__file__).resolve().parents[2] / "cases").glob("bar*.toml"))
VARIANTS = [(path, name) for path in BARS for name in load_case(path).variant_names]


def make_spinning_body(mesh: Mesh, axis: int) -> tuple[Body, State]:
    """A free body that spins at 10 rad/s about an axis."""
    body = make_solid(mesh, **METHODS["polar"])
    return body, State(0, mesh.points, make_spin(body, 10.0 * np.eye(3)[axis]))


def run(one: Problem) -> State:
    """The last state of a problem's schedule."""
    prepared, state = one.prepare(), one.start
    assert isinstance(prepared, EnergyGuard) or one.method.law == "linear" or one.method.iterations == "converged"
    for _ in range(one.last_step):
        state, _ = prepared.step(state)
    return state


# Runs that blow up


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("split", ["kuhn", "alternating"])
def test_a_long_bar_in_fast_spin_is_stopped_while_its_numbers_are_finite(split, axis):
    """Unguarded its energy grew by 7e2 to 3e9 in 100 steps and by 5e24 to 2e31 in 300."""
    body, state = make_spinning_body(box((2.0, 24.0, 4.0), (2, 8, 2), split), axis)
    start = 0.5 * (state.v * body.momentum(state.v)).sum()
    prepared = prepare_stepper(body, 0.5)
    said = (
        r"unstable: the energy grew to \S+ J, more than 10 times the \S+ J .* schedule\.dt than 0\.5, .*\"converged\""
    )
    with pytest.raises(SolveError, match=said):
        for _ in range(120):  # measured: it is stopped in step 22 to 80
            state, _ = prepared.step(state)
            assert np.isfinite(state.x).all()
    energy = 0.5 * (state.v * body.momentum(state.v)).sum() + body.energy(state.x)
    assert 10 * start < energy < 1e6 * start


@pytest.mark.parametrize(("size", "axis"), [((4.0, 12.0, 4.0), axis) for axis in range(3)] + [((2.0, 24.0, 4.0), 1)])
def test_a_spin_that_decays_goes_on(size, axis):
    body, state = make_spinning_body(box(size, (2, 8, 2)), axis)
    prepared = prepare_stepper(body, 0.5)
    for _ in range(150):
        state, _ = prepared.step(state)


def test_the_error_names_step_and_time_and_the_frames_before_it_are_kept(tmp_path):
    mesh = {"shape": "box", "size": [2.0, 24.0, 4.0], "cells": [2, 8, 2]}
    material = {"youngs_modulus": 1e8, "poisson_ratio": 0.33, "density": 1000.0}
    initial = {"spin": {"axis": [0.0, 0.0, 1.0], "rate": float(np.degrees(10.0))}}
    schedule = {"dt": 0.5, "frames": 300}
    sections = {"mesh": mesh, "material": material, "initial": initial, "schedule": schedule}
    got = []
    with pytest.raises(SolveError) as caught:
        got.extend(frames(build_problem(tmp_path, supports=None, loads=None, **sections)))
    step = len(got)  # frames 0..step - 1 were yielded
    assert 15 < step < 50
    assert str(caught.value).endswith(f"(at step {step}, t = {step * 0.5:g} s)")


@pytest.mark.parametrize("d", [2, 3])
def test_an_explicit_step_above_the_limit_is_stopped(d, tmp_path):
    one = build_problem(tmp_path, method={"mass": "lumped"}, **(PLANAR if d == 2 else {}))
    prepared = EnergyGuard(one.body, SymplecticEuler(one.body, 1.05 * true_limit(one.body)))
    state = one.start
    with pytest.raises(SolveError, match="the step is unstable"):
        for _ in range(200):
            state, _ = prepared.step(state)
    assert np.isfinite(state.x).all()


class Replay:
    """A stepper that returns given states, one after the other."""

    dt = 0.1
    chooses_model = False

    def __init__(self, *states: State) -> None:
        self.states = list(states)

    def step(self, state: State) -> tuple[State, StepReport]:
        return self.states.pop(0), StepReport(Work(steps=1))


def run_guarded(body: Body, start: float, *speeds: float) -> State:
    """The last state of a guarded body at rest positions whose free nodes have these speeds, step by step."""
    X = body.mesh.points
    first, *others = (
        State(i, X, np.where(body.free_mask[:, None], speed * np.eye(3)[0], 0.0), Memory({"kept": np.ones(1)}))
        for i, speed in enumerate((start, *speeds))
    )
    prepared = EnergyGuard(body, Replay(*others))
    for _ in speeds:
        first, _ = prepared.step(first)
    return first


def test_three_steps_in_a_row_are_too_many_and_two_are_not():
    body = make_clamped_bar(**METHODS["polar"])
    memory = run_guarded(body, 1.0, 5.0, 5.0, 1.0, 5.0, 5.0).memory
    assert set(memory.stepper) == {"kept"} and memory.energy is not None and memory.energy.strikes == 2
    run_guarded(body, 1.0, 3.1, 3.1, 3.1)  # 9.6 times the energy
    v = np.where(body.free_mask[:, None], np.eye(3)[0], 0.0)
    start = 0.5 * (v * body.momentum(v)).sum()
    with pytest.raises(SolveError, match=re.escape(f"{25 * start:.3g} J, more than 10 times the {start:.3g} J")):
        run_guarded(body, 1.0, 1.0, 5.0, 5.0, 5.0)


def test_a_body_that_starts_without_energy_may_reach_that_of_a_strain_of_a_hundred_thousandth():
    body = make_clamped_bar(**METHODS["polar"])
    scale = 1e-10 * (body.material.lam + 2 * body.material.mu) * body.mesh.rest_volumes.sum()  # 2.8 J
    speed = np.sqrt(2 * scale / body.lumped_mass[body.free].sum())
    run_guarded(body, 0.0, *3 * [3 * speed])
    with pytest.raises(SolveError, match="the step is unstable"):
        run_guarded(body, 0.0, *3 * [4 * speed])


@pytest.mark.parametrize("broken", ["x", "v"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_an_error_that_names_step_and_time(tmp_path, monkeypatch, broken, wrong):
    one = build_problem(tmp_path, "linear")
    X = one.body.mesh.points
    bad = {"x": X.copy(), "v": 0 * X}
    bad[broken][3, 1] = wrong
    prepared = Replay(State(1, X, 0 * X), State(2, **bad))
    monkeypatch.setattr(Problem, "prepare", lambda problem: prepared)
    said = r"positions are no longer finite at step 2, t = 0\.2 s; try a smaller schedule\.dt than 0\.1"
    with pytest.raises(SolveError, match=said):
        list(frames(one))


# Calm runs


@pytest.mark.parametrize(("path", "variant"), VARIANTS, ids=lambda value: getattr(value, "stem", value))
def test_no_thrown_bar_is_stopped(path, variant):
    run(build(load_case(path).variant(variant)))


SCHEDULE = {"schedule": {"dt": 0.05, "frames": 100}}
TURNED = {"spin": {"axis": [0.0, 1.0, 0.0], "rate": 180.0, "center": [0.5, 0.0, 0.5]}}
CALM = {
    "heavy soft bar": {"material": {"youngs_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0}, "initial": None},
    "falling": {"supports": None, "initial": None},
    "falling from rest, slowly": {"supports": None, "initial": None, "loads": {"gravity": [0.0, 0.0, -1e-6]}},
    "turned end": {
        "initial": None,
        "supports": [{"plane": "y", "at": 3.0}, {"plane": "y", "at": 0.0, "motion": TURNED}],
    },
    "jerked end": {
        "initial": None,
        "loads": None,
        "supports": [{"plane": "y", "at": 3.0, "motion": {"velocity": [50.0, 0, 0]}}],
    },
    "dragged body": {"initial": None, "supports": [{"nodes": [0], "motion": {"velocity": [1.0, 1.0, 0.0]}}]},
    "at rest": {"initial": None, "loads": None},
    "at rest, free": {"initial": None, "loads": None, "supports": None},
    "pulled": {"initial": None, "loads": {"traction": [{"plane": "y", "at": 0.0, "normal_traction": 1e6}]}},
    "in the plane": PLANAR,
}


@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2", "symplectic_euler"])
@pytest.mark.parametrize("sections", CALM.values(), ids=CALM)
def test_no_calm_scene_is_stopped(tmp_path, sections, stepper):
    explicit = {"schedule": {"dt": 5e-4, "frames": 1000}} if stepper == "symplectic_euler" else {}
    run(build_problem(tmp_path, **SCHEDULE | sections | {"method": {"stepper": stepper}} | explicit))


@pytest.mark.parametrize("size", [1.0, 1e-3])
@pytest.mark.parametrize("name", ["backward_euler", "bdf2", "symplectic_euler"])
def test_noise_on_a_body_at_rest_is_not_stopped(name, size):
    """Noise in positions that a user would not see causes larger velocities."""
    mesh = box((size, 3 * size, size), (1, 3, 1))
    body = make_solid(mesh, material=Material(1e7, 0.3, 1000.0), mass="lumped", **METHODS["polar"])
    x = mesh.points + 1e-9 * size * np.random.default_rng(6).standard_normal(mesh.points.shape)
    prepared, state = prepare_stepper(body, 0.4 * true_limit(body), stepper=name), State(0, x, 0 * x)
    for _ in range(500):
        state, _ = prepared.step(state)
    assert np.abs(state.x - mesh.points).max() < 1e-6 * size


# Costs


@pytest.mark.parametrize("name", ["backward_euler", "bdf2"])
def test_the_methods_whose_energy_is_bounded_are_not_guarded(name):
    for method, is_guarded in (("linear", False), ("polar", True), ("gram_schmidt", True)):
        body = make_clamped_bar(**METHODS[method])
        assert isinstance(prepare_stepper(body, 0.07, stepper=name), EnergyGuard) == is_guarded
    body = make_clamped_bar(**METHODS["polar"])
    assert not isinstance(prepare_stepper(body, 0.07, stepper=name, iterations="converged"), EnergyGuard)
    assert isinstance(prepare_stepper(body, 0.07, stepper=name, iterations=3), EnergyGuard)
    assert isinstance(prepare_stepper(body, 1e-3, stepper="symplectic_euler"), EnergyGuard)


def test_a_calm_run_pays_for_one_elastic_energy_at_its_start(monkeypatch):
    body = make_clamped_bar(**METHODS["polar"])
    calls = []
    energy = type(body).energy
    monkeypatch.setattr(type(body), "energy", lambda self, x: calls.append(1) or energy(self, x))
    prepared, state = (
        prepare_stepper(body, 0.07),
        State(0, body.mesh.points, np.where(body.free_mask[:, None], [10.0, 0, 0], 0.0)),
    )
    for _ in range(20):
        state, _ = prepared.step(state)
    assert len(calls) == 1
