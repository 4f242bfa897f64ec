"""Backward Euler: closed forms, its own energy law, what it conserves, and how much work it does."""

from itertools import pairwise, product

import numpy as np
import pytest

import pipeline.problem.methods
from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.fem.element import deformation_gradient
from pipeline.fem.loads import body_force
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.fem.rotation import Rotation
from pipeline.linear.cg import make_block_jacobi_cg
from pipeline.linear.solver import RestState, SystemSettings
from pipeline.linear.superlu import SuperLU
from pipeline.linear.work import Work
from pipeline.mesh.simplex import Mesh
from pipeline.problem.methods import Choice
from pipeline.stepping.backward_euler import damping_ratio
from pipeline.stepping.state import State
from tests.bodies import (
    BOXES,
    METHODS,
    list_states,
    make_clamped_bar,
    make_solid,
    make_spin,
    make_thesis_bar,
    prepare_stepper,
)

RNG = np.random.default_rng(3)
MESHES = pytest.mark.parametrize("mesh", BOXES.values(), ids=BOXES)
METHOD = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
GRAVITY = np.array([0.0, 0.0, -9.81])


def throw(body) -> np.ndarray:
    """The bar's published initial velocities: -40 m/s along z, zero on held nodes."""
    return np.where(body.free_mask[:, None], [0.0, 0.0, -40.0], 0.0)


def energy(body, state) -> float:
    return 0.5 * (state.v * body.momentum(state.v)).sum() + body.energy(state.x)


@pytest.mark.parametrize("dt", [1e-4, 0.01, 0.07])
@METHOD
@MESHES
def test_free_fall_is_its_closed_form(mesh, method, dt):
    d = mesh.dimension
    g, v0 = GRAVITY[-d:], np.array([1.0, -2.0, 3.0])[:d]
    body = make_solid(mesh, load=body_force(mesh, 1000.0 * g), **method)
    last = list_states(body, dt, 20, np.tile(v0, (len(mesh.points), 1)))[-1]
    t = 20 * dt
    wanted = v0 * t + g * t * (t + dt) / 2
    # rounding of K times the distance is multiplied by (omega_max dt)^2: 1e-11 at the last dt, 1e-8 at 3 s
    assert np.abs(last.x - mesh.points - wanted).max() < 1e-10 * np.abs(wanted).max()
    assert np.abs(last.v - v0 - g * t).max() < 1e-10 * np.abs(v0 + g * t).max()


@pytest.mark.parametrize("mode", [0, 3])
@pytest.mark.parametrize("z", [0.02, 0.73, 5.0])
def test_a_mode_decays_and_lags_as_backward_euler_says(mode, z):
    """w = omega q + i q' is divided by 1 + i z in a step: amplitude 1/sqrt(1 + z^2), phase atan z."""
    body = make_clamped_bar()
    found, shapes = find_lowest_frequencies(body, mode + 1)
    omega, shape = found[mode], shapes[mode]
    X, dual = body.mesh.points, body.momentum(shape)
    w = [
        omega * ((s.x - X) * dual).sum() + 1j * (s.v * dual).sum()
        for s in list_states(body, z / omega, 5, 0.3 * shape, X + 0.1 * shape)
    ]
    for before, after in pairwise(w):
        assert after * (1 + 1j * z) == pytest.approx(before, abs=1e-10 * abs(before))
    assert abs(w[1] / w[0]) == pytest.approx(1 / np.hypot(1, z), rel=1e-10)
    assert np.angle(w[0] / w[1]) == pytest.approx(np.arctan(z), rel=1e-10)


def test_damping_of_the_thesis_bar_is_a_third_of_critical():
    assert damping_ratio(10.42 * 0.07) == pytest.approx(0.32, abs=5e-3)  # T: "oscillates until it stops"
    assert damping_ratio(10.42 * 1.9e-3) == pytest.approx(0.01, abs=1e-3)
    assert damping_ratio(1e-4) == pytest.approx(5e-5, rel=1e-6)  # zeta -> z/2


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
@MESHES
def test_an_unforced_linear_step_loses_half_the_squares_of_its_changes(mesh, mass):
    body = make_solid(mesh, held=[0, 1], mass=mass)
    K = body.pattern.matrix(body.linearize(mesh.points)[1])
    v = np.where(body.free_mask[:, None], RNG.standard_normal(mesh.points.shape), 0.0)
    states = list_states(body, 0.01, 20, v)
    start = energy(body, states[0])
    for a, b in pairwise(states):
        dv, du = b.v - a.v, b.x - a.x
        loss = ((dv * body.momentum(dv)).sum() + du.ravel() @ K @ du.ravel()) / 2
        assert energy(body, a) - energy(body, b) == pytest.approx(loss, abs=1e-12 * start)
    assert energy(body, states[-1]) < 0.9 * start


