r"""One implicit stage, which backward Euler and BDF2 share, and two ways to solve it.

    find v:   M (v - v_h) = h (f_ext + f_el(x_h + h v)),    x = x_h + h v,    supported nodes prescribed

Linearized at x* with the stiffness K = -df_el/dx for the rotations there (correction to T 6.12-6.16: + f_0):

    (M + h^2 K) v = M v_h + h (f_ext + f_el(x*) - K (x_h - x*))

    Prefactored     constant K: one factor for the whole run, one substitution per step (linear law; any x* is exact)
    FrozenPasses    k such solves with K = sum_e R K_e R^T, each at the positions that the previous one reached;
                    k = 1 is the thesis' method ("warped stiffness"), k > 1 Newton with the frozen tangent

Both are unconditionally stable for the linear law. One solve uses the rotations of the state that it starts from: a
cell that turns by t in the step gains tan^2 t of its volume, and elongated bodies in fast spin can blow up.
"""

from functools import cached_property
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.laws import Tangent
from pipeline.linear.solver import LinearSolver
from pipeline.linear.work import Work
from pipeline.stepping.damping import FrozenDamping
from pipeline.stepping.report import StepReport


class Stage(NamedTuple):  # a frozen dataclass takes a microsecond longer to make, of 40 in the shortest steps
    """The equation above: x_h, v_h (n, d), h [s] and x* = `start` (n, d).

    `held` (k, d) are the positions of the held nodes and `load` (n, d) [N] the loads f_ext at the end of the step.
    `now` (n, d) are the positions x_n before it; `starts_at_x_n` says that x_h and x* are x_n too, as in backward
    Euler. `R` (e, d, d) are the rotations at x*, None if the law chooses them. `guided` (c,) are the coordinates of the
    single held components, None without guides.
    """

    x_h: Floats
    v_h: Floats
    h: float
    start: Floats
    now: Floats
    held: Floats
    load: Floats
    starts_at_x_n: bool
    R: Floats | None = None
    guided: Floats | None = None


class StageSolver(Protocol):
    """Solves stages of one body and one h."""

    @property
    def chooses_model(self) -> bool:
        """Return whether each solve chooses its own model, and reports it."""
        ...

    def solve(self, stage: Stage) -> tuple[Floats, Floats, StepReport]:
        """Return x and v (n, d), arrays that the caller owns, and a report; raises SolveError."""
        ...


def advance(body: Body, stage: Stage, v: Floats, out: Floats | None = None) -> Floats:
    """Return x = x_h + h v (n, d), in `out` if given; held nodes are exactly where their supports hold them."""
    x = np.multiply(v, stage.h, out=out)
    x += stage.x_h
    return hold(body, stage, x)


def hold(body: Body, stage: Stage, x: Floats) -> Floats:
    """Move the held nodes and components in x (n, d) to the places that the stage gives them; return x."""
    x[body.supports.nodes] = stage.held
    if body.supports.guides is not None:
        x.reshape(-1)[body.supports.guides.components] = stage.guided
    return x


class StageSystem:
    """The linear systems of one body, linearized at positions x and solved for v - v*, v* = (x - x_h)/h.

    A (v - v*) = M (v_h - v*) + h (f_ext + f_el(x) - C v*),    A = M + h C + h^2 K(x)

    is the equation above with h K (x_h - x) = -h^2 K v* moved to the left, and the force -C v of a damped body
    (damping.py). A, f and the right-hand side b are allocated once, as are the buffers of a solve.
    """

    def __init__(self, body: Body, solver: LinearSolver) -> None:
        self.body = body
        self.solver = solver
        X, d = body.mesh.points, body.mesh.dimension
        self.A = np.empty((body.pattern.blocks, d, d))
        self.f, self.b = np.empty_like(X), np.empty_like(X)
        self._free = np.empty((2, len(body.free), d))
        self._cut = np.empty(
            0 if body.guide_cut is None else len(body.guide_cut.entries)
        )  # the entries that guides cut
        self.damping = None if body.damping is None else FrozenDamping(body, body.damping)

    def freeze_damping(self, stage: Stage, *, at_start: bool) -> None:
        """Freeze the damping of a stage, for a solve at its start or for others; without damping do nothing."""
        if self.damping is None:
            return
        if at_start or not stage.starts_at_x_n:
            self.damping.freeze(stage.start, stage.h, stage.R)
        else:
            self.damping.freeze_middle(stage.x_h, stage.v_h, stage.h)

    def linearize(self, x: Floats, h: float, R: Floats | None = None, kind: Tangent = "frozen") -> Work:
        """Assemble A and f_el at positions x (n, d) and give A to the solver."""
        self.body.assemble_system(x, h, self.f, self.A, R=R, kind=kind)
        if self.damping is not None:
            self.A += self.damping.values
        return self.update_solver(x)

    def update_solver(self, x: Floats) -> Work:
        """Give the solver A as it is, assembled at positions x (n, d)."""
        body = self.body

        def write_rotations(out: Floats) -> None:
            body.nodal_rotations(x, self._nodal_rotations).take(body.free, 0, out, "clip")
            if body.guide_cut is not None:
                body.guide_cut.restrict_rotations(out)

        if body.guide_cut is not None:
            body.guide_cut.apply(self.A, self._cut)
        return self.solver.update(self.A[: body.free_pattern.blocks], write_rotations)

    @cached_property
    def _nodal_rotations(self) -> Floats:
        """Return a buffer for the nodes' rotations, for the few solvers that ask for them."""
        d = self.body.mesh.dimension
        return np.empty((len(self.body.mesh.points), d, d))

    def solve(self, held: Floats, w: Floats, guided: Floats | None = None) -> Work:
        """Solve A w = b on the free nodes, w = held (k, d) on the others; w (n, d) is the guess; b and f change.

        With guides, their components of w are `guided` (c,).
        """
        body = self.body
        if guided is not None:
            return self._solve_guided(held, guided, w)
        if not body.supports.nodes.size:
            return self.solver.solve(self.b, w)
        b, free = self._free
        w.take(body.free, 0, free, "clip")
        if held.any():
            w[body.free] = 0.0
            w[body.supports.nodes] = held
            self.b -= body.pattern.multiply(self.A, w, self.f)
        self.b.take(body.free, 0, b, "clip")
        work = self.solver.solve(b, free)
        w[body.free] = free
        w[body.supports.nodes] = held
        return work

    def _solve_guided(self, held: Floats, guided: Floats, w: Floats) -> Work:
        """Do the same with guides: their components have equations of their own, A_cc w_c = A_cc guided_c."""
        body, cut = self.body, self.body.guide_cut
        assert cut is not None
        b, free = self._free
        w.take(body.free, 0, free, "clip")
        if held.any() or guided.any():
            w[body.free] = 0.0
            w[body.supports.nodes] = held
            w.reshape(-1)[cut.components] = guided
            cut.undo(self.A, self._cut)
            self.b -= body.pattern.multiply(self.A, w, self.f)
            cut.apply(self.A)
        self.b.take(body.free, 0, b, "clip")
        free[cut.is_held] = guided
        b[cut.is_held] = guided * self.A.reshape(-1)[cut.diagonal]
        work = self.solver.solve(b, free)
        w[body.free] = free
        w[body.supports.nodes] = held
        w.reshape(-1)[cut.components] = guided
        return work


