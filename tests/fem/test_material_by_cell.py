"""Materials that differ from cell to cell: kernels against numpy, one material in arrays, masses, bounds and errors."""

import numpy as np
import pytest

from pipeline.fem.body import Body
from pipeline.fem.body_choice import make_body
from pipeline.fem.compiled_body import CompiledBody
from pipeline.fem.frame_error import measure_frame_error
from pipeline.fem.laws import Corotational, Linear
from pipeline.fem.mass import CONSISTENT_MASS, LUMPED_MASS
from pipeline.fem.material import Material
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.fem.supports import Supports
from pipeline.mesh.quadratic import raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.stepping.symplectic_euler import element_limit, true_limit
from tests.bodies import make_rotation

RNG = np.random.default_rng(5)
SHAPES = {"3D": box((2.0, 3.0, 1.0), (2, 3, 1)), "2D": rectangle((2.0, 3.0), (2, 3))}
MESHES = {f"{d}-{order}": mesh if order == 1 else raise_order(mesh) for d, mesh in SHAPES.items() for order in (1, 2)}
EACH = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
NOBODY = Supports(np.zeros(0, dtype=np.int64))


def make_material(mesh) -> Material:
    e = len(mesh.cells)
    return Material(1e6 * 10 ** RNG.uniform(0, 3, e), RNG.uniform(-0.2, 0.45, e), RNG.uniform(500, 5000, e))


def make_uniform(mesh) -> tuple[Material, Material]:
    """One material as numbers, and the same in arrays."""
    material = Material(1e6, 0.3, 1000.0)
    return material, Material(*(np.full(len(mesh.cells), v) for v in (1e6, 0.3, 1000.0)))


def make_two(mesh, material, law=Corotational, mass=CONSISTENT_MASS) -> tuple[Body, Body]:
    """The body with kernels, and that with numpy."""
    zero = np.zeros_like(mesh.points)
    return make_body(mesh, law(material), NOBODY, zero, mass), Body(mesh, law(material), NOBODY, zero, mass)


def deform(mesh):
    X = mesh.points + 0.05 * RNG.standard_normal(mesh.points.shape)
    return X @ make_rotation(mesh.dimension, [1, -2, 0.5], 0.8).T


@pytest.mark.parametrize("law", [Linear, Corotational])
@EACH
def test_kernels_and_numpy_agree(mesh, law):
    (compiled, plain), x = make_two(mesh, make_material(mesh), law), deform(mesh)
    assert compiled.energy(x) == pytest.approx(plain.energy(x), rel=1e-11)
    f = plain.force(x)
    assert np.abs(compiled.force(x) - f).max() < 1e-11 * np.abs(f).max()
    for kind in ("frozen", "projected", "exact") if law is Corotational else ("frozen",):
        K = plain.linearize(x, kind=kind)[1]
        assert np.abs(compiled.linearize(x, kind=kind)[1] - K).max() < 1e-11 * np.abs(K).max(), kind
    if law is Corotational:
        R, S = np.empty_like(plain.rotations(x)), np.empty_like(plain.rotations(x))
        wanted = plain.measure_frame_error(x, None, R)
        assert compiled.measure_frame_error(x, None, S) == pytest.approx(wanted, rel=1e-9)
        assert compiled.bound_frame_error(x) >= wanted.indicator * (1 - 1e-9)


@EACH
def test_one_material_in_arrays_is_that_in_numbers(mesh):
    one, same = (make_two(mesh, material)[0] for material in make_uniform(mesh))
    x = deform(mesh)
    assert same.energy(x) == pytest.approx(one.energy(x), rel=1e-14)
    assert np.array_equal(same.force(x), one.force(x))
    assert np.array_equal(same.linearize(x)[1], one.linearize(x)[1])
    assert np.allclose(same.mass, one.mass, rtol=1e-14)
    assert np.allclose(same.lumped_mass, one.lumped_mass, rtol=1e-14)
    assert same.frequency_bound == pytest.approx(one.frequency_bound, rel=1e-14)
    assert element_limit(same) == pytest.approx(element_limit(one), rel=1e-12)
    R, S = np.empty_like(one.rotations(x)), np.empty_like(one.rotations(x))
    assert same.measure_frame_error(x, None, S) == pytest.approx(one.measure_frame_error(x, None, R), rel=1e-12)


