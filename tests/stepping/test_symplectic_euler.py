"""Symplectic Euler: the limits of its step, refusal of larger ones, momenta, order, and no matrix."""

from collections.abc import Iterator

import numpy as np
import pytest

import pipeline.fem.body
from pipeline.errors import CaseError
from pipeline.fem.assembly import Assembly
from pipeline.fem.body import Body
from pipeline.fem.material import Material
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.linear.work import Work
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh
from pipeline.problem.methods import STEP_LIMITS
from pipeline.run.frame_iterator import frames
from pipeline.stepping.state import State
from pipeline.stepping.symplectic_euler import SymplecticEuler, element_limit, true_limit
from tests.bodies import (
    METHODS,
    PLANAR,
    build_problem,
    list_states,
    make_clamped_bar,
    make_solid,
    make_spin,
    make_thesis_bar,
    prepare_stepper,
)

RNG = np.random.default_rng(12)
EXPLICIT = {"stepper": "symplectic_euler"}
THIN = rectangle((4.0, 12.0), (2, 8))  # the bar in the plane


def clamp_beam(d: int, **keywords: object) -> Body:
    if d == 3:
        return make_clamped_bar(mass="lumped", **keywords)
    return make_solid(THIN, held=np.flatnonzero(THIN.points[:, 1] == 12.0), mass="lumped", **keywords)


def iterate_states(body: Body, dt: float, x: np.ndarray, v: np.ndarray, steps: int) -> Iterator[State]:
    """The stepper alone: no limit, no guard."""
    prepared, state = SymplecticEuler(body, dt), State(0, x, v)
    for _ in range(steps):
        state, _ = prepared.step(state)
        yield state


def angular_momentum(body: Body, state: State) -> np.ndarray:
    """The angular momentum about the origin; one component in the plane."""
    x, p = state.x, body.lumped_mass[:, None] * state.v
    return np.cross(x, p).sum(axis=0) if x.shape[1] == 3 else np.array((x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0]).sum())


def test_the_thesis_bar_has_its_known_limits():
    body = clamp_beam(3)
    assert true_limit(body) == pytest.approx(2.895e-3, abs=5e-7)
    assert 2 / true_limit(body) == pytest.approx(690.7, abs=0.05 + 5e-3)  # 690.75 here
    assert element_limit(body) == pytest.approx(2.171e-3, abs=5e-7)


REGULAR = [[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]]
KUHN = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]]
EQUILATERAL = [[0.0, 0], [1, 0], [0.5, 0.75**0.5]]
RIGHT = [[0.0, 0], [1, 0], [0, 1]]


@pytest.mark.parametrize(
    ("corners", "wanted"),
    [(REGULAR, 0.5**0.5), (KUHN, 0.5412), (EQUILATERAL, 0.8165), (RIGHT, 2 / 3)],
    ids=["regular tetrahedron", "kuhn", "equilateral", "right isosceles"],
)
def test_a_cell_alone_is_limited_by_the_time_sound_takes_along_its_shortest_edge(corners, wanted):
    mesh = Mesh(np.array(corners), np.arange(len(corners))[None])
    edges = np.linalg.norm(mesh.points[:, None] - mesh.points, axis=-1)
    body = make_solid(mesh, material=Material(9.0, 0.0, 4.0), mass="lumped")
    found = element_limit(body) * body.material.wave_speed / edges[edges > 0].min()
    assert found == pytest.approx(wanted, abs=5e-5)
    assert true_limit(body) == pytest.approx(element_limit(body), rel=1e-9)


@pytest.mark.parametrize(("height", "wanted"), [(1.0, 0.450), (0.1, 0.0742), (0.01, 0.00745), (0.001, 0.000745)])
def test_a_sliver_is_limited_by_its_height(height, wanted):
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, height]]), np.arange(4)[None])
    body = make_solid(mesh, material=Material(1.0, 0.3, 1.0), mass="lumped")
    assert element_limit(body) == pytest.approx(wanted, rel=1.2e-3)  # three digits are given
    assert true_limit(body) == pytest.approx(element_limit(body), rel=1e-6)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("held", ["nothing", "one end", "all but one node"])
