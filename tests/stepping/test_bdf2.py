"""BDF2: its root on one mode, the order of both steppers, its start, and supports held and moved exactly."""

from functools import cache

import numpy as np
import pytest

from pipeline.fem.modes import find_lowest_frequencies
from pipeline.fem.supports import RigidMotion
from pipeline.linear.work import Work
from pipeline.mesh.shapes import box, rectangle
from pipeline.run.frame_iterator import frames
from pipeline.stepping.bdf2 import mode_factor
from pipeline.stepping.state import Memory, State
from tests.bodies import METHODS, build_problem, list_states, make_clamped_bar, make_solid, prepare_stepper

ITERATIONS = pytest.mark.parametrize("iterations", [1, "converged"])


def root(z: float) -> complex:
    """The larger G of 3/2 - 2/G + 1/(2 G^2) = -i z, of w' = -i omega w."""
    return complex(max(np.roots([1.5 + 1j * z, -2.0, 0.5]), key=abs))


@pytest.mark.parametrize("mode", [0, 3])
@pytest.mark.parametrize("z", [0.02, 0.73, 20.0])
def test_a_mode_decays_and_lags_by_the_larger_root(mode, z):
    """w = omega q + i q' of one mode, started on the branch of the larger root, for which the squared formula holds."""
    body = make_clamped_bar()
    found, shapes = find_lowest_frequencies(body, mode + 1)
    omega, shape = found[mode], shapes[mode]
    X, dual = body.mesh.points, body.momentum(shape)
    G = root(z)
    assert mode_factor(z) == pytest.approx(G.conjugate(), rel=1e-12)
    assert abs((1.5 - 2 / G + 1 / (2 * G**2)) ** 2 + z**2) < 1e-12 * max(1.0, z**2)
    # 1e3 sqrt(kg) m: meters, so that the rest of it after some steps is far above the rounding of X
    w = [1e3 * omega * (1 + 3j), 1e3 * omega * (1 + 3j) * G]
    (x_before, v_before), (x, v) = ((X + one.real / omega * shape, one.imag * shape) for one in w)
    prepared = prepare_stepper(body, z / omega, stepper="bdf2")
    state = State(1, x, v, Memory({"x_before": x_before, "v_before": v_before}))
    for _ in range(5):
        state, _ = prepared.step(state)
        w.append(omega * ((state.x - X) * dual).sum() + 1j * (state.v * dual).sum())
        assert abs(w[-1] / w[-2]) == pytest.approx(abs(G), rel=1e-10)
        assert np.angle(w[-2] / w[-1]) == pytest.approx(-np.angle(G), rel=1e-10)


def test_bdf2_damps_by_the_fourth_power_of_the_step_and_backward_euler_by_its_square():
    z = np.array([0.02, 0.01])
    lost = 1 - np.abs([root(one) for one in z])
    assert np.log2(lost[0] / lost[1]) == pytest.approx(4.0, abs=0.01)
    assert abs(root(1e6)) < 1e-2  # L-stable


@ITERATIONS
@pytest.mark.parametrize("method", ["linear", "polar"])
def test_the_first_step_is_backward_eulers(method, iterations):
    body = make_clamped_bar(**METHODS[method])
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -40.0], 0.0)
    one, other = (
        list_states(body, 0.07, 1, v, stepper=name, iterations=iterations)[-1] for name in ("bdf2", "backward_euler")
    )
    assert np.array_equal(one.x, other.x) and np.array_equal(one.v, other.v)


def make_swinging_beam(d: int) -> tuple:
    """A clamped beam, two cells long, in its lowest mode: its tip swings by almost half its length.

    So few cells have no motion that the steps below do not resolve.
    """
    mesh = rectangle((1.0, 2.0), (1, 2)) if d == 2 else box((1.0, 2.0, 1.0), (1, 2, 1))
    body = make_solid(mesh, held=np.flatnonzero(mesh.points[:, 1] == 0.0), **METHODS["polar"])
    found, shapes = find_lowest_frequencies(body)
    return body, found[0], found[0] * shapes[0] / np.abs(shapes[0]).max()


def end(d: int, name: str, iterations: object, n: int) -> np.ndarray:
    """The beam's positions after a radian of its phase in n steps."""
    body, omega, v = make_swinging_beam(d)
    return list_states(body, 1 / omega / n, n, v, stepper=name, iterations=iterations)[-1].x


