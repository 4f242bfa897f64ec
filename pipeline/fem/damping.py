r"""Rayleigh damping: C = alpha M + beta K', with the stiffness K' = sum_e R K_e R^T of frozen rotations.

A mode of frequency omega has the damping ratio alpha / (2 omega) + beta omega / 2. Alpha slows every motion, also that
of a free body as a whole. Beta acts on rates of strain: the rotation of an unstrained body has none.
"""

from dataclasses import dataclass
from math import hypot, sqrt


@dataclass(frozen=True)
class Rayleigh:
    """The factors alpha = `mass` [1/s] and beta = `stiffness` [s], not negative."""

    mass: float = 0.0
    stiffness: float = 0.0

    def damping_ratio(self, omega: float) -> float:
        """Return the damping of a mode of frequency omega [rad/s] over the critical one [1]."""
        return self.mass / (2 * omega) + self.stiffness * omega / 2

    def stiffen(self, h: float) -> float:
        """Return the h' [s] for which M + h'^2 K is as stiff as M + h C + h^2 K."""
        return sqrt(h * (h + self.stiffness))

    def explicit_limit(self, omega: float) -> float:
        """Return the largest stable step [s] of symplectic Euler for modes up to omega [rad/s].

        It is the root of (dt^2 + 2 beta dt) omega^2 = 4 + 2 alpha dt: a step takes alpha v at its end and beta K' v at
        its start.
        """
        c = self.stiffness * omega**2 - self.mass
        return 4 / (c + hypot(c, 2 * omega))


def find_mode_root(zeta: float) -> complex:
    """Return the root w of w^2 + 2 zeta w + 1 = 0 of a mode e^(w omega t): of positive frequency, or the slow one."""
    if zeta < 1:
        return complex(-zeta, sqrt(1 - zeta**2))
    return complex(-1 / (zeta + sqrt(zeta**2 - 1)), 0.0)