def test_the_bound_over_cells_is_below_the_limit_of_the_dense_matrices(d, held):
    mesh = rectangle((2.0, 3.0), (2, 3)) if d == 2 else box((2.0, 3.0, 1.0), (2, 3, 1))
    nodes = {
        "nothing": [],
        "one end": np.flatnonzero(mesh.points[:, 1] == 0.0),
        "all but one node": range(1, len(mesh.points)),
    }
    body = make_solid(mesh, held=nodes[held], mass="lumped", **METHODS["polar"])
    free = (d * body.free[:, None] + np.arange(d)).ravel()
    K = body.pattern.matrix(body.linearize(mesh.points)[1]).toarray()[np.ix_(free, free)]
    root = np.sqrt(np.repeat(body.lumped_mass, d)[free])
    dense = 2 / np.sqrt(np.linalg.eigvalsh(K / root / root[:, None])[-1])
    assert true_limit(body) == pytest.approx(dense, rel=1e-8)
    assert element_limit(body) <= dense


@pytest.mark.parametrize("method", ["linear", "polar"])
@pytest.mark.parametrize("d", [2, 3])
def test_just_below_the_limit_noise_stays_and_just_above_it_diverges(d, method):
    body = clamp_beam(d, **METHODS[method])
    X, limit = body.mesh.points, true_limit(body)
    noise = np.where(body.free_mask[:, None], 1e-3 * RNG.standard_normal(X.shape), 0.0)

    def speed(v: np.ndarray) -> float:
        return float(np.sqrt((body.momentum(v) * v).sum()))

    # every mode keeps v^2 + omega^2 x^2 - omega^2 dt x v, so its speed stays below v_0 / sqrt(1 - (omega dt / 2)^2)
    largest = max(speed(s.v) for s in iterate_states(body, 0.99 * limit, X, noise, 1000))
    assert largest < speed(noise) / np.sqrt(1 - 0.99**2)
    for state in iterate_states(body, 1.01 * limit, X, noise, 250):
        if speed(state.v) > 1e3 * speed(noise):
            return
    pytest.fail(f"grew to {speed(state.v) / speed(noise):.3g} only")


def test_a_step_above_the_limit_is_refused_with_both_limits(tmp_path):
    bar = {
        "mesh": {"shape": "box", "size": [4.0, 12.0, 4.0], "cells": [2, 8, 2]},
        "supports": [{"plane": "y", "at": 12.0}],
    }
    bar["material"] = {"youngs_modulus": 1e8, "poisson_ratio": 0.33, "density": 1000.0}
    build_problem(tmp_path, method=EXPLICIT, schedule={"dt": 2.89e-3, "frames": 1}, **bar)
    said = r"schedule\.dt: 0\.0029 is above the limit of symplectic_euler: 0\.002895 s for this body, 0\.002171 s by"
    with pytest.raises(CaseError, match=said):
        build_problem(tmp_path, method=EXPLICIT, schedule={"dt": 2.9e-3, "frames": 1}, **bar)


@pytest.mark.parametrize("sections", [{}, PLANAR], ids=["3D", "2D"])
def test_the_limit_itself_is_computed_only_above_the_bound_over_cells(tmp_path, monkeypatch, sections):
    body = build_problem(tmp_path, **sections).body
    below, above = element_limit(body), true_limit(body)
    assert below < 0.95 * above
    calls = []

    def count_call(body: Body) -> float:
        calls.append(body)
        return true_limit(body)

    monkeypatch.setitem(STEP_LIMITS, "symplectic_euler", (element_limit, count_call))  # type: ignore[arg-type]  # Mapping to the reader
    build_problem(tmp_path, method=EXPLICIT, schedule={"dt": 0.999 * below, "frames": 1}, **sections)
    assert not calls
    build_problem(tmp_path, method=EXPLICIT, schedule={"dt": 0.999 * above, "frames": 1}, **sections)
    assert len(calls) == 1


