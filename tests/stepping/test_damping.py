"""Rayleigh damping: modal damping against closed forms, rotations that are not damped, energy, every method."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.case import MethodSpec, load_case
from pipeline.errors import CaseError, SolveError
from pipeline.fem.body import Body
from pipeline.fem.damping import Rayleigh, find_mode_root
from pipeline.fem.element import deformation_gradient
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.mesh.quadratic import raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.problem.check import check_problem, format_check
from pipeline.problem.methods import LINEAR_SOLVERS, MODE_FACTORS
from pipeline.problem.problem import build
from pipeline.problem.stage_solvers import make_stepper
from pipeline.run.frame_iterator import frames
from pipeline.stepping.damping import FrozenDamping
from pipeline.stepping.energy_guard import work_of_supports
from pipeline.stepping.state import State
from pipeline.stepping.symplectic_euler import element_limit, true_limit
from tests.bodies import build_problem, list_states, make_rotation, make_solid, make_spin, write_case

BOTH = Rayleigh(3.0, 2e-3)
SHAPES = {"space": box((1.0, 3.0, 1.0), (1, 3, 1)), "plane": rectangle((1.0, 3.0), (1, 3))}
SHAPE = pytest.mark.parametrize("shape", SHAPES)
ORDER = pytest.mark.parametrize("order", [1, 2])
DAMPING = pytest.mark.parametrize(
    "damping",
    [Rayleigh(8.0, 0.0), Rayleigh(0.0, 4e-3), BOTH, Rayleigh(400.0, 0.2)],
    ids=["alpha", "beta", "both", "over"],
)


def make_beam(shape: str = "space", law: str = "linear", order: int = 1, *, damping=BOTH, held=True, **keys) -> Body:
    mesh = SHAPES[shape] if order == 1 else raise_order(SHAPES[shape])
    nodes = np.flatnonzero(mesh.points[:, 1] == 3.0) if held else ()
    return replace(make_solid(mesh, law, held=nodes, **keys), damping=damping)


def follow_mode(body: Body, dt: float, steps: int, amplitude: float = 1e-3, **method) -> tuple[np.ndarray, float]:
    """Return displacement and velocity (steps + 1, 2) along the lowest mode, of a body that starts there, and omega."""
    omega, modes = find_lowest_frequencies(body)
    X, mode = body.mesh.points, modes[0]
    states = list_states(body, dt, steps, 0 * X, X + amplitude * mode, **method)
    weights = body.momentum(mode)
    for state in states:  # it stays along that mode
        u = np.vdot(weights, state.x - X)
        assert np.abs(state.x - X - u * mode).max() < 1e-6 * amplitude * np.abs(mode).max()
    return np.array([[np.vdot(weights, s.x - X), np.vdot(weights, s.v)] for s in states]) / amplitude, float(omega[0])


def make_oscillator(omega: float, damping: Rayleigh) -> np.ndarray:
    """The matrix L of y' = L y for displacement and velocity of a mode."""
    return np.array([[0.0, 1.0], [-(omega**2), -(damping.mass + damping.stiffness * omega**2)]])


@DAMPING
@SHAPE
@ORDER
def test_a_mode_takes_the_steps_of_a_damped_oscillator(shape, order, damping):
    """Backward Euler and BDF2 on y' = L y, and their factor on its modes."""
    body = make_beam(shape, order=order, damping=damping)
    I, dt = np.eye(2), 0.02
    for stepper in MODE_FACTORS:
        y, omega = follow_mode(body, dt, 40, stepper=stepper)
        L = make_oscillator(omega, damping)
        expected = [y[0], np.linalg.solve(I - dt * L, y[0])]
        for _ in range(39):
            b = expected[-1] if stepper == "backward_euler" else (4 * expected[-1] - expected[-2]) / 3
            expected.append(np.linalg.solve(I - dt * L * (1 if stepper == "backward_euler" else 2 / 3), b))
        np.testing.assert_allclose(y, expected, atol=1e-7 * np.abs(y).max())
        zeta = damping.damping_ratio(omega)
        G = MODE_FACTORS[stepper](omega * dt, zeta)
        late = np.array(expected)[6:] if stepper == "bdf2" else np.array(expected)
        if zeta < 1:
            rest = late[2:] - 2 * G.real * late[1:-1] + abs(G) ** 2 * late[:-2]
            assert np.abs(rest).max() < 1e-3 * np.abs(late).max()
        else:
            np.testing.assert_allclose(late[-1] / late[-2], G.real, rtol=1e-3)


