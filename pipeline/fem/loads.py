"""Dead loads: nodal forces that depend on the rest shape only; their potential is -f . u."""

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.mass import consistent_masses
from pipeline.mesh.simplex import Mesh
from pipeline.mesh.surface import outward_areas


def body_force(mesh: Mesh, b: Floats) -> Floats:
    """Return the nodal forces V b / (d + 1) (n, d) [N] of a force density b (d,) [N/m3]."""
    return mesh.node_volumes[:, None] * b


def body_force_field(mesh: Mesh, b: Floats) -> Floats:
    """Return the nodal forces (n, d) [N] of a force density b (n, d) [N/m3], given at nodes, linear in cells."""
    f = np.zeros_like(mesh.points)
    np.add.at(f, mesh.cells, consistent_masses(mesh, 1.0) @ b[mesh.cells])
    return f


def normal_traction(mesh: Mesh, faces: Ints, traction: float) -> Floats:
    """Return the nodal forces t n A / d (n, d) [N] of a traction [Pa], positive outward, on the rest faces (f, d)."""
    share = traction * outward_areas(mesh.points, faces) / mesh.dimension
    f = np.zeros_like(mesh.points)
    for corner in faces.T:
        np.add.at(f, corner, share)
    return f
