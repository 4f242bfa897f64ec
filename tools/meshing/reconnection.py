"""The nodes of each tetrahedron: local moves that improve cells or change their number.

Moves: an edge and its 3 to 7 cells replaced by the best triangulation of the ring around it (inside and on the
surface); a face replaced by the edge through it (2 cells to 3); a cell peeled off the surface, or added to it.
The cost of a move is the change in sum q^-2, and on the surface also that in its distance from the shape.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numba import njit

from tools.meshing.shapes import Floats, Ints, Shape
from tools.meshing.smoothing import smooth_points

Tet = tuple[int, ...]
Key = tuple[int, ...]
_LEAST = 0.003  # no move makes a cell of lower quality
_LEAST_ADDED = 0.02  # nor adds one of lower quality to the surface
_SURFACE = 120.0  # price of the squared distance to the shape over edge length
_LONGEST_RING = 7  # 42 triangulations; longer ones are rare and slow


@njit(cache=True)  # type: ignore[untyped-decorator]
def _compute_quality(X: Floats, a: int, b: int, c: int, d: int) -> float:  # pragma: no cover - compiled
    """Return 6 sqrt(2) V / rms(edge)^3 of one cell, like smoothing.compute_cell_quality."""
    s = 0.0
    u = np.empty((4, 3))
    for i in range(3):
        u[0, i] = X[a, i]
        u[1, i] = X[b, i]
        u[2, i] = X[c, i]
        u[3, i] = X[d, i]
    for i in range(4):
        for j in range(i):
            for k in range(3):
                s += (u[i, k] - u[j, k]) ** 2
    A = u[1] - u[0]
    B = u[2] - u[0]
    D = u[3] - u[0]
    v = (
        (A[1] * B[2] - A[2] * B[1]) * D[0] + (A[2] * B[0] - A[0] * B[2]) * D[1] + (A[0] * B[1] - A[1] * B[0]) * D[2]
    ) / 6
    return 8.48528137423857 * v / ((s / 6) ** 1.5)


def _compute_badness(quality: float) -> float:
    """Return q^-2, continued by a steep line below 1e-3, so that an inverted cell also has a price."""
    return 1e6 - 1e6 * quality if quality <= 1e-3 else quality**-2


def _list_triangulations(n: int) -> list[tuple[tuple[int, int, int], ...]]:
    """Return all triangulations of a polygon of n corners."""
    memo: dict[tuple[int, int], list[tuple[tuple[int, int, int], ...]]] = {}

    def between(i: int, j: int) -> list[tuple[tuple[int, int, int], ...]]:
        if j - i < 2:
            return [()]
        if (i, j) not in memo:
            memo[i, j] = [
                (*left, *right, (i, k, j)) for k in range(i + 1, j) for left in between(i, k) for right in between(k, j)
            ]
        return memo[i, j]

    return between(0, n - 1)


_TRIANGULATIONS = {n: _list_triangulations(n) for n in range(3, _LONGEST_RING + 1)}


@dataclass(frozen=True)
class Move:
    """Cells to remove (by number) and to add, the price, and the kind and place of the proposal."""

    cost: float
    old: Sequence[int]
    new: Sequence[Tet]
    kind: str
    where: Key

    @property
    def gain(self) -> int:
        """Return the change in the number of cells."""
        return len(self.new) - len(self.old)


def _make_key(*nodes: int) -> Key:
    return tuple(sorted(nodes))


class Complex:
    """Tetrahedra by number, with the cells at each edge and face. Results depend on the order of these sets."""

    def __init__(self, shape: Shape, points: Floats, cells: Ints) -> None:
        self.shape, self.points = shape, points.copy()
        self.tets: dict[int, Tet] = {}
        self.quality: dict[int, float] = {}
        self.at_edge: defaultdict[Key, set[int]] = defaultdict(set)
        self.at_face: defaultdict[Key, set[int]] = defaultdict(set)
        self._next = 0
        for cell in cells:
            self._add(tuple(int(node) for node in cell))

    @property
    def cells(self) -> Ints:
        """Return the cells (e, 4) in the order of their creation."""
        return np.array([self.tets[i] for i in sorted(self.tets)], dtype=np.int64)

    def _measure(self, nodes: Tet) -> float:
        return float(_compute_quality(self.points, *nodes))

    def _add(self, tet: Tet) -> None:
        number = self._next
        self._next += 1
        self.tets[number], self.quality[number] = tet, self._measure(tet)
        for edge in combinations(sorted(tet), 2):
            self.at_edge[edge].add(number)
        for face in combinations(sorted(tet), 3):
            self.at_face[face].add(number)

    def _remove(self, number: int) -> None:
        tet = self.tets.pop(number)
        del self.quality[number]
        for table, size in ((self.at_edge, 2), (self.at_face, 3)):
            for part in combinations(sorted(tet), size):
                table[part].discard(number)
                if not table[part]:
                    del table[part]

    def smooth(self, iterations: int, fit: float = 60.0) -> None:
        """Move the nodes by smoothing.smooth_points."""
        self.points = smooth_points(self.shape, self.points, self.cells, iterations=iterations, fit=fit)
        for number, tet in self.tets.items():
            self.quality[number] = self._measure(tet)

    # Queries

    def _is_on_surface(self, *face: int) -> bool:
        return len(self.at_face.get(_make_key(*face), ())) == 1

    def _list_neighbors(self, edge: Key) -> set[int]:
        """Return the nodes that share a cell with an edge, without its own."""
        return {node for i in self.at_edge.get(_make_key(*edge), ()) for node in self.tets[i]} - set(edge)

    def _compute_surface_cost(self, old: Key, new: Key) -> float:
        """Return the price of flipping an edge of the surface: the distance that its middle moves off the shape."""
        X = self.points
        length = np.linalg.norm(X[old[0]] - X[old[1]])
        middles = np.array([(X[old[0]] + X[old[1]]) / 2, (X[new[0]] + X[new[1]]) / 2])
        off = self.shape.distance(middles)
        return float(_SURFACE * (off[1] ** 2 - off[0] ** 2) / length**2)

    # The moves

    def list_moves(self) -> Iterator[Move]:
        """Yield every possible move."""
        for edge in list(self.at_edge):
            for kind in ("edge", "add"):
                move = self.propose(kind, edge)
                if move is not None:
                    yield move
        for face in list(self.at_face):
            move = self.propose("face", face)
            if move is not None:
                yield move

    def propose(self, kind: str, where: Key) -> Move | None:
        """Return the best move of a kind at an edge or a face, or None."""
        return {"edge": self._propose_edge, "add": self._propose_addition, "face": self._propose_face}[kind](where)

    def apply(self, move: Move) -> bool:
        """Make a move and return True, unless its surroundings have changed since it was proposed."""
        now = self.propose(move.kind, move.where)
        if now is None or set(now.old) != set(move.old) or now.gain != move.gain:
            return False
        for number in now.old:
            self._remove(number)
        for tet in now.new:
            self._add(tet)
        return True

    def _find_ring(self, edge: Key) -> tuple[list[int], bool] | None:
        """Return the nodes around an edge in order, and whether the ring is closed; None if they are not one fan."""
        numbers = self.at_edge.get(edge)
        if not numbers or len(numbers) > _LONGEST_RING:
            return None
        following: dict[int, int] = {}
        for number in numbers:
            tet = self.tets[number]
            first, second = (node for node in tet if node not in edge)
            order = [tet.index(node) for node in (*edge, first, second)]
            if sum(order[j] > order[i] for i in range(4) for j in range(i)) % 2:  # an odd permutation
                first, second = second, first
            if first in following:
                return None
            following[first] = second
        starts = [node for node in following if node not in set(following.values())]
        if len(starts) > 1:
            return None
        ring = [starts[0] if starts else next(iter(following))]
        while ring[-1] in following and (len(ring) == 1 or ring[-1] != ring[0]):
            ring.append(following[ring[-1]])
        closed = not starts
        ring = ring[:-1] if closed else ring
        if len(ring) != len(numbers) + (0 if closed else 1) or len(ring) > _LONGEST_RING:
            return None
        return ring, closed

    def _propose_edge(self, edge: Key) -> Move | None:
        around = self._find_ring(edge)
        if around is None:
            return None
        ring, closed = around
        old = list(self.at_edge[edge])
        before = sum(_compute_badness(self.quality[i]) for i in old)
        if closed:
            return self._propose_triangulation(edge, ring, old, before, extra=0.0, closed=True)
        ends = (ring[0], ring[-1])
        if len(ring) == 2:
            return self._propose_peeling(edge, ends, old, before)
        if _make_key(*ends) in self.at_edge:
            return None
        extra = self._compute_surface_cost(edge, ends)
        return self._propose_triangulation(edge, ring, old, before, extra=extra, closed=False)

    def _propose_peeling(self, edge: Key, ends: Key, old: list[int], before: float) -> Move | None:
        """Return the move that peels a single cell off the surface; its opposite edge must be inside."""
        a, b = edge
        if any(self._is_on_surface(*ends, node) for node in self._list_neighbors(ends)):
            return None
        if self._is_on_surface(a, *ends) or self._is_on_surface(b, *ends):
            return None
        return Move(self._compute_surface_cost(edge, ends) - before, old, [], "edge", edge)

    def _propose_triangulation(
        self, edge: Key, ring: list[int], old: list[int], before: float, *, extra: float, closed: bool
    ) -> Move | None:
        """Return the cheapest triangulation of the ring, each triangle joined to both ends of the edge."""
        a, b = edge
        best: Move | None = None
        for triangles in _TRIANGULATIONS.get(len(ring), ()):
            cost, new = extra, []
            for i, j, k in triangles:
                p, q, r = ring[i], ring[j], ring[k]
                new += [(p, q, r, b), (p, r, q, a)]
            for tet in new:
                quality = self._measure(tet)
                if quality <= _LEAST:
                    break
                cost += _compute_badness(quality)
            else:
                if (best is None or cost - before < best.cost) and not self._has_crossing(ring, triangles, closed):
                    best = Move(cost - before, old, new, "edge", edge)
        return best

    def _has_crossing(self, ring: list[int], triangles: tuple[tuple[int, int, int], ...], closed: bool) -> bool:
        """Return whether a new diagonal is already an edge of the mesh."""
        n = len(ring)
        for i, j, k in triangles:
            for x, y in ((i, j), (j, k), (i, k)):
                is_side = (y - x) % n in (1, n - 1) and (closed or y - x == 1)
                if is_side or (not closed and (x, y) == (0, n - 1)):
                    continue
                if _make_key(ring[x], ring[y]) in self.at_edge:
                    return True
        return False

    def _propose_face(self, face: Key) -> Move | None:
        numbers = list(self.at_face.get(face, ()))
        if len(numbers) != 2:
            return None
        above, below = (next(node for node in self.tets[i] if node not in face) for i in numbers)
        if _make_key(above, below) in self.at_edge:
            return None
        a, b, c = face
        if self._measure((a, b, c, above)) < 0:
            a, b = b, a
        new = [(a, b, below, above), (b, c, below, above), (c, a, below, above)]
        cost = -sum(_compute_badness(self.quality[i]) for i in numbers)
        for tet in new:
            quality = self._measure(tet)
            if quality <= _LEAST:
                return None
            cost += _compute_badness(quality)
        return Move(cost, numbers, new, "face", face)

    def _propose_addition(self, edge: Key) -> Move | None:
        """Return the move that fills the notch at a concave edge of the surface with a cell."""
        a, b = edge
        wings = [node for node in sorted(self._list_neighbors(edge)) if self._is_on_surface(a, b, node)]
        if len(wings) != 2 or _make_key(*wings) in self.at_edge:
            return None
        c, d = wings
        tet = (a, b, c, d) if self._measure((a, b, c, d)) >= 0 else (b, a, c, d)
        quality = self._measure(tet)
        if quality < _LEAST_ADDED:
            return None
        inner = [next(n for n in self._find_cell(a, b, wing) if n not in (a, b, wing)) for wing in wings]
        # the new cell must not overlap the two cells below it
        if self._measure((tet[0], tet[1], c, inner[0])) > 0 or self._measure((tet[0], tet[1], inner[1], d)) > 0:
            return None
        return Move(_compute_badness(quality) + self._compute_surface_cost(edge, (c, d)), [], [tet], "add", edge)

    def _find_cell(self, *face: int) -> Tet:
        return self.tets[next(iter(self.at_face[_make_key(*face)]))]
