"""Mass matrices of elements, consistent, or lumped into a positive diagonal; a density is a number or one per element.

Linear simplices are lumped by row sums, quadratic ones by their scaled diagonal (mesh/quadratic.py).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.material import MaterialValues, align_values
from pipeline.mesh.element_mesh import ElementMesh


@dataclass(frozen=True)
class MassModel:
    """`cell_masses(mesh, density)` returns the mass matrices of all elements (e, k, k) [kg]."""

    cell_masses: Callable[[ElementMesh, MaterialValues], Floats]
    is_diagonal: bool


def consistent_masses(mesh: ElementMesh, density: MaterialValues) -> Floats:
    """Return rho int N_a N_b dV of each element (e, k, k) [kg]; rho V / ((d+1)(d+2)) (1 + delta_ab) of order 1."""
    if mesh.order > 1:
        return np.asarray(align_values(density, 2) * mesh.shape_products)
    k = mesh.dimension + 1
    return np.asarray(density * mesh.rest_volumes / (k * (k + 1)))[:, None, None] * (1 + np.eye(k))


def lumped_masses(mesh: ElementMesh, density: MaterialValues) -> Floats:
    """Return the diagonal mass matrix of each element (e, k, k) [kg]; rho V / (d + 1) delta_ab of order 1."""
    if mesh.order > 1:
        return np.asarray(align_values(density, 2) * mesh.lumped_shares[:, :, None] * np.eye(mesh.cells.shape[1]))
    k = mesh.dimension + 1
    return np.asarray(density * mesh.rest_volumes / k)[:, None, None] * np.eye(k)


def lump_masses(mesh: ElementMesh, density: MaterialValues) -> Floats:
    """Return the mass of every node (n,) [kg], all positive: a density (e,) is that of each element."""
    if not isinstance(density, np.ndarray):
        return density * mesh.lumped_volumes
    shares = density[:, None] * mesh.lumped_shares
    return np.bincount(mesh.cells.ravel(), shares.ravel(), len(mesh.points)).astype(np.float64, copy=False)


CONSISTENT_MASS = MassModel(consistent_masses, is_diagonal=False)
LUMPED_MASS = MassModel(lumped_masses, is_diagonal=True)
