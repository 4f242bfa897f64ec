"""Shape functions, node orders, quadratures and mirrors of every kind of cell, against VTK and exact integrals."""

import itertools
import math
import re

import numpy as np
import pytest
import sympy
import vtk
from sympy.polys.rings import PolyElement, ring

from pipeline.errors import MeshError
from pipeline.formats.cell_kinds import ROWS, TYPES, explain_refusal
from pipeline.formats.grid import CellArray
from pipeline.mesh.blocks import check_types, find_simplices, mirror_cells, split_blocks
from pipeline.mesh.cell_mesh import measure_volumes
from pipeline.mesh.quadrature import find_quadrature, find_samples
from pipeline.mesh.shape_functions import CellKind, find_kind

KINDS = [(row.number, count) for row in ROWS for count in row.kinds]
IN_VTK = [(number, count) for number, count in KINDS if number != 74]  # a number without a class
LAGRANGE = 68


def list_ids(kinds: list[tuple[int, int]]) -> list[str]:
    return [f"{TYPES[number].name} {count}" for number, count in kinds]


def make_vtk_cell(number: int, count: int) -> vtk.vtkCell:
    generic = vtk.vtkGenericCell()
    generic.SetCellType(number)
    cell = generic.GetRepresentativeCell()
    if number > LAGRANGE:
        cell.GetPointIds().SetNumberOfIds(count)
        cell.GetPoints().SetNumberOfPoints(count)
        if hasattr(cell, "SetUniformOrderFromNumPoints"):
            cell.SetUniformOrderFromNumPoints(count)
        cell.Initialize()
    return cell


def draw_inside(kind: CellKind, count: int) -> np.ndarray:
    """Reference points inside the simplex, which lie inside the other shapes too."""
    return np.random.default_rng(5).dirichlet(np.ones(kind.dimension + 1), count)[:, 1:]


def find_vtk_coordinates(number: int, xi: np.ndarray) -> np.ndarray:
    """VTK's coordinates (q, 3); see shape_functions.py about the pyramid of 19 nodes."""
    at = np.zeros((len(xi), 3))
    at[:, : xi.shape[1]] = xi
    if number == 37:
        at[:, :2] = 0.5 + (xi[:, :2] - 0.5) * (1 - xi[:, 2:])
        at[:, 2] = (1 + xi[:, 2]) / 2
    return at


@pytest.mark.parametrize(("number", "count"), IN_VTK, ids=list_ids(IN_VTK))
def test_shape_functions_are_those_of_vtk(number: int, count: int) -> None:
    kind, cell = find_kind(number, count), make_vtk_cell(number, count)
    xi = draw_inside(kind, 30)
    values = np.zeros((30, count))
    for row, at in zip(values, find_vtk_coordinates(number, xi), strict=True):
        cell.InterpolateFunctions(at, row)
    np.testing.assert_allclose(kind.evaluate(xi), values, atol=1e-14)


@pytest.mark.parametrize(("number", "count"), IN_VTK, ids=list_ids(IN_VTK))
def test_derivatives_are_those_of_vtk(number: int, count: int) -> None:
    if number == 27:  # VTK's contradict its own functions; the test by differences covers this kind
        cell, step = make_vtk_cell(number, count), 1e-6
        ahead, behind, slopes = np.zeros(count), np.zeros(count), np.zeros(3 * count)
        cell.InterpolateFunctions((0.3 + step, 0.2, 0.1), ahead)
        cell.InterpolateFunctions((0.3 - step, 0.2, 0.1), behind)
        cell.InterpolateDerivs((0.3, 0.2, 0.1), slopes)
        assert np.abs((ahead - behind) / (2 * step) - slopes[:count]).max() > 0.01
        return
    kind, cell = find_kind(number, count), make_vtk_cell(number, count)
    xi, d = draw_inside(kind, 10), kind.dimension
    ours = kind.differentiate(xi)
    for mine, at, here in zip(ours, find_vtk_coordinates(number, xi), xi, strict=True):
        slopes = np.zeros((d, count))
        try:
            cell.InterpolateDerivs(at, slopes.reshape(-1))
        except TypeError:  # some planar cells have a third row
            rows = np.zeros((3, count))
            cell.InterpolateDerivs(at, rows.reshape(-1))
            slopes = rows[:2]
        if number in (70, 72):  # these list the axes of one node after the other
            slopes = slopes.reshape(count, d).T
        expected = slopes.T
        if number == 37:
            low = 1 - here[2]
            chain = np.array([[low, 0, 0.5 - here[0]], [0, low, 0.5 - here[1]], [0, 0, 0.5]])
            expected = expected @ chain
        np.testing.assert_allclose(mine, expected, atol=3e-14 * count)


