r"""Quadratures that are exact for the volume of every kind of cell, and for the volumes of its nodes.

The integrand det(dx/dxi) is a polynomial whose degree follows from that n of the map: d (n - 1) in a simplex, d n - 1
along each axis of a square or cube, 3 n - 2 across and 3 n - 1 along a wedge. The mean of F has the same degrees, and
the integrals of N_a det have n more. Products of Gauss's rules serve all of them; cheaper ones are listed below.

Of a surface in space the integrand |t_1 x t_2| is no polynomial unless the surface is plane: the rules of surfaces
have two more points along each axis, and are not exact.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.mesh.shape_functions import CellKind

_SURFACE_POINTS = 2  # more along each axis
_BELOW_APEX = 1e-3  # of the height: lengths across the axis keep 13 digits there
# barycentric coordinates of points and their weights, of unit sum, exact to a degree
_TETRAHEDRA = {
    1: (np.full((1, 4), 0.25), np.ones(1)),
    # corners and centers of faces: the corners are sampled anyway
    3: (np.concatenate([np.eye(4), (1 - np.eye(4)) / 3]), np.repeat([1 / 40, 9 / 40], 4)),
}
_TRIANGLES = {
    1: (np.full((1, 3), 1 / 3), np.ones(1)),
    2: ((1 - np.eye(3)) / 2, np.full(3, 1 / 3)),  # the middles of edges, which are nodes of quadratic triangles
}


class Quadrature(NamedTuple):
    """Points xi (q, dimension) and weights (q,), whose sum is the volume of the reference cell."""

    points: Floats
    weights: Floats


@cache
def find_quadrature(kind: CellKind, purpose: str = "volume") -> Quadrature:
    """Return the quadrature of a kind for "volume", "nodes" (integrals of N_a det) or "surface" (in space)."""
    n, d = _find_degree(kind), kind.dimension
    nodal = int(purpose == "nodes")
    more = 2 * _SURFACE_POINTS if purpose == "surface" and not kind.is_linear_simplex else 0
    if kind.shape in ("triangle", "tetrahedron"):
        return _integrate_simplex(d, d * (n - 1) + nodal * n + more)
    if kind.shape == "wedge":
        across = _integrate_simplex(2, 3 * n - 2 + nodal * n)
        return _multiply(across, _integrate_interval(3 * kind.order - 1 + nodal * kind.order))
    # the functions of pyramids can have a higher degree along the third axis
    first, last = (_integrate_interval(d * m - 1 + nodal * m + more) for m in (kind.order, n))
    plane = _multiply(first, first)
    return plane if d == 2 else _multiply(plane, last)


def _find_degree(kind: CellKind) -> int:
    """Return the degree of the shape functions, which centers of faces raise."""
    if kind.shape == "pyramid" and kind.order == 2:
        return 3 if "centers" in kind.name else 2
    bubbles = "center" in kind.name and kind.shape in ("triangle", "tetrahedron", "wedge")
    return kind.order + bubbles * (2 if kind.shape == "tetrahedron" else 1)


def _integrate_interval(degree: int) -> Quadrature:
    """Return Gauss's rule on [0, 1], exact to that degree."""
    points, weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    return Quadrature((points[:, None] + 1) / 2, weights / 2)


def _integrate_simplex(dimension: int, degree: int) -> Quadrature:
    """Return a rule on a triangle or tetrahedron, exact to that degree: listed, or a product on the collapsed cube."""
    listed = _TRIANGLES if dimension == 2 else _TETRAHEDRA
    enough = [known for known in listed if known >= degree]
    if enough:
        barycentric, weights = listed[min(enough)]
        return Quadrature(barycentric[:, 1:], weights / (2 if dimension == 2 else 6))
    from scipy.special import roots_jacobi

    total = _integrate_interval(degree)
    for axis in range(1, dimension):  # the weight (1 - y)^axis is that of the collapsed coordinates
        y, w = roots_jacobi(degree // 2 + 1, axis, 0)
        y, w = (y + 1) / 2, w / 2 ** (axis + 1)
        inner = total.points[None, :, :] * (1 - y)[:, None, None]
        points = np.concatenate([inner, np.broadcast_to(y[:, None, None], (*inner.shape[:2], 1))], axis=2)
        total = Quadrature(points.reshape(-1, axis + 1), np.outer(w, total.weights).ravel())
    return total


def _multiply(a: Quadrature, b: Quadrature) -> Quadrature:
    """Return the product of two rules."""
    points = np.concatenate(
        [np.repeat(a.points, len(b.weights), axis=0), np.tile(b.points, (len(a.weights), 1))], axis=1
    )
    return Quadrature(points, np.outer(a.weights, b.weights).ravel())


# rules with points inside: of each orbit of d + 1 points, one barycentric coordinate and the d others, which are equal.
# All points of a rule weigh the same, and it does not depend on the order of the corners
_ORBITS = {
    (2, 2): ((2 / 3, 1 / 6),),
    (3, 2): (((5 + 3 * 5**0.5) / 20, (5 - 5**0.5) / 20),),
    (3, 3): ((0.661129616462466914, 0.112956794512511029), (0.0134150502093912688, 0.328861649930202910)),
}


@cache
def find_stress_quadrature(dimension: int, *, is_straight: bool) -> Quadrature:
    """Return the rule for stresses in quadratic simplices: exact to degree 2, or 3 in curved tetrahedra.

    Products of gradients have degree 2 in straight cells; constant stresses in curved ones have the degree d.
    """
    d = dimension
    rows = [np.full((d + 1,) * 2, b) + (a - b) * np.eye(d + 1) for a, b in _ORBITS[d, 2 if is_straight else d]]
    barycentric, volume = np.concatenate(rows), 1 / (2 if d == 2 else 6)
    return Quadrature(barycentric[:, 1:], np.full(len(barycentric), volume / len(barycentric)))


@cache
def find_mass_quadrature(dimension: int, *, is_straight: bool) -> Quadrature:
    """Return the rule for products of two quadratic shape functions: degree 4, and that of det J0 if curved."""
    return _integrate_simplex(dimension, 4 if is_straight else 4 + dimension)


@cache
def find_samples(kind: CellKind, purpose: str = "volume") -> Quadrature:
    """Return the points at which det F is sampled: those of the quadrature, and the nodes, with weights of zero.

    A node that is a point of the quadrature comes once. In linear simplices det F is constant: they have one point.

    The coordinates of a pyramid collapse in its apex: the derivatives vanish there, and F depends on the line along
    which one comes to it; along each line F of a linear pyramid is constant. So the apex is sampled a little below
    it, on the axis; the lines through the other corners of the base have samples of their own at these corners.
    """
    quadrature = find_quadrature(kind, purpose)
    if kind.is_linear_simplex:
        return quadrature
    nodes = kind.nodes.copy()
    if kind.shape == "pyramid":
        nodes[4, 2] -= _BELOW_APEX
    apart = np.abs(nodes[:, None] - quadrature.points).max(axis=2).min(axis=1)
    nodes = nodes[apart > 1e-9]
    return Quadrature(
        np.concatenate([quadrature.points, nodes]), np.concatenate([quadrature.weights, np.zeros(len(nodes))])
    )
