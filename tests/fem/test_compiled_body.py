"""Compiled kernels agree with the plain numpy code."""

import numpy as np
import pytest

from pipeline.fem.body import Body
from pipeline.fem.body_choice import make_body
from pipeline.fem.compiled_body import CompiledBody, LinearBody
from pipeline.fem.kernels import GRAM_SCHMIDT, IDENTITY, POLAR
from pipeline.fem.laws import Corotational, Linear
from pipeline.fem.mass import CONSISTENT_MASS
from pipeline.fem.material import Material
from pipeline.fem.rotation import GRAM_SCHMIDT_ROTATION, POLAR_ROTATION, Rotation, gram_schmidt, polar, polar_by_svd
from pipeline.fem.supports import Supports
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.simplex import Mesh, edge_matrices, signed_volumes
from pipeline.run.measures import measure_cells, measure_simplices_by_numpy

MATERIAL = Material(1e6, 0.3, 1000.0)
NOWHERE = Supports(np.zeros(0, dtype=np.int64))


@pytest.fixture(params=[POLAR_ROTATION, GRAM_SCHMIDT_ROTATION], ids=["polar", "gram_schmidt"])
def rotation(request) -> Rotation:
    return request.param


@pytest.fixture(params=[2, 3], ids=["triangles", "tetrahedra"])
def bodies(request, rotation: Rotation) -> tuple[Body, Body]:
    even = box([1.0, 2.0, 1.5], [2, 3, 2]) if request.param == 3 else rectangle([1.0, 2.0], [4, 7])
    # cells of different volumes, so that a missing weight shows
    moved = even.points + 0.05 * np.random.default_rng(0).uniform(-1, 1, even.points.shape)
    mesh = Mesh(moved, even.cells)
    assert mesh.rest_volumes.max() > 1.5 * mesh.rest_volumes.min()
    arguments = (mesh, Corotational(MATERIAL, rotation), NOWHERE, np.zeros_like(mesh.points), CONSISTENT_MASS)
    return Body(*arguments), CompiledBody(*arguments)