def test_a_mode_decays_by_the_formula_as_steps_shrink():
    """zeta = alpha / (2 omega) + beta omega / 2; BDF2 converges with order 2."""
    errors = []
    for dt in (2e-3, 1e-3, 5e-4):
        damping = Rayleigh(2.0, 3e-3)
        y, omega = follow_mode(make_beam(damping=damping), dt, round(0.4 / dt), stepper="bdf2")
        zeta = damping.mass / (2 * omega) + damping.stiffness * omega / 2
        assert 0.05 < zeta < 0.5
        t, turn = 0.4, omega * np.sqrt(1 - zeta**2)
        exact = np.exp(-zeta * omega * t) * (np.cos(turn * t) + zeta / np.sqrt(1 - zeta**2) * np.sin(turn * t))
        errors.append(abs(y[-1, 0] - exact))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.2) and errors[1] / errors[2] == pytest.approx(4, rel=0.1)
    assert errors[2] < 2e-3


@pytest.mark.parametrize("zeta", [0.0, 0.02, 0.9, 1.0, 3.0])
def test_mode_roots_and_factors_are_those_of_the_oscillator(zeta):
    root = find_mode_root(zeta)
    assert abs(root**2 + 2 * zeta * root + 1) < 1e-14
    for factor in MODE_FACTORS.values():
        for z in (1e-4, 1e-3):
            assert factor(z, zeta) == pytest.approx(np.exp(root * z), abs=z * z)


@pytest.mark.parametrize(
    "method", [{"iterations": 1}, {"iterations": 3}, {"iterations": "converged"}, {"model": "auto"}]
)
@ORDER
def test_small_motions_of_the_corotational_law_are_damped_like_those_of_the_linear_one(method, order):
    ways = [("linear", {"law": "linear"}), ("corotational", method)]
    for stepper in MODE_FACTORS:
        y, other = (
            follow_mode(make_beam(law=law, order=order), 0.02, 20, 1e-4, stepper=stepper, **keys)[0]
            for law, keys in ways
        )
        np.testing.assert_allclose(y, other, atol=1e-5 * np.abs(y).max())


# Explicit


@DAMPING
@SHAPE
def test_an_explicit_mode_takes_the_steps_of_the_formula(shape, damping):
    body = make_beam(shape, mass="lumped", damping=damping)
    dt = 0.5 * true_limit(body)
    y, omega = follow_mode(body, dt, 50, stepper="symplectic_euler", mass="lumped")
    u, v = y[0]
    for row in y[1:]:
        v = (v - dt * omega**2 * (u + damping.stiffness * v)) / (1 + damping.mass * dt)
        u += dt * v
        np.testing.assert_allclose(row, [u, v], atol=1e-7 * np.abs(y).max())


@DAMPING
@SHAPE
@pytest.mark.parametrize("law", ["linear", "corotational"])
def test_damping_moves_the_explicit_limit(shape, damping, law):
    """Just below the limit noise decays, just above it grows; the formula is the root of the quadratic."""
    body = make_beam(shape, law, mass="lumped", damping=damping)
    limit, plain = true_limit(body), true_limit(replace(body, damping=None))
    omega = 2 / plain
    square = (limit**2 + 2 * damping.stiffness * limit) * omega**2
    assert square == pytest.approx(4 + 2 * damping.mass * limit, rel=1e-9)
    assert element_limit(body) <= limit and (not damping.stiffness or damping.mass or limit < plain)
    noise = 1e-9 * np.random.default_rng(1).standard_normal(body.mesh.points.shape) * body.free_mask[:, None]
    for share in (0.99, 1.01):
        stepper = make_stepper(body, share * limit, MethodSpec(stepper="symplectic_euler", mass="lumped"))
        state = State(0, body.mesh.points + noise, 0 * noise)
        try:
            for _ in range(1500):
                state, _ = stepper.step(state)
        except SolveError:  # the energy guard
            assert share > 1
        away = np.abs(state.x - body.mesh.points).max()
        assert away < 2e-8 if share < 1 else away > 1e-7


