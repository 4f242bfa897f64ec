"""Inverted and collapsed cells: the outcome of each treatment, in one table."""

from functools import cache

import numpy as np
import pytest

from pipeline.fem.body import Body
from pipeline.fem.element import deformation_gradient
from pipeline.fem.laws import Corotational
from pipeline.fem.rotation import Rotation, polar
from pipeline.fem.supports import Supports
from pipeline.mesh.simplex import Mesh
from pipeline.problem.methods import INVERSIONS
from tests.bodies import MATERIAL, METHODS, list_states, make_clamped_bar, make_rotation, make_solid

# F = diag(1, 1, J) with R = diag(-1, 1, -1), the base's edge being shorter than the height: its strain of -2 is held
# in balance where 2 mu (-J - 1) + lam (-J - 1 - 2) = 0; in the plane alike
AT_REST_INVERTED = -(2 * MATERIAL.mu + 3 * MATERIAL.lam) / (2 * MATERIAL.mu + MATERIAL.lam)
DT, STEPS = 0.07, 100  # backward Euler damps all that moves here within ten steps or so
RECOVERS, INVERTED, FINITE = "J = 1", "rests inverted", "finite"


def make_apex(d: int, depth: float) -> tuple[Body, np.ndarray]:
    """A right simplex of height 1 on a fixed base, its apex below the base."""
    mesh = Mesh(np.concatenate([np.zeros((1, d)), np.eye(d)]), np.arange(d + 1)[None])
    x = mesh.points.copy()
    x[d, d - 1] = -depth
    return make_solid(mesh, held=range(d), **METHODS["polar"]), x


def scramble_bar(seed: int) -> tuple[Body, np.ndarray]:
    """The thesis bar with every free node anywhere within 3 m, a cell being 2 m, 1.5 m and 2 m."""
    body = make_clamped_bar(**METHODS["polar"])
    away = np.random.default_rng(seed).uniform(-3.0, 3.0, body.mesh.points.shape)
    return body, body.mesh.points + np.where(body.free_mask[:, None], away, 0.0)


def collapse_bar(rank: int) -> tuple[Body, np.ndarray]:
    """The thesis bar, its free nodes pressed into a plane, onto a line or into a point of the held face."""
    body = make_clamped_bar(**METHODS["polar"])
    X = body.mesh.points
    kept = [1, 0, 2][:rank]
    x = np.tile([2.0, 12.0, 2.0], (len(X), 1))
    x[:, kept] = X[:, kept]
    return body, np.where(body.free_mask[:, None], x, X)


STARTS = {
    "apex .2": (make_apex, 3, 0.2),
    "apex .8": (make_apex, 3, 0.8),
    "apex 1.2": (make_apex, 3, 1.2),
    "scrambled 0": (scramble_bar, 0),
    "scrambled 1": (scramble_bar, 1),
    "scrambled 2": (scramble_bar, 2),
    "rank 2": (collapse_bar, 2),
    "rank 1": (collapse_bar, 1),
    "rank 0": (collapse_bar, 0),
}
# `last` takes the first rotation of a scrambled cell from the rest shape: it left one cell of 192 at J = -.63
TABLE = {
    "flip": dict.fromkeys(STARTS, RECOVERS) | {"apex 1.2": INVERTED},
    "last": dict.fromkeys(STARTS, RECOVERS) | {"scrambled 0": FINITE},
    "crossing": dict.fromkeys(STARTS, RECOVERS),
}


@cache
def end(treatment: str, start: str) -> np.ndarray:
    """J of every cell after STEPS steps."""
    make, *arguments = STARTS[start]
    body, x = make(*arguments)
    states = list_states(body, DT, STEPS, np.zeros_like(x), x, inversion=treatment)
    assert all(np.isfinite(s.x).all() and np.isfinite(s.v).all() for s in states)
    return np.linalg.det(deformation_gradient(body.mesh, states[-1].x))


def classify(J: np.ndarray) -> str:
    # what is left of the motion after 100 steps that damp it, and of the rounding of F = 0 in a bar of 12 m
    if np.abs(J - 1).max() < 1e-6:
        return RECOVERS
    return INVERTED if np.abs(J - AT_REST_INVERTED).max() < 1e-6 else FINITE


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("treatment", INVERSIONS)
def test_a_start_that_is_inverted_or_collapsed_ends_as_its_treatment_says(treatment, start):
    J = end(treatment, start)
    print(f"{treatment}, {start}: J from {J.min():.4g} to {J.max():.4g}")
    assert classify(J) == TABLE[treatment][start]


def test_two_treatments_recover_every_apex_and_the_inverted_rest_is_at_its_formula():
    recovering = [t for t in TABLE if all(classify(end(t, s)) == RECOVERS for s in STARTS if s.startswith("apex"))]
    assert recovering == ["last", "crossing"]
    assert end("flip", "apex 1.2")[0] == pytest.approx(-1.985, abs=5e-4)


