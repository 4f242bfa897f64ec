"""The order in space: a manufactured static solution with a prescribed boundary, straight and curved cells."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from pipeline.fem.body import Body
from pipeline.fem.element import nodal_sums
from pipeline.fem.laws import Linear
from pipeline.fem.mass import CONSISTENT_MASS
from pipeline.fem.material import Material
from pipeline.fem.supports import Supports
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.integration import integrate_cells
from pipeline.mesh.quadratic import QuadraticMesh, make_quadratic_mesh, raise_order
from pipeline.mesh.quadrature import find_mass_quadrature
from pipeline.mesh.shapes import box, rectangle
from pipeline.mesh.surface import find_boundary_faces

MATERIAL = Material(1.0, 0.3, 1.0)


def displace(X: np.ndarray) -> np.ndarray:
    """u = (prod sin pi X_i, 0, 0) at points (..., d)."""
    u = np.zeros_like(X)
    u[..., 0] = np.sin(np.pi * X).prod(axis=-1)
    return u


def differentiate(X: np.ndarray) -> np.ndarray:
    """The gradient of u (..., d, d)."""
    d, s, c = X.shape[-1], np.sin(np.pi * X), np.cos(np.pi * X)
    G = np.zeros((*X.shape, d))
    for j in range(d):
        G[..., 0, j] = np.pi * c[..., j] * s[..., [k for k in range(d) if k != j]].prod(axis=-1)
    return G


def find_body_force(X: np.ndarray) -> np.ndarray:
    """b = -div sigma(u)."""
    d, mu, lam = X.shape[-1], MATERIAL.mu, MATERIAL.lam
    s, c, b = np.sin(np.pi * X), np.cos(np.pi * X), np.zeros_like(X)
    b[..., 0] = ((d + 1) * mu + lam) * np.pi**2 * s.prod(axis=-1)
    for j in range(1, d):
        others = s[..., [k for k in range(1, d) if k != j]].prod(axis=-1)
        b[..., j] = -(lam + mu) * np.pi**2 * c[..., 0] * c[..., j] * others
    return b


def solve(mesh: ElementMesh, load: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The displacements (n, d), exact on the held nodes."""
    d, X = mesh.dimension, mesh.points
    body = Body(mesh, Linear(MATERIAL), Supports(held), load, CONSISTENT_MASS)
    K = body.pattern.matrix(body.linearize(X)[1]).tocsr()
    u = np.zeros_like(X)
    u[held] = displace(X[held])
    free = np.repeat(body.free_mask, d)
    u[body.free] = spsolve(K[free][:, free].tocsc(), (load.ravel() - K @ u.ravel())[free]).reshape(-1, d)
    return u


def nodal_error(d: int, n: int, split: str) -> float:
    """Return the L2 error at the nodes of linear simplices on the unit square or cube, n cells per side."""
    mesh = (rectangle if d == 2 else box)([1.0] * d, [n] * d, split)
    held = np.flatnonzero(((mesh.points < 1e-9) | (mesh.points > 1 - 1e-9)).any(axis=1))
    u = solve(mesh, mesh.node_volumes[:, None] * find_body_force(mesh.points), held)
    return float(np.sqrt((mesh.node_volumes @ (u - displace(mesh.points)) ** 2).sum()))


@pytest.mark.parametrize("split", ["kuhn", "alternating"])
@pytest.mark.parametrize(("d", "sizes"), [(2, (8, 16, 32)), (3, (4, 8, 16))])
def test_a_static_solution_converges_with_the_square_of_the_cells(d: int, sizes: tuple[int, ...], split: str) -> None:
    errors = np.array([nodal_error(d, n, split) for n in sizes])
    orders = np.log2(errors[:-1] / errors[1:])
    assert orders[-1] == pytest.approx(2.0, abs=0.15)


def integrate_errors(mesh: QuadraticMesh) -> tuple[float, float]:
    """Return the errors of u in L2 and of its gradient in L2, integrated over the cells; so is the load."""
    rule = find_mass_quadrature(mesh.dimension, is_straight=False)
    weights, gradients = integrate_cells(mesh.points, mesh.cells, mesh.kind, rule)
    N = mesh.kind.evaluate(rule.points)
    at = N @ mesh.points[mesh.cells]
    load = nodal_sums(mesh, np.einsum("eq,qa,eqd->ead", weights, N, find_body_force(at)))
    u = solve(mesh, load, np.unique(find_boundary_faces(mesh)[0]))[mesh.cells]
    value = (N @ u - displace(at)) ** 2
    slope = (np.einsum("eai,eqaj->eqij", u, gradients) - differentiate(at)) ** 2
    return tuple(
        float(np.sqrt(weights.ravel() @ part.reshape(weights.size, -1).sum(axis=1))) for part in (value, slope)
    )


def bend(mesh: QuadraticMesh) -> QuadraticMesh:
    """A body with curved sides: the nodes of the square or cube moved by a smooth map."""
    X = mesh.points
    return make_quadratic_mesh(X + 0.15 * np.sin(2.0 * X[:, ::-1]) * X, mesh.cells)


@pytest.mark.parametrize("is_curved", [False, True], ids=["straight", "curved"])
@pytest.mark.parametrize(("d", "sizes"), [(2, (4, 8, 16)), (3, (2, 4, 8))])
def test_order_2_converges_with_the_third_power_and_its_strains_with_the_second(
    d: int, sizes: tuple[int, ...], is_curved: bool
) -> None:
    errors = []
    for n in sizes:
        mesh = raise_order((rectangle if d == 2 else box)([1.0] * d, [n] * d, "kuhn"))
        errors.append(integrate_errors(bend(mesh) if is_curved else mesh))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    print(d, is_curved, orders)
    assert (orders[-1] >= [2.8, 1.8]).all() and (orders[-1] <= [3.3, 2.2]).all()
