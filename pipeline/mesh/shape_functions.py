r"""Shape functions N_a of every kind of cell and their derivatives, in VTK's node order and reference coordinates.

    x(xi) = sum_a N_a(xi) x_a,   N_a(xi_b) = 1 if a = b, else 0,   sum_a N_a = 1

Each kind spans a space of polynomials: products of polynomials of one variable each, the reference coordinates or the
barycentric ones. N_a are the combinations of these modes that are 1 at one node and 0 at the others.

The coordinates of pyramids are collapsed, as VTK's of 5 and 13 nodes: the cube [0, 1]^3 with its top in the apex, so
that their functions are polynomials. VTK's coordinates p of 19 nodes are those of the pyramid itself, with the base at
p_2 = 1/2: p_i - 1/2 = (xi_i - 1/2) (1 - xi_2), p_2 = (1 + xi_2) / 2.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError
from pipeline.formats.cell_kinds import TYPES, explain_refusal
from pipeline.mesh.node_order import place_in_cube, place_in_simplex, place_in_wedge

_ROUNDING = 1e-12  # of coefficients, which are of the order of one
_CORNERS = {"triangle": 3, "quad": 4, "tetrahedron": 4, "hexahedron": 8, "wedge": 6, "pyramid": 5}


@dataclass(frozen=True, eq=False, repr=False)
class ModeSpace:
    """M modes: products of one polynomial of each variable y_v = slopes_v . xi + offsets_v.

    `polynomials` (v, p, degree + 1) are coefficients of powers of y_v; mode m takes number modes[m, v] of variable v.
    """

    slopes: Floats
    offsets: Floats
    polynomials: Floats
    modes: Ints

    def evaluate(self, xi: Floats) -> Floats:
        """Return the modes (q, M) at reference points xi (q, dimension)."""
        factors = self._evaluate_factors(xi, self.polynomials)
        return np.asarray(factors.prod(axis=1))

    def differentiate(self, xi: Floats) -> Floats:
        """Return the derivatives (q, M, dimension) of the modes."""
        factors = self._evaluate_factors(xi, self.polynomials)
        powers = np.arange(1, self.polynomials.shape[2])
        slopes = self._evaluate_factors(xi, self.polynomials[:, :, 1:] * powers)
        total = np.zeros((*factors.shape[::2], xi.shape[1]))
        for v in range(len(self.slopes)):
            others = np.delete(factors, v, axis=1).prod(axis=1)
            total += (slopes[:, v] * others)[:, :, None] * self.slopes[v]
        return total

    def _evaluate_factors(self, xi: Floats, polynomials: Floats) -> Floats:
        """Return the factor (q, v, M) of each variable in each mode."""
        y = (xi @ self.slopes.T + self.offsets)[:, :, None]
        values = np.zeros((len(xi), *polynomials.shape[:2]))
        for power in range(polynomials.shape[2] - 1, -1, -1):
            values = values * y + polynomials[:, :, power]
        return np.stack([values[:, v, self.modes[:, v]] for v in range(len(self.slopes))], axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class CellKind:
    """The shape functions of k nodes at reference positions `nodes` (k, dimension).

    `shape` is the name of the geometric shape, `order` the degree along edges, `corners` the numbers of the nodes at
    the corners, in VTK's order of the linear cell. `combine` (M, k) makes shape functions from the modes of `space`.
    """

    name: str
    shape: str
    dimension: int
    order: int
    nodes: Floats
    corners: Ints
    space: ModeSpace
    combine: Floats

    def __repr__(self) -> str:
        return f"<CellKind {self.name}: {len(self.nodes)} nodes, {self.dimension}D>"

    @property
    def is_linear_simplex(self) -> bool:
        """Return whether the shape functions are those of a triangle or tetrahedron of order 1."""
        return len(self.nodes) == self.dimension + 1

    def evaluate(self, xi: Floats) -> Floats:
        """Return N (q, k) at reference points xi (q, dimension)."""
        return self.space.evaluate(np.asarray(xi, dtype=np.float64)) @ self.combine

    def differentiate(self, xi: Floats) -> Floats:
        """Return dN/dxi (q, k, dimension) at reference points xi (q, dimension)."""
        slopes = self.space.differentiate(np.asarray(xi, dtype=np.float64))
        return np.ascontiguousarray(np.einsum("qmd,mk->qkd", slopes, self.combine))


def find_kind(cell_type: int, node_count: int) -> CellKind:
    """Return the kind of cells of a VTK type with that many nodes; raises MeshError if it has no shape functions."""
    number, count = int(cell_type), int(node_count)
    row = TYPES.get(number)
    if row is not None and count in row.kinds:
        return make_kind(row.kinds[count])
    reason = explain_refusal(number, count)
    raise MeshError(reason or f"cells of type {number} have faces, but no shape functions")


@cache
def make_kind(name: str) -> CellKind:
    """Return the kind of that name in the table of cell_kinds.py."""
    if name in ("pixel", "voxel"):
        return _reorder(name, make_kind("quad 1" if name == "pixel" else "hexahedron 1"))
    shape, _, rest = name.partition(" ")
    order = int(rest[0]) if rest[0].isdigit() else 2
    nodes, space, spanning = _BUILDERS[shape](order, rest)
    values = space.evaluate(nodes)
    inverse: Floats = np.linalg.inv(values if spanning is None else values @ spanning).astype(np.float64)
    combine = inverse if spanning is None else spanning @ inverse
    near = np.abs(combine - np.round(combine)) < _ROUNDING
    combine[near] = np.round(combine[near])
    corners = np.arange(_CORNERS[shape], dtype=np.int64)
    return CellKind(name, shape, nodes.shape[1], order, nodes, corners, space, combine)


def _reorder(name: str, kind: CellKind) -> CellKind:
    """Return the pixel or voxel, whose nodes run along the first axis first."""
    order = np.lexsort(kind.nodes.T)
    corners = np.argsort(order).astype(np.int64)
    return CellKind(name, kind.shape, kind.dimension, 1, kind.nodes[order], corners, kind.space, kind.combine[:, order])


Build = tuple[Floats, ModeSpace, Floats | None]  # nodes, modes, and the combinations of modes that span the space


def _build_cube(order: int, rest: str, dimension: int) -> Build:
    """Return a quadrilateral or hexahedron: all products of Lagrange polynomials, or serendipity spaces."""
    centered = (2 * np.eye(dimension), -np.ones(dimension))
    if rest == str(order):
        places = place_in_cube(order, dimension)
        table = np.stack([_list_lagrange(order)] * dimension)
        return places / order, ModeSpace(*centered, table, places), None
    places, powers = place_in_cube(2, dimension), np.indices((3,) * dimension).reshape(dimension, -1).T
    squares = (powers == 2).sum(axis=1)
    if rest == "2 by 1":  # quadratic along the first axis
        keep, chosen = powers[:, 1] < 2, [0, 1, 2, 3, 4, 6]
    elif rest == "2 by serendipity":  # biquadratic on the four faces around the third axis
        keep, chosen = (squares < 2) | ((powers[:, 2] == 2) & (squares == 2)), list(range(24))
    else:
        keep, chosen = squares < 2, list(range(8 if dimension == 2 else 20))
    table = np.stack([np.eye(3)] * dimension)
    return places[chosen] / 2, ModeSpace(*centered, table, powers[keep].astype(np.int64)), None


def _build_simplex(order: int, rest: str, dimension: int) -> Build:
    """Return a triangle or tetrahedron: Silvester's products of barycentric coordinates, and bubbles."""
    places = place_in_simplex(order, dimension)
    nodes, modes = places / order, _complete(places, order)
    if rest != str(order):
        solid = [(1, 1, 1, 0), (1, 1, 0, 1), (0, 1, 1, 1), (1, 0, 1, 1), (1, 1, 1, 1)]  # of faces, and inside
        bubbles = np.array([(1, 1, 1)] if dimension == 2 else solid, dtype=np.int64)
        centers = bubbles[:, 1:] / bubbles.sum(axis=1, keepdims=True)
        nodes, modes = np.concatenate([nodes, centers]), np.concatenate([modes, bubbles])
    table = np.stack([_list_silvester(order)] * (dimension + 1))
    return nodes, ModeSpace(*_list_barycentric(dimension, dimension), table, modes), None


