"""Preconditioned conjugate gradients on nodal vectors, and the simplest preconditioner: inverse diagonal blocks.

For small steps, in which the mass dominates and few iterations suffice: no factor, little memory, meshes of any size.
"""

from typing import Protocol

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.assembly import BlockPattern
from pipeline.linear.solver import NodalRotations, SystemSettings
from pipeline.linear.work import Work

# far more than a worthwhile solve takes: block Jacobi needs about 3 h omega_max, a cycle on stretched cells 60
_LIMIT = 2000


class Preconditioner(Protocol):
    """An approximate inverse of the last matrix that `update` received."""

    def update(self, values: Floats, write_rotations: NodalRotations) -> Work:
        """Take the matrix with these values (blocks, d, d); ask for the nodes' rotations if they are needed."""
        ...

    def apply(self, r: Floats, size: float, Ap: Floats, z: Floats) -> tuple[float, float]:
        """Write the approximate A^-1 r into z (n, d), with |r| = `size`; return z . r and z . A p."""
        ...


class ConjugateGradients:
    """Solves for changing matrices of one pattern to a relative residual of rtol; its vectors are allocated once."""

    def __init__(self, systems: SystemSettings, preconditioner: Preconditioner) -> None:
        self.pattern = pattern = systems.pattern
        self.rtol = systems.rtol
        self.preconditioner = preconditioner
        n, d = pattern.nodes, pattern.dimension
        self._r, self._z, self._p, self._Ap = (np.zeros((n, d)) for _ in range(4))
        self._load_kernels()

    def _load_kernels(self) -> None:
        """Call the kernels of a solve on zeros: they are compiled or loaded here, not in a timed step."""
        from pipeline.linear.kernels import vectors as kernels

        r, d = self._r, self.pattern.dimension
        self.pattern.multiply(np.zeros((self.pattern.blocks, d, d)), r, self._Ap)
        kernels.subtract(r, self._Ap, self._z)
        kernels.descend(kernels.dot(r, r), self._p, self._Ap, self._z, r)
        kernels.follow(self._z, 0.0, self._p)

    def update(self, values: Floats, write_rotations: NodalRotations) -> Work:
        """Take the matrix with these values; they are not copied."""
        self._values = values
        return self.preconditioner.update(values, write_rotations)

    def solve(self, b: Floats, x: Floats) -> Work:
        """Improve x (n, d) to a relative residual of rtol; raises SolveError if that is not reached."""
        from pipeline.linear.kernels import vectors as kernels

        r, z, p, Ap = self._r, self._z, self._p, self._Ap
        target = self.rtol * np.sqrt(kernels.dot(b, b))
        size = kernels.subtract(b, self.pattern.multiply(self._values, x, Ap), r)
        p[:] = 0.0
        rz, step = 1.0, 0.0  # so that the first direction is z
        for iteration in range(_LIMIT):
            if size <= target:
                return Work(solves=1, linear_iterations=iteration)
            rz_new, zAp = self.preconditioner.apply(r, size, Ap, z)
            # Polak-Ribiere, (r_new - r) . z = -step A p . z: a factor in single precision is a slightly different
            # preconditioner each time
            kernels.follow(z, -step * zAp / rz, p)
            rz = rz_new
            curvature = kernels.dot(p, self.pattern.multiply(self._values, p, Ap))
            if not curvature > 0:
                raise SolveError(f"the system's matrix is not positive definite (p . A p = {curvature:.3g})")
            step = rz / curvature
            size = kernels.descend(step, p, Ap, x, r)
        raise SolveError(
            f"conjugate gradients did not reach {self.rtol:g} in {_LIMIT} iterations; try a smaller schedule.dt or "
            'another method.linear_solver, such as "warped"'
        )


class BlockJacobi:
    """The inverses of the diagonal blocks."""

    def __init__(self, pattern: BlockPattern) -> None:
        from pipeline.linear.kernels.vectors import apply_blocks, invert_blocks

        d = pattern.dimension
        self._invert = invert_blocks
        self._diagonal = pattern.diagonal
        self._inverse = np.zeros((pattern.nodes, d, d))
        # kernels are compiled or loaded here, not in a timed step
        none = np.zeros((0, d))
        invert_blocks(np.eye(d)[None], self._diagonal[:0], self._inverse[:0])
        apply_blocks(self._inverse[:0], none, none, none)

    def update(self, values: Floats, write_rotations: NodalRotations) -> Work:
        """Invert the diagonal blocks; raises SolveError if one is singular."""
        if not self._invert(values, self._diagonal, self._inverse):
            raise SolveError("a diagonal block of the system's matrix is singular")
        return Work()

    def apply(self, r: Floats, size: float, Ap: Floats, z: Floats) -> tuple[float, float]:
        """Write D^-1 r into z; return z . r and z . A p."""
        from pipeline.linear.kernels import vectors as kernels

        result: tuple[float, float] = kernels.apply_blocks(self._inverse, r, Ap, z)
        return result


def make_block_jacobi_cg(systems: SystemSettings) -> ConjugateGradients:
    """Return conjugate gradients preconditioned by the inverses of the diagonal blocks."""
    return ConjugateGradients(systems, BlockJacobi(systems.pattern))