def test_numbers_are_given_to_kernels_as_one_row():
    """One material costs no memory and no loads from it that grow with the cells."""
    mesh = MESHES["3D-1"]
    one, same = (make_two(mesh, material)[0] for material in make_uniform(mesh))
    assert isinstance(one, CompiledBody) and isinstance(same, CompiledBody)
    assert one._cells[3].shape[0] == 1 < same._cells[3].shape[0]
    assert make_two(MESHES["2D-1"], Material(1.0, 0.3, 1.0))[0]._cells[3].shape == (1,)


@EACH
def test_forces_are_the_derivative_of_the_energy(mesh):
    body, x = make_two(mesh, make_material(mesh))[0], deform(mesh)
    dx = RNG.standard_normal(x.shape)
    slope = (body.energy(x + 1e-6 * dx) - body.energy(x - 1e-6 * dx)) / 2e-6
    assert slope == pytest.approx(-np.vdot(body.force(x), dx), rel=1e-7)


@EACH
def test_masses_are_those_of_the_cells(mesh):
    material = make_material(mesh)
    total = float(material.density @ mesh.rest_volumes)
    for mass in (CONSISTENT_MASS, LUMPED_MASS):
        body = make_two(mesh, material, mass=mass)[0]
        assert body.lumped_mass.sum() == pytest.approx(total, rel=1e-13)
        assert body.momentum(np.ones_like(mesh.points)).sum(axis=0) == pytest.approx(total, rel=1e-12)
        v = RNG.standard_normal(mesh.points.shape)
        assert np.vdot(v, body.momentum(v)) <= body.mass_bound @ (v**2).sum(axis=1) * (1 + 1e-12)
    # the first moment, which consistent masses integrate exactly
    body = make_two(mesh, material)[0]
    corners = mesh.points[mesh.cells[:, : mesh.dimension + 1]].mean(axis=1)
    moment = (material.density * mesh.rest_volumes) @ corners
    assert body.momentum(mesh.points).sum(axis=0) == pytest.approx(moment, rel=1e-12)


@EACH
def test_bounds_of_the_time_step_hold(mesh):
    body = make_two(mesh, make_material(mesh), mass=LUMPED_MASS)[0]
    assert 2 / body.frequency_bound <= element_limit(body) * (1 + 1e-9) <= true_limit(body) * (1 + 2e-9)


def test_the_frame_error_is_relative_to_the_material_of_each_cell():
    """A rotation of a cell is the same error in a soft and in a stiff one."""
    F = np.stack([make_rotation(3, [0, 0, 1], angle) for angle in (0.1, 0.1)])
    errors = [
        measure_frame_error(Corotational(material), F, None, np.empty_like(F)).indicator
        for material in (Material(1.0, 0.3, 1.0), Material(np.array([1.0, 1e9]), 0.3, 1.0))
    ]
    assert errors[0] == pytest.approx(errors[1], rel=1e-12)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("ratio", [1.0, 9.0, 100.0])
def test_frequencies_of_a_bar_of_two_materials(ratio, order):
    """A bar along x in plane strain with nu = 0, held at x = 0: omega solves tan(k1 a) tan(k2 b) = Z1 / Z2.

    Z = sqrt(rho (lam + 2 mu)) are the impedances; the transfer matrix of the two parts gives the condition.
    """
    mesh = rectangle((2.0, 0.02), (64, 1))
    mesh = mesh if order == 1 else raise_order(mesh)
    E = np.where(mesh.centers[:, 0] < 1.0, 1e4, 1e4 * ratio)
    rho = np.where(mesh.centers[:, 0] < 1.0, 1.0, 2.0)
    held = np.flatnonzero(mesh.points[:, 0] == 0.0)
    body = make_body(mesh, Linear(Material(E, 0.0, rho)), Supports(held), np.zeros_like(mesh.points), CONSISTENT_MASS)
    frequencies, modes = find_lowest_frequencies(body, 60)
    c1, c2, Z1, Z2 = 100.0, np.sqrt(1e4 * ratio / 2), 100.0, np.sqrt(2e4 * ratio)
    omega = np.linspace(1.0, 400.0, 400_001)
    condition = np.cos(omega / c1) * np.cos(omega / c2) - Z2 / Z1 * np.sin(omega / c1) * np.sin(omega / c2)
    k = np.flatnonzero(np.diff(np.sign(condition)))[0]
    first = omega[k] + 1e-3 * condition[k] / (condition[k] - condition[k + 1])
    # the first mode along the bar: bending modes move its axis across
    along = [w for w, u in zip(frequencies, modes, strict=True) if np.abs(u[:, 0]).max() > 20 * np.abs(u[:, 1]).max()]
    assert along[0] == pytest.approx(first, rel=3e-4 if order == 1 else 2e-5)
