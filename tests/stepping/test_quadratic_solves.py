"""Newton's method, auto and the energy guard on meshes of order 2: scales, iterations, bounds."""

import numpy as np
import pytest

from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.element import deformation_gradient
from pipeline.mesh.quadratic import make_quadratic_mesh, raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.stepping.energy_guard import EnergyGuard
from pipeline.stepping.state import State
from pipeline.stepping.symplectic_euler import SymplecticEuler, element_limit, true_limit
from tests.bodies import METHODS, list_states, make_solid, make_spin, prepare_stepper

POLAR = METHODS["polar"]


def make_beam(d: int, *, curved: bool = False, order: int = 2, **keywords: object) -> Body:
    """The thesis' bar with cells of twice its size, held at y = 12; `curved` turns its straight sides into arcs."""
    mesh = box((4.0, 12.0, 4.0), (1, 4, 1)) if d == 3 else rectangle((4.0, 12.0), (1, 4))
    if order == 2:
        mesh = raise_order(mesh)
        if curved:
            X = mesh.points.copy()
            X[:, 0] += 0.01 * X[:, 1] ** 2
            mesh = make_quadratic_mesh(X, mesh.cells)
            assert not mesh.is_straight
    held = np.flatnonzero(mesh.points[:, 1] == 12.0)
    return make_solid(mesh, held=held, **{**POLAR, **keywords})


def throw(body: Body, speed: float) -> np.ndarray:
    return np.where(body.free_mask[:, None], -speed * np.eye(body.mesh.dimension)[-1], 0.0)


# Newton


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_near_rest_good_steps_are_not_halved_for_rounding_of_the_energy(d, curved, seed):
    """As with order 1: the strain that rounding of positions causes has the right size."""
    body = make_beam(d, curved=curved)
    X = body.mesh.points
    away = np.random.default_rng(seed).uniform(-0.2, 0.2, X.shape)
    prepared = prepare_stepper(body, 0.07, iterations="converged")
    state = State(0, X + np.where(body.free_mask[:, None], away, 0.0), 0 * away)
    counts = []
    for _ in range(60):
        state, report = prepared.step(state)
        counts.append(report.work.iterations)
    assert max(counts) <= 12 and max(counts[15:]) <= 3, counts
    assert np.abs(state.x - X).max() < 5e-6  # measured: 3e-6, of the lowest mode


@pytest.mark.parametrize("speed", [20.0, 120.0])
@pytest.mark.parametrize("d", [2, 3])
def test_newton_takes_as_many_iterations_as_with_order_one(d, speed):
    counts = []
    for order in (1, 2):
        body = make_beam(d, order=order)
        prepared, state = (
            prepare_stepper(body, 0.05, iterations="converged"),
            State(0, body.mesh.points, throw(body, speed)),
        )
        total = 0
        for _ in range(20):
            state, report = prepared.step(state)
            total += report.work.iterations
        counts.append(total)
    assert counts[1] <= 1.3 * counts[0], counts


def test_a_body_at_rest_needs_no_iteration():
    body = make_beam(3)
    _, report = prepare_stepper(body, 0.05, iterations="converged").step(State(0, body.mesh.points, throw(body, 0.0)))
    assert report.work.iterations == 0


# auto


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("time_stepper", ["backward_euler", "bdf2"])
@pytest.mark.parametrize("d", [2, 3])
def test_auto_keeps_its_tolerance_and_is_near_the_converged_motion(d, time_stepper, curved):
    body = make_beam(d, curved=curved)
    X, v = body.mesh.points, throw(body, 20.0)
    prepared, state = prepare_stepper(body, 0.02, model="auto", stepper=time_stepper), State(0, X, v)
    wanted = list_states(body, 0.02, 25, v, iterations="converged", stepper=time_stepper)
    solves = 0
    for other in wanted[1:]:
        state, report = prepared.step(state)
        assert report.choice is not None and report.choice.indicator <= 0.01
        solves += report.choice.solves
        J, K = (np.linalg.det(deformation_gradient(body.mesh, x)) for x in (state.x, other.x))
        assert np.abs(J - K).max() < 0.01
    moved = max(np.abs(other.x - X).max() for other in wanted)
    assert np.abs(state.x - wanted[-1].x).max() < 0.05 * moved
    assert solves <= 60  # measured: 25 to 50 in 25 steps


