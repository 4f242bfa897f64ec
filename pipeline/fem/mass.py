"""Mass matrices of the linear simplex: consistent, or lumped into a diagonal of the row sums."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.mesh.simplex import Mesh


@dataclass(frozen=True)
class MassModel:
    """`cell_masses(mesh, density)` returns the mass matrices of all cells (e, d + 1, d + 1) [kg]."""

    cell_masses: Callable[[Mesh, float], Floats]
    is_diagonal: bool


def consistent_masses(mesh: Mesh, density: float) -> Floats:
    """Return rho V / ((d+1)(d+2)) (1 + delta_ab) of each cell (e, d + 1, d + 1) [kg]."""
    k = mesh.dimension + 1
    return (density * mesh.rest_volumes / (k * (k + 1)))[:, None, None] * (1 + np.eye(k))


def lumped_masses(mesh: Mesh, density: float) -> Floats:
    """Return rho V / (d + 1) delta_ab of each cell (e, d + 1, d + 1) [kg]."""
    k = mesh.dimension + 1
    return (density * mesh.rest_volumes / k)[:, None, None] * np.eye(k)


CONSISTENT_MASS = MassModel(consistent_masses, is_diagonal=False)
LUMPED_MASS = MassModel(lumped_masses, is_diagonal=True)