@pytest.mark.parametrize(("number", "count"), IN_VTK, ids=list_ids(IN_VTK))
def test_nodes_are_numbered_as_vtk_numbers_them(number: int, count: int) -> None:
    kind, cell = find_kind(number, count), make_vtk_cell(number, count)
    theirs = np.array([cell.GetParametricCoords()[i] for i in range(3 * count)]).reshape(count, 3)
    mine = find_vtk_coordinates(number, kind.nodes)
    if number in (14, 27):  # any two coordinates name the apex, to which the top of the cube collapses
        mine[4, :2] = theirs[4, :2]
    np.testing.assert_allclose(mine, theirs, atol=1e-12)
    assert TYPES[number].dimension == cell.GetCellDimension()


@pytest.mark.parametrize(("number", "count"), KINDS, ids=list_ids(KINDS))
def test_shape_functions_interpolate(number: int, count: int) -> None:
    kind, step = find_kind(number, count), 1e-6
    assert (len(kind.nodes) == count and len(kind.corners) == {2: 3, 3: 4}[kind.dimension]) or len(kind.corners) > 3
    np.testing.assert_allclose(kind.evaluate(kind.nodes), np.eye(count), atol=1e-13)
    xi = draw_inside(kind, 20)
    np.testing.assert_allclose(kind.evaluate(xi).sum(axis=1), 1, atol=1e-14 * count)
    slopes = kind.differentiate(xi)
    np.testing.assert_allclose(slopes.sum(axis=1), 0, atol=1e-13 * count)
    for axis, unit in enumerate(np.eye(kind.dimension)):
        differences = (kind.evaluate(xi + step * unit) - kind.evaluate(xi - step * unit)) / (2 * step)
        np.testing.assert_allclose(slopes[:, :, axis], differences, atol=1e-8)


def test_every_number_of_vtk_has_a_row() -> None:
    texts = "TRIANGLE|QUAD|PIXEL|TETRA|VOXEL|HEXA|WEDGE|PYRAMID|PRISM|POLYHEDRON|POLYGON|LAGRANGE|BEZIER|STRIP|CONVEX"
    names = [name for name in dir(vtk) if re.fullmatch(rf"VTK_(\w*_)?({texts})\w*", name) and "WIPE" not in name]
    names = [name for name in names if "RESOLUTION" not in name and "TENSOR" not in name]
    numbers = {int(getattr(vtk, name)) for name in names if isinstance(getattr(vtk, name), int)}
    assert {5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 22, 42, 71, 80} <= numbers
    assert {number for number in numbers if number >= 0} <= set(TYPES)
    assert len(TYPES) == len(ROWS)


def test_types_with_the_same_functions_are_one_kind() -> None:
    assert find_kind(71, 4) is find_kind(10, 4) and find_kind(69, 3) is find_kind(5, 3)
    assert find_kind(72, 8) is find_kind(12, 8) and find_kind(71, 10) is find_kind(24, 10)
    assert find_kind(73, 6) is find_kind(13, 6) and find_kind(70, 4) is find_kind(9, 4)
    array = CellArray(np.array([71, 10], np.uint8), np.array([0, 4, 8]), np.arange(8))
    assert len(split_blocks(array)) == 1
    simplices = find_simplices(array)
    assert simplices is not None and simplices.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert find_simplices(CellArray(np.array([71], np.uint8), np.array([0, 10]), np.arange(10))) is None


@pytest.mark.parametrize(
    ("number", "count", "words"),
    [
        (79, 8, "weights of Bezier cells are not read; write Lagrange cells"),
        (78, 10, "write Lagrange cells"),
        (6, 5, "split strips into triangles"),
        (36, 6, "write quadratic triangles"),
        (41, 9, "write polyhedra"),
        (72, 12, "with 12 nodes cannot be measured, only with 8, 27, 64, 125: write one order along all axes"),
        (71, 56, "at most 4"),
        (10, 5, "only with 4"),
        (3, 2, "no volume"),
        (99, 4, "not one of VTK's"),
    ],
)
def test_refusals_say_what_to_do(number: int, count: int, words: str) -> None:
    assert words in explain_refusal(number, count)
    with pytest.raises(MeshError, match=r"x\.vtu: cell 1: "):
        kinds = np.array([10, number], np.uint8)
        check_types(CellArray(kinds, np.array([0, 4, 4 + count]), np.arange(4 + count)), "x.vtu")
    with pytest.raises(MeshError, match=words.split(":")[0].split(",")[0]):
        find_kind(number, count)