@pytest.mark.parametrize("shake", [0.0, 0.05, 0.5, 5.0], ids=["rest", "strained", "some inverted", "scrambled"])
def test_forces_stiffness_and_energy_are_those_of_the_plain_body(bodies: tuple[Body, Body], shake: float) -> None:
    plain, compiled = bodies
    rng = np.random.default_rng(1)
    d = plain.mesh.dimension
    x = plain.mesh.points @ polar(rng.normal(size=(1, d, d)))[0] + shake * rng.normal(size=plain.mesh.points.shape)
    assert compiled.energy(x) == pytest.approx(plain.energy(x), rel=1e-11, abs=1e-9 * 1e6 * 3)
    f, K = plain.linearize(x)
    # relative to the largest force or stiffness of this motion, and to those of a strain of one
    f_scale, K_scale = max(np.abs(f).max(), 1e6), np.abs(K).max()
    for given in (None, plain.rotations(x)):
        g, L = compiled.linearize(x, given)
        np.testing.assert_allclose(g, f, atol=1e-11 * f_scale)
        np.testing.assert_allclose(L, K, atol=1e-10 * K_scale)
    np.testing.assert_allclose(compiled.rotations(x), plain.rotations(x), atol=1e-9)
    np.testing.assert_allclose(compiled.nodal_rotations(x), plain.nodal_rotations(x), atol=1e-9)
    np.testing.assert_allclose(compiled.force(x), f, atol=1e-11 * f_scale)
    for kind in ("projected", "exact"):
        g, L = compiled.linearize(x, kind=kind)
        expected = plain.linearize(x, kind=kind)[1]
        np.testing.assert_allclose(g, f, atol=1e-11 * f_scale)
        np.testing.assert_allclose(L, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("cells", [[1, 1, 1], [2, 3, 2], [4, 8, 2]], ids=["6", "72", "384"])
@pytest.mark.parametrize("shake", [0.0, 0.05, 0.5], ids=["rest", "strained", "some inverted"])
def test_compiled_volumes_and_angles_are_those_of_numpy(cells: list[int], shake: float) -> None:
    mesh, rng = box([1.0, 2.0, 1.5], cells), np.random.default_rng(3)
    x = mesh.points @ polar(rng.normal(size=(1, 3, 3)))[0] + shake * rng.normal(size=mesh.points.shape)
    for positions in (x, np.asfortranarray(x), x.astype(np.float32)):
        volumes, _, _, angles = measure_cells(mesh, positions)
        expected = measure_simplices_by_numpy(mesh, positions.astype(np.float64))
        assert np.array_equal(volumes, expected[0])
        assert np.array_equal(volumes, signed_volumes(positions.astype(np.float64), mesh.cells))
        np.testing.assert_allclose(angles, expected.angles, atol=1e-9)
    np.testing.assert_allclose(
        volumes, np.linalg.det(edge_matrices(positions.astype(float), mesh.cells)) / 6, atol=1e-14
    )
    assert np.array_equal(measure_cells(mesh, mesh.points)[0], mesh.rest_volumes)  # a ratio of one at rest


def test_nan_stays_in_its_cells() -> None:
    mesh = box([1.0, 2.0, 1.5], [2, 3, 2])
    x = 1.1 * mesh.points
    x[0] = np.nan
    touched = (mesh.cells == 0).any(axis=1)
    volumes, _, _, angles = measure_cells(mesh, x)
    assert np.isnan(volumes[touched]).all() and not np.isnan(volumes[~touched]).any()
    np.testing.assert_allclose(angles[~touched], 0.0, atol=1e-12)


@pytest.mark.parametrize("spread", [0.01, 0.3, 1.0, 30.0])
def test_rotations_are_those_of_the_singular_value_decomposition(spread: float) -> None:
    rng = np.random.default_rng(2)
    F = polar_by_svd(rng.normal(size=(20000, 3, 3))) @ (np.eye(3) + spread * rng.normal(size=(20000, 3, 3)))
    R, S = polar(F), polar_by_svd(F)
    s = np.linalg.svd(F)[1]
    sign = np.sign(np.linalg.det(F))
    gap = (s[:, 1] + sign * s[:, 2]) / s[:, 0]  # how well F determines its rotation
    assert (np.abs(R - S).max(axis=(1, 2)) * gap).max() < 1e-13


@pytest.mark.parametrize("d", [2, 3])
def test_gram_schmidt_rotations_of_degenerate_gradients_are_those_of_numpy(d: int) -> None:
    """Columns that are zero, parallel or nearly so, huge or tiny; the identity if F is not finite."""
    rng = np.random.default_rng(5)
    F = rng.normal(size=(2000, d, d))
    F[100:200, :, 0] = 0.0
    F[200:300, :, 1] = F[200:300, :, 0]
    F[300:400] = 0.0
    F[400:500, :, 1] = (F[400:500, :, 0].T * rng.normal(size=100)).T + 1e-9 * rng.normal(size=(100, d))
    F[500:600], F[600:700] = 1e200 * F[500:600], 1e-200 * F[600:700]
    F[700:800, :, 0] *= 1e-12
    F[800:900] = F[800:900, :, :1] * F[800:900, :1, :]
    expected, found = gram_schmidt(F), rotations_of(F, GRAM_SCHMIDT_ROTATION)
    loose = np.r_[400:500, 800:900]  # the rest of the second column is rounding error there
    np.testing.assert_allclose(np.delete(found, loose, 0), np.delete(expected, loose, 0), atol=1e-12)
    np.testing.assert_allclose(found[400:500], expected[400:500], atol=1e-6)
    np.testing.assert_allclose(np.swapaxes(found, 1, 2) @ found, np.broadcast_to(np.eye(d), F.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(found), 1.0)
    for nothing in (np.nan, np.inf):
        F[0, 0, 0] = nothing
        np.testing.assert_array_equal(rotations_of(F[:1], GRAM_SCHMIDT_ROTATION)[0], np.eye(d))


def rotations_of(F: np.ndarray, rotation: Rotation) -> np.ndarray:
    """The rotations of a compiled body with as many separate cells."""
    d = F.shape[1]
    corners = np.vstack([np.zeros(d), np.eye(d)])
    mesh = Mesh(np.tile(corners, (len(F), 1)), np.arange(len(F) * (d + 1)).reshape(-1, d + 1))
    x = np.einsum("eij,aj->eai", F, corners).reshape(-1, d)
    x[np.isnan(x)] = 0.0 if np.isfinite(F).all() else np.nan
    arguments = (mesh, Corotational(MATERIAL, rotation), NOWHERE, np.zeros_like(x), CONSISTENT_MASS)
    return CompiledBody(*arguments).rotations(x)


@pytest.mark.parametrize("d", [2, 3])
def test_the_linear_law_has_one_matrix_and_agrees_with_the_plain_body(d: int) -> None:
    mesh = box([1.0, 2.0, 1.5], [2, 3, 2]) if d == 3 else rectangle([1.0, 2.0], [4, 7])
    held = Supports(np.flatnonzero(mesh.points[:, 0] == 0.0))
    arguments = (mesh, Linear(MATERIAL), held, np.zeros_like(mesh.points), CONSISTENT_MASS)
    plain, body = Body(*arguments), make_body(*arguments)
    assert type(body) is LinearBody
    x = mesh.points + np.random.default_rng(4).normal(size=mesh.points.shape)
    f, K = plain.linearize(x)
    for given in (None, plain.rotations(x)):
        g, L = body.linearize(x, given)
        np.testing.assert_allclose(g, f, atol=1e-12 * np.abs(f).max())
        np.testing.assert_allclose(L, K, atol=1e-12 * np.abs(K).max())
    np.testing.assert_allclose(body.stiffness, K, atol=1e-12 * np.abs(K).max())
    np.testing.assert_allclose(body.force(x), f, atol=1e-12 * np.abs(f).max())
    assert body.energy(x) == pytest.approx(plain.energy(x), rel=1e-12)
    np.testing.assert_array_equal(body.rotations(x), plain.rotations(x))


def test_rotations_have_the_numbers_of_their_kernels() -> None:
    mesh = box([1.0, 1.0, 1.0], [1, 1, 1])
    laws = {
        POLAR: Corotational(MATERIAL),
        GRAM_SCHMIDT: Corotational(MATERIAL, GRAM_SCHMIDT_ROTATION),
        IDENTITY: Linear(MATERIAL),
    }
    for number, law in laws.items():
        assert make_body(mesh, law, NOWHERE, mesh.points, CONSISTENT_MASS)._rotation == number


def test_a_law_without_a_kernel_runs_on_numpy() -> None:
    mesh = box([1.0, 1.0, 1.0], [1, 1, 1])
    law = Corotational(MATERIAL, Rotation(lambda F: np.broadcast_to(np.eye(3), F.shape)))
    assert type(make_body(mesh, law, NOWHERE, mesh.points, CONSISTENT_MASS)) is Body


def test_the_corotational_law_is_compiled(rotation: Rotation) -> None:
    for mesh in (box([1.0, 1.0, 1.0], [1, 1, 1]), rectangle([1.0, 1.0], [1, 1])):
        law = Corotational(MATERIAL, rotation)
        assert type(make_body(mesh, law, NOWHERE, mesh.points, CONSISTENT_MASS)) is CompiledBody
