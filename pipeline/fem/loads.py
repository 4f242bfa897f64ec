"""Dead loads: nodal forces that depend on the rest shape only; their potential is -f . u."""

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.mass import consistent_masses
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.surface import integrate_normals


def body_force(mesh: ElementMesh, b: Floats) -> Floats:
    """Return the nodal forces b int N_a dV (n, d) [N] of a force density b (d,) [N/m3]."""
    return mesh.node_volumes[:, None] * b


def body_force_field(mesh: ElementMesh, b: Floats) -> Floats:
    """Return the nodal forces (n, d) [N] of a force density b (n, d) [N/m3] that is given at nodes and interpolated."""
    f = np.zeros_like(mesh.points)
    np.add.at(f, mesh.cells, consistent_masses(mesh, 1.0) @ b[mesh.cells])
    return f


def normal_traction(mesh: ElementMesh, faces: Ints, traction: float) -> Floats:
    """Return the nodal forces t int N_a n dA (n, d) [N] of a traction [Pa], positive outward, on rest faces (f, k)."""
    f, shares = np.zeros_like(mesh.points), integrate_normals(mesh.points, faces, traction)
    for a, nodes in enumerate(faces.T):
        np.add.at(f, nodes, shares[:, a])
    return f
