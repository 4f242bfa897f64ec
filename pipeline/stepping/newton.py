r"""The converged stage: Newton's method on the incremental potential, with backtracking.

    phi(x) = |x - y|_M^2 / (2 h^2) + W(x) - f_ext . x,    y = x_h + h v_h,    supported nodes prescribed
    grad phi = M (x - y) / h^2 + grad W - f_ext,          v = (x - x_h) / h

A damped body adds the dissipation (x - x_h) . C (x - x_h) / (2 h) to phi and C v to grad phi (damping.py).

Its minimum is the stage's solution. From x_n every accepted iterate lowers phi, so the energy after a step of
backward Euler is bounded by the energy before it. From the predictor y Newton's method usually takes 3 to 4 iterations,
so y is tried first; the result is accepted only if it converged and phi is no higher than phi(x_n).

An iteration:  solve (M/h^2 + K) dx = -grad phi,  then x += s dx with the first s of 1, 1/2, 1/4, … that lowers phi
enough (Armijo). It stops at  |grad phi| <= tolerance (|M v_h|/h + |f_ext| + |f_el| + a rounding floor).

tangent = "projected" always descends; in compression it converges linearly, so near the end the exact one replaces it.
"exact" converges quadratically but may not descend in compression; "frozen" (K' of the thesis) converges linearly.
The last two are for studies.

If an inverted cell is stretched so far that tr S > d + 2 mu/lam, W has a convex crease; at a minimum on it the
gradient does not vanish, and the solve raises an error.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.laws import Tangent
from pipeline.fem.material import integrate_values
from pipeline.linear.solver import LinearSolver
from pipeline.linear.work import Work
from pipeline.stepping.report import StepReport
from pipeline.stepping.stage import Stage, StageSystem, advance, hold

_PREDICTOR_ITERATIONS = 30  # a good predictor needs 3 to 6, in fast spin about a generic axis 16 to 30
_NEAR = 1e-2  # of the forces: from here the exact tangent is tried
_SUFFICIENT = 1e-4  # Armijo: the part of the predicted decrease that a step must bring
_SHORTEST = 2.0**-30  # a shorter step changes phi by less than its rounding
# forces cancel to rounding, about 1e-16 of the stiffest cell's force per unit strain, summed over some cells
_ROUNDING = 1e-13
_DIGITS = 1e-13  # of phi: its terms cancel, and each is a sum over cells
_SAME_PHI = 1e-12  # relative: two values of phi that differ by less are equal to rounding


@dataclass(frozen=True)
class NewtonLimits:
    """The residual over the forces' size [1] and the number of iterations at which to stop, and the tangent to use."""

    tolerance: float
    iterations: int
    tangent: Tangent = "projected"


_Terms = tuple[float, float, float, float]  # of phi [J]: inertia, elastic energy, loads, dissipation


@dataclass(frozen=True, eq=False)
class _Descent:
    """The outcome of one attempt: x (n, d), phi [J], the residual over its scale [1], and the work."""

    x: Floats
    phi: float
    residual: float
    converged: bool
    work: Work


