"""The isotropic elastic material, the same in all cells or another one in each."""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats

MaterialValues = float | Floats  # of all cells, or of each (e,)


@dataclass(frozen=True, eq=False)
class Material:
    """Young's modulus [Pa], Poisson's ratio [1] and density [kg/m3; kg/m2 of a planar body of unit thickness].

    A planar body is in plane strain: the Lame parameters are the three-dimensional ones.
    """

    youngs_modulus: MaterialValues
    poisson_ratio: MaterialValues
    density: MaterialValues

    @property
    def mu(self) -> MaterialValues:
        """Return the shear modulus [Pa]."""
        return self.youngs_modulus / (2 * (1 + self.poisson_ratio))

    @property
    def lam(self) -> MaterialValues:
        """Return the first Lame parameter [Pa]."""
        nu = self.poisson_ratio
        return self.youngs_modulus * nu / ((1 + nu) * (1 - 2 * nu))

    @property
    def wave_modulus(self) -> MaterialValues:
        """Return lam + 2 mu [Pa], the stiffness in a pressure wave."""
        return self.lam + 2 * self.mu

    @property
    def wave_speed(self) -> float:
        """Return the speed of pressure waves [m/s], the largest of all cells."""
        return float(np.max((self.wave_modulus / self.density) ** 0.5))

    @property
    def slowest_wave_speed(self) -> float:
        """Return the speed of pressure waves [m/s], the smallest of all cells."""
        return float(np.min((self.wave_modulus / self.density) ** 0.5))

    def spread(self, points: int) -> "Material":
        """Return the material at that many integration points, numbered cell by cell."""
        return Material(*(spread_values(v, points) for v in (self.youngs_modulus, self.poisson_ratio, self.density)))


def integrate_values(values: MaterialValues, volumes: Floats) -> float:
    """Return the sum over cells of values times volumes (e,)."""
    if isinstance(values, np.ndarray):
        return float(values @ volumes)
    return values * float(volumes.sum())


def spread_values(values: MaterialValues, points: int) -> MaterialValues:
    """Return values at integration points (points,) of those of cells (e,); a number remains one."""
    if not isinstance(values, np.ndarray) or len(values) == points:
        return values
    return np.repeat(values, points // len(values))


def align_values(values: MaterialValues, dimensions: int) -> MaterialValues:
    """Return values with that many more axes of length 1, so that they multiply arrays of matrices or tensors."""
    return values.reshape(-1, *[1] * dimensions) if isinstance(values, np.ndarray) else values
