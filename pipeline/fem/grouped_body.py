"""Bodies of order 1 whose groups of cells share one dilatation, with compiled sums.

The kernels of cells get lam = 0; those of fem/kernels/dilatation.py add the part with lam.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.compiled_body import CompiledBody, LinearBody
from pipeline.fem.dilatation import Groups
from pipeline.fem.laws import Tangent


@dataclass(frozen=True, eq=False, repr=False)
class GroupedBody(CompiledBody):
    """The same as Body up to rounding; only its exact and projected tangents are summed by numpy."""

    @cached_property
    def _cells(self) -> tuple[Any, ...]:
        """Return the kernels' arguments after x: cells, gradients of all but their first node, weights, mu, lam = 0."""
        *others, lam = super()._cells
        return (*others, 0 * lam)

    @property
    def _groups(self) -> Groups:
        assert self.groups is not None  # make_body gives other formulations a CompiledBody
        return self.groups

    @cached_property
    def _group_gradients(self) -> Floats:
        """Return a buffer for the g (groups, m, d)."""
        return np.empty((*self._groups.nodes.shape, self.mesh.dimension))

    def _find_dilatations(self, x: Floats, R: Floats) -> Floats:
        """Write the g of the rotations R (e, d, d) into their buffer; return theta of every group (groups,)."""
        from pipeline.fem.kernels.dilatation import find_dilatations, sum_gradients

        mesh, groups, g = self.mesh, self._groups, self._group_gradients
        gradients = mesh.integration.gradients[:, 0]
        sum_gradients(mesh.cells, gradients, mesh.rest_volumes, R, groups.labels, groups.places, g)
        theta = np.empty(len(groups.nodes))
        find_dilatations(x, groups.nodes, groups.volumes, g, theta)
        return theta

    def warm_up(self, *, solves: bool = True, frame_errors: bool = False, tangents: bool = False) -> None:
        """Load or compile the kernels that later steps need."""
        super().warm_up(solves=solves, frame_errors=frame_errors, tangents=tangents)
        X = self.mesh.points
        self.energy(X)
        if solves:
            self.linearize(X)
        if tangents or not solves:
            self.force(X)

    def energy(self, x: Floats) -> float:
        """Return the elastic energy [J] at positions x (n, d)."""
        groups, theta = self._groups, self._find_dilatations(x, self.rotations(x))
        return super().energy(x) + 0.5 * float((groups.lam * groups.volumes) @ theta**2)

    def force(self, x: Floats, R: Floats | None = None, *, out: Floats | None = None) -> Floats:
        """Return the elastic forces ON the nodes (n, d) [N]; if R is given, with numpy as in Body."""
        from pipeline.fem.kernels.dilatation import add_forces

        if R is not None:
            return Body.force(self, x, R, out=out)
        f = super().force(x, out=out)
        theta = self._find_dilatations(x, self.rotations(x))
        add_forces(self._groups.nodes, self._groups.lam * theta, self._group_gradients, f)
        return f

    def add_stiffness(
        self, x: Floats, scale: float, f: Floats, A: Floats, *, R: Floats | None = None, kind: Tangent = "frozen"
    ) -> None:
        """Write the elastic forces into f (n, d) and add scale * K to A (blocks, d, d)."""
        from pipeline.fem.kernels.dilatation import add_forces, add_stiffness

        if kind != "frozen":
            Body.add_stiffness(self, x, scale, f, A, R=R, kind=kind)
            return
        R, groups = self.rotations(x) if R is None else np.ascontiguousarray(R), self._groups
        super().add_stiffness(x, scale, f, A, R=R)
        theta, g = self._find_dilatations(x, R), self._group_gradients
        add_forces(groups.nodes, groups.lam * theta, g, f)
        assembly = self._group_assembly
        assert assembly is not None  # there are groups
        add_stiffness(assembly.corners, assembly.pairs, scale * groups.lam / groups.volumes, g, A)


@dataclass(frozen=True, eq=False, repr=False)
class GroupedLinearBody(LinearBody):
    """A body with the linear law, whose stiffness is summed once, by numpy."""

    def add_stiffness(
        self, x: Floats, scale: float, f: Floats, A: Floats, *, R: Floats | None = None, kind: Tangent = "frozen"
    ) -> None:
        """Write the elastic forces into f (n, d) and add scale * K to A (blocks, d, d)."""
        Body.add_stiffness(self, x, scale, f, A, R=R, kind=kind)
