"""Bodies of order 2 at rest and in motion: elastica, momenta, energies, closed forms, the two rotation sites."""

from itertools import pairwise

import numpy as np
import pytest

from pipeline.fem.body import Body
from pipeline.fem.element import deformation_gradient
from pipeline.fem.loads import body_force, normal_traction
from pipeline.fem.material import Material
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.mesh.quadratic import QuadraticMesh, make_quadratic_mesh, raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.surface import find_boundary_faces
from pipeline.stepping.state import State
from pipeline.stepping.symplectic_euler import SymplecticEuler, element_limit, true_limit
from tests.bodies import METHODS, QUADRATIC, find_equilibrium, list_states, make_solid, make_spin, prepare_stepper
from tests.cases.test_scenes import elastica_tip

RNG = np.random.default_rng(4)
MESHES = pytest.mark.parametrize("mesh", QUADRATIC.values(), ids=QUADRATIC)
POLAR = METHODS["polar"]
SOFT = Material(1e7, 0.3, 1000.0)
BAR = raise_order(box((4.0, 12.0, 4.0), (1, 4, 1)))
THIN = raise_order(rectangle((4.0, 12.0), (1, 4)))


def solve_beam(d: int, cells: int, alpha: float, *, at_tip: bool) -> tuple[float, float]:
    """How far the tip of a clamped beam goes down and inward at rest, over its length, which is 20 heights; nu = 0."""
    length, E = 20.0, 1e7
    mesh = raise_order((box if d == 3 else rectangle)([length, 1.0, 1.0][:d], [cells, 1, 1][:d], "alternating"))
    X, EI = mesh.points, E / 12
    load = np.zeros_like(X)
    if at_tip:  # spread over the end, as the integrals of its shape functions
        faces, _ = find_boundary_faces(mesh)
        end = faces[(X[faces][:, :, 0] == length).all(axis=1)]
        load[:, -1] = -normal_traction(mesh, end, alpha * EI / length**2)[:, 0]
    else:
        load[:, -1] = body_force(mesh, np.full(d, -alpha * EI / length**3))[:, -1]
    held = np.flatnonzero(X[:, 0] == 0.0)
    x = find_equilibrium(make_solid(mesh, held=held, load=load, material=Material(E, 0.0, 100.0), **POLAR))
    moved = (x - X)[X[:, 0] == length].mean(axis=0) / length
    return float(-moved[-1]), float(-moved[0])


@pytest.mark.parametrize(("d", "cells"), [(3, 10), (2, 20)], ids=["60 tetrahedra", "40 triangles"])
def test_a_bent_beam_of_few_cells_is_the_elastica(d, cells):
    """Within .5 % at all loads of the tables; measured at most: tetrahedra .22 %, triangles .17 %.

    The beam's shear adds .2 % that the elastica leaves out, and the cells of two heights are as much too stiff.
    """
    for alpha, at_tip in [(0.4, True), (0.8, True), (1.0, True), (2.0, True), (3.0, True), (4.0, False)]:
        found = solve_beam(d, cells, alpha, at_tip=at_tip)
        assert found == pytest.approx(elastica_tip(alpha, at_tip=at_tip), rel=2.5e-3)


def iterate_states(body: Body, x: np.ndarray, v: np.ndarray, steps: int) -> list[State]:
    """Symplectic Euler at half its limit."""
    prepared, states = SymplecticEuler(body, true_limit(body) / 2), [State(0, x, v)]
    for _ in range(steps):
        states.append(prepared.step(states[-1])[0])
    return states


def bend(mesh: QuadraticMesh, angle: float) -> np.ndarray:
    """The bar bent to an arc of that angle [rad] over its length."""
    x, last = mesh.points.copy(), mesh.dimension - 1
    along, across = 1, 0 if last == 1 else 2
    r, c = np.ptp(x[:, along]) / angle, x[:, across] - 2.0
    turn = x[:, along] / r
    x[:, along], x[:, across] = (r - c) * np.sin(turn), r - (r - c) * np.cos(turn)
    return x


def measure_turning(body: Body, states: list[State]) -> float:
    """The largest change of the angular momentum about the origin over its size at first."""
    turning = []
    for s in states:
        products = np.einsum("ni,nj->ij", s.x, body.momentum(s.v))
        turning.append(products - products.T)
    return float(np.abs(np.array(turning) - turning[0]).max() / np.abs(turning[0]).max())


@pytest.mark.parametrize("mesh", [THIN, BAR], ids=["2D", "3D"])
def test_rotations_at_points_keep_the_momenta_of_a_bent_spinning_bar_to_rounding(mesh):
    body = make_solid(mesh, mass="lumped", **POLAR)
    x, v = bend(mesh, 1.0), make_spin(body, np.array([1.0, 0.5, 3.0]))
    states = iterate_states(body, x, v, 1000)
    assert measure_turning(body, states) < 1e-12
    p = np.array([body.momentum(s.v).sum(axis=0) for s in states])
    assert np.abs(p - p[0]).max() < 1e-12 * np.abs(body.momentum(v)).sum()