@pytest.mark.parametrize("steps", [1, 7, 60])
@pytest.mark.parametrize("axis", [(0, 0, 1.0), (1.0, 0, 0), (0, 1.0, 0), (1.0, -2.0, 0.5)])
@pytest.mark.parametrize("mesh", [BOXES["triangles"], make_thesis_bar()], ids=["triangles", "bar"])
def test_a_free_linear_body_in_spin_swells_to_37_volumes(mesh, axis, steps):
    """J = 1 + (omega t)^2 at omega t = 6, for every axis, dt and cell: the law mistakes a rotation for a stretch."""
    body = make_solid(mesh)
    omega = 10.0 * (np.array([0.0, 0.0, 1.0]) if mesh.dimension == 2 else np.array(axis))
    t = 6.0 / np.linalg.norm(omega)
    last = list_states(body, t / steps, steps, make_spin(body, omega))[-1]
    J = np.linalg.det(deformation_gradient(mesh, last.x))
    assert pytest.approx(np.full(len(mesh.cells), 37.0), rel=1e-9) == J


@pytest.mark.parametrize("d", [2, 3])
def test_the_first_step_of_a_corotational_spin_swells_by_the_angle_of_one_step(d):
    """One solve uses the rotations it starts from: J = 1 + (omega dt)^2 after the first step."""
    body = make_solid(BOXES["triangles"] if d == 2 else make_thesis_bar(), **METHODS["polar"])
    last = list_states(body, 0.07, 1, make_spin(body, np.array([0.0, 0.0, 10.0])))[-1]
    J = np.linalg.det(deformation_gradient(body.mesh, last.x))
    assert pytest.approx(np.full(len(J), 1 + 0.7**2), rel=1e-9) == J


@METHOD
@MESHES
def test_a_free_body_keeps_its_linear_momentum(mesh, method):
    body = make_solid(mesh, **method)
    v = 20 * RNG.standard_normal(mesh.points.shape)
    for iterations in (1, 3):
        p = [body.momentum(s.v).sum(axis=0) for s in list_states(body, 0.01, 20, v, iterations=iterations)]
        # rounding of sums of elastic forces, which are far above the momentum's own
        assert np.abs(np.array(p) - p[0]).max() < 1e-10 * np.abs(body.momentum(v)).sum()


@METHOD
@pytest.mark.parametrize("iterations", [1, 3])
def test_held_nodes_stay_to_the_bit(method, iterations):
    body = make_clamped_bar(**method)
    held = body.supports.nodes
    for state in list_states(body, 0.07, 5, throw(body), iterations=iterations)[1:]:
        assert np.array_equal(state.x[held], body.mesh.points[held]) and not state.v[held].any()


@METHOD
def test_both_linear_solvers_give_the_same_motion(method):
    body = make_clamped_bar(**method)
    ends = [
        list_states(body, 0.07, 10, throw(body), linear_solver=name, linear_rtol=1e-12)[-1].x
        for name in ("superlu", "cg")
    ]
    # residuals of 1e-12, times a condition number of 1e3 at this step, over ten steps
    assert np.abs(ends[0] - ends[1]).max() < 1e-8 * body.mesh.size


@METHOD
def test_another_numbering_of_the_nodes_changes_nothing(method):
    body = make_clamped_bar(**method)
    mesh = body.mesh
    order = RNG.permutation(len(mesh.points))
    place = np.argsort(order)
    other = make_solid(Mesh(mesh.points[order], place[mesh.cells]), held=place[body.supports.nodes], **method)
    x = list_states(body, 0.07, 20, throw(body))[-1].x
    y = list_states(other, 0.07, 20, throw(other))[-1].x
    assert np.abs(y[place] - x).max() < 1e-10 * np.abs(x - mesh.points).max()


@MESHES
def test_many_frozen_passes_solve_the_implicit_equation(mesh):
    body = make_solid(mesh, **METHODS["polar"])
    v0 = RNG.standard_normal(mesh.points.shape)
    dt = 0.01
    residuals = []
    for passes in (1, 3, 40):
        one = list_states(body, dt, 1, v0, iterations=passes)[-1]
        r = body.momentum(one.v - v0) - dt * body.force(mesh.points + dt * one.v)
        residuals.append(np.abs(r).max() / (dt * np.abs(body.force(mesh.points + dt * v0)).max()))
    assert residuals[0] > residuals[1] > residuals[2] and residuals[2] < 1e-11  # converges linearly


