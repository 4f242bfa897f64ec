r"""Symplectic Euler (W): v += dt/m (f_el(x) + f_ext), x += dt v, with lumped masses; no matrix.

Order 1, without damping of its own: energy oscillates about its true value. Stable only for dt < 2 / omega_max. Not for
stiff bodies with large steps; no other method has a cheaper step.

A damped body takes v <- (v + dt/m (f_el(x) - beta K' v + f_ext)) / (1 + alpha dt); beta shrinks the limit:

    (dt^2 + 2 beta dt) omega_max^2 < 4 + 2 alpha dt

    element bound    omega_max <= max_e omega_e, the largest frequency of a cell alone, free, with its lumped mass
    true limit       omega_max of the whole body at rest, supports held (Lanczos)
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.element import stiffness_blocks
from pipeline.fem.material import align_values
from pipeline.linear.work import Work
from pipeline.stepping.inversion import Treatment, track_rotations
from pipeline.stepping.parts import StepperParts
from pipeline.stepping.report import StepReport
from pipeline.stepping.state import NO_ARRAYS, Memory, State


@dataclass(eq=False)
class SymplecticEuler:
    """A stepper that does not check its own limit: `pipeline.build` does."""

    chooses_model: ClassVar[bool] = False

    body: Body
    dt: float
    treatment: Treatment | None = None

    def __post_init__(self) -> None:
        from pipeline.stepping.kernels.positions import kick

        self._kick = kick
        self._dt_over_mass = self.dt / self.body.lumped_mass
        self._kept = 1.0  # the part of a velocity that alpha leaves
        if self.body.damping is not None:
            self._kept = 1 / (1 + self.body.damping.mass * self.dt)
            self._dt_over_mass *= self._kept
        # kernels are compiled or loaded here, not in a timed step
        self.body.warm_up(solves=False)
        none = np.zeros_like(self.body.load[:0])
        held = self.body.supports.nodes[:0]
        kick(none, self.body.load[:0], self._dt_over_mass[:0], none, none, self.dt, held, none, none)

    @classmethod
    def make(cls, body: Body, dt: float, parts: StepperParts) -> "SymplecticEuler":
        """Return the stepper with the parts that a case names."""
        return cls(body, dt, parts.make_treatment())

    def step(self, state: State) -> tuple[State, StepReport]:
        """Return the state dt later."""
        body = self.body
        R, inversion = track_rotations(self.treatment, body, state.x, state)
        v, before = body.damped_force(state.x, state.v, R), state.v
        if body.damping is not None:
            before = before * self._kept
        x = np.empty_like(state.x)
        held, load = body.held_positions((state.step + 1) * self.dt), body.load_at(state.step * self.dt)
        self._kick(v, load, self._dt_over_mass, state.x, before, self.dt, body.supports.nodes, held, x)
        guided = body.guided_positions((state.step + 1) * self.dt)
        if guided is not None and body.supports.guides is not None:
            places = body.supports.guides.components
            v.reshape(-1)[places] = (guided - state.x.reshape(-1)[places]) / self.dt
            x.reshape(-1)[places] = guided
        work = Work(steps=1, rotations=int(not body.law.constant_tangent))
        return State(state.step + 1, x, v, Memory(NO_ARRAYS, inversion, state.memory.energy)), StepReport(work)


def element_limit(body: Body) -> float:
    """Return 2 / max_e omega_e [s], less with damping: a step below it is stable about rest, whatever the supports."""
    K, m = _cell_matrices(body)
    scaled = K / np.sqrt(m)[:, :, None] / np.sqrt(m)[:, None, :]
    return _find_limit(body, float(np.linalg.eigvalsh(scaled)[:, -1].max()))


def true_limit(body: Body) -> float:
    """Return 2 / omega_max [s] of the body at rest, less if damped; raises SolveError if Lanczos does not converge."""
    _, K = body.linearize(body.mesh.points)
    pattern = body.free_pattern
    matrix = pattern.matrix(K[: pattern.blocks])
    root = np.repeat(np.sqrt(body.lumped_mass[body.free]), pattern.dimension)
    if body.guide_cut is not None:  # a held component as if its mass were infinite
        root[body.guide_cut.is_held.ravel()] = np.inf
    operator = LinearOperator(matrix.shape, matvec=lambda u: (matrix @ (u.ravel() / root)) / root, dtype=np.float64)
    if matrix.shape[0] < 3:
        return _find_limit(body, float(np.linalg.eigvalsh(operator @ np.eye(matrix.shape[0])).max()))
    start = np.random.default_rng(0).standard_normal(matrix.shape[0])
    try:
        largest = eigsh(
            operator, 1, which="LA", v0=start, return_eigenvectors=False, tol=1e-10, ncv=min(40, matrix.shape[0])
        )
    except ArpackError as error:
        raise SolveError(
            f"Lanczos did not find the largest frequency ({error}); set schedule.dt below the element bound"
        ) from error
    return _find_limit(body, float(largest[0]))


def _find_limit(body: Body, square: float) -> float:
    """Return the largest stable step [s] for the square of the largest frequency [1/s2]."""
    if body.damping is None:
        return float(2 / np.sqrt(square))
    return body.damping.explicit_limit(float(np.sqrt(square)))


def _cell_matrices(body: Body) -> tuple[Floats, Floats]:
    """Return every cell's stiffness (e, m, m) at rest and its lumped masses (e, m), of m = k d degrees of freedom.

    The bound holds because a node's mass in the whole body is the sum of its masses in the cells.
    """
    mesh = body.mesh
    e, k = mesh.cells.shape
    d = mesh.dimension
    identity = np.broadcast_to(np.eye(d), (mesh.integration.weights.size, d, d))
    # a mean dilatation only lowers the energy: (sum w theta)^2 / V <= sum w theta^2
    K = stiffness_blocks(mesh, body.law.tangent(identity, identity)).reshape(e, k * d, k * d)
    return K, np.repeat(align_values(body.material.density, 1) * mesh.lumped_shares, d, axis=1)