@pytest.mark.parametrize("treatment", INVERSIONS)
@pytest.mark.parametrize("depth", [0.2, 0.8, 1.2])
def test_an_inverted_triangle_recovers_unless_its_height_has_become_its_longer_side(treatment, depth):
    body, x = make_apex(2, depth)
    last = list_states(body, DT, STEPS, np.zeros_like(x), x, inversion=treatment)[-1]
    J = np.linalg.det(deformation_gradient(body.mesh, last.x))[0]
    stays = treatment == "flip" and depth > 1
    assert pytest.approx(AT_REST_INVERTED if stays else 1.0, abs=1e-6) == J


def reflecting_rotation(F: np.ndarray) -> np.ndarray:
    """T 6.6 and W as printed: the unitary polar factor, which is a reflection where det F < 0."""
    U, _, Vt = np.linalg.svd(F)
    return U @ Vt


@pytest.mark.parametrize("depth", [0.2, 0.8])
@pytest.mark.parametrize("d", [2, 3])
def test_the_reflecting_rotation_keeps_an_inverted_cell_inverted_and_ours_lets_it_recover(d, depth):
    body, x = make_apex(d, depth)
    ends = {}
    for rotation in (reflecting_rotation, polar):
        law = Corotational(MATERIAL, Rotation(rotation))
        other = Body(body.mesh, law, Supports(body.supports.nodes), body.load, body.mass_model)
        last = list_states(other, DT, STEPS, np.zeros_like(x), x)[-1]
        ends[rotation] = np.linalg.det(deformation_gradient(body.mesh, last.x))[0], other.energy(last.x)
    # the mirror image is taken for the rest shape: J = -1 without energy
    assert ends[reflecting_rotation] == pytest.approx((-1.0, 0.0), abs=1e-6)
    assert ends[polar] == pytest.approx((1.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("treatment", [name for name, row in INVERSIONS.items() if row.part])
@pytest.mark.parametrize("d", [2, 3])
def test_treatments_are_the_polar_rotation_unless_inverted_and_always_a_rotation(d, treatment):
    rng = np.random.default_rng(4)
    made = INVERSIONS[treatment].part()
    memory = {}
    for _ in range(20):
        F = rng.standard_normal((50, d, d))
        F[0], F[1], F[2, :, 0] = 0.0, np.diag([1.0, 0, 0][:d]), 0.0
        before = F.copy(), {name: value.copy() for name, value in memory.items()}
        R, new = made.rotations(F, memory)
        assert np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(d)).max() < 1e-14 * 10  # products of 3 x 3
        assert np.linalg.det(R) == pytest.approx(np.ones(50), abs=1e-13)
        upright = np.linalg.det(F) > 0
        assert np.array_equal(R[upright], polar(F[upright]))
        assert np.array_equal(F, before[0])
        assert all(np.array_equal(memory[name], value) for name, value in before[1].items())
        memory = new


@pytest.mark.parametrize("d", [2, 3])
def test_crossing_takes_the_direction_that_collapsed_and_last_the_rotation_from_before(d):
    Q = make_rotation(d, [1, 2, 3], 0.7)
    deep = Q @ np.diag([1.0, 0.5, -1.5] if d == 3 else [0.5, -1.5])  # flip would take the shortest: not the last axis
    for treatment in ("last", "crossing"):
        made = INVERSIONS[treatment].part()
        _, memory = made.rotations(Q[None], {})
        R, memory = made.rotations(deep[None], memory)
        assert np.abs(R[0] - Q).max() < 1e-14
        # and once more turned, while it is inverted: crossing follows, last stays
        S = make_rotation(d, [3, 1, -2], 1.0)
        R, _ = made.rotations((S @ deep)[None], memory)
        assert np.abs(R[0] - (Q if treatment == "last" else S @ Q)).max() < 1e-14
    assert np.abs(polar(deep[None])[0] - Q).max() > 0.5


@pytest.mark.parametrize("d", [2, 3])
def test_crossing_forgets_the_direction_of_a_cell_that_has_recovered(d):
    made, memory = INVERSIONS["crossing"].part(), {}
    last, first = np.array([[1.0, 1.0, -1.5], [-1.5, 1.0, 1.0]])[:, [0, 2] if d == 2 else [0, 1, 2]]
    for stretches in (last, np.ones(d), first):
        R, memory = made.rotations(np.diag(stretches)[None], memory)
        assert np.abs(R[0] - np.eye(d)).max() < 1e-14


@pytest.mark.parametrize("stepper", ["backward_euler", "bdf2", "symplectic_euler"])
@pytest.mark.parametrize("treatment", ["last", "crossing"])
def test_every_stepper_carries_the_memory_of_its_treatment(treatment, stepper):
    body, x = make_apex(3, 1.2)
    dt = 1e-4 if stepper == "symplectic_euler" else 0.01
    states = list_states(body, dt, 5, np.zeros_like(x), x, inversion=treatment, stepper=stepper)
    names = {"last": {"rotation_before"}, "crossing": {"gradient_before", "collapsed"}}[treatment]
    assert all(names == set(s.memory.inversion) for s in states[1:])
    assert all(np.isfinite(value).all() for value in states[-1].memory.inversion.values())
    assert states[-1].x[3, 2] > -1.2  # and is on its way


def test_the_default_treatment_has_no_memory():
    body, x = make_apex(3, 0.5)
    memory = list_states(body, DT, 1, np.zeros_like(x), x)[-1].memory
    assert not memory.inversion and not memory.stepper and memory.energy is not None
