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

from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.laws import Tangent
from pipeline.mesh.simplex import Floats
from pipeline.stepping.implicit import Stage, StageSystem
from pipeline.stepping.linear_solve import LinearSolver
from pipeline.stepping.state import Work

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


@dataclass(frozen=True, eq=False)
class _Descent:
    """How one attempt ended: x (n, d), phi [J], the residual over its scale [1], and the work."""

    x: Floats
    phi: float
    residual: float
    converged: bool
    work: Work


class Converged:
    """Solves stages to a residual tolerance."""

    def __init__(self, body: Body, solver: LinearSolver, limits: NewtonLimits) -> None:
        self.body = body
        self.limits = limits
        self.system = StageSystem(body, solver)
        m = body.material
        # a force that strain of one would make: what rounding is measured by
        self._stiff = (2 * m.mu + abs(m.lam)) * body.mesh.rest_volumes.max() ** (
            (body.mesh.dimension - 1) / body.mesh.dimension
        )
        # the energy of a strain of one everywhere [J], and the strain that rounded positions make
        self._full = (2 * m.mu + abs(m.lam)) * float(body.mesh.rest_volumes.sum())
        steepest = float(np.abs(body.mesh.shape_gradients).max())
        self._rounded_strain = float(np.finfo(np.float64).eps * np.abs(body.mesh.points).max()) * steepest

    def solve(self, stage: Stage) -> tuple[Floats, Work]:
        """Return v at the minimum of phi; raises SolveError with the residual where the limit is reached."""
        predictor = self._held(stage.x_h + stage.h * stage.v_h, stage)
        first = self.descend(predictor, stage, min(_PREDICTOR_ITERATIONS, self.limits.iterations))
        safe = self._held(stage.start, stage)
        if first.converged and first.phi <= self.potential(safe, stage) + abs(first.phi) * 1e-12:
            return (first.x - stage.x_h) / stage.h, first.work
        found = self.descend(safe, stage, self.limits.iterations)
        work = first.work + found.work
        if not found.converged:
            raise self._failure(found)
        return (found.x - stage.x_h) / stage.h, work

    def _failure(self, found: _Descent) -> SolveError:
        count = found.work.iterations
        said = f"Newton did not reach {self.limits.tolerance:g} in {count} iterations (residual {found.residual:.2g}); "
        if count < self.limits.iterations:
            said += (
                "no step lowers the energy further, as where inverted cells are stretched to several times their size"
            )
            return SolveError(f"{said}: try a smaller schedule.dt or a stiffer body")
        return SolveError(f"{said}try a smaller schedule.dt or a larger method.max_iterations")

    def potential(self, x: Floats, stage: Stage) -> float:
        """Return phi(x) [J]."""
        return float(sum(self._terms(x, stage)))

    def _terms(self, x: Floats, stage: Stage) -> tuple[float, float, float]:
        away = x - (stage.x_h + stage.h * stage.v_h)
        inertia = (away * self.body.momentum(away)).sum() / (2 * stage.h**2)
        return float(inertia), self.body.energy(x), -float((self.body.load * (x - self.body.mesh.points)).sum())

    def descend(self, x: Floats, stage: Stage, limit: int) -> _Descent:
        """Return where at most `limit` iterations from x lead."""
        phi, work = self.potential(x, stage), Work()
        for iteration in range(limit + 1):
            r, relative = self._residual(x, self.body.force(x), stage)
            if relative <= self.limits.tolerance or iteration == limit or not np.isfinite(relative):
                break
            dx, solved = self._direction(x, r, relative, stage)
            x, phi, moved = self._search(x, dx, phi, -float((r * dx).sum()), stage)
            work += solved + Work(iterations=1, rotations=1)
            if not moved:
                break
        return _Descent(x, phi, relative, relative <= self.limits.tolerance, work)

    def _held(self, x: Floats, stage: Stage) -> Floats:
        out = x.copy()
        out[self.body.supports.nodes] = stage.held
        return out

    def _residual(self, x: Floats, f: Floats, stage: Stage) -> tuple[Floats, float]:
        """Return -grad phi (n, d) [N], zero on held nodes, and its norm over that of the forces in it."""
        body = self.body
        momentum = body.momentum((x - stage.x_h) / stage.h - stage.v_h)
        r = body.load + f - momentum / stage.h
        r[body.supports.nodes] = 0.0
        size = np.linalg.norm(body.momentum(stage.v_h)) / stage.h + np.linalg.norm(body.load) + np.linalg.norm(f)
        floor = _ROUNDING / self.limits.tolerance * self._stiff * np.sqrt(x.size)
        return r, float(np.linalg.norm(r) / max(size, floor))

    def _direction(self, x: Floats, r: Floats, relative: float, stage: Stage) -> tuple[Floats, Work]:
        """Return the Newton step dx (n, d), by the exact tangent near the end where that is positive definite."""
        kind = self.limits.tangent
        if kind == "projected" and relative < _NEAR:
            try:
                dx, work = self._solved(x, r, "exact", stage)
            except SolveError:  # a Cholesky factor says so; others give a direction that does not descend
                dx, work = np.zeros_like(r), Work(factorisations=1)
            if (r * dx).sum() > 0:
                return dx, work
            dx, again = self._solved(x, r, kind, stage)
            return dx, work + again
        return self._solved(x, r, kind, stage)

    def _solved(self, x: Floats, r: Floats, kind: Tangent, stage: Stage) -> tuple[Floats, Work]:
        """Return dx (n, d) with (M/h^2 + K) dx = r on the free nodes."""
        work = self.system.linearise(x, stage.h, kind=kind)
        dx = np.zeros_like(r)
        np.multiply(r, stage.h**2, out=self.system.b)
        return dx, work + self.system.solve(dx[self.body.supports.nodes], dx)

    def _search(self, x: Floats, dx: Floats, phi: float, slope: float, stage: Stage) -> tuple[Floats, float, bool]:
        """Return x + s dx with the first s of 1, 1/2, … that lowers phi enough, its phi, and whether there was one."""
        # at the solution phi no longer changes in its digits; a step that promises less than those is taken whole
        noise = self._noise(self._terms(x, stage))
        s = 1.0
        while s >= _SHORTEST:
            trial = x + s * dx
            value = self.potential(trial, stage)
            if value <= phi + _SUFFICIENT * s * min(slope, 0.0) + noise:
                return trial, value, True
            s /= 2
        return x, phi, False

    def _noise(self, terms: tuple[float, float, float]) -> float:
        """Return the part of phi [J] that is rounding, from its terms.

        Near the rest shape W loses more digits than any sum does: half of full e^2, it changes by full e de with the
        strain de that rounded positions make. Without that part the search would halve good steps, over and over.
        """
        elastic = max(terms[1], 0.0)  # rounding may leave it a little below
        return _DIGITS * sum(map(abs, terms)) + float(np.sqrt(2 * elastic * self._full)) * self._rounded_strain
