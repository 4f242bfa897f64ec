"""Mean dilatation: derivatives, patch tests, rigid motions, no mode without energy, and all methods."""

import numpy as np
import pytest

from pipeline.fem.body import Body
from pipeline.fem.loads import body_force
from pipeline.fem.material import Material
from pipeline.mesh.surface import find_boundary_faces
from tests.bodies import BOXES, METHODS, QUADRATIC, list_states, make_rotation, make_solid
from tests.fem.test_quadratic_element import make_patch

SOFT = Material(1e8, 0.49, 1000.0)
NEAR = Material(1e8, 0.4999, 1000.0)
MESHES = {f"order 1, {name}": mesh for name, mesh in BOXES.items()} | {
    f"order 2, {name}": mesh for name, mesh in QUADRATIC.items()
}
ALL = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
LAWS = pytest.mark.parametrize("name", ["linear", "polar"])
RNG = np.random.default_rng(9)


def make_mean(mesh, name: str = "polar", material: Material = SOFT, **keywords) -> Body:
    return make_solid(mesh, **METHODS[name], material=material, volumetric="mean", **keywords)


def deform(mesh, amount: float = 0.02) -> np.ndarray:
    X = mesh.points + amount * RNG.standard_normal(mesh.points.shape)
    return X @ make_rotation(mesh.dimension, [1, -2, 0.5], 2.0).T + 1.0


def difference(function, x, direction, h=1e-5):
    return (function(x + h * direction) - function(x - h * direction)) / (2 * h)


@LAWS
@ALL
def test_forces_and_tangents_are_derivatives(mesh, name):
    body, x = make_mean(mesh, name), deform(mesh)
    R = body.rotations(x)
    f, K = body.linearize(x, kind="exact" if name == "polar" else "frozen")
    _, frozen = body.linearize(x, R)
    assert np.abs(f - body.force(x)).max() < 1e-12 * np.abs(f).max()
    for direction in RNG.standard_normal((3, *x.shape)):
        assert difference(body.energy, x, direction) == pytest.approx(-np.vdot(f, direction), rel=1e-6)
        for values, force in ((K, body.force), (frozen, lambda y: body.force(y, R))):
            product = body.pattern.multiply(values, direction, np.empty_like(x))
            wanted = -difference(force, x, direction)
            assert np.abs(product - wanted).max() < 1e-6 * np.abs(wanted).max()


@LAWS
@ALL
def test_compiled_sums_are_those_of_numpy(mesh, name):
    body, x = make_mean(mesh, name), deform(mesh)
    plain = Body(mesh, body.law, body.supports, body.load, body.mass_model, None, body.formulation)
    assert body.energy(x) == pytest.approx(plain.energy(x), rel=1e-12)
    for kind in ("frozen", "projected", "exact") if name == "polar" else ("frozen",):
        for own, other in zip(body.linearize(x, kind=kind), plain.linearize(x, kind=kind), strict=True):
            assert np.abs(own - other).max() < 1e-12 * np.abs(other).max()


@LAWS
@ALL
def test_the_mean_of_a_constant_dilatation_changes_nothing(mesh, name):
    """The energy and forces of a homogeneous deformation are those without a mean."""
    A = np.eye(mesh.dimension) + 0.1 * RNG.standard_normal((mesh.dimension,) * 2)
    x, full = mesh.points @ A.T, make_solid(mesh, **METHODS[name], material=SOFT)
    body = make_mean(mesh, name)
    assert body.energy(x) == pytest.approx(full.energy(x), rel=1e-11)
    f = full.force(x)
    assert np.abs(body.force(x) - f).max() < 1e-11 * np.abs(f).max()


@LAWS
@ALL
def test_the_mean_lowers_the_energy(mesh, name):
    x = mesh.points + 0.02 * RNG.standard_normal(mesh.points.shape)
    assert make_mean(mesh, name).energy(x) < 0.9 * make_solid(mesh, **METHODS[name], material=SOFT).energy(x)


@LAWS
@pytest.mark.parametrize("is_curved", [False, True], ids=["straight", "curved"])
@pytest.mark.parametrize("d", [2, 3])
def test_patch_test(d, is_curved, name):
    mesh = make_patch(d, is_curved=is_curved)
    inner = np.ones(len(mesh.points), dtype=bool)
    inner[find_boundary_faces(mesh)[0]] = False
    f = make_mean(mesh, name).force(mesh.points @ (np.eye(d) + 0.1 * RNG.standard_normal((d, d))).T)
    assert np.abs(f[inner]).max() < 1e-12 * np.abs(f).max()


@LAWS
@ALL
def test_rigid_motions_are_the_only_modes_without_energy(mesh, name):
    """Next to nu = .5 too; the softest other mode is hardly softer than that of nu = .3."""
    values, rigid = {}, {2: 3, 3: 6}[mesh.dimension]
    for material in (Material(1e8, 0.3, 1000.0), NEAR):
        body = make_mean(mesh, name, material)
        x = mesh.points @ make_rotation(mesh.dimension, [1, 2, 3], 1.0).T
        K = body.pattern.matrix(body.linearize(x)[1]).toarray()
        values[material] = np.linalg.eigvalsh(K)
        assert np.abs(values[material][:rigid]).max() < 1e-13 * values[material][-1]
        assert np.abs(body.force(x)).max() < 1e-12 * NEAR.lam if name == "polar" else True
    low, near = (v[rigid] for v in values.values())
    assert 0.5 * low < near < 1.5 * low


@ALL
def test_the_projected_tangent_is_positive_semidefinite_in_compression(mesh):
    body = make_mean(mesh)
    values = np.linalg.eigvalsh(body.pattern.matrix(body.linearize(0.5 * mesh.points, kind="projected")[1]).toarray())
    assert values[0] > -1e-13 * values[-1]


@pytest.mark.parametrize("mesh", [BOXES["triangles"], QUADRATIC["triangles"], BOXES["alternating"]])
@pytest.mark.parametrize(
    "method",
    [
        {"iterations": 1},
        {"iterations": "converged"},
        {"iterations": "converged", "tangent": "exact"},
        {"model": "auto"},
        {"stepper": "bdf2"},
        {"law": "linear"},
        {"linear_solver": "warped"},
        {"linear_solver": "multigrid"},
    ],
    ids=str,
)
def test_methods_run_and_agree(mesh, method):
    """Ten short steps of every method end near those of converged ones, for nu = .499."""
    held, load = np.flatnonzero(mesh.points[:, 1] == 0.0), body_force(mesh, 1e4 * np.eye(mesh.dimension)[0])
    law = "linear" if method.get("law") == "linear" else "polar"
    material = Material(1e8, 0.499, 1000.0)
    ends = []
    for given, name in ((method, law), ({"iterations": "converged"}, "polar")):
        body = make_mean(mesh, name, material, held=held, load=load)
        ends.append(list_states(body, 0.002, 10, np.zeros_like(mesh.points), **given)[-1].x - mesh.points)
    scale = np.abs(ends[1]).max()
    assert scale > 1e-5
    assert np.abs(ends[0] - ends[1]).max() < (0.4 if "stepper" in method else 0.02) * scale