def test_rotations_of_elements_turn_a_bent_bar_by_themselves():
    """The torque is about .06 E V times the square of the angle by which an element bends; measured."""
    for cells in ((1, 4, 1), (2, 8, 2)):
        mesh = raise_order(box((4.0, 12.0, 4.0), cells))
        for degrees in (10.0, 30.0):
            torque = {}
            for sites in ("points", "element"):
                body, x = make_solid(mesh, rotation_at=sites, **POLAR), bend(mesh, np.radians(degrees))
                torque[sites] = np.linalg.norm(np.cross(x, body.force(x)).sum(axis=0)) / (1e8 * 192.0)
            assert torque["points"] < 1e-15
            assert torque["element"] / np.radians(degrees / cells[1]) ** 2 == pytest.approx(0.06, abs=0.01)
    # a loose bar bent by 57 degrees, 14 an element, loses or gains much of its angular momentum in 1000 steps
    body = make_solid(BAR, mass="lumped", rotation_at="element", **POLAR)
    spin = make_spin(body, np.array([1.0, 0.5, 3.0]))
    assert measure_turning(body, iterate_states(body, bend(BAR, 1.0), spin, 1000)) > 0.1


@MESHES
def test_the_explicit_limit_lies_between_its_bounds_and_divides_calm_from_blown_up(mesh):
    body = make_solid(mesh, held=np.flatnonzero(mesh.points[:, 1] < 0.2), mass="lumped", **POLAR)
    d, free = mesh.dimension, np.repeat(body.free_mask, mesh.dimension)
    K = body.pattern.matrix(body.linearize(mesh.points)[1]).toarray()[np.ix_(free, free)]
    root = np.sqrt(np.repeat(body.lumped_mass, d)[free])
    dense = 2 / np.sqrt(np.linalg.eigvalsh(K / root / root[:, None])[-1])
    assert true_limit(body) == pytest.approx(dense, rel=1e-8)
    assert 2 / body.frequency_bound <= dense and element_limit(body) <= dense
    noise = np.where(body.free_mask[:, None], 1e-3 * RNG.standard_normal(mesh.points.shape), 0.0)
    size = {}
    for share in (0.99, 1.01):
        prepared, state = SymplecticEuler(body, share * dense), State(0, mesh.points, noise)
        for _ in range(250):
            state, _ = prepared.step(state)
        size[share] = np.abs(state.v).max() / np.abs(noise).max()
    assert size[0.99] < 20 and size[1.01] > 1e3


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("stepper", ["backward_euler", "symplectic_euler"])
@MESHES
def test_free_fall_is_its_closed_form(mesh, stepper, name):
    """x = x0 + v0 t + g t (t + dt) / 2: gravity's nodal forces and the masses agree only with consistent ones."""
    d, dt = mesh.dimension, 1e-4
    g, v0 = np.array([1.0, -9.81, 2.0])[:d], np.array([1.0, -2.0, 3.0])[:d]
    mass = "lumped" if stepper == "symplectic_euler" else "consistent"
    body = make_solid(mesh, load=body_force(mesh, 1000.0 * g), mass=mass, **METHODS[name])
    states = list_states(body, dt, 20, np.tile(v0, (len(mesh.points), 1)), stepper=stepper)
    t, m = 20 * dt, body.momentum(np.ones_like(mesh.points))
    wanted = v0 * t + g * t * (t + dt) / 2
    moved = states[-1].x - mesh.points
    assert (m * moved).sum(axis=0) / m.sum(axis=0) == pytest.approx(wanted, rel=1e-10)
    if mass == "consistent":
        assert np.abs(moved - wanted).max() < 1e-10 * np.abs(wanted).max()


@pytest.mark.parametrize("z", [0.02, 0.73, 5.0])
@MESHES
def test_a_mode_decays_and_lags_as_backward_euler_says(mesh, z):
    body = make_solid(mesh, held=np.flatnonzero(mesh.points[:, 1] < 0.2))
    (omega,), (shape,) = find_lowest_frequencies(body)
    X, dual = mesh.points, body.momentum(shape)
    w = [
        omega * ((s.x - X) * dual).sum() + 1j * (s.v * dual).sum()
        for s in list_states(body, z / omega, 5, 0.3 * shape, X + 0.1 * shape)
    ]
    for before, after in pairwise(w):
        assert after * (1 + 1j * z) == pytest.approx(before, abs=1e-10 * abs(w[0]))  # of positions of 3 m


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
@MESHES
def test_an_unforced_linear_step_loses_half_the_squares_of_its_changes(mesh, mass):
    body = make_solid(mesh, held=[0, 1], mass=mass)
    K = body.pattern.matrix(body.linearize(mesh.points)[1])
    v = np.where(body.free_mask[:, None], RNG.standard_normal(mesh.points.shape), 0.0)
    states = list_states(body, 0.01, 20, v)
    energy = [0.5 * (s.v * body.momentum(s.v)).sum() + body.energy(s.x) for s in states]
    for (a, b), (before, after) in zip(pairwise(states), pairwise(energy), strict=True):
        dv, du = b.v - a.v, b.x - a.x
        loss = ((dv * body.momentum(dv)).sum() + du.ravel() @ K @ du.ravel()) / 2
        assert before - after == pytest.approx(loss, abs=1e-12 * energy[0])