@pytest.mark.parametrize(("number", "count"), KINDS, ids=list_ids(KINDS))
def test_mirrored_cells_change_the_sign_of_their_volume(number: int, count: int) -> None:
    kind = find_kind(number, count)
    points = kind.nodes + 0.02 * np.random.default_rng(0).normal(size=kind.nodes.shape)
    array = CellArray(np.full(2, number, np.uint8), np.array([0, count, 2 * count]), np.tile(np.arange(count), 2))
    mirrored = mirror_cells(array, np.array([1]))
    before = measure_volumes(points, array, kind.dimension)
    after = measure_volumes(points, mirrored, kind.dimension)
    assert after == pytest.approx(before * [1, -1], rel=1e-12) and before[0] > 0
    assert sorted(mirrored.connectivity[count:]) == list(range(count))
    assert np.array_equal(mirror_cells(mirrored, np.array([1])).connectivity, array.connectivity)


# the monomials r^i s^j t^k whose combinations the shape functions are, in exact arithmetic: independent of our modes
SPACES = {
    (9, 4): lambda i, j, k: max(i, j) < 2 and k == 0,
    (12, 8): lambda i, j, k: max(i, j, k) < 2,
    (13, 6): lambda i, j, k: i + j < 2 and k < 2,
    (22, 6): lambda i, j, k: i + j <= 2 and k == 0,
    (23, 8): lambda i, j, k: min(i, j) < 2 and k == 0,
    (28, 9): lambda i, j, k: k == 0,
    (30, 6): lambda i, j, k: j < 2 and k == 0,
    (24, 10): lambda i, j, k: i + j + k <= 2,
    (25, 20): lambda i, j, k: (i, j, k).count(2) <= 1,
    (33, 24): lambda i, j, k: (i, j, k).count(2) <= 1 or (k == 2 and (i, j, k).count(2) == 2),
    (29, 27): lambda i, j, k: True,
    (26, 15): lambda i, j, k: i + j + max(k - 1, 0) <= 2,
    (31, 12): lambda i, j, k: i + j <= 2 and k < 2,
    (32, 18): lambda i, j, k: i + j <= 2,
}
CURVED = [*SPACES, (14, 5), (27, 13)]
R, r, s, t = ring("r,s,t", sympy.QQ)


def list_exact_functions(number: int, count: int) -> list[PolyElement]:
    """Shape functions as polynomials with rational coefficients."""
    if number == 14:
        return [(1 - r) * (1 - s) * (1 - t), r * (1 - s) * (1 - t), r * s * (1 - t), (1 - r) * s * (1 - t), t]
    if number == 27:
        return list_pyramid_functions()
    inside = SPACES[number, count]
    powers = [p for p in itertools.product(range(3), repeat=3) if inside(*p)]
    nodes = np.zeros((count, 3), dtype=int)
    nodes[:, : TYPES[number].dimension] = np.rint(2 * find_kind(number, count).nodes)
    rows = [[sympy.Rational(math.prod(int(x) ** n for x, n in zip(X, p, strict=True)), 2 ** sum(p)) for p in powers]
            for X in nodes]  # fmt: skip
    inverse = sympy.Matrix(rows).inv()
    monomials = [r**i * s**j * t**k for i, j, k in powers]
    return [sum((inverse[m, a] * f for m, f in enumerate(monomials)), R(0)) for a in range(count)]


