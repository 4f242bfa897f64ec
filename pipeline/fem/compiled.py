"""A body whose sums over cells are compiled, for what is solved most: tetrahedra, corotational, polar."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.fem.body import Body
from pipeline.fem.laws import Corotational, Law, Tangent
from pipeline.fem.rotation import polar
from pipeline.fem.supports import Supports
from pipeline.mesh.simplex import Floats, Mesh


def make_body(
    mesh: Mesh, law: Law, supports: Supports, load: Floats, mass_pairs: Callable[[Mesh, float], Floats]
) -> Body:
    """Return a body, a compiled one where there are kernels for its law and cells."""
    compiled = mesh.dimension == 3 and isinstance(law, Corotational) and law.rotation is polar
    return (CompiledBody if compiled else Body)(mesh, law, supports, load, mass_pairs)


@dataclass(frozen=True, eq=False)
class CompiledBody(Body):
    """The same numbers as Body, to rounding, from kernels.py."""

    @cached_property
    def _cells(self) -> tuple[Any, ...]:
        """Return what every kernel takes after x: cells, shape gradients, rest volumes, mu, lam."""
        m = self.material
        return (self.mesh.cells, self.mesh.shape_gradients, self.mesh.rest_volumes, m.mu, m.lam)

    @cached_property
    def _pairs(self) -> np.ndarray:
        return self.assembly.pairs.reshape(-1, 4, 4)

    def energy(self, x: Floats) -> float:
        """Return the elastic energy [J] at positions x (n, 3)."""
        from pipeline.fem import kernels

        return float(kernels.energy(_plain(x), *self._cells))

    def nodal_rotations(self, x: Floats) -> Floats:
        """Return the polar rotation of each node's mean gradient (n, 3, 3)."""
        from pipeline.fem import kernels

        n = len(x)
        sums, R = np.empty((n, 3, 3)), np.empty((n, 3, 3))
        kernels.nodal_rotations(_plain(x), *self._cells[:3], sums, R)
        return R

    def force(self, x: Floats, R: Floats | None = None) -> Floats:
        """Return the elastic forces ON the nodes (n, 3) [N]; with given rotations the plain way."""
        if R is not None:
            return super().force(x, R)
        from pipeline.fem import kernels

        f = np.empty_like(x)
        kernels.force(_plain(x), *self._cells, f)
        return f

    def linearise(self, x: Floats, R: Floats | None = None, kind: Tangent = "frozen") -> tuple[Floats, Floats]:
        """Return the elastic forces (n, 3) [N] and the values of K (blocks, 3, 3) [N/m]; frozen ones are compiled."""
        if kind != "frozen":
            return super().linearise(x, R, kind)
        from pipeline.fem import kernels

        f = np.empty_like(x)
        K = np.empty((len(self.pattern.indices), 3, 3))
        given = R is not None
        used = np.ascontiguousarray(R) if R is not None else np.empty((len(self.mesh.cells), 3, 3))
        kernels.linearise(_plain(x), *self._cells, self._pairs, given, used, f, K)
        return f, K


def _plain(x: Floats) -> Floats:
    """Return x as the one kind of array that kernels are compiled for: contiguous and writable."""
    return np.require(x, np.float64, ["C", "W"])
