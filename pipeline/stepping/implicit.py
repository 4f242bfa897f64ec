r"""One implicit stage, which backward Euler and BDF2 share, and how far its Newton iteration goes.

    find v:   M (v - v_h) = h (f_ext + f_el(x_h + h v)),    x = x_h + h v,    supported nodes given

Linearised at x* with the stiffness K = -df_el/dx of the rotations there (correction to T 6.12-6.16: + f_0):

    (M + h^2 K) v = M v_h + h (f_ext + f_el(x*) - K (x_h - x*))

    Prefactored     constant K: one factor for the whole run, one substitution a step (linear law; any x* is exact)
    FrozenPasses    k such solves with K = sum_e R K_e R^T, each at the state that the one before reached;
                    k = 1 is the thesis' method ("warped stiffness"), k > 1 Newton with the frozen tangent

Both are unconditionally stable for the linear law. One solve uses the rotations of the state that it starts from: a
cell that turns by t in the step gains a volume of tan^2 t, and elongated bodies in fast spin can blow up.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pipeline.fem.body import Body
from pipeline.mesh.simplex import Floats
from pipeline.stepping.linear_solve import LinearSolver
from pipeline.stepping.state import Work


@dataclass(frozen=True, eq=False)
class Stage:
    """The equation above: x_h, v_h (n, d), h [s], x* = `start` (n, d), and the held nodes' positions `held` (k, d).

    R (e, d, d) are the rotations at x*, where something else than the law has chosen them.
    """

    x_h: Floats
    v_h: Floats
    h: float
    start: Floats
    held: Floats
    R: Floats | None = None


class StageSolver(Protocol):
    """Solves stages of one body and one h."""

    def solve(self, stage: Stage) -> tuple[Floats, Work]:
        """Return the velocity v (n, d) and the work it took; raises SolveError."""
        ...


class StageSystem:
    """The linear systems (M + h^2 K) v = b of one body: held velocities moved to the right, free ones solved."""

    def __init__(self, body: Body, solver: LinearSolver) -> None:
        self.body = body
        self.solver = solver
        self._free_blocks = body.free_pattern[1]

    def update(self, K: Floats, h: float, x: Floats) -> Work:
        """Take M + h^2 K, made at positions x (n, d), for the solves to come."""
        self._values = self.body.mass + h**2 * K
        body = self.body
        return self.solver.update(self._values[self._free_blocks], lambda: body.nodal_rotations(x)[body.free])

    def solve(self, b: Floats, stage: Stage) -> tuple[Floats, Work]:
        """Return v (n, d) with the held nodes' velocities as the stage gives them."""
        body = self.body
        held = body.supports.nodes
        v = stage.v_h.copy()
        v[held] = (stage.held - stage.x_h[held]) / stage.h
        if np.any(v[held]):
            known = np.zeros_like(v)
            known[held] = v[held]
            b = b - body.pattern.product(self._values, known)
        v[body.free], work = self.solver.solve(b[body.free], v[body.free])
        return v, work


class Prefactored:
    """The constant tangent of the linear law: M + h^2 K is factored once."""

    def __init__(self, body: Body, solver: LinearSolver, h: float) -> None:
        self.body = body
        self.system = StageSystem(body, solver)
        _, self.K = body.linearise(body.mesh.points)
        self.setup = self.system.update(self.K, h, body.mesh.points)

    def solve(self, stage: Stage) -> tuple[Floats, Work]:
        """Return v of the one linear system; the linearisation at x_h is exact."""
        # f_el = -K u; the same sum as body.force(x_h), without visiting a cell
        f = -self.body.pattern.product(self.K, stage.x_h - self.body.mesh.points)
        b = self.body.momentum(stage.v_h) + stage.h * (self.body.load + f)
        v, work = self.system.solve(b, stage)
        work += Work(iterations=1) + self.setup
        self.setup = Work()
        return v, work


class FrozenPasses:
    """A fixed number of solves, each with the rotations of the state before it."""

    def __init__(self, body: Body, solver: LinearSolver, passes: int) -> None:
        self.body = body
        self.system = StageSystem(body, solver)
        self.passes = passes
        body.linearise(body.mesh.points)  # kernels are compiled, or loaded, here and not in a timed step

    def solve(self, stage: Stage) -> tuple[Floats, Work]:
        """Return v after the last pass."""
        v, work = self.pass_from(stage.start, stage, stage.R)
        for _ in range(self.passes - 1):
            v, done = self.pass_from(stage.x_h + stage.h * v, stage)
            work += done
        return v, work

    def pass_from(self, x: Floats, stage: Stage, R: Floats | None = None) -> tuple[Floats, Work]:
        """Return v of the system linearised at x (n, d), with the law's rotations there or with R."""
        body, h = self.body, stage.h
        f, K = body.linearise(x, R)
        b = body.momentum(stage.v_h) + h * (body.load + f)
        if x is not stage.x_h:
            b -= h * body.pattern.product(K, stage.x_h - x)
        work = self.system.update(K, h, x)
        v, solved = self.system.solve(b, stage)
        return v, work + solved + Work(iterations=1, rotations=1)