class Converged:
    """Solves stages to a residual tolerance, in buffers allocated once."""

    chooses_model: ClassVar[bool] = False

    def __init__(self, body: Body, solver: LinearSolver, limits: NewtonLimits) -> None:
        self.body = body
        self.limits = limits
        self.system = StageSystem(body, solver)
        m, X = body.material, body.mesh.points
        # the force of a unit strain, the scale of rounding
        modulus, V, d = 2 * m.mu + np.abs(m.lam), body.mesh.rest_volumes, body.mesh.dimension
        self._stiff = float(np.max(modulus)) * V.max() ** ((d - 1) / d)
        # the energy of a unit strain everywhere [J], and the strain that rounding of positions causes
        self._full = integrate_values(modulus, V)
        # rates of strain count as strains if a body is damped
        self._rate = 0.0 if body.damping is None else body.damping.stiffness
        steepest = float(np.abs(body.mesh.integration.gradients).max())
        self._steepest = steepest
        self._rounded_strain = float(np.finfo(np.float64).eps * np.abs(X).max()) * steepest
        # the iterate and a trial of the next one; y, -grad phi, dx, and scratch for two vectors
        self._x, self._trial = np.empty((2, *X.shape))
        self._y, self._r, self._dx, self._away, self._Ma = np.empty((5, *X.shape))
        self._constant_forces = 0.0  # the size [N] of the forces that do not depend on x

    def solve(self, stage: Stage) -> tuple[Floats, Floats, StepReport]:
        """Return x and v at the minimum of phi; raises SolveError that names the residual at the iteration limit."""
        self._begin(stage)
        end = self._descend(self._y, stage, min(_PREDICTOR_ITERATIONS, self.limits.iterations))
        work = end.work
        if not (end.converged and end.phi <= self._phi_before(stage) + abs(end.phi) * _SAME_PHI):
            end = self._descend(stage.start, stage, self.limits.iterations)
            work = work + end.work
        if not end.converged:
            raise self._make_error(end)
        v = np.subtract(end.x, stage.x_h)
        v /= stage.h
        return advance(self.body, stage, v), v, StepReport(work)

    def descend(self, start: Floats, stage: Stage, limit: int) -> _Descent:
        """Return the outcome of at most `limit` iterations from start (n, d); the next descent overwrites its x."""
        self._begin(stage)
        return self._descend(start, stage, limit)

    def _phi_before(self, stage: Stage) -> float:
        return sum(self._terms(self._hold(stage.start, stage, self._trial), stage))

    def _begin(self, stage: Stage) -> None:
        """Freeze the damping, compute y, and the size of the forces that do not change in the stage."""
        self.system.freeze_damping(stage, at_start=False)
        np.multiply(stage.v_h, stage.h, out=self._y)
        self._y += stage.x_h
        inertia = _norm(self.body.momentum(stage.v_h, self._Ma)) / stage.h
        self._constant_forces = inertia + _norm(stage.load)

    def _make_error(self, end: _Descent) -> SolveError:
        tolerance, count = self.limits.tolerance, end.work.iterations
        text = f"Newton did not reach {tolerance:g} in {count} iterations (residual {end.residual:.2g}); "
        if count >= self.limits.iterations:
            return SolveError(f"{text}try a smaller schedule.dt or a larger method.max_iterations")
        reason = "no step lowers the energy further, as with inverted cells stretched to several times their size"
        return SolveError(f"{text}{reason}; try a smaller schedule.dt or a stiffer body")

    def _terms(self, x: Floats, stage: Stage) -> _Terms:
        """Return the terms of phi(x) [J]."""
        np.subtract(x, self._y, out=self._away)
        inertia = float(np.vdot(self._away, self.body.momentum(self._away, self._Ma))) / (2 * stage.h**2)
        np.subtract(x, self.body.mesh.points, out=self._away)
        loads = -float(np.vdot(stage.load, self._away))
        if self.system.damping is None:
            return inertia, self.body.energy(x), loads, 0.0
        np.subtract(x, stage.x_h, out=self._away)
        dissipation = float(np.vdot(self._away, self.system.damping.multiply(self._away))) / (2 * stage.h**2)
        return inertia, self.body.energy(x), loads, dissipation

    def _descend(self, start: Floats, stage: Stage, limit: int) -> _Descent:
        self._hold(start, stage, self._x)
        terms, work = self._terms(self._x, stage), Work()
        for iteration in range(limit + 1):
            relative = self._residual(stage)
            if relative <= self.limits.tolerance or iteration == limit or not np.isfinite(relative):
                break
            work += self._find_direction(relative, stage) + Work(iterations=1, rotations=1)
            lower = self._search(terms, -float(np.vdot(self._r, self._dx)), stage)
            if lower is None:
                break
            terms = lower
        return _Descent(self._x, sum(terms), relative, relative <= self.limits.tolerance, work)

    def _hold(self, x: Floats, stage: Stage, out: Floats) -> Floats:
        """Return x, in `out`, with the held nodes where the stage holds them."""
        np.copyto(out, x)
        return hold(self.body, stage, out)

    def _residual(self, stage: Stage) -> float:
        """Write -grad phi at x into r (n, d) [N], zero on held nodes; return its norm over the size of its forces."""
        body, r = self.body, self._r
        body.force(self._x, out=r)
        size = self._constant_forces + _norm(r)
        np.subtract(self._x, self._y, out=self._away)
        body.momentum(self._away, self._Ma)
        self._Ma /= stage.h**2
        r += stage.load
        r -= self._Ma
        if self.system.damping is not None:
            size += self._subtract_damping(stage)
        r[body.supports.nodes] = 0.0
        if body.supports.guides is not None:
            r.reshape(-1)[body.supports.guides.components] = 0.0
        stiff = self._stiff
        if body.damping is not None:  # differences of positions lose digits, in C v as in strains
            drag = body.damping.mass * float(body.lumped_mass.max()) * _find_largest(self._x)
            stiff = stiff * (1 + self._rate / stage.h) + drag / stage.h
        floor = _ROUNDING / self.limits.tolerance * stiff * np.sqrt(r.size)
        return _norm(r) / max(size, floor)

    def _subtract_damping(self, stage: Stage) -> float:
        """Subtract C v from r (n, d) [N]; return the size of C v."""
        assert self.system.damping is not None
        np.subtract(self._x, stage.x_h, out=self._away)
        impulse = self.system.damping.multiply(self._away)
        impulse /= stage.h**2
        self._r -= impulse
        return _norm(impulse)

    def _find_direction(self, relative: float, stage: Stage) -> Work:
        """Compute the Newton step dx (n, d); near the end with the exact tangent if that is positive definite."""
        kind = self.limits.tangent
        if kind != "projected" or relative >= _NEAR:
            return self._solve_for_dx(kind, stage)
        try:
            work = self._solve_for_dx("exact", stage)
        except SolveError:  # Cholesky found it indefinite; other solvers return a direction that does not descend
            return Work(factorizations=1) + self._solve_for_dx(kind, stage)
        if np.vdot(self._r, self._dx) > 0:
            return work
        return work + self._solve_for_dx(kind, stage)

    def _solve_for_dx(self, kind: Tangent, stage: Stage) -> Work:
        """Solve (M/h^2 + K) dx = r on the free nodes."""
        work = self.system.linearize(self._x, stage.h, kind=kind)
        np.multiply(self._r, stage.h**2, out=self.system.b)
        self._dx[:] = 0.0
        guides = self.body.supports.guides
        guided = None if guides is None else np.zeros(len(guides.components))
        return work + self.system.solve(self._dx[self.body.supports.nodes], self._dx, guided)

    def _search(self, terms: _Terms, slope: float, stage: Stage) -> _Terms | None:
        """Move x to x + s dx with the first s of 1, 1/2, … that lowers phi enough; return the terms of phi there.

        If there is no such s, x stays as it is and None is returned.
        """
        # at the solution phi changes by less than its rounding; a step that promises less than that is taken whole
        phi, noise, s = sum(terms), self._noise(terms, stage), 1.0
        while s >= _SHORTEST:
            np.multiply(self._dx, s, out=self._trial)
            self._trial += self._x
            trial = self._terms(self._trial, stage)
            if sum(trial) <= phi + _SUFFICIENT * s * min(slope, 0.0) + noise:
                self._x, self._trial = self._trial, self._x
                return trial
            s /= 2
        return None

    def _noise(self, terms: _Terms, stage: Stage) -> float:
        """Return the part of phi [J] that is rounding, from its terms.

        Near the rest shape W loses more digits than a sum does: W = full e^2 / 2 changes by full e de with the strain
        de that rounding of positions causes. Without that part the search would halve good steps over and over.
        """
        elastic = max(terms[1], 0.0)  # rounding may leave it slightly negative
        lost = float(np.sqrt(2 * elastic * self._full))
        noise = _DIGITS * sum(map(abs, terms)) + lost * self._rounded_strain
        if not self._rate:
            return noise
        # the dissipation is a sum over differences of displacements, most of which may be rigid
        turned = _find_largest(np.subtract(self._x, stage.x_h, out=self._away)) * self._steepest
        return noise + float(np.finfo(np.float64).eps) * turned**2 * self._full * self._rate / stage.h


def _find_largest(a: Floats) -> float:
    """Return the largest absolute value."""
    return float(max(a.max(), -a.min()))


def _norm(a: Floats) -> float:
    return float(np.sqrt(np.vdot(a, a)))
