"""Moves nodes for better tetrahedra and keeps the surface on the shape: L-BFGS on one smooth objective.

Quality is q = 6 sqrt(2) V / rms(edge)^3 here, 1 for a regular tetrahedron and smooth in the nodes; elsewhere it is
3 inradius / circumradius.
"""

import numpy as np
from scipy.optimize import minimize

from tools.meshing.points import OUTWARD
from tools.meshing.shapes import Floats, Ints, Shape, compute_gradient

C = 6 * np.sqrt(2)
_PAIRS = [(i, j) for i in range(4) for j in range(i)]
_LEAST = 1e-3  # lower bound of the quality in a mesh of good cells
_SOFT = 0.02  # in a mesh with worse cells quality is smoothed over this width, so that they can improve


def compute_cell_quality(points: Floats, cells: Ints) -> Floats:
    """Return q (e,), negative for inverted cells."""
    e = points[cells]
    volume = np.einsum("ij,ij->i", np.cross(e[:, 1] - e[:, 0], e[:, 2] - e[:, 0]), e[:, 3] - e[:, 0]) / 6
    mean_square = sum(((e[:, i] - e[:, j]) ** 2).sum(1) for i, j in _PAIRS) / 6
    return np.asarray(C * volume / mean_square**1.5)


def list_surface_faces(cells: Ints) -> Ints:
    """Return the faces that belong to one cell only (f, 3), oriented outward."""
    faces = cells[:, OUTWARD].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, 1), axis=0, return_index=True, return_counts=True)
    if count.max() > 2:
        raise ValueError("a face belongs to more than two cells")
    return faces[first[count == 1]]


def smooth_points(shape: Shape, points: Floats, cells: Ints, *, iterations: int, fit: float = 60.0) -> Floats:
    """Return the points after L-BFGS, or unchanged if the worst cell got worse; `fit` weighs the surface."""
    before = compute_cell_quality(points, cells).min()
    objective = _Objective(shape, points, cells, fit, soft=0.0 if before > _SOFT else _SOFT)
    result = minimize(
        objective, points.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": iterations, "maxcor": 20}
    )
    moved = np.asarray(result.x, dtype=np.float64).reshape(-1, 3)
    return moved if compute_cell_quality(moved, cells).min() >= min(1e-4, before) else points


class _Objective:
    """sum q^-2 plus squared distances of surface nodes, middles of surface edges and features from their places."""

    def __init__(self, shape: Shape, points: Floats, cells: Ints, fit: float, *, soft: float) -> None:
        self.shape, self.cells, self.soft = shape, cells, soft
        faces = list_surface_faces(cells)
        self.surface = np.unique(faces)
        self.edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1), axis=0)
        e = points[cells]
        size = np.mean(np.linalg.norm(e[:, 0] - e[:, 1], axis=1))
        total, count = np.zeros(len(points)), np.zeros(len(points))
        for i, j in _PAIRS:
            length = np.linalg.norm(e[:, i] - e[:, j], axis=1)
            for node in (i, j):
                np.add.at(total, cells[:, node], length)
                np.add.at(count, cells[:, node], 1)
        local = total / np.maximum(count, 1)
        # weights are per squared length, so that the objective does not depend on the size of the shape
        self.surface_weight = fit / local[self.surface] ** 2
        self.edge_weight = 0.15 * fit / size**2
        self.feature_weight = 0.3 * fit / local[: len(shape.features)] ** 2

    def __call__(self, flat: Floats) -> tuple[float, Floats]:
        """Return the value and its gradient (3 n,)."""
        points = flat.reshape(-1, 3)
        slope = np.zeros_like(points)
        value = self._quality(points, slope)
        if not np.isfinite(value):
            return 1e12, np.zeros_like(flat)
        return sum(self._fit(points, slope), value), slope.ravel()

    def _quality(self, points: Floats, slope: Floats) -> float:
        """Return sum q^-2, infinite below the least quality, and add its gradient to slope."""
        e = points[self.cells]
        a, b, c = (e[:, i] - e[:, 0] for i in (1, 2, 3))
        bc = np.cross(b, c)
        V = (a * bc).sum(1) / 6
        D = e - e.mean(1, keepdims=True)
        R = 4 * (D**2).sum((1, 2)) / 6  # the mean squared edge, from the distances to the center
        q = C * V / R**1.5
        if self.soft:
            root = np.sqrt(q * q + self.soft * self.soft * 4)
            chi, dchi = (q + root) / 2, (1 + q / root) / 2
        elif (q <= _LEAST).any():
            return float("inf")
        else:
            chi, dchi = q, np.ones_like(q)
        dV = np.empty_like(e)
        dV[:, 1], dV[:, 2], dV[:, 3] = bc / 6, np.cross(c, a) / 6, np.cross(a, b) / 6
        dV[:, 0] = -(dV[:, 1] + dV[:, 2] + dV[:, 3])
        dR = 8 * D / 6
        dq = C * (dV / (R**1.5)[:, None, None] - 1.5 * (V / R**2.5)[:, None, None] * dR)
        np.add.at(slope, self.cells, (-2 * chi**-3.0 * dchi)[:, None, None] * dq)
        return float((chi**-2.0).sum())

    def _fit(self, points: Floats, slope: Floats) -> tuple[float, float, float]:
        """Return the terms of surface nodes, middles of edges and features, and add their gradient to slope."""
        distance = self.shape.distance
        on, w = points[self.surface], self.surface_weight
        f, g = distance(on), compute_gradient(distance, on)
        nodes = (w * f**2).sum()
        slope[self.surface] += 2 * (w * f)[:, None] * g
        middle = (points[self.edges[:, 0]] + points[self.edges[:, 1]]) / 2
        f, g = distance(middle), compute_gradient(distance, middle)
        edges = self.edge_weight * (f**2).sum()
        half = self.edge_weight * f[:, None] * g
        np.add.at(slope, self.edges[:, 0], half)
        np.add.at(slope, self.edges[:, 1], half)
        count = len(self.shape.features)
        off, w = points[:count] - self.shape.features, self.feature_weight
        slope[:count] += 2 * w[:, None] * off
        return float(nodes), float(edges), float((w * (off * off).sum(1)).sum())
