"""Compiled kernels of order 2 agree with the plain numpy code."""

import pickle

import numpy as np
import pytest

from pipeline.fem.body import Body, Formulation
from pipeline.fem.body_choice import make_body
from pipeline.fem.compiled_body import CompiledBody, LinearBody, load_kernels
from pipeline.fem.laws import Corotational, Law, Linear
from pipeline.fem.mass import CONSISTENT_MASS
from pipeline.fem.material import Material
from pipeline.fem.rotation import GRAM_SCHMIDT_ROTATION, polar
from pipeline.fem.supports import Supports
from pipeline.mesh.quadratic import QuadraticMesh, raise_order
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh
from tests.bodies import bend_sides

MATERIAL = Material(1e6, 0.3, 1000.0)
LAWS = {
    "polar": Corotational(MATERIAL),
    "gram_schmidt": Corotational(MATERIAL, GRAM_SCHMIDT_ROTATION),
    "linear": Linear(MATERIAL),
}
FORMULATIONS = [Formulation(sites, volumetric) for sites in ("points", "element") for volumetric in ("full", "mean")]  # type: ignore[arg-type]


def make_mesh(d: int, *, is_curved: bool) -> QuadraticMesh:
    """Cells of different volumes, so that a missing weight shows; their number leaves lanes empty."""
    even = box([1.0, 2.0, 1.5], [1, 3, 1]) if d == 3 else rectangle([1.0, 2.0], [3, 5])
    moved = even.points + 0.05 * np.random.default_rng(0).uniform(-1, 1, even.points.shape)
    mesh = raise_order(Mesh(moved, even.cells))
    assert mesh.rest_volumes.max() > 1.2 * mesh.rest_volumes.min()
    return bend_sides(mesh, 0.02) if is_curved else mesh


MESHES = {
    "tetrahedra": make_mesh(3, is_curved=False),
    "curved tetrahedra": make_mesh(3, is_curved=True),
    "triangles": make_mesh(2, is_curved=False),
    "curved triangles": make_mesh(2, is_curved=True),
}


@pytest.fixture(params=MESHES.values(), ids=MESHES.keys())
def mesh(request) -> QuadraticMesh:
    return request.param


@pytest.fixture(params=FORMULATIONS, ids="-".join)
def formulation(request) -> Formulation:
    return request.param


def make_bodies(mesh: QuadraticMesh, law: Law, formulation: Formulation) -> tuple[Body, CompiledBody]:
    """The supports put free nodes first, so that the rows are not in the order of the nodes."""
    held = Supports(np.flatnonzero(mesh.points[:, 1] < 0.3))
    arguments = (mesh, law, held, np.zeros_like(mesh.points), CONSISTENT_MASS, None, formulation)
    return Body(*arguments), CompiledBody(*arguments)


def deform(mesh: QuadraticMesh, shake: float) -> np.ndarray:
    rng, d = np.random.default_rng(1), mesh.dimension
    return mesh.points @ polar(rng.normal(size=(1, d, d)))[0] + shake * rng.normal(size=mesh.points.shape)


@pytest.mark.parametrize("law", ["polar", "gram_schmidt"])
@pytest.mark.parametrize("shake", [0.0, 0.03, 0.5, 5.0], ids=["rotated", "strained", "some inverted", "scrambled"])
def test_forces_stiffness_and_energy_are_those_of_the_plain_body(mesh, formulation, law: str, shake: float) -> None:
    plain, compiled = make_bodies(mesh, LAWS[law], formulation)
    x = deform(mesh, shake)
    assert compiled.energy(x) == pytest.approx(plain.energy(x), rel=1e-11, abs=1e-3)
    f, K = plain.linearize(x)
    f_scale, K_scale = max(np.abs(f).max(), 1e6), np.abs(K).max()
    for given in (None, plain.rotations(x)):
        g, L = compiled.linearize(x, given)
        np.testing.assert_allclose(g, f, atol=1e-11 * f_scale)
        np.testing.assert_allclose(L, K, atol=1e-10 * K_scale)
        np.testing.assert_allclose(compiled.force(x, given), f, atol=1e-11 * f_scale)
    np.testing.assert_allclose(compiled.rotations(x), plain.rotations(x), atol=1e-9)
    np.testing.assert_allclose(compiled.nodal_rotations(x), plain.nodal_rotations(x), atol=1e-9)
    for kind in ("projected", "exact"):
        g, L = compiled.linearize(x, kind=kind)
        expected = plain.linearize(x, kind=kind)[1]
        np.testing.assert_allclose(g, f, atol=1e-11 * f_scale)
        np.testing.assert_allclose(L, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("states", ["one point", "a plane", "reflected"])
def test_collapsed_cells_give_the_numbers_of_the_plain_body(mesh, formulation, states: str) -> None:
    plain, compiled = make_bodies(mesh, LAWS["polar"], formulation)
    squash = {"one point": 0.0, "a plane": 1.0, "reflected": 1.0}[states] * np.eye(mesh.dimension)
    squash[0, 0] *= {"one point": 0.0, "a plane": 0.0, "reflected": -1.3}[states]
    x = mesh.points @ squash  # away from the origin, numpy's F of one point is rounding, and its rotation any
    f, K = plain.linearize(x)
    g, L = compiled.linearize(x)
    assert np.isfinite(g).all() and np.isfinite(L).all()
    assert compiled.energy(x) == pytest.approx(plain.energy(x), rel=1e-11)
    if states != "reflected":  # a gradient without a closest rotation gives any of them
        np.testing.assert_allclose(g, f, atol=1e-9 * np.abs(f).max())
        np.testing.assert_allclose(L, K, atol=1e-9 * np.abs(K).max())


def test_other_rotations_than_those_of_the_positions_are_used(mesh, formulation) -> None:
    plain, compiled = make_bodies(mesh, LAWS["polar"], formulation)
    R, x = plain.rotations(deform(mesh, 0.3)), deform(mesh, 0.05)
    (f, K), (g, L) = plain.linearize(x, R), compiled.linearize(x, R)
    assert np.abs(f - plain.force(x)).max() > 0.1 * np.abs(f).max()
    np.testing.assert_allclose(g, f, atol=1e-12 * np.abs(f).max())
    np.testing.assert_allclose(L, K, atol=1e-12 * np.abs(K).max())
    np.testing.assert_allclose(compiled.force(x, R), f, atol=1e-12 * np.abs(f).max())


@pytest.mark.parametrize("volumetric", ["full", "mean"])
def test_the_exact_tangent_is_the_derivative_of_the_forces(mesh, volumetric) -> None:
    _, body = make_bodies(mesh, LAWS["polar"], Formulation("points", volumetric))
    x, h = deform(mesh, 0.04), 1e-6
    direction = np.random.default_rng(3).normal(size=x.shape)
    K = body.pattern.matrix(body.linearize(x, kind="exact")[1])
    wanted = -(body.force(x + h * direction) - body.force(x - h * direction)) / (2 * h)
    found = (K @ direction.ravel()).reshape(x.shape)
    np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())
    work = -(body.energy(x + h * direction) - body.energy(x - h * direction)) / (2 * h)
    assert work == pytest.approx(float(np.vdot(body.force(x), direction)), rel=1e-6)


