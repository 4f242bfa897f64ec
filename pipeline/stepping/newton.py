r"""The converged stage: Newton's method on the incremental potential, with backtracking.

    phi(x) = |x - y|_M^2 / (2 h^2) + W(x) - f_ext . x,    y = x_h + h v_h,    supported nodes given
    grad phi = M (x - y) / h^2 + grad W - f_ext,          v = (x - x_h) / h

Its minimum is the stage's solution. From x_n every accepted iterate lowers phi, so the energy after a step of
backward Euler is bounded by the energy before it. From the predictor y it takes 3 to 4 iterations where it converges,
so that is tried first and kept only if it ends no higher than phi(x_n).

tangent = "projected" always descends, and near the end, where it would converge linearly in compression, gives way to
the exact one; "exact" converges quadratically but may not descend in compression;
"frozen" (K' of the thesis) converges linearly. The last two are there to be studied.

Where an inverted cell is stretched so far that tr S > d + 2 mu/lam, W has a convex crease; a minimum on it has no
vanishing gradient, and is an error.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.laws import Tangent
from pipeline.linear.choice import LinearSolver
from pipeline.linear.work import Work
from pipeline.stepping.stage import Stage, StageSystem, reached

_PREDICTOR_ITERATIONS = 30  # where the predictor is good it needs 3 to 6, in fast spin about a generic axis 16 to 30
_NEAR = 1e-2  # of the forces: from here the exact tangent is tried
_SUFFICIENT = 1e-4  # Armijo: the part of the predicted decrease that a step must bring
_SHORTEST = 2.0**-30  # a shorter step is lost in the rounding of phi
# forces cancel to rounding, about 1e-16 of the stiffest cell's force per unit strain, summed over some cells
_ROUNDING = 1e-13
_DIGITS = 1e-13  # of phi: its terms cancel, and each is a sum over cells


@dataclass(frozen=True)
class NewtonLimits:
    """Where the iteration stops: residual over the forces' size [1], iterations, and which tangent it uses."""

    tolerance: float
    iterations: int
    tangent: Tangent = "projected"


_Terms = tuple[float, float, float]  # of phi [J]: inertia, elastic energy, loads


@dataclass(frozen=True, eq=False)
class _Descent:
    """How one attempt ended: x (n, d), phi [J], the residual over its scale [1], and the work."""

    x: Floats
    phi: float
    residual: float
    converged: bool
    work: Work


