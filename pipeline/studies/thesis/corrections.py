"""The printed formulas, run on the thesis' own bar beside the corrected ones.

Each function of TESTS takes the problem of the linear bar with f = 20 as printed, and returns (numbers of the printed
formula, numbers of the corrected one), which `published.CORRECTIONS` puts into words.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.modes import find_lowest_frequencies
from pipeline.mesh.simplex import Mesh, require_simplices
from pipeline.problem.problem import Problem
from pipeline.studies.thesis.formulas_as_printed import force_6_12, step_4_48, stiffness_4_30, stiffness_4_32
from pipeline.studies.thesis.published import CORRECTIONS, Correction

Numbers = Mapping[str, float]
STEPS = 100
_ZERO = 1e-10  # of the largest singular value: far above rounding, far below the next value (1e-2)


@dataclass(frozen=True, eq=False)
class DenseSystem:
    """The free degrees of freedom of a small body as dense matrices (k, k) and vectors (k,)."""

    M: Floats
    f: Floats
    v: Floats
    free: Ints
    problem: Problem

    @property
    def mesh(self) -> Mesh:
        """Return the mesh of linear tetrahedra."""
        return require_simplices(self.problem.body.mesh)

    def restrict(self, blocks: Floats) -> Floats:
        """Return the assembled matrix (k, k) of the cells' matrices (e, 4, 3, 4, 3)."""
        return assemble_dense(self.mesh, blocks)[np.ix_(self.free, self.free)]


def assemble_dense(mesh: Mesh, blocks: Floats) -> Floats:
    """Return the whole matrix (n d, n d) of the cells' (e, 4, 3, 4, 3), which need not be symmetric."""
    dofs = (3 * mesh.cells[:, :, None] + np.arange(3)).reshape(len(mesh.cells), 12)
    K = np.zeros((mesh.points.size, mesh.points.size))
    np.add.at(K, (dofs[:, :, None], dofs[:, None, :]), blocks.reshape(-1, 12, 12))
    return K


def make_dense(problem: Problem) -> DenseSystem:
    """Return the matrices of a problem's free degrees of freedom."""
    body = problem.body
    free = np.repeat(body.free_mask, body.mesh.dimension)
    M = body.pattern.matrix(body.mass).toarray()[np.ix_(free, free)]
    dofs = np.flatnonzero(free).astype(np.int64)
    return DenseSystem(M, body.load.ravel()[free], problem.start.v.ravel()[free], dofs, problem)


def measure_element(problem: Problem, blocks: Floats) -> dict[str, float]:
    """Return the numbers of the first cell's K_e: asymmetry, kernel, lowest eigenvalue, forces of rotations."""
    mesh = problem.body.mesh
    K = blocks[0].reshape(12, 12)
    singular = np.linalg.svd(K, compute_uv=False)
    X = mesh.points[mesh.cells[0]]
    scale = problem.body.material.youngs_modulus * mesh.rest_volumes[0] ** (2 / 3)
    forces = [float(np.linalg.norm(K @ np.cross(axis, X - X.mean(axis=0)).ravel()) / scale) for axis in np.eye(3)]
    return {
        "asymmetry": float(np.linalg.norm(K - K.T) / np.linalg.norm(K)),
        "kernel": float((singular < _ZERO * singular[0]).sum()),
        "lowest": float(np.linalg.eigvalsh((K + K.T) / 2)[0] / singular[0]),
        "about_x": forces[0],
        "about_y": forces[1],
        "about_z": forces[2],
    }


def measure_travel(system: DenseSystem, K: Floats, *, corrected: bool) -> float:
    """Return the largest displacement [m] of any node within 100 steps of T 4.48."""
    u, v, farthest = np.zeros_like(system.v), system.v, 0.0
    for _ in range(STEPS):
        u, v = step_4_48(system.M, K, system.f, u, v, system.problem.dt, corrected=corrected)
        farthest = max(farthest, float(np.linalg.norm(u.reshape(-1, 3), axis=1).max()))
    return farthest


