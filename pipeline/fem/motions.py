"""Motions whose clock is a history: they start gently, go to and fro, or end."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.supports import Motion


@dataclass(frozen=True, eq=False)
class RetimedMotion:
    """A motion that is at time `clock(t)` [s] of its own when the time is t; after `until` [s] it stays in its place.

    `pace` is d clock/dt at the start. For a velocity and a spin that a history multiplies, the clock is the integral of
    the history; for a displacement, which is a velocity of 1 s, it is the history.
    """

    motion: Motion
    clock: Callable[[float], float]
    pace: float
    until: float = inf

    def positions(self, X: Floats, time: float) -> Floats:
        """Return the positions of the points X (k, d) at a time [s]."""
        return self.motion.positions(X, self.clock(min(time, self.until)))

    def velocities(self, X: Floats) -> Floats:
        """Return the velocities of the points X (k, d) at the start [m/s]."""
        return np.asarray(self.pace * self.motion.velocities(X))