class Converged:
    """Solves stages to a residual tolerance, in room made once."""

    def __init__(self, body: Body, solver: LinearSolver, limits: NewtonLimits) -> None:
        self.body = body
        self.limits = limits
        self.system = StageSystem(body, solver)
        m, X = body.material, body.mesh.points
        # a force that strain of one would make: what rounding is measured by
        self._stiff = (2 * m.mu + abs(m.lam)) * body.mesh.rest_volumes.max() ** (
            (body.mesh.dimension - 1) / body.mesh.dimension
        )
        # the energy of a strain of one everywhere [J], and the strain that rounded positions make
        self._full = (2 * m.mu + abs(m.lam)) * float(body.mesh.rest_volumes.sum())
        steepest = float(np.abs(body.mesh.shape_gradients).max())
        self._rounded_strain = float(np.finfo(np.float64).eps * np.abs(X).max()) * steepest
        # where the iteration is, where it might go; y, -grad phi, dx, and scratch for two vectors
        self._x, self._trial = np.empty((2, *X.shape))
        self._y, self._r, self._dx, self._away, self._Ma = np.empty((5, *X.shape))
        self._stage: Stage | None = None
        self._given = 0.0  # the size of the forces that a stage brings

    def solve(self, stage: Stage) -> tuple[Floats, Floats, Work]:
        """Return x and v at the minimum of phi; raises SolveError with the residual where the limit is reached."""
        self._take(stage)
        first = self.descend(self._y, stage, min(_PREDICTOR_ITERATIONS, self.limits.iterations))
        if first.converged:
            safe = self._hold(stage.start, stage, self._trial)
            if first.phi <= sum(self._terms(safe, stage)) + abs(first.phi) * 1e-12:
                return *self._found(first.x, stage), first.work
        found = self.descend(stage.start, stage, self.limits.iterations)
        work = first.work + found.work
        if not found.converged:
            raise self._failure(found)
        return *self._found(found.x, stage), work

    def _found(self, x: Floats, stage: Stage) -> tuple[Floats, Floats]:
        v = np.subtract(x, stage.x_h)
        v /= stage.h
        return reached(self.body, stage, v), v

    def _take(self, stage: Stage) -> None:
        """Find y, and the size of the forces that do not change in the stage."""
        self._stage = stage
        np.multiply(stage.v_h, stage.h, out=self._y)
        self._y += stage.x_h
        inertia = _norm(self.body.momentum(stage.v_h, self._Ma)) / stage.h
        self._given = inertia + _norm(stage.load)

    def _failure(self, found: _Descent) -> SolveError:
        count = found.work.iterations
        said = f"Newton did not reach {self.limits.tolerance:g} in {count} iterations (residual {found.residual:.2g}); "
        if count < self.limits.iterations:
            said += (
                "no step lowers the energy further, as where inverted cells are stretched to several times their size"
            )
            return SolveError(f"{said}: try a smaller schedule.dt or a stiffer body")
        return SolveError(f"{said}try a smaller schedule.dt or a larger method.max_iterations")

    def _terms(self, x: Floats, stage: Stage) -> _Terms:
        """Return the terms of phi(x) [J]."""
        np.subtract(x, self._y, out=self._away)
        inertia = float(np.vdot(self._away, self.body.momentum(self._away, self._Ma))) / (2 * stage.h**2)
        np.subtract(x, self.body.mesh.points, out=self._away)
        return inertia, self.body.energy(x), -float(np.vdot(stage.load, self._away))

    def descend(self, start: Floats, stage: Stage, limit: int) -> _Descent:
        """Return where at most `limit` iterations from start (n, d) lead; the next descent overwrites its x."""
        if stage is not self._stage:
            self._take(stage)
        self._hold(start, stage, self._x)
        terms, work = self._terms(self._x, stage), Work()
        for iteration in range(limit + 1):
            relative = self._residual(stage)
            if relative <= self.limits.tolerance or iteration == limit or not np.isfinite(relative):
                break
            work += self._direction(relative, stage) + Work(iterations=1, rotations=1)
            before, terms = terms, self._search(terms, -float(np.vdot(self._r, self._dx)), stage)
            if terms is before:
                break
        return _Descent(self._x, sum(terms), relative, relative <= self.limits.tolerance, work)

    def _hold(self, x: Floats, stage: Stage, out: Floats) -> Floats:
        """Copy x into out, the held nodes to where the stage has them, and return it."""
        np.copyto(out, x)
        out[self.body.supports.nodes] = stage.held
        return out

    def _residual(self, stage: Stage) -> float:
        """Write -grad phi at x into r (n, d) [N], zero on held nodes; return its norm over that of the forces in it."""
        body, r = self.body, self._r
        body.force(self._x, out=r)
        size = self._given + _norm(r)
        np.subtract(self._x, self._y, out=self._away)
        body.momentum(self._away, self._Ma)
        self._Ma /= stage.h**2
        r += stage.load
        r -= self._Ma
        r[body.supports.nodes] = 0.0
        floor = _ROUNDING / self.limits.tolerance * self._stiff * np.sqrt(r.size)
        return _norm(r) / max(size, floor)

    def _direction(self, relative: float, stage: Stage) -> Work:
        """Find the Newton step dx (n, d), by the exact tangent near the end where that is positive definite."""
        kind = self.limits.tangent
        if kind != "projected" or relative >= _NEAR:
            return self._solved(kind, stage)
        try:
            work = self._solved("exact", stage)
        except SolveError:  # a Cholesky factor says so; others give a direction that does not descend
            return Work(factorisations=1) + self._solved(kind, stage)
        if np.vdot(self._r, self._dx) > 0:
            return work
        return work + self._solved(kind, stage)

    def _solved(self, kind: Tangent, stage: Stage) -> Work:
        """Make (M/h^2 + K) dx = r on the free nodes."""
        work = self.system.linearise(self._x, stage.h, kind=kind)
        np.multiply(self._r, stage.h**2, out=self.system.b)
        self._dx[:] = 0.0
        return work + self.system.solve(self._dx[self.body.supports.nodes], self._dx)

    def _search(self, terms: _Terms, slope: float, stage: Stage) -> _Terms:
        """Move x to x + s dx with the first s of 1, 1/2, … that lowers phi enough; return its terms, or those given.

        They are the given ones, and x stays, where there is no such s.
        """
        # at the solution phi no longer changes in its digits; a step that promises less than those is taken whole
        phi, noise, s = sum(terms), self._noise(terms), 1.0
        while s >= _SHORTEST:
            np.multiply(self._dx, s, out=self._trial)
            self._trial += self._x
            found = self._terms(self._trial, stage)
            if sum(found) <= phi + _SUFFICIENT * s * min(slope, 0.0) + noise:
                self._x, self._trial = self._trial, self._x
                return found
            s /= 2
        return terms

    def _noise(self, terms: _Terms) -> float:
        """Return the part of phi [J] that is rounding, from its terms.

        Near the rest shape W loses more digits than any sum does: half of full e^2, it changes by full e de with the
        strain de that rounded positions make. Without that part the search would halve good steps, over and over.
        """
        elastic = max(terms[1], 0.0)  # rounding may leave it a little below
        return _DIGITS * sum(map(abs, terms)) + float(np.sqrt(2 * elastic * self._full)) * self._rounded_strain


def _norm(a: Floats) -> float:
    return float(np.sqrt(np.vdot(a, a)))