def test_one_solve_is_the_thesis_formula_with_corrected_signs():
    """(M + dt^2 K') v = M v_n + dt (f + f_el(x_n)), assembled densely."""
    load = body_force(make_thesis_bar(), 1000.0 * GRAVITY)
    body = make_clamped_bar(load=load, **METHODS["polar"])
    state = list_states(body, 0.07, 3, throw(body))[-1]
    f, K = body.linearize(state.x)
    M, K = (body.pattern.matrix(A).toarray() for A in (body.mass, K))
    free = (3 * body.free[:, None] + np.arange(3)).ravel()
    b = (body.momentum(state.v) + 0.07 * (load + f)).ravel()[free]
    v = np.linalg.solve((M + 0.07**2 * K)[np.ix_(free, free)], b).reshape(-1, 3)
    after, _ = prepare_stepper(body, 0.07).step(state)
    assert np.abs(after.v[body.free] - v).max() < 1e-11 * np.abs(v).max()
    assert np.array_equal(after.x[body.free], state.x[body.free] + 0.07 * after.v[body.free])


def test_backward_euler_is_of_order_one_if_steps_resolve_the_motion():
    body = make_clamped_bar()
    found, shapes = find_lowest_frequencies(body)
    t = 0.4 / found[0]
    ends = [list_states(body, t / n, n, found[0] * shapes[0])[-1].x - body.mesh.points for n in (16, 32, 64)]
    exact = np.sin(0.4) * shapes[0]
    errors = [np.abs(end - exact).max() for end in ends]
    assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > 0.9)


def test_a_linear_run_factors_once_and_extracts_no_rotation(monkeypatch):
    def fail(F):
        raise AssertionError("a linear scene extracts no rotations")

    monkeypatch.setitem(pipeline.problem.methods.ROTATIONS, "polar", Choice(Rotation(fail), ""))
    body = make_clamped_bar()
    prepared, state, work = prepare_stepper(body, 0.07), State(0, body.mesh.points, throw(body)), Work()
    for _ in range(10):
        state, report = prepared.step(state)
        work += report.work
    assert work == Work(steps=10, solves=10, iterations=10, factorizations=1)


@pytest.mark.parametrize("passes", [1, 3])
def test_every_pass_of_a_corotational_step_is_one_factor_one_solve_and_one_extraction(passes):
    body = make_clamped_bar(**METHODS["polar"])
    _, report = prepare_stepper(body, 0.07, iterations=passes).step(State(0, body.mesh.points, throw(body)))
    assert report.work == Work(steps=1, solves=passes, iterations=passes, factorizations=passes, rotations=passes)


@METHOD
def test_a_step_does_not_change_its_input(method):
    body = make_clamped_bar(**method)
    state = State(0, body.mesh.points.copy(), throw(body))
    before = state.x.copy(), state.v.copy(), body.load.copy()
    prepared = prepare_stepper(body, 0.07)
    first, _ = prepared.step(state)
    kept = first.x.copy(), first.v.copy()
    prepared.step(first)
    for got, wanted in zip((state.x, state.v, body.load, first.x, first.v), (*before, *kept), strict=True):
        assert np.array_equal(got, wanted)


WAYS = ({}, {"iterations": 2}, {"iterations": "converged"}, {"model": "auto"})
EVERY_WAY = [("symplectic_euler", {}), *product(("backward_euler", "bdf2"), WAYS)]


@pytest.mark.parametrize(("name", "changes"), EVERY_WAY, ids=str)
def test_copies_of_a_state_and_a_new_stepper_give_the_same_bits(name, changes):
    body, dt = make_clamped_bar(**METHODS["polar"]), 1e-4 if name == "symplectic_euler" else 0.07
    states = list_states(body, dt, 6, throw(body), stepper=name, **changes)
    prepared = prepare_stepper(body, dt, stepper=name, **changes)
    for before, after in pairwise(states):
        carried = {key: value.copy() for key, value in before.memory.stepper.items()}
        copy = State(before.step, before.x.copy(), before.v.copy(), before.memory._replace(stepper=carried))
        for other in (prepared, prepare_stepper(body, dt, stepper=name, **changes)):
            end, _ = other.step(copy)
            assert end.x.tobytes() == after.x.tobytes() and end.v.tobytes() == after.v.tobytes()


@pytest.mark.parametrize("solver", [SuperLU, make_block_jacobi_cg])
def test_a_singular_system_is_a_clear_error(solver):
    pattern = BlockPattern(np.array([0, 1]), np.array([0]), 3, np.array([0]))
    rest = RestState(np.zeros((1, 3)), lambda: np.eye(3)[None])
    with pytest.raises(SolveError, match="singular"):
        solver(SystemSettings(pattern, 1e-8, rest)).update(np.zeros((1, 3, 3)), lambda Q: np.copyto(Q, np.eye(3)))