def test_a_written_consistent_mass_is_refused_and_an_inherited_one_lumped_with_a_note(tmp_path):
    schedule = {"dt": 1e-4, "frames": 1}
    with pytest.raises(CaseError, match=r"method\.mass: symplectic_euler needs 'lumped'"):
        build_problem(tmp_path, method=EXPLICIT | {"mass": "consistent"}, schedule=schedule)
    with pytest.raises(CaseError, match="symplectic_euler needs 'lumped'"):
        variants = {"polar": {"method.stepper": "symplectic_euler", "method.mass": "consistent"}}
        build_problem(tmp_path, variants=variants, schedule=schedule)
    variants = {"polar": {"method.stepper": "symplectic_euler"}}
    for method in (None, {"mass": "consistent"}):
        one = build_problem(tmp_path, variants=variants, method=method, schedule=schedule)
        assert one.method.mass == "lumped" and any("lumped" in note for note in one.notes)
        assert one.body.momentum(np.ones((16, 3))) == pytest.approx(one.body.lumped_mass[:, None] * np.ones((16, 3)))
    assert not build_problem(tmp_path, method=EXPLICIT | {"mass": "lumped"}, schedule=schedule).notes


@pytest.mark.parametrize("stretch", [0.0, 0.1])
@pytest.mark.parametrize("mesh", [THIN, box((4.0, 12.0, 4.0), (1, 4, 1))], ids=["2D", "3D"])
def test_polar_keeps_the_angular_momentum_of_a_free_body_to_rounding(mesh, stretch):
    body = make_solid(mesh, mass="lumped", **METHODS["polar"])
    x = mesh.points * np.array([1.0, 1.0 + stretch, 1.0])[: mesh.dimension]
    v = make_spin(body, np.array([1.0, 0.5, 3.0])) * np.array([1.0, 1.0 + stretch, 1.0])[: mesh.dimension]
    start = angular_momentum(body, State(0, x, v))
    run = iterate_states(body, true_limit(body) / 2, x, v, 2000)
    # 2000 sums over the nodes, each rounded to 1e-16 of its terms: measured 1e-15 to 9e-15
    assert max(np.abs(angular_momentum(body, s) - start).max() for s in run) < 1e-12 * np.linalg.norm(start)


def test_gram_schmidt_loses_the_angular_momentum_of_a_stretched_bar_but_not_of_a_relaxed_one():
    """About the bar's own axis; measured: -6.0 of it are left after 2000 steps, and none after 900; relaxed: 3e-4."""
    body = make_solid(make_thesis_bar(), mass="lumped", **METHODS["gram_schmidt"])
    lost = {}
    for stretch in (0.0, 0.1):
        x = body.mesh.points * [1.0, 1.0 + stretch, 1.0]
        v = make_spin(body, np.array([0.0, 3.0, 0.0]))
        kept = [angular_momentum(body, s)[1] for s in iterate_states(body, true_limit(body) / 2, x, v, 2000)]
        lost[stretch] = 1 - min(kept) / angular_momentum(body, State(0, x, v))[1]
    assert lost[0.1] > 0.5 and lost[0.0] < 1e-2