@pytest.mark.parametrize("d", [2, 3])
def test_rotations_that_are_reached_are_the_same_bits_however_they_are_measured(d):
    """A resumed run measures them again, by another function."""
    body = make_beam(d)
    x = body.mesh.points + 0.05 * np.random.default_rng(0).normal(size=body.mesh.points.shape)
    R, S, T = np.empty((3, body.site_count, d, d))
    body.update_rotations(x, R)
    body.measure_frame_error(x, None, S)
    body.measure_frame_error(x, R, T)
    assert R.tobytes() == S.tobytes() == T.tobytes()
    assert R.tobytes() == body.rotations(x).tobytes()


# The energy guard


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_the_mass_bound_of_the_guard_is_one(d, curved, mass):
    body = make_beam(d, curved=curved, mass=mass)
    b = np.repeat(body.mass_bound, d)
    M = body.pattern.matrix(body.mass).toarray()
    assert np.linalg.eigvalsh(np.diag(b) - M).min() > -1e-9 * b.max()
    assert b.sum() < 2.5 * M.sum()  # and of use
    rng = np.random.default_rng(0)
    for _ in range(20):
        v = rng.normal(size=body.mesh.points.shape)
        assert (v * body.momentum(v)).sum() <= (body.mass_bound[:, None] * v**2).sum() * (1 + 1e-12)


def test_one_solve_of_a_long_bar_in_fast_spin_is_stopped_while_its_numbers_are_finite():
    mesh = raise_order(box((2.0, 24.0, 4.0), (1, 4, 1)))
    body = make_solid(mesh, **POLAR)
    state = State(0, mesh.points, make_spin(body, np.array([0.0, 0.0, 10.0])))
    prepared = prepare_stepper(body, 0.5)
    assert isinstance(prepared, EnergyGuard)
    with pytest.raises(SolveError, match="the step is unstable"):
        for _ in range(150):
            state, _ = prepared.step(state)
            assert np.isfinite(state.x).all() and np.isfinite(state.v).all()


# The explicit limit


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("way", ["linear", "polar"])
@pytest.mark.parametrize("d", [2, 3])
def test_the_limit_of_lumped_masses_lies_above_its_bounds_and_divides_calm_from_blown_up(d, way, curved):
    """The masses are the scaled diagonal of Hinton, Rock and Zienkiewicz."""
    body = make_beam(d, curved=curved, mass="lumped", **METHODS[way])
    X, limit = body.mesh.points, true_limit(body)
    assert 0.5 * limit < element_limit(body) <= limit
    assert 2 / limit <= body.frequency_bound < 5 * 2 / limit
    assert (body.lumped_mass > 0).all()
    assert body.lumped_mass.sum() == pytest.approx(1000.0 * body.mesh.rest_volumes.sum(), rel=1e-12)
    noise = np.where(body.free_mask[:, None], 1e-5 * np.random.default_rng(3).standard_normal(X.shape), 0.0)

    def measure_speed(v: np.ndarray) -> float:
        return float(np.sqrt((body.momentum(v) * v).sum()))

    for share, grows in ((0.99, False), (1.01, True)):
        stepper, state = SymplecticEuler(body, share * limit), State(0, X, noise)
        largest = 0.0
        for _ in range(400):
            state, _ = stepper.step(state)
            largest = max(largest, measure_speed(state.v))
            if largest > 1e3 * measure_speed(noise):
                break
        if grows:
            assert largest > 1e3 * measure_speed(noise)
        else:
            assert largest < measure_speed(noise) / np.sqrt(1 - 0.99**2)
