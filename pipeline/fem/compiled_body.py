"""Bodies with the corotational or the linear law, whose sums over cells are compiled."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.assembly import sort_corners
from pipeline.fem.body import Body
from pipeline.fem.frame_error import FrameError, indicator, scale_moduli, spurious_volume
from pipeline.fem.kernels import IDENTITY, POLAR
from pipeline.fem.laws import CREASE, Corotational, Law, Linear, Tangent
from pipeline.fem.material import MaterialValues


class KernelSet(NamedTuple):
    """The modules of kernels of one kind of element: for sums, frame errors and exact tangents."""

    sums: Any
    frame_errors: Any
    tangents: Any


def load_kernels(order: int, dimension: int) -> KernelSet | None:
    """Return the kernels of elements of an order and a dimension, None if there are none."""
    from pipeline.fem.kernels import (
        frame_error,
        frame_error10,
        tangent,
        tangent10,
        tetrahedron,
        tetrahedron10,
        triangle,
        triangle6,
    )

    table = {
        (1, 2): KernelSet(triangle, triangle, triangle),
        (1, 3): KernelSet(tetrahedron, frame_error, tangent),
        (2, 2): KernelSet(triangle6, triangle6, triangle6),
        (2, 3): KernelSet(tetrahedron10, frame_error10, tangent10),
    }
    return table.get((order, dimension))


@dataclass(frozen=True, eq=False, repr=False)
class CompiledBody(Body):
    """The same as Body up to rounding; sums over elements with the kernels of its order and dimension."""

    @cached_property
    def _rotation(self) -> int:
        number = find_rotation_number(self.law)
        assert number is not None  # make_body gives other laws a Body
        return number

    @cached_property
    def _modules(self) -> KernelSet:
        kernels = load_kernels(self.mesh.order, self.mesh.dimension)
        assert kernels is not None
        return kernels

    def __getstate__(self) -> dict[str, Any]:  # modules cannot be pickled
        return {name: value for name, value in vars(self).items() if not isinstance(value, KernelSet)}

    @cached_property
    def _no_rotations(self) -> Floats:
        return np.empty((0, self.mesh.dimension, self.mesh.dimension))

    @cached_property
    def _cells(self) -> tuple[Any, ...]:
        """Return the kernels' arguments after x: cells, gradients of all but their first node, weights, mu, lam.

        The nodes of a cell are in the order of their rows, so that its blocks lie on or below the diagonal. In space
        the gradients are in blocks of LANES points (blocks, 3 (k - 1), LANES); copies of the last one fill the last
        block. If the order is 1, weights are (e,); else (e, q), and whether the dilatation is a mean comes last.
        """
        m, (weights, gradients) = self.material, self.mesh.integration
        cells, G = self._arrange_gradients(gradients)
        lanes = self._fill_values(m.mu, weights.shape[1]), self._fill_values(m.lam, weights.shape[1])
        if self.mesh.order == 1:
            return (cells, G[:, 0] if self.mesh.dimension == 2 else G, self.mesh.rest_volumes, *lanes)
        return (cells, G, weights, *lanes, self.formulation.volumetric == "mean")

    def _fill_values(self, values: MaterialValues, q: int) -> Floats:
        """Return values (m,) for kernels, of each cell; in space (m, LANES), of q points per cell.

        m is 1 if all cells have the same value.
        """
        if self.mesh.dimension == 2:
            return np.atleast_1d(values)
        points = np.repeat(values, q) if isinstance(values, np.ndarray) else np.array([values])
        from pipeline.fem.kernels.rotation import LANES

        blocks = -(-len(points) // LANES) if isinstance(values, np.ndarray) else 1
        return np.asarray(points[np.minimum(np.arange(blocks * LANES), len(points) - 1)].reshape(blocks, LANES))

    @cached_property
    def _strays(self) -> tuple[Floats, Floats, float]:
        """Return mu and lam at the sites for frame errors, and the modulus by which their stresses are divided."""
        mu, lam, modulus = scale_moduli(self.material)
        q = self.site_count // len(self.mesh.cells)
        return self._fill_values(mu, q), self._fill_values(lam, q), modulus

    @cached_property
    def _sites(self) -> tuple[Any, ...]:
        """Return the arguments of the kernels that find rotations at their sites, between x and the method."""
        weights, gradients = self.mesh.integration
        if self.mesh.order == 1:
            return self._cells[:2]
        if self.formulation.rotation_at == "points":
            return (*self._cells[:2], weights.shape[1])
        mean = np.einsum("eq,eqai->eai", weights / weights.sum(axis=1, keepdims=True), gradients)
        return (*self._arrange_gradients(mean[:, None]), 1)

    def _arrange_gradients(self, gradients: Floats) -> tuple[Ints, Floats]:
        """Return the cells and gradients (e, q, k, d) with nodes sorted by row, without the first one's gradients.

        In space they fill whole blocks of lanes.
        """
        nodes = sort_corners(self.mesh, self.order)
        cells = np.take_along_axis(self.mesh.cells, nodes, axis=1)
        gradients = np.take_along_axis(gradients, nodes[:, None, 1:, None], axis=2)
        if self.mesh.dimension == 3:
            cells, gradients = _fill_lanes(cells, gradients)
        return cells.astype(np.int32), gradients

    @cached_property
    def _element_rotations(self) -> Floats:
        """Return a buffer for rotations that are one per element."""
        return np.empty((self.site_count, *self._no_rotations.shape[1:]))

    @cached_property
    def _pairs(self) -> np.ndarray:
        return self.assembly.pairs.astype(np.int32)

    def warm_up(self, *, solves: bool = True, frame_errors: bool = False, tangents: bool = False) -> None:
        """Call the kernels of later steps on no cells, which loads or compiles them."""
        super().warm_up(solves=solves)
        cells, G, weights, *rest = self._cells
        X, none, nothing = (
            _to_contiguous(self.mesh.points),
            (cells[:0], G[:0], weights[:0], *rest),
            self._no_rotations,
        )
        given = () if self.mesh.order == 1 else (False, nothing)
        self._modules.sums.energy(X, *none, self._rotation, *given)
        f = np.empty_like(X)
        if solves:
            self._modules.sums.nodal_rotations(X, *none[:3], nothing)
            self._modules.sums.linearize(X, *none, self._rotation, self._pairs[:0], 1.0, False, nothing, f, nothing)
        if frame_errors or self.site_count < self.mesh.integration.weights.size:
            # on no cells: R is empty, and kernels check no bounds
            no_sites = (*(part[:0] for part in self._sites[:2]), *self._sites[2:])
            self._modules.sums.rotations(X, *no_sites, self._rotation, nothing)
        if frame_errors:
            sites = (cells[:0], G[:0], *self._sites[2:], *self._strays[:2])
            self._modules.frame_errors.bound_frame_error(X, *sites)
            self._modules.frame_errors.measure_frame_error(X, *sites, nothing, nothing)
        if tangents or not solves:
            self._modules.sums.force(X, *none, self._rotation, *given, f)
        if tangents:
            self._modules.tangents.add_rotation_stiffness(X, *none, self._pairs[:0], 1.0, CREASE, False, nothing)

    def _give_rotations(self, x: Floats, R: Floats | None) -> tuple[bool, Floats]:
        """Return whether kernels take their rotations from an array, and that array: R, or one of each element."""
        if R is not None:
            return True, _to_contiguous(R)
        if self.site_count == self.mesh.integration.weights.size:
            return False, self._no_rotations
        self.update_rotations(x, self._element_rotations)
        return True, self._element_rotations

    def energy(self, x: Floats) -> float:
        """Return the elastic energy [J] at positions x (n, d)."""
        x = _to_contiguous(x)
        given = () if self.mesh.order == 1 else self._give_rotations(x, None)
        return float(self._modules.sums.energy(x, *self._cells, self._rotation, *given))

    def rotations(self, x: Floats) -> Floats:
        """Return the rotations of the law (s, d, d) at positions x (n, d)."""
        R = np.empty((self.site_count, *self._no_rotations.shape[1:]))
        self.update_rotations(x, R)
        return R

    def nodal_rotations(self, x: Floats, out: Floats | None = None) -> Floats:
        """Return for each node the polar rotation of the mean F of its cells (n, d, d)."""
        R = np.empty((len(x), *self._no_rotations.shape[1:])) if out is None else out
        self._modules.sums.nodal_rotations(_to_contiguous(x), *self._cells[:3], R)
        return R

    def update_rotations(self, x: Floats, R: Floats) -> float:
        """Write the rotations of the law into R (s, d, d); return the spurious volume of the largest one."""
        least_trace = self._modules.sums.rotations(_to_contiguous(x), *self._sites, self._rotation, R)
        return spurious_volume(least_trace, x.shape[1])

    def measure_frame_error(self, x: Floats, used: Floats | None, reached: Floats) -> FrameError:
        """Write the rotations at x into reached (s, d, d); return their frame error from those used."""
        if self._rotation != POLAR or self.groups is not None:  # the kernels take every point's own dilatation
            error = super().measure_frame_error(x, used, reached)
            # the bits of update_rotations, by which a resumed run measures them
            return FrameError(error.indicator, self.update_rotations(x, reached))
        mu, lam, modulus = self._strays
        before, d = self._no_rotations if used is None else used, x.shape[1]
        trace, stress, own = self._modules.frame_errors.measure_frame_error(
            _to_contiguous(x), *self._sites, mu, lam, before, reached
        )
        return FrameError(indicator(trace, d, stress, modulus), spurious_volume(own, d))

    def bound_frame_error(self, x: Floats) -> float:
        """Return an upper bound on the indicator of measure_frame_error(x, None) that needs no rotations."""
        if self._rotation != POLAR or self.groups is not None:
            return super().bound_frame_error(x)
        mu, lam, modulus = self._strays
        tangent, stress = self._modules.frame_errors.bound_frame_error(_to_contiguous(x), *self._sites, mu, lam)
        cosine = (1 - tangent**2) / (1 + tangent**2)  # of the angle, from the tangent of half of it
        return indicator(2 * cosine + x.shape[1] - 2, x.shape[1], stress, modulus)

    def force(self, x: Floats, R: Floats | None = None, *, out: Floats | None = None) -> Floats:
        """Return the elastic forces ON the nodes (n, d) [N]; if R is given and the order 1, with numpy as in Body."""
        if R is not None and self.mesh.order == 1:
            return super().force(x, R, out=out)
        f, x = np.empty_like(x) if out is None else out, _to_contiguous(x)
        given = () if self.mesh.order == 1 else self._give_rotations(x, R)
        self._modules.sums.force(x, *self._cells, self._rotation, *given, f)
        return f

    def add_stiffness(
        self, x: Floats, scale: float, f: Floats, A: Floats, *, R: Floats | None = None, kind: Tangent = "frozen"
    ) -> None:
        """Write the elastic forces into f (n, d) and add scale * K to A (blocks, d, d)."""
        x = _to_contiguous(x)
        given, used = self._give_rotations(x, R)
        if kind != "frozen" and (given or self._rotation != POLAR):
            super().add_stiffness(x, scale, f, A, R=R, kind=kind)
            return
        self._modules.sums.linearize(x, *self._cells, self._rotation, self._pairs, scale, given, used, f, A)
        if kind != "frozen":
            projected = kind == "projected"
            self._modules.tangents.add_rotation_stiffness(x, *self._cells, self._pairs, scale, CREASE, projected, A)


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


def _fill_lanes(cells: Ints, gradients: Floats) -> tuple[Ints, Floats]:
    """Return cells and gradients (e, q, k - 1, 3) for whole blocks of lanes, those (blocks, 3 (k - 1), LANES)."""
    from pipeline.fem.kernels.rotation import LANES

    e, q, others, _ = gradients.shape
    blocks = -(-e * q // LANES)
    points = np.minimum(np.arange(blocks * LANES), e * q - 1)
    filled = gradients.reshape(e * q, 3 * others)[points].reshape(blocks, LANES, 3 * others).swapaxes(1, 2).copy()
    return cells[np.minimum(np.arange(blocks * LANES // q), e - 1)], filled


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