def list_pyramid_functions() -> list[PolyElement]:
    """VTK's of 13 nodes, in coordinates from -1 to 1, from its documented formulas."""
    a, b, c = 2 * r - 1, 2 * s - 1, 2 * t - 1
    corners = []
    for e, f in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        A, B = e * a, f * b
        rest = 4 - 3 * A - 3 * B + 2 * A * B + 2 * c - A * c - B * c + 2 * A * B * c
        corners.append(-(1 + A) * (1 + B) * (1 - c) * rest / 16)
    across = [(a, -b), (b, a), (a, b), (b, -a)]
    base = [(1 - u**2) * (1 + v) * (1 - c) * (2 - v - v * c) / 8 for u, v in across]
    sides = [(1 + e * a) * (1 + f * b) * (1 - c**2) / 4 for e, f in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return [*corners, c * (1 + c) / 2, *base, *sides]


def integrate_exactly(f: PolyElement, shape: str) -> sympy.Rational:
    """The integral over the reference cell, monomial by monomial."""
    total = sympy.Rational(0)
    for (i, j, k), coefficient in f.terms():
        if shape == "tetrahedron":
            product = math.factorial(i) * math.factorial(j) * math.factorial(k)
            part = sympy.Rational(product, math.factorial(i + j + k + 3))
        elif shape in ("triangle", "wedge"):
            part = sympy.Rational(math.factorial(i) * math.factorial(j), math.factorial(i + j + 2) * (k + 1))
        else:
            part = sympy.Rational(1, (i + 1) * (j + 1) * (k + 1))
        total += coefficient * part
    return total


@pytest.mark.parametrize(("number", "count"), CURVED, ids=list_ids(CURVED))
def test_volumes_of_curved_cells_are_exact(number: int, count: int) -> None:
    kind, d = find_kind(number, count), TYPES[number].dimension
    rng = np.random.default_rng(number)
    points = np.round(64 * (2 * kind.nodes + 0.1 * rng.normal(size=kind.nodes.shape))) / 64  # rational numbers
    functions = list_exact_functions(number, count)
    x = [sum((sympy.Rational(X) * N for X, N in zip(axis, functions, strict=True)), R(0)) for axis in points.T]
    x += [t] * (3 - d)
    J = [[f.diff(v) for v in (r, s, t)] for f in x]
    det = sum((J[0][a] * (J[1][(a + 1) % 3] * J[2][(a + 2) % 3] - J[1][(a + 2) % 3] * J[2][(a + 1) % 3])
               for a in range(3)), R(0))  # fmt: skip
    exact = integrate_exactly(det, kind.shape)
    shares = [integrate_exactly(det * N, kind.shape) for N in functions]
    array = CellArray(np.array([number], np.uint8), np.array([0, count]), np.arange(count))
    assert measure_volumes(points, array, d)[0] == pytest.approx(float(exact), rel=1e-13)
    at, weights = find_quadrature(kind, "nodes")
    dets = np.linalg.det(np.einsum("ai,qad->qid", points, kind.differentiate(at)))
    scale = float(abs(exact))
    np.testing.assert_allclose((weights * dets) @ kind.evaluate(at), [float(v) for v in shares], atol=1e-13 * scale)


@pytest.mark.parametrize(("number", "count"), KINDS, ids=list_ids(KINDS))
def test_quadratures_are_exact_for_volumes(number: int, count: int) -> None:
    """A rule of many more points, which serves any polynomial, gives the same volumes of random maps."""
    kind = find_kind(number, count)
    fine, weight = np.polynomial.legendre.leggauss(14)
    fine, weight = (fine + 1) / 2, weight / 2
    cube = np.array(list(itertools.product(fine, repeat=kind.dimension)))
    weights = np.prod(list(itertools.product(weight, repeat=kind.dimension)), axis=1)
    if kind.shape in ("triangle", "wedge", "tetrahedron"):  # collapse the cube
        weights = weights * (1 - cube[:, 1])
        cube[:, 0] *= 1 - cube[:, 1]
    if kind.shape == "tetrahedron":
        weights = weights * (1 - cube[:, 2]) ** 2
        cube[:, :2] *= 1 - cube[:, 2:]
    points = np.random.default_rng(1).normal(size=kind.nodes.shape)
    rules = ((find_quadrature(kind), ""), (find_samples(kind), ""), (find_quadrature(kind, "nodes"), "nodes"))
    for (at, w), purpose in rules:
        volumes = []
        for x, u in ((at, w), (cube, weights)):
            part = np.linalg.det(np.einsum("ai,qad->qid", points, kind.differentiate(x))) * u
            volumes.append(part @ kind.evaluate(x) if purpose else part.sum())
        np.testing.assert_allclose(volumes[0], volumes[1], atol=1e-10 * np.abs(volumes[1]).max())