def test_a_step_above_the_damped_limit_is_refused(tmp_path):
    material = {"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0, "stiffness_damping": 0.1}
    method = {"stepper": "symplectic_euler", "mass": "lumped"}
    sections = {"method": method, "schedule": {"dt": 1e-3, "frames": 1}, "variants": {"polar": {}}}
    build_problem(tmp_path, **sections)
    with pytest.raises(CaseError, match=r"schedule\.dt: 0\.001 is above the limit of symplectic_euler"):
        build_problem(tmp_path, **sections, material=material)


# Free bodies


@pytest.mark.parametrize("iterations", [1, 4, "converged"])
@pytest.mark.parametrize("stepper", MODE_FACTORS)
def test_alpha_slows_a_free_body_and_beta_does_not(stepper, iterations):
    body = make_beam(law="corotational", held=False)
    drift = np.broadcast_to([1.0, -2.0, 3.0], body.mesh.points.shape)
    dt = 0.05
    states = list_states(body, dt, 8, drift, stepper=stepper, iterations=iterations)
    v = [1.0, 1 / (1 + BOTH.mass * dt)]
    for _ in range(7):
        v.append(
            v[-1] / (1 + BOTH.mass * dt)
            if stepper == "backward_euler"
            else (4 * v[-1] - v[-2]) / (3 + 2 * BOTH.mass * dt)
        )
    for state, part in zip(states, v, strict=True):
        np.testing.assert_allclose(state.v, part * drift, atol=1e-9)


@SHAPE
@ORDER
@pytest.mark.parametrize("way", [{"iterations": 1}, {"iterations": 4}, {"iterations": "converged"}, {"model": "auto"}])
@pytest.mark.parametrize("stepper", MODE_FACTORS)
def test_beta_does_not_damp_a_rotation(shape, order, stepper, way):
    """A free body turns by .025 rad a step; beta is as long as the step. The undamped motion is compared with."""
    dt, ends = 0.05, []
    for damping in (None, Rayleigh(0.0, dt)):
        body = make_beam(shape, "corotational", order, held=False, damping=damping)
        v = make_spin(body, np.array([0.0, 0.0, 0.5]))
        ends.append(list_states(body, dt, 20, v, stepper=stepper, **way)[-1])
    spin = [float(np.linalg.norm(make_angular_momentum(body, s))) for s in ends]
    start = float(np.linalg.norm(make_angular_momentum(body, State(0, body.mesh.points, v))))
    assert spin[0] - 1.5e-3 * start < spin[1] < start
    for end in ends:  # tan^2 of .025 is 6.3e-4; one solve of a body with beta = dt keeps twice that
        ratio = np.linalg.det(deformation_gradient(body.mesh, end.x))
        assert np.abs(ratio - 1).max() < (1.4e-3 if way in ({"iterations": 1}, {"model": "auto"}) else 7e-4)


@SHAPE
@ORDER
def test_the_damping_force_of_a_rotation_is_of_fourth_order(shape, order):
    """Frozen in the middle of the step from x_n, a rigid rotation by t has a force of order t^4; at x_n it is t^2."""
    body, h, forces = make_beam(shape, "corotational", order, held=False, damping=Rayleigh(0.0, 1.0)), 0.1, []
    assert body.damping is not None
    frozen, X = FrozenDamping(body, body.damping), body.mesh.points
    for angle in (0.2, 0.1, 0.05):
        frozen.freeze_middle(X, make_spin(body, np.array([0.0, 0.0, angle / h])), h)
        Q = make_rotation(X.shape[1], [0.0, 0.0, 1.0], angle)
        forces.append(np.linalg.norm(frozen.multiply(X @ Q.T - X)) / h)
        frozen.freeze(X, h)
        assert forces[-1] < 0.2 * np.linalg.norm(frozen.multiply(X @ Q.T - X)) / h
    assert forces[0] / forces[1] == pytest.approx(16, rel=0.02) and forces[1] / forces[2] == pytest.approx(16, rel=0.01)


@pytest.mark.parametrize("beta", [0.05, 0.5])
@SHAPE
def test_auto_keeps_its_tolerance_in_damped_spins(shape, beta):
    body = make_beam(shape, "corotational", held=False, damping=Rayleigh(0.0, beta))
    v = make_spin(body, np.array([0.0, 0.0, 2.0]))
    for state in list_states(body, 0.05, 20, v, model="auto"):
        assert np.abs(np.linalg.det(deformation_gradient(body.mesh, state.x)) - 1).max() < 0.01


def make_angular_momentum(body: Body, state: State) -> np.ndarray:
    p = body.momentum(state.v)
    if p.shape[1] == 2:
        return np.array([(state.x[:, 0] * p[:, 1] - state.x[:, 1] * p[:, 0]).sum()])
    return np.cross(state.x, p).sum(axis=0)


# Every method


@pytest.mark.parametrize("stepper", MODE_FACTORS)
@ORDER
def test_many_passes_end_where_newtons_method_does(stepper, order):
    body = make_beam(law="corotational", order=order, damping=Rayleigh(1.0, 5e-4))
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -20.0], 0.0)
    ends = [
        [s.x for s in list_states(body, 0.03, 6, v, stepper=stepper, iterations=iterations, tolerance=1e-12)]
        for iterations in (40, "converged")
    ]
    assert np.abs(ends[0] - body.mesh.points).max() > 0.1
    np.testing.assert_allclose(*ends, atol=1e-9)