@pytest.mark.parametrize("sites", ["points", "element"])
@pytest.mark.parametrize("shake", [0.0, 0.01, 0.5], ids=["rotated", "strained", "some inverted"])
def test_frame_errors_are_those_of_the_plain_body(mesh, sites, shake: float) -> None:
    plain, body = make_bodies(mesh, LAWS["polar"], Formulation(sites))
    x = deform(mesh, shake)
    expected, reached = np.empty((plain.site_count, *mesh.points.shape[1:] * 2)), body.rotations(mesh.points)
    before = plain.rotations(deform(mesh, 0.02))
    for used in (None, before):
        wanted = plain.measure_frame_error(x, used, expected)
        found = body.measure_frame_error(x, used, reached)
        assert found == pytest.approx(wanted, rel=1e-8)
        np.testing.assert_allclose(reached, expected, atol=1e-9)
    small = mesh.points + 0.003 * (x - mesh.points)
    wanted, bound = plain.measure_frame_error(small, None, expected).indicator, body.bound_frame_error(small)
    assert wanted <= bound * (1 + 1e-9) < np.inf


def test_frame_errors_of_positions_that_are_not_finite_are_not(mesh) -> None:
    _, body = make_bodies(mesh, LAWS["polar"], Formulation())
    x = mesh.points.copy()
    x[3] = np.nan
    reached = body.rotations(mesh.points)
    assert not np.isfinite(body.bound_frame_error(x))
    assert not np.isfinite(body.measure_frame_error(x, None, reached).from_rest)
    assert np.isnan(body.energy(x)) and np.isfinite(reached).all()


@pytest.mark.parametrize("volumetric", ["full", "mean"])
def test_the_linear_law_has_one_matrix_and_agrees_with_the_plain_body(mesh, volumetric) -> None:
    plain, _ = make_bodies(mesh, LAWS["linear"], Formulation("points", volumetric))
    body = make_body(
        mesh, plain.law, plain.supports, plain.load, CONSISTENT_MASS, None, Formulation("points", volumetric)
    )
    assert type(body) is LinearBody
    x = deform(mesh, 0.3)
    f, K = plain.linearize(x)
    np.testing.assert_allclose(body.stiffness, K, atol=1e-12 * np.abs(K).max())
    np.testing.assert_allclose(body.force(x), f, atol=1e-11 * np.abs(f).max())
    assert body.energy(x) == pytest.approx(plain.energy(x), rel=1e-11)


def test_positions_in_other_layouts_give_the_same(mesh) -> None:
    _, body = make_bodies(mesh, LAWS["polar"], Formulation("element"))
    x = deform(mesh, 0.1)
    f, E = body.force(x), body.energy(x)
    frozen = x.copy()
    frozen.flags.writeable = False
    for positions in (np.asfortranarray(x), frozen):
        assert np.array_equal(body.force(positions), f) and body.energy(positions) == E


def test_every_kind_of_element_has_a_row_of_kernels_and_a_body_can_be_pickled(mesh) -> None:
    assert load_kernels(2, mesh.dimension) is not None and load_kernels(3, mesh.dimension) is None
    _, body = make_bodies(mesh, LAWS["polar"], Formulation())
    x = deform(mesh, 0.1)
    f = body.force(x)
    assert np.array_equal(pickle.loads(pickle.dumps(body)).force(x), f)


@pytest.mark.parametrize("sites", ["points", "element"])
def test_warming_up_leaves_nothing_to_compile(mesh, sites) -> None:
    _, body = make_bodies(mesh, LAWS["polar"], Formulation(sites))
    body.warm_up(solves=True, frame_errors=sites == "points", tangents=sites == "points")
    modules = {*body._modules}
    kernels = [k for m in modules for k in vars(m).values() if hasattr(k, "signatures") and k.__module__ == m.__name__]
    before = {k: len(k.signatures) for k in kernels}
    x = deform(mesh, 0.1)
    body.energy(x), body.nodal_rotations(x), body.linearize(x)
    if sites == "points":
        body.force(x), body.linearize(x, kind="projected"), body.linearize(x, kind="exact")
        reached = body.rotations(x)
        body.measure_frame_error(x, None, reached), body.bound_frame_error(x)
    assert {k: len(k.signatures) for k in kernels} == before