def run_third_sum(problem: Problem) -> tuple[Numbers, Numbers]:
    """Return the numbers of T 4.30."""
    make = partial(stiffness_4_30, require_simplices(problem.body.mesh), problem.body.material)
    return measure_element(problem, make()), measure_element(problem, make(corrected=True))


def run_left_factor(problem: Problem) -> tuple[Numbers, Numbers]:
    """Return the numbers of T 4.32; its K is used in a correct step."""
    system, numbers = make_dense(problem), []
    for corrected in (False, True):
        blocks = stiffness_4_32(require_simplices(problem.body.mesh), problem.body.material, corrected=corrected)
        K = system.restrict(blocks)
        numbers.append(measure_element(problem, blocks) | {"travel": measure_travel(system, K, corrected=True)})
    return numbers[0], numbers[1]


def run_load_sign(problem: Problem) -> tuple[Numbers, Numbers]:
    """Return the numbers of T 4.48: growth of the first mode a step, largest displacement, and rise under gravity."""
    system, dt = make_dense(problem), problem.dt
    K = system.restrict(stiffness_4_30(require_simplices(problem.body.mesh), problem.body.material, corrected=True))
    omega, modes = find_lowest_frequencies(problem.body)
    z = float(omega[0]) * dt
    zero = np.zeros_like(system.f)
    theory = {False: 1 + z / np.hypot(1, z), True: 1 / np.hypot(1, z)}
    numbers = []
    for corrected in (False, True):
        u, v = modes[0].ravel()[system.free], zero
        sizes = []
        for _ in range(STEPS):
            u, v = step_4_48(system.M, K, zero, u, v, dt, corrected=corrected)
            sizes.append(np.sqrt(u @ system.M @ u + v @ system.M @ v / omega[0] ** 2))
        moved, _ = step_4_48(system.M, K, system.f, zero, zero, dt, corrected=corrected)
        numbers.append({
            "growth": float(sizes[-1] / sizes[STEPS // 2]) ** (1 / (STEPS - 1 - STEPS // 2)),
            "theory": float(theory[corrected]),
            "travel": measure_travel(system, K, corrected=corrected),
            "rise": float(moved.reshape(-1, 3)[:, 2].mean()),
        })  # fmt: skip
    return numbers[0], numbers[1]


def run_rest_force(problem: Problem) -> tuple[Numbers, Numbers]:
    """Return the numbers of T 6.12 to 6.16: residual at rest without loads, over -2 K x, and the first step."""
    system, body = make_dense(problem), problem.body
    blocks = stiffness_4_30(system.mesh, body.material, corrected=True)
    K_all = assemble_dense(system.mesh, blocks)
    x = body.mesh.points.ravel()
    f_0 = K_all @ x
    K, numbers = system.restrict(blocks), []
    for corrected in (False, True):
        r = force_6_12(K_all, np.zeros_like(x), x, np.zeros_like(x), f_0, corrected=corrected)[system.free]
        v = np.linalg.solve(system.M + problem.dt**2 * K, problem.dt * r)
        expected = -2 * f_0[system.free]
        numbers.append({
            "residual": float(np.linalg.norm(r)),
            "share": float(r @ expected / (expected @ expected)),
            "jump": float(np.linalg.norm(problem.dt * v.reshape(-1, 3), axis=1).max()),
        })  # fmt: skip
    return numbers[0], numbers[1]


TESTS: Mapping[str, Callable[[Problem], tuple[Numbers, Numbers]]] = {
    "third_sum": run_third_sum,
    "left_factor": run_left_factor,
    "load_sign": run_load_sign,
    "rest_force": run_rest_force,
}


def run_corrections(problem: Problem) -> list[tuple[Correction, str, str]]:
    """Return every correction with the results of the printed and the corrected formula in words, if it runs."""
    rows = []
    for row in CORRECTIONS:
        if not row.test:
            rows.append((row, "", ""))
            continue
        printed, corrected = TESTS[row.test](problem)
        rows.append((row, row.fails.format(**printed), row.holds.format(**corrected)))
    return rows