def _build_wedge(order: int, rest: str) -> Build:
    """Return a wedge: products of a triangle's functions and polynomials along the third axis."""
    places = place_in_wedge(order)
    nodes, axial = places / order, _list_lagrange(order)
    modes = np.column_stack([_complete(places[:, :2], order), places[:, 2]])
    if rest == "2 by 1":
        nodes, axial = nodes[:12], _list_lagrange(1)
        modes = np.column_stack([modes[:12, :3], (places[:12, 2] > 0).astype(np.int64)])
    elif rest == "serendipity":  # quadratic on triangles, and 1 - y^2 along the edges between them
        nodes, axial = nodes[:15], np.array([[0.5, -0.5, 0], [0.5, 0.5, 0], [1.0, 0, -1.0]])
        edges = np.column_stack([np.eye(3, dtype=np.int64), np.full(3, 2, dtype=np.int64)])
        modes = np.concatenate([np.column_stack([modes[:12, :3], places[:12, 2] // 2]), edges])
    elif rest != str(order):
        along = np.array([0, 2, 1], dtype=np.int64)
        bubbles = np.column_stack([np.ones((3, 3), dtype=np.int64), along])
        centers = np.column_stack([np.full((3, 2), 1 / 3), along / 2])
        nodes = np.concatenate([nodes[:15], centers[:2], nodes[15:], centers[2:]])
        modes = np.concatenate([modes[:15], bubbles[:2], modes[15:], bubbles[2:]])
    table = _stack_tables([*[_list_silvester(order)] * 3, axial])
    slopes, offsets = _list_barycentric(2, 3)
    slopes, offsets = np.vstack([slopes, [0, 0, 2.0]]), np.append(offsets, -1.0)
    return nodes, ModeSpace(slopes, offsets, table, modes), None


# the spaces of VTK's pyramids in r, s = 2 xi - 1 and c = 1 - xi_2; with z = 1 - c and x = r c, y = s c
_PYRAMIDS = {
    "1": "1 | c | rc | sc | rsc",
    # the 13 nodes do not span x^2 and y^2
    "2": "1 | c | c2 | rc | sc | rsc | rc2 | sc2 | rsc2 | r2sc2 | rs2c2 | c - r2c - s2c + s2c2 + r2s2c - r2s2c2"
    " | c - s2c - r2c + r2c2 + r2s2c - r2s2c2",
    "2 with centers": "c - c2 | rc - rc2 | sc - sc2 | rsc - rsc2 | 1 - 3c + 2c2"
    " | c - c2 - r2c + r2c2 - s2c + s2c2 + r2s2c - r2s2c2 | c2 - r2c2 - s2c2 + r2s2c2"
    " | sc2 - sc3 - r2sc2 + r2sc3 | s2c2 - s2c3 - r2s2c2 + r2s2c3"
    " | rc2 - rc3 - rs2c2 + rs2c3 | r2c2 - r2c3 - r2s2c2 + r2s2c3"
    " | c2 - r2c2 | sc2 - r2sc2 | c2 - s2c2 | rc2 - rs2c2"
    " | r2c2 + s2c2 - c | rc2 + rs2c2 - rc | sc2 + r2sc2 - sc | 2rsc2 - rsc",
}
_TERM = re.compile(r"([+-]?)(\d*)((?:[rsc]\d?)*)")


def _build_pyramid(order: int, rest: str) -> Build:
    """Return a pyramid in collapsed coordinates."""
    base = place_in_cube(order, 2) / order
    nodes = [np.column_stack([base[:4], np.zeros(4)]), np.array([[0.5, 0.5, 1.0]])]
    if order == 2:
        edges = np.column_stack([base[[4, 5, 6, 7]], np.zeros(4)])
        nodes += [edges, np.column_stack([base[:4], np.full(4, 0.5)])]
    if rest == "2 with centers":
        # of the base, of the triangles, and of the whole
        sides = [[0.5, 0.0, 1 / 3], [1.0, 0.5, 1 / 3], [0.5, 1.0, 1 / 3], [0.0, 0.5, 1 / 3]]
        nodes += [np.array([[0.5, 0.5, 0.0], *sides, [0.5, 0.5, 0.25]])]
    powers = np.indices((3, 3, 4)).reshape(3, -1).T.astype(np.int64)
    spanning = np.column_stack([_read_polynomial(text, powers) for text in _PYRAMIDS[rest].split("|")])
    slopes, offsets = np.diag([2.0, 2.0, -1.0]), np.array([-1.0, -1.0, 1.0])
    space = ModeSpace(slopes, offsets, np.stack([np.eye(4)] * 3), powers)
    return np.concatenate(nodes), space, spanning


def _read_polynomial(text: str, powers: Ints) -> Floats:
    """Return the coefficients (M,) of a sum like `c - 2r2c`, whose variables stand before their powers."""
    total = np.zeros(len(powers))
    for sign, factor, variables in _TERM.findall(text.replace(" ", "")):
        if not (factor or variables):
            continue
        exponents = {name: int(power or 1) for name, power in re.findall(r"([rsc])(\d?)", variables)}
        wanted = [exponents.get(name, 0) for name in "rsc"]
        total[(powers == wanted).all(axis=1)] += float(sign + (factor or "1"))
    return total


def _list_lagrange(order: int) -> Floats:
    """Return the Lagrange polynomials of equally spaced points in [-1, 1] (order + 1, order + 1)."""
    at = np.linspace(-1, 1, order + 1)
    others = [np.delete(at, i) for i in range(order + 1)]
    scales = [np.prod(a - other) for a, other in zip(at, others, strict=True)]
    return np.array([np.poly(other)[::-1] / scale for other, scale in zip(others, scales, strict=True)])


def _list_silvester(order: int) -> Floats:
    """Return P_a(y) = prod over m < a of (order y - m) / (m + 1), a <= order."""
    table, last = np.zeros((order + 1, order + 1)), np.ones(1)
    for a in range(order + 1):
        table[a, : a + 1] = last
        last = np.convolve(last, [-a / (a + 1), order / (a + 1)])
    return table


def _list_barycentric(dimension: int, total: int) -> tuple[Floats, Floats]:
    """Return slopes and offsets of 1 - sum xi and of each xi_i, i < dimension, of `total` coordinates."""
    slopes = np.zeros((dimension + 1, total))
    slopes[0, :dimension], slopes[1:, :dimension] = -1, np.eye(dimension)
    return slopes, np.array([1.0] + [0.0] * dimension)


def _complete(places: Ints, order: int) -> Ints:
    """Return places with the remaining barycentric one first."""
    return np.column_stack([order - places.sum(axis=1), places])


def _stack_tables(tables: list[Floats]) -> Floats:
    """Return tables of polynomials filled with zeros to one shape."""
    shape = np.max([table.shape for table in tables], axis=0)
    return np.stack([np.pad(t, [(0, shape[0] - t.shape[0]), (0, shape[1] - t.shape[1])]) for t in tables])


_BUILDERS: dict[str, Callable[[int, str], Build]] = {
    "triangle": lambda order, rest: _build_simplex(order, rest, 2),
    "tetrahedron": lambda order, rest: _build_simplex(order, rest, 3),
    "quad": lambda order, rest: _build_cube(order, rest, 2),
    "hexahedron": lambda order, rest: _build_cube(order, rest, 3),
    "wedge": _build_wedge,
    "pyramid": _build_pyramid,
}
