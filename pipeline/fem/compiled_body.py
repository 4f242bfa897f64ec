"""Bodies with the corotational or the linear law, whose sums over cells are compiled."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.assembly import sort_corners
from pipeline.fem.body import Body, Sites
from pipeline.fem.frame_error import FrameError, indicator, spurious_volume
from pipeline.fem.kernels import IDENTITY, POLAR
from pipeline.fem.laws import CREASE, Corotational, Law, Linear, Tangent
from pipeline.fem.mass import MassModel
from pipeline.fem.supports import Supports
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.simplex import Mesh


@dataclass(frozen=True, eq=False, repr=False)
class CompiledBody(Body):
    """The same as Body up to rounding; sums over cells with kernels/tetrahedron.py or, in the plane, triangle.py."""

    mesh: Mesh

    @cached_property
    def _rotation(self) -> int:
        number = find_rotation_number(self.law)
        assert number is not None  # make_body gives other laws a Body
        return number

    @cached_property
    def _kernels(self) -> Any:
        from pipeline.fem.kernels import tetrahedron, triangle

        return tetrahedron if self.mesh.dimension == 3 else triangle

    @cached_property
    def _frame_error_kernels(self) -> Any:
        from pipeline.fem.kernels import frame_error, triangle

        return frame_error if self.mesh.dimension == 3 else triangle

    @cached_property
    def _tangent_kernels(self) -> Any:
        from pipeline.fem.kernels import tangent, triangle

        return tangent if self.mesh.dimension == 3 else triangle

    def __getstate__(self) -> dict[str, Any]:  # modules cannot be pickled
        return {name: value for name, value in vars(self).items() if not isinstance(value, ModuleType)}

    @cached_property
    def _no_rotations(self) -> Floats:
        return np.empty((0, self.mesh.dimension, self.mesh.dimension))

    @cached_property
    def _cells(self) -> tuple[Any, ...]:
        """Return the kernels' arguments after x: cells, gradients of all but their first corner, volumes, mu, lam.

        The corners of a cell are in the order of their rows, so that its blocks lie on or below the diagonal. In space
        the gradients are in blocks of LANES cells (blocks, 9, LANES); copies of the last cell fill the last block.
        """
        m, corners = self.material, sort_corners(self.mesh, self.order)
        cells = np.take_along_axis(self.mesh.cells, corners, axis=1)
        G = np.take_along_axis(self.mesh.shape_gradients, corners[:, 1:, None], axis=1)
        if self.mesh.dimension == 3:
            lanes = self._kernels.LANES
            filled = np.minimum(np.arange(-(-len(cells) // lanes) * lanes), len(cells) - 1)
            cells, G = cells[filled], G[filled].reshape(-1, lanes, 9).swapaxes(1, 2).copy()
        return (cells.astype(np.int32), G, self.mesh.rest_volumes, m.mu, m.lam)

    @cached_property
    def _pairs(self) -> np.ndarray:
        return self.assembly.pairs.astype(np.int32)

    def warm_up(self, *, solves: bool = True, frame_errors: bool = False, tangents: bool = False) -> None:
        """Call the kernels of later steps on no cells, which loads or compiles them."""
        super().warm_up(solves=solves)
        cells, G, V, mu, lam = self._cells
        X, none, nothing = _to_contiguous(self.mesh.points), (cells[:0], G[:0], V[:0], mu, lam), self._no_rotations
        self._kernels.energy(X, *none, self._rotation)
        f = np.empty_like(X)
        if solves:
            self._kernels.nodal_rotations(X, *none[:3], nothing)
            self._kernels.linearize(X, *none, self._rotation, self._pairs[:0], 1.0, False, nothing, f, nothing)
        if frame_errors:
            self._kernels.rotations(X, *none[:2], self._rotation, nothing)
            self._frame_error_kernels.bound_frame_error(X, *none[:2], mu, lam)
            self._frame_error_kernels.measure_frame_error(X, *none[:2], mu, lam, nothing, nothing)
        if tangents or not solves:
            self._kernels.force(X, *none, self._rotation, f)
        if tangents:
            self._tangent_kernels.add_rotation_stiffness(X, *none, self._pairs[:0], 1.0, CREASE, False, nothing)

    def energy(self, x: Floats) -> float:
        """Return the elastic energy [J] at positions x (n, d)."""
        return float(self._kernels.energy(_to_contiguous(x), *self._cells, self._rotation))

    def rotations(self, x: Floats) -> Floats:
        """Return the rotations of the law (e, d, d) at positions x (n, d)."""
        R = np.empty((len(self.mesh.cells), *self._no_rotations.shape[1:]))
        self.update_rotations(x, R)
        return R

    def nodal_rotations(self, x: Floats, out: Floats | None = None) -> Floats:
        """Return for each node the polar rotation of the mean F of its cells (n, d, d)."""
        R = np.empty((len(x), *self._no_rotations.shape[1:])) if out is None else out
        self._kernels.nodal_rotations(_to_contiguous(x), *self._cells[:3], R)
        return R

    def update_rotations(self, x: Floats, R: Floats) -> float:
        """Write the rotations of the law into R (e, d, d); return the spurious volume of the largest one."""
        least_trace = self._kernels.rotations(_to_contiguous(x), *self._cells[:2], self._rotation, R)
        return spurious_volume(least_trace, x.shape[1])

    def measure_frame_error(self, x: Floats, used: Floats | None, reached: Floats) -> FrameError:
        """Write the rotations at x into reached (e, d, d); return their frame error from those used."""
        if self._rotation != POLAR:
            return super().measure_frame_error(x, used, reached)
        cells, G, _, mu, lam = self._cells
        before, d = self._no_rotations if used is None else used, x.shape[1]
        trace, stress, own = self._frame_error_kernels.measure_frame_error(
            _to_contiguous(x), cells, G, mu, lam, before, reached
        )
        return FrameError(indicator(trace, d, stress, self.material), spurious_volume(own, d))

    def bound_frame_error(self, x: Floats) -> float:
        """Return an upper bound on the indicator of measure_frame_error(x, None) that needs no rotations."""
        if self._rotation != POLAR:
            return super().bound_frame_error(x)
        cells, G, _, mu, lam = self._cells
        tangent, stress = self._frame_error_kernels.bound_frame_error(_to_contiguous(x), cells, G, mu, lam)
        cosine = (1 - tangent**2) / (1 + tangent**2)  # of the angle, from the tangent of half of it
        return indicator(2 * cosine + x.shape[1] - 2, x.shape[1], stress, self.material)

    def force(self, x: Floats, R: Floats | None = None, *, out: Floats | None = None) -> Floats:
        """Return the elastic forces ON the nodes (n, d) [N]; if R is given, with numpy as in Body."""
        if R is not None:
            return super().force(x, R, out=out)
        f = np.empty_like(x) if out is None else out
        self._kernels.force(_to_contiguous(x), *self._cells, self._rotation, f)
        return f

    def add_stiffness(
        self, x: Floats, scale: float, f: Floats, A: Floats, *, R: Floats | None = None, kind: Tangent = "frozen"
    ) -> None:
        """Write the elastic forces into f (n, d) and add scale * K to A (blocks, d, d)."""
        if kind != "frozen" and (R is not None or self._rotation != POLAR):
            super().add_stiffness(x, scale, f, A, R=R, kind=kind)
            return
        x, used = _to_contiguous(x), self._no_rotations if R is None else _to_contiguous(R)
        self._kernels.linearize(x, *self._cells, self._rotation, self._pairs, scale, R is not None, used, f, A)
        if kind != "frozen":
            projected = kind == "projected"
            self._tangent_kernels.add_rotation_stiffness(x, *self._cells, self._pairs, scale, CREASE, projected, A)


@dataclass(frozen=True, eq=False, repr=False)
class LinearBody(CompiledBody):
    """A body with the linear law: forces are K (X - x), with K summed over cells once."""

    @cached_property
    def stiffness(self) -> Floats:
        """Return the values of K (blocks, d, d) [N/m]."""
        return self.linearize(self.mesh.points)[1]

    def force(self, x: Floats, R: Floats | None = None, *, out: Floats | None = None) -> Floats:
        """Return the elastic forces ON the nodes (n, d) [N]; R is not used."""
        from pipeline.fem.kernels.blocks import multiply_difference

        f, X = np.empty_like(x) if out is None else out, self.mesh.points
        indptr, columns, order = self.pattern.indptr, self.pattern.columns, self.pattern.order
        multiply_difference(indptr, columns, order, self.stiffness, X, _to_contiguous(x), f)
        return f

    def energy(self, x: Floats) -> float:
        """Return the elastic energy (x - X) . K (x - X) / 2 [J] at positions x (n, d)."""
        u = x - self.mesh.points
        return 0.5 * float(np.vdot(u, self.pattern.multiply(self.stiffness, u, np.empty_like(u))))

    def warm_up(self, *, solves: bool = True, frame_errors: bool = False, tangents: bool = False) -> None:
        """Sum the stiffness, and load or compile the kernels that multiply by it."""
        self.momentum(np.zeros_like(self.mesh.points))
        self.force(self.mesh.points)
        self.energy(self.mesh.points)


def _to_contiguous(x: Floats) -> Floats:
    """Return x as a contiguous, writable float64 array, the only kind that kernels are compiled for."""
    if x.flags.carray and x.dtype == np.float64:  # np.require takes microseconds for the same check
        return x
    return np.require(x, np.float64, ["C", "W"])


def find_rotation_number(law: Law) -> int | None:
    """Return the kernels' number for the rotation of a law, None for a law or rotation without a kernel."""
    if isinstance(law, Linear):
        return IDENTITY
    return law.rotation.number if isinstance(law, Corotational) else None


def make_body(
    mesh: ElementMesh,
    law: Law,
    supports: Supports,
    load: Floats,
    mass_model: MassModel,
    varying_load: Callable[[float], Floats] | None = None,
    rotation_at: Sites = "points",
) -> Body:
    """Return the fastest body for a law; a law without a kernel gets a plain Body."""
    if isinstance(mesh, Mesh) and find_rotation_number(law) is not None:
        kind = LinearBody if isinstance(law, Linear) else CompiledBody
        return kind(mesh, law, supports, load, mass_model, varying_load)
    return Body(mesh, law, supports, load, mass_model, varying_load, rotation_at)
