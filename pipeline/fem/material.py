"""The isotropic elastic material."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """Young's modulus [Pa], Poisson's ratio [1] and density [kg/m3; kg/m2 of a planar body of unit thickness].

    A planar body is in plane strain: the Lame parameters are the three-dimensional ones.
    """

    youngs_modulus: float
    poisson_ratio: float
    density: float

    @property
    def mu(self) -> float:
        """Return the shear modulus [Pa]."""
        return self.youngs_modulus / (2 * (1 + self.poisson_ratio))

    @property
    def lam(self) -> float:
        """Return the first Lame parameter [Pa]."""
        nu = self.poisson_ratio
        return self.youngs_modulus * nu / ((1 + nu) * (1 - 2 * nu))

    @property
    def wave_speed(self) -> float:
        """Return the speed of pressure waves [m/s]."""
        return float(((self.lam + 2 * self.mu) / self.density) ** 0.5)
