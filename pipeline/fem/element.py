"""The linear simplex element: F = I + sum_a u_a (x) grad N_a, constant in a cell, for triangles and tetrahedra."""

import numpy as np

from pipeline.arrays import Floats
from pipeline.mesh.simplex import Mesh


def deformation_gradient(mesh: Mesh, x: Floats) -> Floats:
    """Return F (e, d, d) of the positions x (n, d): the gradient of x with respect to the rest points."""
    return np.swapaxes(x[mesh.cells], 1, 2) @ mesh.shape_gradients


def nodal_sums(mesh: Mesh, per_corner: Floats) -> Floats:
    """Return the sums at the nodes of values per cell and corner: (e, d + 1, k) -> (n, k)."""
    n, k = len(mesh.points), per_corner.shape[-1]
    dofs = (k * mesh.cells[:, :, None] + np.arange(k)).ravel()
    return np.asarray(np.bincount(dofs, weights=per_corner.ravel(), minlength=n * k), np.float64).reshape(n, k)


def nodal_forces(mesh: Mesh, P: Floats) -> Floats:
    """Return the nodal forces f_a = -sum V P grad N_a (n, d) [N] of first Piola-Kirchhoff stresses P (e, d, d) [Pa]."""
    return nodal_sums(mesh, -mesh.rest_volumes[:, None, None] * (mesh.shape_gradients @ np.swapaxes(P, 1, 2)))


def stiffness_blocks(mesh: Mesh, C: Floats) -> Floats:
    """Return K_e (e, d + 1, d, d + 1, d) [N/m] of the tangents C_iJkL = dP_iJ/dF_kL (e, d, d, d, d) [Pa]."""
    e, corners, d = mesh.shape_gradients.shape
    G = mesh.shape_gradients[:, None]
    half = (G @ C.reshape(e, d, d, d * d)).reshape(e, d, corners, d, d)  # G_aJ C_iJkL, as (i, a, k, L)
    blocks = half @ np.swapaxes(G, 2, 3)[:, :, None]  # G_bL, as (i, a, k, b)
    blocks *= mesh.rest_volumes[:, None, None, None, None]
    return blocks.transpose(0, 2, 1, 4, 3)
