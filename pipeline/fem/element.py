"""Sums over the integration points of elements: F = I + sum_a u_a (x) grad N_a there, and forces and stiffness from it.

Points are numbered element by element, p = e q of them; a linear simplex has one, since its F is constant.
"""

import numpy as np

from pipeline.arrays import Floats
from pipeline.mesh.element_mesh import ElementMesh


def deformation_gradient(mesh: ElementMesh, x: Floats) -> Floats:
    """Return F (p, d, d) of the positions x (n, d): the gradient of x with respect to the rest points."""
    d = x.shape[1]
    return (np.swapaxes(x[mesh.cells], 1, 2)[:, None] @ mesh.integration.gradients).reshape(-1, d, d)


def mean_gradient(mesh: ElementMesh, F: Floats) -> Floats:
    """Return the means (e, d, d) over elements of gradients F (p, d, d), weighted by volume."""
    w = mesh.integration.weights
    return np.asarray(np.einsum("eq,eqij->eij", w / w.sum(axis=1, keepdims=True), F.reshape(*w.shape, *F.shape[1:])))


def nodal_sums(mesh: ElementMesh, per_corner: Floats) -> Floats:
    """Return the sums at the nodes of values per element and node: (e, k, c) -> (n, c)."""
    n, c = len(mesh.points), per_corner.shape[-1]
    dofs = (c * mesh.cells[:, :, None] + np.arange(c)).ravel()
    return np.asarray(np.bincount(dofs, weights=per_corner.ravel(), minlength=n * c), np.float64).reshape(n, c)


def nodal_forces(mesh: ElementMesh, P: Floats) -> Floats:
    """Return the nodal forces f_a = -sum w P grad N_a (n, d) [N] of first Piola-Kirchhoff stresses P (p, d, d) [Pa]."""
    weights, G = mesh.integration
    P = P.reshape(*weights.shape, *P.shape[1:])
    return nodal_sums(mesh, (-weights[:, :, None, None] * (G @ np.swapaxes(P, 2, 3))).sum(axis=1))


def stiffness_blocks(mesh: ElementMesh, C: Floats) -> Floats:
    """Return K_e (e, k, d, k, d) [N/m] of the tangents C_iJkL = dP_iJ/dF_kL (p, d, d, d, d) [Pa]."""
    weights, gradients = mesh.integration
    e, q, k, d = gradients.shape
    C, parts = C.reshape(e, q, *C.shape[1:]), []
    for point in range(q):
        G = gradients[:, point, None]
        half = (G @ C[:, point].reshape(e, d, d, d * d)).reshape(e, d, k, d, d)  # G_aJ C_iJkL, as (i, a, k, L)
        blocks = half @ np.swapaxes(G, 2, 3)[:, :, None]  # G_bL, as (i, a, k, b)
        blocks *= weights[:, point, None, None, None, None]
        parts.append(blocks)
    return np.asarray(sum(parts[1:], parts[0])).transpose(0, 2, 1, 4, 3)
