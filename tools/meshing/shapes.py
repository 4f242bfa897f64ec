"""The two bodies as implicit functions: approximate signed distance, negative inside; z is up, lengths have no unit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Field = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Shape:
    """The counts that a mesh must have, and its distance function, spacing, bounding box and seed.

    `features` are points that must be nodes: rims and tips, which even spacing would round off.
    """

    name: str
    nodes: int
    cells: int
    surface_nodes: int
    seed: int
    low: Floats
    high: Floats
    distance: Field
    spacing: Field
    features: Floats


def compute_gradient(field: Field, points: Floats, step: float = 1e-4) -> Floats:
    """Return the gradient (n, 3) by central differences; 1e-4 for bodies of size 30 leaves 8 digits."""
    result = np.empty_like(points)
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        result[:, axis] = (field(points + shift) - field(points - shift)) / (2 * step)
    return result


def project(field: Field, points: Floats, iterations: int = 6) -> Floats:
    """Return the points moved onto the zero of the field by Newton steps along its gradient."""
    for _ in range(iterations):
        value, slope = field(points), compute_gradient(field, points)
        points = points - (value / np.maximum((slope * slope).sum(1), 0.05))[:, None] * slope
    return points


def _unite(a: Floats, b: Floats, blend: float) -> Floats:
    """Return the smooth minimum: both bodies, with a fillet of about `blend`."""
    h = np.clip(0.5 + 0.5 * (b - a) / blend, 0, 1)
    return b * (1 - h) + a * h - blend * h * (1 - h)


def _intersect(a: Floats, b: Floats, blend: float) -> Floats:
    return -_unite(-a, -b, blend)


def _measure_ellipsoid(p: Floats, center: Sequence[float], radii: Sequence[float]) -> Floats:
    r = np.asarray(radii, dtype=np.float64)
    q = p - np.asarray(center, dtype=np.float64)
    k0, k1 = np.linalg.norm(q / r, axis=1), np.linalg.norm(q / r**2, axis=1)
    return np.where(k1 > 1e-9, k0 * (k0 - 1) / np.maximum(k1, 1e-9), -r.min())


# The mushroom


def make_mushroom() -> Shape:
    """Return a cap of radius 12 on a stem whose foot is wider; 219 nodes, 656 tetrahedra."""
    features = np.vstack([_make_ring(11.9, 3.0, 20), _make_ring(4.2, -13.9, 7)])
    return Shape(
        name="mushroom",
        nodes=219,
        cells=656,
        surface_nodes=182,
        seed=14,
        low=np.array([-15, -15, -17.0]),
        high=np.array([15, 15, 17.0]),
        distance=_measure_mushroom,
        spacing=lambda p: np.full(len(p), 1.0),
        features=project(_measure_mushroom, features),
    )


def _make_ring(radius: float, z: float, count: int) -> Floats:
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, z)], 1)


def _measure_mushroom(p: Floats) -> Floats:
    r = np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + 1e-12)
    z = p[:, 2]
    dome = _measure_ellipsoid(p, (0, 0, 2.6), (12.3, 12.3, 10.8))
    under = (2.8 + 0.10 * (12 - r)) - z  # the underside is a little hollow
    cap = _intersect(dome, under * 0.99, 1.2)
    stem_radius = 3.6 + 1.0 * np.clip((-4 - z) / 9, 0, 1) ** 2
    stem = _intersect(_intersect(r - stem_radius, -14.2 - z, 1.2), z - 6, 1.0)
    return _unite(cap, stem, 1.6)


# The armadillo


@dataclass(frozen=True)
class Part:
    """A rounded cone from `start` to `end`, or, with `radii`, an ellipsoid about `start`."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    start_radius: float
    end_radius: float
    blend: float
    radii: tuple[float, float, float] | None = None

    def find_tip(self, *, back: bool = False) -> Floats:
        """Return the farthest point along the cone's axis, or the farthest back."""
        a, b = np.array(self.start), np.array(self.end)
        d = (b - a) / np.linalg.norm(b - a)
        return a - self.start_radius * d if back else b + self.end_radius * d

    def to_row(self) -> list[float]:
        """Return the part as a row for `_blend_parts`; an ellipsoid has its radii in place of an end."""
        return [*self.start, *(self.radii or self.end), self.start_radius, self.end_radius, self.blend]