@cache
def exact_end(d: int) -> np.ndarray:
    """Extrapolated from 1024 and 2048 steps; its error, of the third order, is below 1e-7 m."""
    coarse, fine = (end(d, "bdf2", 1, n) for n in (1024, 2048))
    return fine + (fine - coarse) / 3


def errors(d: int, name: str, iterations: object, counts: tuple[int, ...]) -> np.ndarray:
    """The largest distances [m] from the exact end."""
    return np.array([np.abs(end(d, name, iterations, n) - exact_end(d)).max() for n in counts])


@ITERATIONS
@pytest.mark.parametrize("d", [2, 3])
def test_bdf2_is_of_order_two_and_backward_euler_of_order_one(d, iterations):
    bdf2 = errors(d, "bdf2", iterations, (128, 256, 512))
    euler = errors(d, "backward_euler", iterations, (128, 256, 512))
    # measured: 2.00 2.00 (2D), 1.92 1.97 (3D); .99 1.00 and .95 .97; z = omega dt is below .008
    assert (np.log2(bdf2[:-1] / bdf2[1:]) >= 1.9).all()
    assert (np.log2(euler[:-1] / euler[1:]) >= 0.9).all()
    assert euler[1] / bdf2[1] > 19  # measured at 256 steps: 88 to 101


@ITERATIONS
def test_free_fall_is_exact_but_for_its_first_step(iterations):
    """x = x0 + v0 t + g t^2/2, plus the error of the first step of backward Euler: g dt^2/2 (1 + 1/3 + 1/9 …) in x."""
    mesh, dt = box((2.0, 3.0, 1.0), (2, 3, 1)), 0.03
    g = np.array([0.0, 0.0, -9.81])
    body = make_solid(mesh, load=1000.0 * mesh.node_volumes[:, None] * g, **METHODS["polar"])
    v0 = np.array([1.0, -2.0, 3.0])
    for s in list_states(body, dt, 20, np.tile(v0, (len(mesh.points), 1)), stepper="bdf2", iterations=iterations):
        t = s.step * dt
        begun = 0.75 * (1 - (1 / 3) ** s.step) * dt**2
        assert s.x - mesh.points == pytest.approx(np.tile(v0 * t + g * (t**2 / 2 + begun), (len(s.x), 1)), abs=1e-11)
        assert s.v == pytest.approx(np.tile(v0 + g * t, (len(s.x), 1)), abs=1e-10)


@ITERATIONS
@pytest.mark.parametrize("variant", ["linear", "polar"])
def test_held_nodes_stay_and_moved_ones_follow_their_motion_to_the_bit(tmp_path, variant, iterations):
    moved = {"velocity": [0.3, 0.0, 0.0], "spin": {"axis": [0.0, 1.0, 0.0], "rate": 200.0, "center": [0.5, 0.0, 0.5]}}
    supports = [{"plane": "y", "at": 3.0}, {"plane": "y", "at": 0.0, "motion": moved}]
    one = build_problem(tmp_path, variant, supports=supports, method={"stepper": "bdf2", "iterations": iterations})
    X = one.body.mesh.points
    (nodes, moving), *others = one.body.supports.motions
    assert isinstance(moving, RigidMotion) and not others
    for frame in frames(one):
        assert np.array_equal(frame.x[X[:, 1] == 3.0], X[X[:, 1] == 3.0])
        assert np.array_equal(frame.x[nodes], moving.positions(X[nodes], frame.time))


@pytest.mark.parametrize("method", ["linear", "polar"])
def test_a_step_is_one_solve_and_the_linear_law_factors_twice_in_all(method):
    """Backward Euler's M + dt^2 K for the first step, M + (2 dt/3)^2 K for all others."""
    body = make_clamped_bar(**METHODS[method])
    prepared, state, work = (
        prepare_stepper(body, 0.07, stepper="bdf2"),
        State(0, body.mesh.points, 0 * body.mesh.points),
        Work(),
    )
    for _ in range(5):
        state, report = prepared.step(state)
        work += report.work
    linear = method == "linear"
    wanted = Work(steps=5, solves=5, iterations=5, factorizations=2 if linear else 5, rotations=0 if linear else 5)
    assert work == wanted
