r"""Rayleigh damping in implicit stages: C = alpha M + beta K'(x_c), frozen within a stage.

    M (v - v_h) = h (f_ext + f_el(x_h + h v) - C v)

x_c is the place at which v = (x - x_h)/h is a velocity: the predicted middle of the step in backward Euler, the
extrapolated end in BDF2. So a rigid rotation by the angle t in a step has a rate of strain of order t^4/h and t^3/h,
not t^2/h.
C does not depend on x, so the stage keeps a potential, with the dissipation (x - x_h) . C (x - x_h) / (2 h) added.

A first solve of backward Euler moves nodes along the tangent of a rotation at x_n, not the secant: its x_c is x_n.
"""

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.damping import Rayleigh


class FrozenDamping:
    """The values h C (blocks, d, d) [kg] of the stage that was begun last."""

    def __init__(self, body: Body, damping: Rayleigh) -> None:
        self.body = body
        self.damping = damping
        self.values = np.empty_like(body.mass)
        self._x, self._product = np.empty((2, *body.mesh.points.shape))

    def freeze(self, x: Floats, h: float, R: Floats | None = None) -> None:
        """Assemble h C with the rotations R (s, d, d), or those at positions x (n, d)."""
        np.multiply(self.body.mass, h * self.damping.mass, out=self.values)
        if self.damping.stiffness:
            self.body.add_stiffness(x, h * self.damping.stiffness, self._product, self.values, R=R)

    def freeze_middle(self, x_h: Floats, v_h: Floats, h: float) -> None:
        """Assemble h C at the predicted middle of a step of backward Euler from x_h (n, d)."""
        np.multiply(v_h, h / 2, out=self._x)
        self._x += x_h
        self.freeze(self._x, h)

    def multiply(self, v: Floats) -> Floats:
        """Return h C v (n, d), in an array that the next call overwrites."""
        return self.body.pattern.multiply(self.values, v, self._product)