def _make_limbs(x: int) -> list[Part]:
    """Return ear, upper arm, forearm, thigh, shin and foot of the left (-1) or right (1) side."""
    return [
        Part((1.5 * x, -0.2, 11.6), (4.0 * x, 0.8, 17.2), 1.35, 0.85, 0.4),
        Part((3.0 * x, -0.2, 5.0), (8.8 * x, -0.4, 4.0), 2.1, 1.65, 0.8),
        Part((8.8 * x, -0.4, 4.0), (10.8 * x, -3.2, 9.2), 1.65, 1.75, 0.4),
        Part((2.8 * x, 0, -3.5), (4.8 * x, -1.4, -8.2), 2.8, 2.2, 0.8),
        Part((4.8 * x, -1.4, -8.2), (5.0 * x, 0.6, -13), 2.1, 1.8, 0.5),
        Part((5.0 * x, 0.4, -13.1), (5.7 * x, -4.4, -13.5), 1.8, 1.45, 0.5),
    ]


_TRUNK = [
    Part((0, 0.2, -0.8), (0, 0, 0), 4.0, 0, 1.0, radii=(4.9, 4.4, 5.4)),  # belly
    Part((0, 1.9, 1.6), (0, 0, 0), 4.0, 0, 1.0, radii=(5.0, 3.9, 6.4)),  # shell
    Part((0, 0.2, 6.5), (0, -1.0, 10.4), 2.6, 2.8, 1.2),  # neck and head
    Part((0, -2.0, 10.2), (0, -7.4, 8.6), 2.1, 1.0, 0.9),  # snout
]
_TAIL = [Part((0, 3.0, -3.5), (0, 8.0, -7.2), 2.6, 1.7, 1.0), Part((0, 8.0, -7.2), (0, 14.5, -6.4), 1.7, 0.85, 0.4)]
_PARTS = [*_TRUNK, *_make_limbs(-1), *_make_limbs(1), *_TAIL]


def make_armadillo() -> Shape:
    """Return an upright animal that faces -y, with ears, arms, feet and a tail; 285 nodes, 787 tetrahedra."""
    snout, tail = _PARTS[3], _PARTS[-1]
    ends = [
        part.find_tip()
        for side in (-1, 1)
        for limbs in (_make_limbs(side),)
        for part in (limbs[i] for i in (0, 2, 5, 4))
    ]
    return Shape(
        name="armadillo",
        nodes=285,
        cells=787,
        surface_nodes=228,
        seed=10,
        low=np.array([-15, -12, -18.0]),
        high=np.array([15, 18, 20.0]),
        distance=lambda p: _measure_armadillo(p)[0],
        spacing=lambda p: np.clip(_measure_armadillo(p)[1], 1.3, 4.0) ** 0.45,  # finer where the part is thin
        features=project(lambda p: _measure_armadillo(p)[0], np.array([snout.find_tip(), *ends, tail.find_tip()])),
    )


_TABLE = np.array([part.to_row() for part in _PARTS])
_IS_ELLIPSOID = np.array([part.radii is not None for part in _PARTS])


def _measure_armadillo(p: Floats) -> tuple[Floats, Floats]:
    """Return the distance and the radius of the nearest part."""
    return _blend_parts(np.ascontiguousarray(p), _TABLE, _IS_ELLIPSOID)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _blend_parts(points: Floats, table: Floats, is_ellipsoid: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return distance and radius, like `_measure_armadillo`; compiled, as it is often called for just two points."""
    distance, radius = np.zeros(len(points)), np.zeros(len(points))
    for n in range(len(points)):
        nearest = np.inf
        for i in range(len(table)):
            x, y, z = points[n, 0] - table[i, 0], points[n, 1] - table[i, 1], points[n, 2] - table[i, 2]
            a, b, c = table[i, 3], table[i, 4], table[i, 5]
            own = table[i, 6]
            if is_ellipsoid[i]:
                k0 = ((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2) ** 0.5
                k1 = ((x / a**2) ** 2 + (y / b**2) ** 2 + (z / c**2) ** 2) ** 0.5
                value = k0 * (k0 - 1) / k1 if k1 > 1e-9 else -min(a, b, c)
            else:
                a, b, c = a - table[i, 0], b - table[i, 1], c - table[i, 2]
                u = min(max((x * a + y * b + z * c) / (a * a + b * b + c * c), 0.0), 1.0)
                own += (table[i, 7] - table[i, 6]) * u
                value = ((x - u * a) ** 2 + (y - u * b) ** 2 + (z - u * c) ** 2) ** 0.5 - own
            if value < nearest:
                nearest, radius[n] = value, own
            k = table[i, 8]
            h = min(max(0.5 + 0.5 * (value - distance[n]) / k, 0.0), 1.0) if i else 0.0
            distance[n] = value * (1 - h) + distance[n] * h - k * h * (1 - h)  # like _unite
    return distance, radius
