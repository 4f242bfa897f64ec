"""Dead loads: nodal forces that depend on the rest shape, and perhaps on time, but not on the motion.

The potential of constant ones is -f . u; those that vary with time have none, but do the work f . dx in a step.
"""

from collections.abc import Callable, Sequence

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.element import nodal_sums
from pipeline.fem.mass import consistent_masses
from pipeline.fem.material import MaterialValues
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.surface import integrate_areas, integrate_normals


def body_force(mesh: ElementMesh, b: Floats) -> Floats:
    """Return the nodal forces b int N_a dV (n, d) [N] of a force density b (d,) [N/m3]."""
    return mesh.node_volumes[:, None] * b


def gravity_force(mesh: ElementMesh, density: MaterialValues, g: Floats) -> Floats:
    """Return the nodal forces g int rho N_a dV (n, d) [N] of a density [kg/m3], a number or one per element."""
    if not isinstance(density, np.ndarray):
        return body_force(mesh, density * g)
    return integrate_density(mesh, density)[:, None] * g


def integrate_density(mesh: ElementMesh, density: MaterialValues) -> Floats:
    """Return int rho N_a dV (n,) [kg] of a density [kg/m3], a number or one per element."""
    if not isinstance(density, np.ndarray):
        return density * mesh.node_volumes
    return nodal_sums(mesh, consistent_masses(mesh, density).sum(axis=2)[:, :, None])[:, 0]


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


def vector_traction(mesh: ElementMesh, faces: Ints, traction: Floats) -> Floats:
    """Return the nodal forces t int N_a dA (n, d) [N] of a traction vector (d,) [Pa] on rest faces (f, k)."""
    f, shares = np.zeros_like(mesh.points), integrate_areas(mesh.points, faces)
    for a, nodes in enumerate(faces.T):
        np.add.at(f, nodes, shares[:, a, None] * traction)
    return f


def point_force(mesh: ElementMesh, cell: int, weights: Floats, force: Floats) -> Floats:
    """Return the nodal forces (n, d) [N] of a force (d,) in a cell at which the shape functions are `weights`."""
    f, nodes = np.zeros_like(mesh.points), mesh.cells[cell]
    f[nodes] = weights[: len(nodes), None] * force
    return f


class VaryingLoad:
    """A sum of nodal forces that vary with time: arrays (n, d) [N] with factors, and functions that return arrays.

    The forces at the last two times are remembered, for those who ask again in the same step.
    """

    def __init__(
        self,
        parts: Sequence[tuple[Callable[[float], float], Floats]],
        functions: Sequence[Callable[[float], Floats]] = (),
    ) -> None:
        self.parts = tuple(parts)
        self.functions = tuple(functions)
        self._recent: list[tuple[float, Floats]] = []

    def __call__(self, time: float) -> Floats:
        """Return the forces (n, d) [N] at a time [s]; the caller must not change them."""
        for when, forces in self._recent:
            if when == time:
                return forces
        terms = [factor(time) * f for factor, f in self.parts] + [function(time) for function in self.functions]
        total = terms[0]
        for term in terms[1:]:
            total = total + term
        self._recent = [*self._recent[-1:], (time, total)]
        return total