@pytest.mark.parametrize("stepper", MODE_FACTORS)
@SHAPE
def test_auto_stays_near_the_converged_motion(stepper, shape):
    body = make_beam(shape, "corotational", damping=Rayleigh(0.0, 0.01))
    v = np.zeros_like(body.mesh.points)
    v[:, -1 if shape == "space" else 0] = np.where(body.free_mask, -20.0, 0.0)
    ends = [
        list_states(body, 0.01, 60, v, stepper=stepper, **method)[-1]
        for method in ({"model": "auto"}, {"iterations": "converged"})
    ]
    span = np.abs(ends[1].x - body.mesh.points).max()
    assert np.abs(ends[0].x - ends[1].x).max() < 0.02 * max(span, 1.0)


@pytest.mark.parametrize("solver", LINEAR_SOLVERS)
def test_every_solver_solves_damped_systems(solver):
    body = make_beam(law="corotational", damping=Rayleigh(1.0, 0.02))
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -20.0], 0.0)
    ends = [list_states(body, 0.03, 6, v, linear_solver=name)[-1].x for name in ("superlu", solver)]
    assert np.abs(ends[0] - ends[1]).max() < 1e-6


@pytest.mark.parametrize("stepper", MODE_FACTORS)
@pytest.mark.parametrize("iterations", [1, 3, "converged"])
def test_the_equilibrium_is_that_of_the_undamped_body(stepper, iterations):
    ends = []
    for damping in (None, Rayleigh(5.0, 0.5)):
        body = make_beam(law="corotational", damping=damping)
        load = 3e4 * body.momentum(np.broadcast_to([0.0, 0.0, -1e-2], body.mesh.points.shape))
        body = replace(body, load=load)
        v = np.zeros_like(load)
        ends.append(list_states(body, 1e6, 12, v, stepper=stepper, iterations=iterations)[-1].x)
    assert np.abs(ends[0] - body.mesh.points).max() > 0.1
    assert np.abs(ends[0] - ends[1]).max() < 1e-6


@pytest.mark.parametrize("damping", [Rayleigh(0.0, 1e3), Rayleigh(1e6, 0.0), Rayleigh(1e4, 10.0)])
@pytest.mark.parametrize("dt", [1e-4, 0.05, 10.0])
@pytest.mark.parametrize("stepper", MODE_FACTORS)
def test_newtons_method_converges_with_any_damping(damping, dt, stepper):
    body = make_beam(law="corotational", damping=damping)
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -20.0], 0.0)
    states = list_states(body, dt, 5, v, stepper=stepper, iterations="converged")
    assert np.isfinite(states[-1].x).all() and np.abs(states[-1].x - body.mesh.points).max() < 20 * 5 * dt


@ORDER
def test_a_damped_converged_step_never_gains_energy(order):
    body = make_beam(law="corotational", order=order, damping=Rayleigh(0.5, 5e-3))
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -40.0], 0.0)
    states = list_states(body, 0.02, 40, v, iterations="converged")
    energies = [0.5 * np.vdot(s.v, body.momentum(s.v)) + body.energy(s.x) for s in states]
    assert (np.diff(energies) <= 1e-9 * energies[0]).all() and energies[-1] < 0.05 * energies[0]


