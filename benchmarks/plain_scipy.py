"""One corotational solve per step in plain scipy, fairly written, without this project's kernels and solvers.

Batched SVD rotations, element matrices by einsum-free products, bincount assembly into CSR, SuperLU or Jacobi-CG.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, cg, splu

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.element import deformation_gradient, nodal_forces, stiffness_blocks
from pipeline.fem.rotation import polar_by_svd
from pipeline.problem.problem import Problem

_MOST_CELLS_SUPERLU = 50_000  # above this, a factorization in every step takes minutes
_MOST_ITERATIONS = 5000  # of Jacobi-CG; block Jacobi took 1700 on a million cells


class PlainStep:
    """Backward Euler with one solve per step and no compiled kernels: (x, v) -> (x, v)."""

    def __init__(self, body: Body, dt: float, solver: str, rtol: float = 1e-6) -> None:
        self.body, self.dt, self.solver, self.rtol = body, dt, solver, rtol
        d, n = body.mesh.dimension, len(body.mesh.points)
        self.free = body.free_components
        dofs = (d * body.mesh.cells[:, :, None] + np.arange(d)).reshape(len(body.mesh.cells), -1)
        k = dofs.shape[1]
        keys = np.repeat(dofs, k, axis=1).ravel() * (d * n) + np.tile(dofs, (1, k)).ravel()
        unique, self.scatter = np.unique(keys, return_inverse=True)
        rows, self.indices = np.divmod(unique, d * n)
        self.indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=d * n))])
        self.shape = (d * n, d * n)
        masses = body.mass_model.cell_masses(body.mesh, body.material.density)
        self.M = self._assemble(masses[:, :, None, :, None] * np.eye(d)[None, None, :, None, :])

    def _assemble(self, blocks: Floats) -> csr_array:
        values = np.bincount(self.scatter, weights=blocks.ravel(), minlength=len(self.indices))
        return csr_array((values, self.indices, self.indptr), shape=self.shape)

    def step(self, x: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Return positions and velocities dt later."""
        body, h = self.body, self.dt
        F = deformation_gradient(body.mesh, x)
        R = polar_by_svd(F)
        f = nodal_forces(body.mesh, body.law.stress(F, R))
        K = self._assemble(stiffness_blocks(body.mesh, body.law.tangent(F, R)))
        A = (self.M + h**2 * K)[self.free][:, self.free]
        b = (self.M @ v.ravel() + h * (body.load + f).ravel())[self.free]
        new = np.zeros(v.size)
        if self.solver == "superlu":
            new[self.free] = splu(
                A.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            ).solve(b)
        else:
            inverse = 1 / A.diagonal()
            M = LinearOperator(A.shape, matvec=lambda r: inverse * r.ravel())
            new[self.free], _ = cg(A, b, x0=v.ravel()[self.free], rtol=self.rtol, M=M, maxiter=_MOST_ITERATIONS)
        v_new = new.reshape(v.shape)
        return x + h * v_new, v_new


def list_starts(problem: Problem) -> list[Callable[[], Callable[[], None]]]:
    """Return a function for each solver that starts the problem's motion and returns its step."""
    solvers = ("cg", "superlu") if len(problem.body.mesh.cells) <= _MOST_CELLS_SUPERLU else ("cg",)
    return [partial(_start_motion, PlainStep(problem.body, problem.dt, solver), problem) for solver in solvers]


def _start_motion(stepper: PlainStep, problem: Problem) -> Callable[[], None]:
    x, v = problem.start.x, problem.start.v

    def step() -> None:
        nonlocal x, v
        x, v = stepper.step(x, v)

    return step
