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
from pipeline.fem.laws import Tangent
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
    """The linear systems of one body, linearised at positions x and solved for v - v*, v* = (x - x_h)/h.

    A (v - v*) = M (v_h - v*) + h (f_ext + f_el(x)),    A = M + h^2 K(x)

    is the equation above with h K (x_h - x) = -h^2 K v* brought to the left. The arrays A and f are made once.
    """

    def __init__(self, body: Body, solver: LinearSolver) -> None:
        self.body = body
        self.solver = solver
        d = body.mesh.dimension
        self.A = np.empty((body.pattern.blocks, d, d))
        self.f = np.empty_like(body.mesh.points)

    def linearise(self, x: Floats, h: float, R: Floats | None = None, kind: Tangent = "frozen") -> Work:
        """Take A and f_el at positions x (n, d) for the solves to come."""
        self.body.system(x, h, self.f, self.A, R=R, kind=kind)
        return self.take(x)

    def take(self, x: Floats) -> Work:
        """Take A as it stands, made at positions x (n, d)."""
        body = self.body
        return self.solver.update(self.A[: body.free_pattern.blocks], lambda: body.nodal_rotations(x)[body.free])

    def solve(self, b: Floats, held: Floats, guess: Floats) -> tuple[Floats, Work]:
        """Return w (n, d) with A w = b on the free nodes and w = held (k, d) on the others; b may change."""
        body = self.body
        w = np.zeros_like(b)
        if held.any():
            w[body.supports.nodes] = held
            b -= self._product(w)
        w[body.free], work = self.solver.solve(b[body.free], guess[body.free])
        return w, work

    def _product(self, w: Floats) -> Floats:
        """Return A w (n, d)."""
        pattern, out = self.body.pattern, np.empty_like(w)
        out[pattern.order] = pattern.product(self.A, w[pattern.order], np.empty_like(w))
        return out


def _held_velocity(stage: Stage, body: Body) -> Floats:
    """Return the velocities (k, d) that the stage gives the held nodes."""
    return (stage.held - stage.x_h[body.supports.nodes]) / stage.h


class Prefactored:
    """The constant tangent of the linear law: M + h^2 K is factored once."""

    def __init__(self, body: Body, solver: LinearSolver, h: float) -> None:
        self.body = body
        self.system = StageSystem(body, solver)
        self._order = body.pattern.order
        self._u, self._Ku = np.empty_like(body.mesh.points), np.empty_like(body.mesh.points)
        _, self.K = body.linearise(body.mesh.points)
        self.system.A[:] = body.mass + h**2 * self.K
        self.setup = self.system.take(body.mesh.points)

    def solve(self, stage: Stage) -> tuple[Floats, Work]:
        """Return v of the one linear system; the linearisation at x_h is exact."""
        body = self.body
        b = body.momentum(stage.v_h)
        b += stage.h * (body.load + self._force(stage.x_h))
        v, work = self.system.solve(b, _held_velocity(stage, body), stage.v_h)
        work += Work(iterations=1) + self.setup
        self.setup = Work()
        return v, work

    def _force(self, x: Floats) -> Floats:
        """Return f_el = -K (x - X) (n, d): the same sum as body.force(x), without visiting a cell."""
        np.subtract(x[self._order], self.body.mesh.points[self._order], out=self._u)
        f = np.empty_like(x)
        f[self._order] = self.body.pattern.product(self.K, self._u, self._Ku)
        return np.negative(f, out=f)


class FrozenPasses:
    """A fixed number of solves, each with the rotations of the state before it."""

    def __init__(self, body: Body, solver: LinearSolver, passes: int) -> None:
        self.body = body
        self.system = StageSystem(body, solver)
        self.passes = passes
        body.rehearse()

    def solve(self, stage: Stage) -> tuple[Floats, Work]:
        """Return v after the last pass."""
        v, work = self.pass_from(stage.start, stage, stage.R)
        for _ in range(self.passes - 1):
            v, done = self.pass_from(stage.x_h + stage.h * v, stage)
            work += done
        return v, work

    def pass_from(self, x: Floats, stage: Stage, R: Floats | None = None) -> tuple[Floats, Work]:
        """Return v of the system linearised at x (n, d), with the law's rotations there or with R."""
        body, h, system = self.body, stage.h, self.system
        work = system.linearise(x, h, R)
        held, away = _held_velocity(stage, body), stage.v_h
        if x is not stage.x_h:
            reached = (x - stage.x_h) / h
            held = held - reached[body.supports.nodes]
            away = stage.v_h - reached
        b = body.momentum(away)
        b += h * (body.load + system.f)
        w, solved = system.solve(b, held, away)
        v = w if x is stage.x_h else reached + w
        return v, work + solved + Work(iterations=1, rotations=1)