@pytest.mark.parametrize("d", [2, 3])
def test_a_free_body_keeps_its_linear_momentum_and_falls_as_the_formula_says(d):
    """x = x0 + v0 t + g t (t + dt)/2."""
    mesh = THIN if d == 2 else make_thesis_bar()
    g, v0, dt = np.array([1.0, -9.81, 2.0])[:d], np.array([1.0, -2.0, 3.0])[:d], 1e-3
    body = make_solid(mesh, load=1000.0 * mesh.node_volumes[:, None] * g, mass="lumped", **METHODS["polar"])
    noise = RNG.standard_normal(mesh.points.shape)
    *_, last = iterate_states(body, dt, mesh.points, np.tile(v0, (len(mesh.points), 1)) + noise, 500)
    t, m = 500 * dt, body.lumped_mass
    mean = m @ noise / m.sum()
    wanted = (v0 + mean) * t + g * t * (t + dt) / 2
    assert m @ (last.x - mesh.points) / m.sum() == pytest.approx(wanted, rel=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_a_mode_is_the_map_of_symplectic_euler_and_loses_nothing(d):
    """q' -= omega^2 dt q, then q += dt q': v^2 + omega^2 x^2 - omega^2 dt x v is kept."""
    body = clamp_beam(d)
    (omega,), (shape,) = find_lowest_frequencies(body)
    X, dt = body.mesh.points, 0.9 * element_limit(body)
    q, p = 100.0, 0.0
    kept = []
    for state in iterate_states(body, dt, X + q * shape, 0 * X, 300):
        p -= dt * omega**2 * q
        q += dt * p
        got = ((state.x - X) * body.momentum(shape)).sum(), (state.v * body.momentum(shape)).sum()
        assert got == pytest.approx((q, p), abs=1e-10 * 100 * omega)
        kept.append(got[1] ** 2 + (omega * got[0]) ** 2 - omega**2 * dt * got[0] * got[1])
    assert np.ptp(kept) < 1e-10 * kept[0]


@pytest.fixture
def matrices(monkeypatch) -> list[Mesh]:
    """The meshes of which a block pattern was made: every matrix, of mass or of stiffness, needs one."""
    made: list[Mesh] = []
    pattern = pipeline.fem.body.assemble_pattern

    def count_call(mesh: Mesh, *arguments: np.ndarray | None) -> Assembly:
        made.append(mesh)
        return pattern(mesh, *arguments)

    monkeypatch.setattr(pipeline.fem.body, "assemble_pattern", count_call)
    return made


@pytest.mark.parametrize("method", ["linear", "polar", "gram_schmidt"])
@pytest.mark.parametrize("d", [2, 3])
def test_a_step_builds_no_matrix_and_extracts_rotations_once(matrices, d, method):
    body = clamp_beam(d, **METHODS[method])
    X = body.mesh.points
    stepper = SymplecticEuler(body, 1e-3)
    assert len(matrices) == (method == "linear")  # whose forces are that matrix' product
    _, report = stepper.step(State(0, X, 0 * X))
    assert report.work == Work(steps=1, rotations=int(method != "linear"))
    assert len(matrices) == (method == "linear")


@pytest.mark.parametrize("sections", [{}, PLANAR], ids=["3D", "2D"])
def test_a_whole_explicit_run_builds_no_matrix(matrices, tmp_path, sections):
    one = build_problem(tmp_path, method=EXPLICIT, schedule={"dt": 1e-4, "frames": 3}, **sections)
    assert one.dt < element_limit(one.body)
    list(frames(one))
    assert not matrices


def test_explicit_and_implicit_runs_converge_to_each_other():
    body = clamp_beam(3, **METHODS["polar"])
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -20.0], 0.0)
    dt = 1e-3
    *_, explicit = iterate_states(body, dt, body.mesh.points, v, 100)
    implicit = list_states(body, dt, 100, v, stepper="bdf2")[-1]
    moved = np.abs(implicit.x - body.mesh.points).max()
    assert np.abs(explicit.x - implicit.x).max() < 0.01 * moved  # errors of order dt omega_1 = .01


def test_the_guarded_stepper_of_the_table_makes_the_same_steps():
    body = clamp_beam(3, **METHODS["polar"])
    v = np.where(body.free_mask[:, None], [0.0, 0.0, -20.0], 0.0)
    *_, bare = iterate_states(body, 1e-3, body.mesh.points, v, 20)
    guarded = list_states(body, 1e-3, 20, v, **EXPLICIT)[-1]
    assert np.array_equal(bare.x, guarded.x) and prepare_stepper(body, 1e-3, **EXPLICIT).dt == 1e-3