@pytest.mark.parametrize("steps", [1, 7])
@MESHES
def test_a_free_linear_body_in_spin_swells_to_37_volumes_at_every_point(mesh, steps):
    body = make_solid(mesh)
    omega = np.array([0.0, 0.0, 10.0]) if mesh.dimension == 2 else 10.0 * np.array([1.0, -2.0, 0.5])
    t = 6.0 / np.linalg.norm(omega)
    last = list_states(body, t / steps, steps, make_spin(body, omega))[-1]
    J = np.linalg.det(deformation_gradient(mesh, last.x))
    assert pytest.approx(np.full(len(J), 37.0), rel=1e-9) == J


def throw_beam(d: int, speed: float) -> tuple[Body, State]:
    """A clamped heavy beam of one cell a side, thrown across its axis."""
    mesh = raise_order(box((1.0, 3.0, 1.0), (1, 2, 1)) if d == 3 else rectangle((1.0, 3.0), (1, 3)))
    held, across = np.flatnonzero(mesh.points[:, 1] == 3.0), np.eye(d)[0]
    body = make_solid(mesh, held=held, material=SOFT, load=body_force(mesh, 9810.0 * across), **POLAR)
    return body, State(0, mesh.points, np.where(body.free_mask[:, None], speed * across, 0.0))


@pytest.mark.parametrize("speed", [20.0, 150.0])  # 150 m/s is above the wave speed; cells invert at times
@pytest.mark.parametrize("d", [2, 3])
def test_a_converged_step_ends_below_the_energy_before_it(d, speed):
    """U_{n+1} + |v_{n+1} - v_n|_M^2 / 2 <= E_n, with the dead load's potential in U."""
    body, start = throw_beam(d, speed)
    for a, b in pairwise(list_states(body, 0.02, 15, start.v, iterations="converged")):
        before, after = (body.energy(s.x) - (body.load * (s.x - body.mesh.points)).sum() for s in (a, b))
        change = b.v - a.v
        after += (change * body.momentum(change)).sum() / 2
        assert after <= before + (a.v * body.momentum(a.v)).sum() / 2 + 1e-12 * abs(after)


@pytest.mark.parametrize("method", [{"iterations": 1}, {"iterations": "converged"}, {"stepper": "bdf2"}], ids=str)
@pytest.mark.parametrize("d", [2, 3])
def test_numbers_of_nodes_do_not_change_the_motion(d, method):
    body, start = throw_beam(d, 20.0)
    mesh, order = body.mesh, RNG.permutation(len(body.mesh.points))
    place = np.argsort(order)
    other = make_quadratic_mesh(mesh.points[order], place[mesh.cells])
    held = place[body.supports.nodes]
    twin = make_solid(other, held=held, material=SOFT, load=body.load[order], **POLAR)
    one, two = (list_states(b, 0.02, 10, v, **method)[-1] for b, v in ((body, start.v), (twin, start.v[order])))
    assert np.abs(two.x - one.x[order]).max() < 1e-10 * mesh.size


@pytest.mark.parametrize("d", [2, 3])
def test_rotations_of_elements_tend_to_those_of_points_on_finer_meshes(d):
    """The tip of the thrown beam after 10 steps: the difference falls at least by two, measured by three and more."""
    away = []
    for n in (1, 2):
        mesh = raise_order(box((1.0, 3.0, 1.0), (n, 3 * n, n)) if d == 3 else rectangle((1.0, 3.0), (n, 3 * n)))
        held, across = np.flatnonzero(mesh.points[:, 1] == 3.0), np.eye(d)[0]
        end = []
        for sites in ("points", "element"):
            load = body_force(mesh, 9810.0 * across)
            body = make_solid(mesh, held=held, material=SOFT, load=load, rotation_at=sites, **POLAR)
            v = np.where(body.free_mask[:, None], 20.0 * across, 0.0)
            prepared, state = prepare_stepper(body, 0.02), State(0, mesh.points, v)
            for _ in range(10):
                state, _ = prepared.step(state)
            end.append(state.x[mesh.points[:, 1] == 0.0].mean(axis=0))
        away.append(np.linalg.norm(end[0] - end[1]))
    assert away[0] > 2 * away[1] > 1e-6
