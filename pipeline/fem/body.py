"""A body: mesh, law, mass, supports and loads, and the vectors and matrices of its equation of motion.

    M dv/dt = f_ext + f_el(x),    f_el,a = -sum_points w P grad N_a,    K = -df_el/dx

Body sums over integration points with numpy, for every law; compiled_body.py does the same with compiled kernels.

Rotations are found at sites: at every integration point, or once per element from its mean F. The latter is cheaper in
elements of order 2, but not accurate if they bend much, and has no potential. Linear simplices have one site each.

With a mean dilatation (dilatation.py) the trace of the strain, in the part of W with lam, is replaced by its mean over
a group of elements, which then do not lock as lam -> infinity (poisson_ratio -> 1/2).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.assembly import Assembly, BlockPattern, assemble_pattern
from pipeline.fem.damping import Rayleigh
from pipeline.fem.dilatation import Groups, average_over_groups, find_dilatation_blocks, group_elements
from pipeline.fem.element import (
    deformation_gradient,
    mean_gradient,
    nodal_forces,
    nodal_sums,
    stiffness_blocks,
)
from pipeline.fem.frame_error import FrameError, measure_frame_error, spurious_volume
from pipeline.fem.guides import GuideCut
from pipeline.fem.laws import Law, Tangent
from pipeline.fem.mass import MassModel, lump_masses
from pipeline.fem.material import Material
from pipeline.fem.rotation import polar
from pipeline.fem.supports import Supports
from pipeline.mesh.element_mesh import ElementMesh


class Formulation(NamedTuple):
    """The formulation of the elements: the sites of their rotations, and their dilatation, at each point or a mean."""

    rotation_at: Literal["points", "element"] = "points"
    volumetric: Literal["full", "mean"] = "full"


PLAIN = Formulation()


@dataclass(frozen=True, eq=False, repr=False)
class Body:
    """A body; `load` (n, d) [N] is the sum of constant dead loads, `varying_load` returns the rest at a time [s].

    Methods write into `out` if it is given. Returned arrays belong to the caller, unless stated otherwise.
    """

    mesh: ElementMesh
    law: Law
    supports: Supports
    load: Floats
    mass_model: MassModel
    varying_load: Callable[[float], Floats] | None = None
    formulation: Formulation = PLAIN
    damping: Rayleigh | None = None

    def __repr__(self) -> str:
        held = len(self.supports.nodes)
        return f"<{type(self).__name__} with law {type(self.law).__name__}, {held} held nodes: {self.mesh}>"

    @property
    def material(self) -> Material:
        """Return the material of the law."""
        return self.law.material

    @cached_property
    def order(self) -> Ints:
        """Return the node of every matrix row: free nodes first, then held ones."""
        return np.concatenate([self.free, np.flatnonzero(~self.free_mask)])

    @cached_property
    def assembly(self) -> Assembly:
        """Return the block pattern of all nodes, free ones first, and the map from cells into it."""
        patches = None if self.groups is None or self.mesh.order > 1 else self.groups.nodes  # if not elements
        return assemble_pattern(self.mesh, self.order, patches)

    @cached_property
    def groups(self) -> Groups | None:
        """Return the groups of elements that share a dilatation, None if each point has its own."""
        return group_elements(self.mesh, self.material.lam) if self.formulation.volumetric == "mean" else None

    @cached_property
    def _group_assembly(self) -> Assembly | None:
        """Return the map from groups into the pattern."""
        return None if self.groups is None else self.groups.assemble(self.pattern)

    @property
    def pattern(self) -> BlockPattern:
        """Return the block pattern of all nodes, free ones first."""
        return self.assembly.pattern

    @cached_property
    def free(self) -> Ints:
        """Return the nodes without support."""
        return np.flatnonzero(self.free_mask)

    @cached_property
    def free_mask(self) -> np.ndarray:
        """Return for each node whether it has no support."""
        mask = np.ones(len(self.mesh.points), dtype=bool)
        mask[self.supports.nodes] = False
        return mask

    @cached_property
    def free_pattern(self) -> BlockPattern:
        """Return the pattern of the free nodes; its values are the first ones of `pattern`."""
        return self.pattern.leading(len(self.free))

    @cached_property
    def free_components(self) -> Ints:
        """Return the components, d node + axis, that nothing holds; ascending."""
        d = self.mesh.dimension
        is_free = np.repeat(self.free_mask, d)
        if self.supports.guides is not None:
            is_free[self.supports.guides.components] = False
        return np.flatnonzero(is_free)

    @cached_property
    def guide_cut(self) -> GuideCut | None:
        """Return the entries of matrices that guides cut out, None without guides."""
        guides = self.supports.guides
        return None if guides is None else GuideCut(self.free_pattern, self.free, guides.components)

    @cached_property
    def mass(self) -> Floats:
        """Return the values of the mass matrix M (blocks, d, d) [kg]."""
        return self._nodal_mass[:, None, None] * np.eye(self.mesh.dimension)

    @cached_property
    def _nodal_mass(self) -> Floats:
        """Return the values of M without their d-fold repetition (blocks,) [kg]."""
        return self.assembly.sum_scalars(self.mass_model.cell_masses(self.mesh, self.material.density))

    @cached_property
    def lumped_mass(self) -> Floats:
        """Return the masses of the nodes (n,) [kg], all positive; their sum is that of M."""
        return lump_masses(self.mesh, self.material.density)

    @cached_property
    def mass_bound(self) -> Floats:
        """Return nodal masses b (n,) [kg] with v . M v <= sum b |v|^2, by Gershgorin: lumped ones if the order is 1."""
        if self.mass_model.is_diagonal or self.mesh.order == 1:
            return self.lumped_mass
        cells = np.abs(self.mass_model.cell_masses(self.mesh, self.material.density)).sum(axis=2)
        return nodal_sums(self.mesh, cells[:, :, None])[:, 0]

    @cached_property
    def frequency_bound(self) -> float:
        """Return an upper bound on the frequencies at rest with lumped masses [rad/s]: cheap, but a few times too high.

        In an element omega^2 <= (lam + 2 mu) sum_a (int |grad N_a|^2 dV / m_a), with the masses m_a of its nodes.
        """
        m, (weights, gradients) = self.material, self.mesh.integration
        squares = np.einsum("eq,eqai,eqai->ea", weights, gradients, gradients)
        ratios = (squares / self.mesh.lumped_shares).sum(axis=1)
        if isinstance(m.wave_modulus / m.density, np.ndarray):
            return float(np.sqrt((m.wave_modulus * ratios / m.density).max()))
        return float(np.sqrt(m.wave_modulus * ratios.max() / m.density))

    @property
    def site_count(self) -> int:
        """Return the number of rotations s: one per integration point, or one per element."""
        e, q = self.mesh.integration.weights.shape
        return e if self.formulation.rotation_at == "element" else e * q

    @cached_property
    def _held_at_rest(self) -> Floats:
        return np.asarray(self.mesh.points[self.supports.nodes])

    def held_positions(self, time: float) -> Floats:
        """Return the positions of the held nodes (k, d) at a time [s]; the caller must not change them."""
        return self.supports.positions(self.mesh.points, time) if self.supports.motions else self._held_at_rest

    def guided_positions(self, time: float) -> Floats | None:
        """Return the coordinates of the guides' components (c,) at a time [s], None without guides."""
        guides = self.supports.guides
        return None if guides is None else guides.positions(self.mesh.points, time)

    def load_at(self, time: float) -> Floats:
        """Return all dead loads f_ext (n, d) [N] at a time [s]; the caller must not change them."""
        return self.load if self.varying_load is None else self.load + self.varying_load(time)

    def momentum(self, v: Floats, out: Floats | None = None) -> Floats:
        """Return M v (n, d) [kg m/s]; lumped masses need no matrix."""
        out = np.empty_like(v) if out is None else out
        if self.mass_model.is_diagonal:
            return np.multiply(self.lumped_mass[:, None], v, out=out)
        from pipeline.fem.kernels.blocks import multiply_scalars

        pattern = self.pattern
        multiply_scalars(pattern.indptr, pattern.columns, pattern.order, self._nodal_mass, np.ascontiguousarray(v), out)
        return out

    def site_gradients(self, x: Floats) -> Floats:
        """Return F (s, d, d) at the sites of rotations, at positions x (n, d)."""
        F = deformation_gradient(self.mesh, x)
        return mean_gradient(self.mesh, F) if len(F) > self.site_count else F

    def rotations(self, x: Floats) -> Floats:
        """Return the rotations of the law (s, d, d) at positions x (n, d)."""
        return self.law.rotations(self.site_gradients(x))

    def _spread(self, R: Floats) -> Floats:
        """Return the rotations at all points (p, d, d) of those at the sites (s, d, d)."""
        points = self.mesh.integration.weights.size
        return R if len(R) == points else np.repeat(R, points // len(R), axis=0)

    def _find_dilatation(self, F: Floats, R: Floats) -> Floats | None:
        """Return the mean dilatation of every point's group (p,), None if each point has its own."""
        if self.groups is None:
            return None
        return average_over_groups(self.mesh, self.groups, self.law.measure_dilatation(F, R))

    def nodal_rotations(self, x: Floats, out: Floats | None = None) -> Floats:
        """Return for each node the polar rotation of the mean F of its elements (n, d, d)."""
        w, F = self.mesh.integration.weights, deformation_gradient(self.mesh, x)
        e, k = self.mesh.cells.shape
        d = x.shape[1]
        total = (w.reshape(-1, 1) * F.reshape(-1, d * d)).reshape(*w.shape, d * d).sum(axis=1)
        R = polar(nodal_sums(self.mesh, np.broadcast_to(total[:, None], (e, k, d * d))).reshape(-1, d, d))
        if out is None:
            return R
        np.copyto(out, R)
        return out

    def energy(self, x: Floats) -> float:
        """Return the elastic energy [J] at positions x (n, d)."""
        return float(self.mesh.integration.weights.ravel() @ self.energy_density(x))

    def energy_density(self, x: Floats) -> Floats:
        """Return the elastic energy per rest volume at all points (p,) [J/m3] at positions x (n, d)."""
        F = deformation_gradient(self.mesh, x)
        R = self._spread(self.rotations(x))
        return self.law.energy_density(F, R, self._find_dilatation(F, R))

    def force(self, x: Floats, R: Floats | None = None, *, out: Floats | None = None) -> Floats:
        """Return the elastic forces ON the nodes f_el (n, d) [N], with the rotations R (s, d, d) if given."""
        F = deformation_gradient(self.mesh, x)
        out = np.empty_like(x) if out is None else out
        R = self._spread(self.rotations(x) if R is None else R)
        out[:] = nodal_forces(self.mesh, self.law.stress(F, R, self._find_dilatation(F, R)))
        return out

    def damped_force(self, x: Floats, v: Floats, R: Floats | None = None, *, out: Floats | None = None) -> Floats:
        """Return f_el(x) - beta K' v (n, d) [N], with the rotations R (s, d, d) at x.

        Forces of given rotations are affine in x, so these are the ones at x + beta v. alpha M v is not included.
        """
        beta = 0.0 if self.damping is None else self.damping.stiffness
        if not beta or self.law.constant_tangent:
            return self.force(x + beta * v if beta else x, R, out=out)
        return self.force(x + beta * v, self.rotations(x) if R is None else R, out=out)

    def warm_up(self, *, solves: bool = True, frame_errors: bool = False, tangents: bool = False) -> None:
        """Load or compile the kernels that later steps need, so that no timed step has to.

        These are the kernels of one solve, or of forces alone, and optionally those of frame errors and tangents.
        """
        if solves:
            self.momentum(np.zeros_like(self.mesh.points))

    def update_rotations(self, x: Floats, R: Floats) -> float:
        """Write the rotations of the law into R (s, d, d); return the spurious volume of the largest one."""
        R[:] = self.rotations(x)
        return spurious_volume(float(np.trace(R, axis1=1, axis2=2).min()), x.shape[1])

    def measure_frame_error(self, x: Floats, used: Floats | None, reached: Floats) -> FrameError:
        """Write the rotations at x into reached (s, d, d); return their frame error from those used (None: I)."""
        if self.site_count < self.mesh.integration.weights.size:
            return measure_frame_error(self.law, self.site_gradients(x), used, reached)
        return measure_frame_error(self.law, self.site_gradients(x), used, reached, self._find_dilatation)

    def bound_frame_error(self, x: Floats) -> float:
        """Return an upper bound on the indicator of measure_frame_error(x, None) that needs no rotations.

        It is infinite if no bound is known.
        """
        return np.inf

    def linearize(self, x: Floats, R: Floats | None = None, kind: Tangent = "frozen") -> tuple[Floats, Floats]:
        """Return the elastic forces (n, d) [N] and the values of K (blocks, d, d) [N/m]."""
        f, K = np.empty_like(x), np.zeros((self.pattern.blocks, x.shape[1], x.shape[1]))
        self.add_stiffness(x, 1.0, f, K, R=R, kind=kind)
        return f, K

    def assemble_system(
        self, x: Floats, h: float, f: Floats, A: Floats, *, R: Floats | None = None, kind: Tangent = "frozen"
    ) -> None:
        """Write the elastic forces into f (n, d) [N] and the values of M + h^2 K into A (blocks, d, d) [kg]."""
        A[:] = self.mass
        self.add_stiffness(x, h**2, f, A, R=R, kind=kind)

    def add_stiffness(
        self, x: Floats, scale: float, f: Floats, A: Floats, *, R: Floats | None = None, kind: Tangent = "frozen"
    ) -> None:
        """Write the elastic forces into f (n, d) and add scale * K to A (blocks, d, d)."""
        F = deformation_gradient(self.mesh, x)
        R = self._spread(self.rotations(x) if R is None else R)
        dilatation = self._find_dilatation(F, R)
        f[:] = nodal_forces(self.mesh, self.law.stress(F, R, dilatation))
        A += scale * self.assembly.sum_blocks(stiffness_blocks(self.mesh, self.law.tangent(F, R, kind, dilatation)))
        if self.groups is not None and self._group_assembly is not None:
            blocks = find_dilatation_blocks(self.mesh, self.groups, R)
            A += scale * self._group_assembly.sum_blocks(blocks)
