"""The order in space: a manufactured static solution with a prescribed boundary."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from pipeline.fem.body import Body
from pipeline.fem.laws import Linear
from pipeline.fem.mass import CONSISTENT_MASS
from pipeline.fem.material import Material
from pipeline.fem.supports import Supports
from pipeline.mesh.shapes import box, rectangle

MATERIAL = Material(1.0, 0.3, 1.0)


def error(d: int, n: int, split: str) -> float:
    """Return the L2 error at the nodes of u = (prod sin pi x_i, 0, 0) on the unit square or cube, n cells per side."""
    mesh = (rectangle if d == 2 else box)([1.0] * d, [n] * d, split)
    X, mu, lam = mesh.points, MATERIAL.mu, MATERIAL.lam
    s, c = np.sin(np.pi * X), np.cos(np.pi * X)
    exact = np.zeros_like(X)
    exact[:, 0] = s.prod(axis=1)
    # b = -div sigma(u)
    b = np.zeros_like(X)
    b[:, 0] = ((d + 1) * mu + lam) * np.pi**2 * exact[:, 0]
    for j in range(1, d):
        others = s[:, [k for k in range(1, d) if k != j]].prod(axis=1)
        b[:, j] = -(lam + mu) * np.pi**2 * c[:, 0] * c[:, j] * others
    held = np.flatnonzero(((X < 1e-9) | (X > 1 - 1e-9)).any(axis=1))
    load = mesh.node_volumes[:, None] * b
    body = Body(mesh, Linear(MATERIAL), Supports(held), load, CONSISTENT_MASS)
    _, K = body.linearize(X)
    pattern = body.free_pattern
    u = np.zeros_like(X)
    u[body.free] = spsolve(pattern.matrix(K[: pattern.blocks]).tocsc(), load[body.free].ravel()).reshape(-1, d)
    return float(np.sqrt((mesh.node_volumes @ (u - exact) ** 2).sum()))


@pytest.mark.parametrize("split", ["kuhn", "alternating"])
@pytest.mark.parametrize(("d", "sizes"), [(2, (8, 16, 32)), (3, (4, 8, 16))])
def test_a_static_solution_converges_with_the_square_of_the_cells(d: int, sizes: tuple[int, ...], split: str) -> None:
    errors = np.array([error(d, n, split) for n in sizes])
    orders = np.log2(errors[:-1] / errors[1:])
    assert orders[-1] == pytest.approx(2.0, abs=0.15)