def test_supports_that_move_a_damped_body_supply_its_losses(tmp_path):
    """The work counts the damping forces on the supports: a foot dragged through alpha M v alone takes that force."""
    drag = {"plane": "y", "at": 3.0, "motion": {"velocity": [2.0, 0.0, 0.0]}}
    material = {"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0, "mass_damping": 50.0}
    one = build_problem(
        tmp_path, supports=[drag], loads=None, initial=None, material=material, schedule={"dt": 0.02, "frames": 60}
    )
    assert one.body.damping == Rayleigh(50.0, 0.0)
    states = [frame.state for frame in frames(one)]
    work = work_of_supports(one.body, states[-2], states[-1], 0.02)
    assert work == pytest.approx(50.0 * 3000.0 * 2.0 * 2.0 * 0.02, rel=0.05)


@pytest.mark.parametrize("stepper", MODE_FACTORS)
def test_a_second_stepper_goes_on_to_the_last_bit(stepper):
    body = make_beam(law="corotational")
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -20.0], 0.0)
    method = MethodSpec(stepper=stepper, iterations=2, linear_solver="warped")
    one, state = make_stepper(body, 0.02, method), State(0, body.mesh.points, v)
    for _ in range(5):
        state, _ = one.step(state)
    other, middle = make_stepper(body, 0.02, method), state
    for _ in range(3):
        state, middle = one.step(state)[0], other.step(middle)[0]
    assert np.array_equal(state.x, middle.x) and np.array_equal(state.v, middle.v)


def test_a_body_without_damping_never_freezes_any(tmp_path, monkeypatch):
    monkeypatch.setattr(FrozenDamping, "__init__", None)
    zero = {"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1000.0, "mass_damping": 0, "stiffness_damping": 0.0}
    ends = []
    for keys in ({}, {"material": zero}):
        one = build_problem(tmp_path, **keys)
        assert one.body.damping is None
        ends.append([frame.x for frame in frames(one)][-1])
    assert np.array_equal(*ends)


@pytest.mark.parametrize("key", ["mass_damping", "stiffness_damping"])
@pytest.mark.parametrize(("value", "message"), [(-1.0, "-1.0 is negative"), ("a", "'a' is not a number")])
def test_wrong_damping_is_refused(tmp_path, key, value, message):
    with pytest.raises(CaseError, match=f"material.{key}: {message}"):
        load_case(write_case(tmp_path), overrides={f"material.{key}": value})


# pipeline check


def test_check_has_the_damping_of_the_material(tmp_path):
    case = load_case(write_case(tmp_path), overrides={"material.stiffness_damping": 2e-3, "material.mass_damping": 0.4})
    one = build(case.variant("polar"))
    check = check_problem(one)
    zeta = 0.2 / check.omega_1 + 1e-3 * check.omega_1
    assert check.material_damping == pytest.approx(zeta)
    G = 1 / (1 - check.z * complex(-zeta, np.sqrt(1 - zeta**2)))
    assert check.damping == pytest.approx(-np.log(abs(G)) / abs(np.log(G)))
    rows = format_check(check, one)
    text = f"damping      the material damps that mode by {100 * zeta:.3g} % of critical, with backward_euler by "
    assert any(row.startswith(text) and "% more than the material take dt near" in row for row in rows)


def test_check_of_an_overdamped_body_has_no_phase(tmp_path):
    case = load_case(write_case(tmp_path), overrides={"material.stiffness_damping": 10.0})
    one = build(case.variant("polar"))
    check = check_problem(one)
    assert check.material_damping > 1 and check.damping == 1.0 and np.isnan(check.phase_lag)
    assert not any(row.startswith("phase") for row in format_check(check, one))


def test_damping_acts_on_all_materials_of_a_body(tmp_path):
    """A mode of two materials takes the steps of the formula; a region has no damping of its own."""
    base = {"youngs_modulus": 1e7, "poisson_ratio": 0.3, "density": 1e3, "mass_damping": 2.0, "stiffness_damping": 5e-3}
    soft = {"youngs_modulus": 1e6, "poisson_ratio": 0.2, "density": 500.0, "below": {"axis": "y", "at": 1.5}}
    one = build_problem(tmp_path, "linear", material=base, materials=[soft], loads=None)
    y, omega = follow_mode(one.body, 0.02, 10)
    step = np.linalg.inv(np.eye(2) - 0.02 * make_oscillator(omega, Rayleigh(2.0, 5e-3)))
    np.testing.assert_allclose(y[1:], y[:-1] @ step.T, atol=1e-7 * np.abs(y).max())
    with pytest.raises(CaseError, match=r"materials\.0\.mass_damping: unknown key"):
        build_problem(tmp_path, materials=[soft | {"mass_damping": 1.0}])
