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
from functools import cached_property
from typing import Protocol

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.laws import Tangent
from pipeline.linear.choice import LinearSolver
from pipeline.linear.work import Work


@dataclass(frozen=True, eq=False)
class Stage:
    """The equation above: x_h, v_h (n, d), h [s], x* = `start` (n, d), the held nodes' positions `held` (k, d) and
    the loads f_ext = `load` (n, d) [N] at the end of the step.

    `now` (n, d) are the positions that the step starts from. R (e, d, d) are the rotations at x*, where something else
    than the law has chosen them.
    """

    x_h: Floats
    v_h: Floats
    h: float
    start: Floats
    now: Floats
    held: Floats
    load: Floats
    R: Floats | None = None


class StageSolver(Protocol):
    """Solves stages of one body and one h."""

    def solve(self, stage: Stage) -> tuple[Floats, Floats, Work]:
        """Return x and v (n, d), arrays of the caller's own, and the work it took; raises SolveError."""
        ...


def reached(body: Body, stage: Stage, v: Floats, out: Floats | None = None) -> Floats:
    """Return x = x_h + h v (n, d), in `out` where that is given; held nodes are where they are held to the last bit."""
    x = np.multiply(v, stage.h, out=out)
    x += stage.x_h
    x[body.supports.nodes] = stage.held
    return x


class StageSystem:
    """The linear systems of one body, linearised at positions x and solved for v - v*, v* = (x - x_h)/h.

    A (v - v*) = M (v_h - v*) + h (f_ext + f_el(x)),    A = M + h^2 K(x)

    is the equation above with h K (x_h - x) = -h^2 K v* brought to the left. A, f and the right-hand side b are made
    once, as is room for what a solve needs.
    """

    def __init__(self, body: Body, solver: LinearSolver) -> None:
        self.body = body
        self.solver = solver
        X, d = body.mesh.points, body.mesh.dimension
        self.A = np.empty((body.pattern.blocks, d, d))
        self.f, self.b = np.empty_like(X), np.empty_like(X)
        self._free = np.empty((2, len(body.free), d))

    def linearise(self, x: Floats, h: float, R: Floats | None = None, kind: Tangent = "frozen") -> Work:
        """Take A and f_el at positions x (n, d) for the solves to come."""
        self.body.system(x, h, self.f, self.A, R=R, kind=kind)
        return self.take(x)

    def take(self, x: Floats) -> Work:
        """Take A as it stands, made at positions x (n, d)."""
        body = self.body

        def frames(out: Floats) -> None:
            body.nodal_rotations(x, self._turned).take(body.free, 0, out, "clip")

        return self.solver.update(self.A[: body.free_pattern.blocks], frames)

    @cached_property
    def _turned(self) -> Floats:
        """Return room for the nodes' rotations, which few solvers ask for."""
        d = self.body.mesh.dimension
        return np.empty((len(self.body.mesh.points), d, d))

    def solve(self, held: Floats, w: Floats) -> Work:
        """Make A w = b on the free nodes and w = held (k, d) on the others; w (n, d) is the guess, b is spent."""
        body = self.body
        if not body.supports.nodes.size:
            return self.solver.solve(self.b, w)
        b, free = self._free
        w.take(body.free, 0, free, "clip")
        if held.any():
            w[body.free] = 0.0
            w[body.supports.nodes] = held
            self.b -= body.product(self.A, w)
        self.b.take(body.free, 0, b, "clip")
        work = self.solver.solve(b, free)
        w[body.free] = free
        w[body.supports.nodes] = held
        return work


class Prefactored:
    """The constant tangent of the linear law: M + h^2 K is factored once."""

    def __init__(self, body: Body, solver: LinearSolver, h: float) -> None:
        self.body = body
        self.system = StageSystem(body, solver)
        self._held = np.empty((len(body.supports.nodes), body.mesh.dimension))
        self._setup: Work | None = self.system.linearise(body.mesh.points, h)

    def solve(self, stage: Stage) -> tuple[Floats, Floats, Work]:
        """Return x and v of the one linear system; the linearisation at x_h is exact."""
        body, system = self.body, self.system
        b = body.momentum(stage.v_h, system.b)
        f = body.force(stage.x_h, out=system.f)
        f += stage.load
        f *= stage.h
        b += f
        v = stage.v_h.copy()
        work = system.solve(_held_velocity(stage, stage.x_h, body, self._held), v)
        work.iterations += 1
        if self._setup is not None:
            work, self._setup = work + self._setup, None
        return reached(body, stage, v), v, work


class FrozenPasses:
    """A fixed number of solves, each with the rotations of the state before it."""

    def __init__(self, body: Body, solver: LinearSolver, passes: int) -> None:
        self.body = body
        self.system = StageSystem(body, solver)
        self.passes = passes
        self._x, self._reached, self._away = np.empty((3, *body.mesh.points.shape))
        self._held = np.empty((len(body.supports.nodes), body.mesh.dimension))

    def solve(self, stage: Stage) -> tuple[Floats, Floats, Work]:
        """Return x and v after the last pass."""
        v = stage.v_h.copy()
        work = self.pass_from(stage.start, stage, v, stage.R)
        for _ in range(self.passes - 1):
            work += self.pass_from(reached(self.body, stage, v, out=self._x), stage, v)
        return reached(self.body, stage, v), v, work

    def pass_from(self, x: Floats, stage: Stage, v: Floats, R: Floats | None = None) -> Work:
        """Write into v, which enters as the guess, the solution linearised at x (n, d), by its rotations or by R."""
        body, h, system = self.body, stage.h, self.system
        work = system.linearise(x, h, R)
        held = _held_velocity(stage, x, body, self._held)
        ahead, away = x is not stage.x_h, stage.v_h
        if ahead:
            np.subtract(x, stage.x_h, out=self._reached)
            self._reached /= h
            away = np.subtract(away, self._reached, out=self._away)
            v -= self._reached
        b = body.momentum(away, system.b)
        system.f += stage.load
        system.f *= h
        b += system.f
        work += system.solve(held, v)
        work.iterations += 1
        work.rotations += 1
        if ahead:
            v += self._reached
        return work


def _held_velocity(stage: Stage, x: Floats, body: Body, out: Floats) -> Floats:
    """Write into out (k, d) with what velocities the held nodes get from x (n, d) to where the stage has them."""
    x.take(body.supports.nodes, 0, out, "clip")
    np.subtract(stage.held, out, out=out)
    out /= stage.h
    return out
