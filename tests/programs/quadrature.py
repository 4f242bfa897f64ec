"""Integrals over cells, for programs that have no convenient integral of their own: numpy, nothing of the package.

Shape functions follow from the nodes on the reference cell and the monomials that they span: N = M(xi) M(nodes)^-1.
"""

from itertools import product

import numpy as np

CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=float)
SIMPLEX = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
PRISM = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], dtype=float)
CUBE_EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
SIMPLEX_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
PRISM_EDGES = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)]


def with_midpoints(corners, edges):
    return np.concatenate([corners, [(corners[a] + corners[b]) / 2 for a, b in edges]])


def monomials(condition, highest=2):
    return [p for p in product(range(highest + 1), repeat=3) if condition(*p)]


# name: (nodes on the reference cell, exponents of the monomials, domain)
KINDS = {
    "tetrahedron": (SIMPLEX, monomials(lambda i, j, k: i + j + k <= 1), "simplex"),
    "tetrahedron_10": (with_midpoints(SIMPLEX, SIMPLEX_EDGES), monomials(lambda i, j, k: i + j + k <= 2), "simplex"),
    "hexahedron": (CUBE, monomials(lambda i, j, k: max(i, j, k) <= 1), "cube"),
    "hexahedron_20": (
        with_midpoints(CUBE, CUBE_EDGES),
        monomials(lambda i, j, k: sum(e for e in (i, j, k) if e > 1) <= 2),
        "cube",
    ),
    "wedge": (PRISM, monomials(lambda i, j, k: i + j <= 1 and k <= 1), "prism"),
    "wedge_15": (
        with_midpoints(PRISM, PRISM_EDGES),
        monomials(lambda i, j, k: i + j <= 2 and i + j + k <= 3 and not (i + j == 2 and k == 2)),
        "prism",
    ),
    "triangle": (SIMPLEX[:3], [(0, 0, 0), (1, 0, 0), (0, 1, 0)], "triangle"),
    "triangle_6": (
        with_midpoints(SIMPLEX[:3], SIMPLEX_EDGES[:3]),
        monomials(lambda i, j, k: k == 0 and i + j <= 2),
        "triangle",
    ),
    "quadrilateral_8": (
        with_midpoints(CUBE[:4], CUBE_EDGES[:4]),
        monomials(lambda i, j, k: k == 0 and i + j <= 3 and max(i, j) <= 2),
        "square",
    ),
    "quadrilateral": (CUBE[:4], [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], "square"),
}


def make_rule(domain, n=5):
    """Return points and weights, exact for polynomials of degree 2n - 3 at least."""
    g, w = np.polynomial.legendre.leggauss(n)
    g, w = (g + 1) / 2, w / 2
    dimension = 2 if domain in ("triangle", "square") else 3
    points = np.array(list(product(g, repeat=dimension)))
    weights = np.array([np.prod(p) for p in product(w, repeat=dimension)])
    if domain in ("triangle", "prism", "simplex"):  # the square, its edge x = 1 drawn into one point
        u, v = points[:, 0].copy(), points[:, 1].copy()
        if domain == "simplex":
            t = points[:, 2].copy()
            points = np.stack([u, v * (1 - u), t * (1 - u) * (1 - v)], axis=1)
            weights = weights * (1 - u) ** 2 * (1 - v)
        else:
            points[:, 1] = v * (1 - u)
            weights = weights * (1 - u)
    return np.pad(points, ((0, 0), (0, 3 - dimension))), weights, dimension


def differentiate(points, exponents):
    """Return the derivatives (point, monomial, 3) and the values (point, monomial) of the monomials."""
    values = np.array([[np.prod(p ** np.array(e)) for e in exponents] for p in points])
    slopes = np.zeros((len(points), len(exponents), 3))
    for m, e in enumerate(exponents):
        for axis in range(3):
            if e[axis]:
                lower = np.array(e)
                lower[axis] -= 1
                slopes[:, m, axis] = e[axis] * np.prod(points**lower, axis=1)
    return values, slopes


def integrate_cells(kind, X, x, cells):
    """Return the rest volumes, volumes and means of F of cells (n, nodes) with points at X at rest, now at x."""
    nodes, exponents, domain = KINDS[kind]
    points, weights, d = make_rule(domain)
    table = np.linalg.inv(differentiate(nodes, exponents)[0])
    slopes = np.einsum("qma,mn->qna", differentiate(points, exponents)[1], table)[..., :d]
    A = np.einsum("qna,eni->eqia", slopes, np.asarray(X)[:, :d][cells])
    B = np.einsum("qna,eni->eqia", slopes, np.asarray(x)[:, :d][cells])
    F = B @ np.linalg.inv(A)
    rest, now = np.linalg.det(A) * weights, np.linalg.det(B) * weights
    mean = np.einsum("eq,eqij->eij", rest, F) / rest.sum(axis=1)[:, None, None]
    return rest.sum(axis=1), now.sum(axis=1), mean