class Prefactored:
    """The constant tangent of the linear law: M + h^2 K is factored once."""

    chooses_model: ClassVar[bool] = False

    def __init__(self, body: Body, solver: LinearSolver, h: float) -> None:
        self.body = body
        self.system = StageSystem(body, solver)
        self._held = np.empty((len(body.supports.nodes), body.mesh.dimension))
        if self.system.damping is not None:
            self.system.damping.freeze(body.mesh.points, h)
        self._setup: Work | None = self.system.linearize(body.mesh.points, h)

    def solve(self, stage: Stage) -> tuple[Floats, Floats, StepReport]:
        """Return x and v from the one linear system; the linearization at x_h is exact."""
        body, system = self.body, self.system
        b = body.momentum(stage.v_h, system.b)
        f = body.force(stage.x_h, out=system.f)
        f += stage.load
        f *= stage.h
        b += f
        v = stage.v_h.copy()
        held, guided = _find_held_velocity(stage, stage.x_h, body, self._held)
        work = system.solve(held, v, guided)
        work.iterations += 1
        if self._setup is not None:
            work, self._setup = work + self._setup, None
        return advance(body, stage, v), v, StepReport(work)


class FrozenPasses:
    """A fixed number of solves, each with the rotations at the positions from which it starts."""

    chooses_model: ClassVar[bool] = False

    def __init__(self, body: Body, solver: LinearSolver, passes: int) -> None:
        self.body = body
        self.system = StageSystem(body, solver)
        self.passes = passes
        self._x, self._v_star, self._away = np.empty((3, *body.mesh.points.shape))
        self._held = np.empty((len(body.supports.nodes), body.mesh.dimension))

    def solve(self, stage: Stage) -> tuple[Floats, Floats, StepReport]:
        """Return x and v after the last pass."""
        v = stage.v_h.copy()
        self.system.freeze_damping(stage, at_start=True)
        work = self.run_pass(stage.start, stage, v, stage.R, at_x_h=stage.starts_at_x_n)
        if self.passes > 1 and stage.starts_at_x_n:
            self.system.freeze_damping(stage, at_start=False)
        for _ in range(self.passes - 1):
            work += self.run_pass(advance(self.body, stage, v, out=self._x), stage, v, at_x_h=False)
        return advance(self.body, stage, v), v, StepReport(work)

    def run_pass(self, x: Floats, stage: Stage, v: Floats, R: Floats | None = None, *, at_x_h: bool) -> Work:
        """Write the solution linearized at x (n, d), with its rotations or R, into v, which enters as the guess.

        `at_x_h` says that x is x_h: then v* is zero, and nothing is subtracted. The damping is frozen.
        """
        body, h, system = self.body, stage.h, self.system
        work = system.linearize(x, h, R)
        held, guided = _find_held_velocity(stage, x, body, self._held)
        away = stage.v_h
        if not at_x_h:
            np.subtract(x, stage.x_h, out=self._v_star)
            self._v_star /= h
            away = np.subtract(away, self._v_star, out=self._away)
            v -= self._v_star
        b = body.momentum(away, system.b)
        system.f += stage.load
        system.f *= h
        b += system.f
        if not at_x_h and system.damping is not None:
            b -= system.damping.multiply(self._v_star)
        work += system.solve(held, v, guided)
        work.iterations += 1
        work.rotations += 1
        if not at_x_h:
            v += self._v_star
        return work


def _find_held_velocity(stage: Stage, x: Floats, body: Body, out: Floats) -> tuple[Floats, Floats | None]:
    """Return the velocities that take held nodes (k, d), in out, and components (c,) from x (n, d) to the stage's end.

    Without guides the second are None.
    """
    x.take(body.supports.nodes, 0, out, "clip")
    np.subtract(stage.held, out, out=out)
    out /= stage.h
    if stage.guided is None or body.supports.guides is None:
        return out, None
    return out, (stage.guided - x.reshape(-1)[body.supports.guides.components]) / stage.h
