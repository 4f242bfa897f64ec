"""The energy guard: stops a method that blows up while its numbers are still finite.

Kinetic + elastic energy above 10 x (its start + |work of loads and supports| so far, at least a natural scale) after
three steps in a row is a SolveError. The elastic part costs a pass over the cells, so it is looked at only where the
kinetic part alone exceeds a tenth of that bound: what blows up, moves.
"""

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.linear.work import Work
from pipeline.stepping.state import State, Stepper

_FACTOR = 10.0
_STRIKES = 3
# the energy of a uniform strain of about 1e-5: motions below it are rounding and noise to a user
_NATURAL_STRAIN = 1e-5


class EnergyGuard:
    """A stepper that watches another; `guard` in memory is (energy at the start, |work of supports|, strikes)."""

    def __init__(self, body: Body, stepper: Stepper, from_rung: int = 0) -> None:
        """Watch steps of this rung and those above; the energy of others is bounded by construction."""
        self.body = body
        self.stepper = stepper
        if body.supports.motions:  # their work asks for forces, whose kernel is compiled, or loaded, here
            body.rehearse(solves=False)
        self._from_rung = from_rung
        self._least = natural_energy(body)
        self._room = np.empty((2, *body.mesh.points.shape))
        # the loads that vary have no potential: their work is counted in every step instead
        self._load_at_rest = float(np.vdot(body.load, body.mesh.points))
        # v . M v is largest with lumped masses: in a cell, where M = rho V (1 + delta) / ((d + 1) (d + 2)), that is so
        self._lumped = np.repeat(body.lumped_mass, body.mesh.dimension)

    @property
    def dt(self) -> float:
        """Return the step's size [s]."""
        return self.stepper.dt

    def step(self, state: State) -> tuple[State, Work]:
        """Return the state dt later; raises SolveError where the energy has no source."""
        guard = state.memory["guard"] if "guard" in state.memory else np.array([self._energy(state), 0.0, 0.0])
        new, work = self.stepper.step(state)
        supplied = supports_work(self.body, state, new, self.dt, room=self._room)
        supplied += varying_load_work(self.body, state, new, self.dt)
        if work.rung >= self._from_rung or supplied or guard[2]:
            guard = self._judged(new, guard, supplied, watched=work.rung >= self._from_rung)
        return State(new.step, new.x, new.v, {**new.memory, "guard": guard}), work

    def _judged(self, new: State, guard: Floats, work_of_supports: float, *, watched: bool) -> Floats:
        """Return the guard's numbers after a step; raises SolveError at the third strike."""
        start, supplied, strikes = guard.tolist()
        supplied += work_of_supports
        brought = start + supplied
        if not watched or self._kinetic_bound(new) <= max(brought, self._least):
            return guard if supplied == guard[1] and not strikes else np.array([start, supplied, 0.0])
        bound = max(brought + self._from_loads(new), self._least)
        strikes = strikes + 1 if self._exceeds(new, bound) else 0.0
        if strikes >= _STRIKES:
            raise SolveError(
                f"the energy has no source: {self._inner(new):.3g} J, more than {_FACTOR:g} x the "
                f"{bound:.3g} J that start, loads and supports brought; try a smaller schedule.dt than {self.dt:g}, "
                f'or method.iterations = "converged"'
            )
        return np.array([start, supplied, strikes])

    def _exceeds(self, state: State, bound: float) -> bool:
        """Return whether kinetic + elastic energy is above what the guard allows, by the cheapest way to tell."""
        return self._kinetic(state) > bound and self._inner(state) > _FACTOR * bound

    def _kinetic_bound(self, state: State) -> float:
        return 0.5 * float(np.vdot(self._lumped, np.square(state.v, out=self._room[0])))

    def _kinetic(self, state: State) -> float:
        return 0.5 * float(np.vdot(state.v, self.body.momentum(state.v, self._room[0])))

    def _inner(self, state: State) -> float:
        return self._kinetic(state) + self.body.energy(state.x)

    def _from_loads(self, state: State) -> float:
        return abs(float(np.vdot(self.body.load, state.x)) - self._load_at_rest)

    def _energy(self, state: State) -> float:
        return self._inner(state) + self._from_loads(state)


def natural_energy(body: Body) -> float:
    """Return the energy [J] below which a motion is rounding and noise to a user."""
    m = body.material
    return _NATURAL_STRAIN**2 * (m.lam + 2 * m.mu) * float(body.mesh.rest_volumes.sum())


def varying_load_work(body: Body, old: State, new: State, dt: float) -> float:
    """Return |f . motion| of the loads that vary with time in a step [J]."""
    if body.varying_load is None:
        return 0.0
    return abs(float(np.vdot(body.varying_load(new.step * dt), new.x - old.x)))


def supports_work(body: Body, old: State, new: State, dt: float, *, room: Floats | None = None) -> float:
    """Return |reaction . motion| of the held nodes in a step [J], in `room` (2, n, d); 0 at once where none moves."""
    if not body.supports.motions:
        return 0.0
    held = body.supports.nodes
    moved = new.x[held] - old.x[held]
    if not moved.any():
        return 0.0
    gained, p = np.empty((2, *new.v.shape)) if room is None else room
    inertia = body.momentum(np.subtract(new.v, old.v, out=gained), p)[held] / dt
    reaction = inertia - body.force(new.x, out=p)[held] - body.load_at(new.step * dt)[held]
    return float(np.abs((reaction * moved).sum(axis=1)).sum())
