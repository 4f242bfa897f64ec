"""Supports: nodes with prescribed positions, fixed or moving.

A node may be held along some axes only, as on rollers or in a plane of symmetry: a guide holds single components.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipeline.arrays import Floats, Ints


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A rigid motion: translation at `velocity` [m/s] and rotation about `center` at `rate` [rad/s] around `axis`.

    In the plane the axis is (0, 0, 1) or (0, 0, -1), and center and velocity have two components.
    """

    velocity: Floats
    axis: Floats
    rate: float
    center: Floats

    def positions(self, X: Floats, time: float) -> Floats:
        """Return the positions of the points X (k, d) at a time [s]; exact, not integrated."""
        R = rotation_about(self.axis, self.rate * time)[: X.shape[1], : X.shape[1]]
        return self.center + (X - self.center) @ R.T + self.velocity * time

    def velocities(self, X: Floats) -> Floats:
        """Return the velocities of the points X (k, d) at the start [m/s]."""
        d = X.shape[1]
        arm = np.pad(X - self.center, [(0, 0), (0, 3 - d)])
        return self.velocity + self.rate * np.cross(self.axis, arm)[:, :d]


class Motion(Protocol):
    """The prescribed motion of some held nodes."""

    def positions(self, X: Floats, time: float) -> Floats:
        """Return the positions of the points X (k, d) at a time [s]."""
        ...

    def velocities(self, X: Floats) -> Floats:
        """Return the velocities of the points X (k, d) at the start [m/s]."""
        ...


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """A displacement u(X, t) (k, d) [m], zero at t = 0; the initial velocity is u(X, dt) / dt for a small dt."""

    displacement: Callable[[Floats, float], Floats]
    dt: float

    def positions(self, X: Floats, time: float) -> Floats:
        """Return the positions of the points X (k, d) at a time [s]."""
        return X + self.displacement(X, time)

    def velocities(self, X: Floats) -> Floats:
        """Return the velocities of the points X (k, d) at the start [m/s]."""
        return np.asarray(self.displacement(X, self.dt) / self.dt)


@dataclass(frozen=True, eq=False, repr=False)
class Guides:
    """Single held components (c,) of nodes, d node + axis, ascending, and the motions of some of them.

    The components of a motion move as it would move their nodes; the others stay at their rest positions.
    """

    components: Ints
    motions: Sequence[tuple[Ints, Motion]] = ()

    def __repr__(self) -> str:
        return f"<Guides: {len(self.components)} held components, {len(self.motions)} motions>"

    def positions(self, points: Floats, time: float) -> Floats:
        """Return the coordinates of `components` (c,) at a time [s]."""
        x = points.reshape(-1)[self.components]
        for components, motion in self.motions:
            nodes, axes = np.divmod(components, points.shape[1])
            moved = motion.positions(points[nodes], time)
            x[np.searchsorted(self.components, components)] = moved[np.arange(len(nodes)), axes]
        return x

    def set_velocities(self, points: Floats, v: Floats) -> None:
        """Write the velocities of `components` at the start into v (n, d) [m/s]."""
        v.reshape(-1)[self.components] = 0.0
        for components, motion in self.motions:
            nodes, axes = np.divmod(components, points.shape[1])
            v[nodes, axes] = motion.velocities(points[nodes])[np.arange(len(nodes)), axes]


@dataclass(frozen=True, eq=False, repr=False)
class Supports:
    """Held nodes (k,), ascending, and the motions of some of them; the others stay at their rest positions.

    `guides`, if any, hold single components of other nodes.
    """

    nodes: Ints
    motions: Sequence[tuple[Ints, Motion]] = ()
    guides: Guides | None = None

    def __repr__(self) -> str:
        guides = "" if self.guides is None else f", {self.guides!r}"
        return f"<Supports: {len(self.nodes)} held nodes, {len(self.motions)} motions{guides}>"

    @property
    def has_motions(self) -> bool:
        """Return whether a held node or component moves."""
        return bool(self.motions) or (self.guides is not None and bool(self.guides.motions))

    def positions(self, points: Floats, time: float) -> Floats:
        """Return the positions of `nodes` (k, d) at a time [s]."""
        x = points[self.nodes]
        for nodes, motion in self.motions:
            x[np.searchsorted(self.nodes, nodes)] = motion.positions(points[nodes], time)
        return x


def rotation_about(axis: Floats, angle: float) -> Floats:
    """Return the rotation (3, 3) by an angle [rad] about an axis, by Rodrigues' formula."""
    a = axis / np.linalg.norm(axis)
    W = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W
