"""The energy guard: stops a method that blows up while its numbers are still finite.

It raises SolveError if, after each of three steps in a row, kinetic + elastic energy is above 10 x (its initial value
+ |work of loads and supports| so far, at least a natural scale). The elastic part costs a pass over the cells, so it is
computed only if the kinetic part alone exceeds a tenth of that bound: a body that blows up moves.
"""

from typing import Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.material import integrate_values
from pipeline.stepping.report import LINEAR, StepReport
from pipeline.stepping.state import EnergyRecord, Memory, State, Stepper

# calm scenes stay below this factor, or exceed it for a step or two; a method that blows up passes it within some tens
# of steps and stays above (tests/stepping/test_energy_guard.py)
_FACTOR = 10.0
_STRIKES = 3
# the energy of a uniform strain of about 1e-5: smaller motions are rounding noise to a user
_NATURAL_STRAIN = 1e-5


class EnergyGuard:
    """A stepper that watches another; it keeps an EnergyRecord in the state's memory.

    It does not watch steps that chose the linear model: their energy is bounded by construction.
    """

    def __init__(self, body: Body, stepper: Stepper) -> None:
        self.body = body
        self.stepper = stepper
        if body.supports.has_motions:  # their work needs forces, whose kernel is compiled or loaded here
            body.warm_up(solves=False)
        self._least = natural_energy(body)
        self._scratch = np.empty((2, *body.mesh.points.shape))
        # varying loads have no potential: their work is counted in every step instead
        self._load_at_rest = float(np.vdot(body.load, body.mesh.points))
        self._mass_bound = np.repeat(body.mass_bound, body.mesh.dimension)

    @property
    def dt(self) -> float:
        """Return the step's size [s]."""
        return self.stepper.dt

    @property
    def chooses_model(self) -> bool:
        """Return whether each step of the watched stepper chooses its own model."""
        return self.stepper.chooses_model

    def step(self, state: State) -> tuple[State, StepReport]:
        """Return the state dt later; raises SolveError if the energy grew without a source."""
        record = state.memory.energy
        if record is None:
            record = EnergyRecord(self._energy(state), 0.0, 0)
        new, report = self.stepper.step(state)
        watched = report.choice is None or report.choice.rung > LINEAR
        supplied = work_of_supports(self.body, state, new, self.dt, scratch=self._scratch)
        supplied += work_of_varying_load(self.body, state, new, self.dt)
        if watched or supplied or record.strikes:
            record = self._update(record, new, supplied, watched=watched)
        if record != new.memory.energy:
            new = State(new.step, new.x, new.v, Memory(new.memory.stepper, new.memory.inversion, record))
        return new, report

    def _update(self, record: EnergyRecord, new: State, work: float, *, watched: bool) -> EnergyRecord:
        """Return the record after a step that added `work` [J]; raises SolveError at the third strike."""
        start, supplied = record.start, record.supplied + work
        source = start + supplied
        if not watched or self._kinetic_bound(new) <= max(source, self._least):
            return EnergyRecord(start, supplied, 0)
        bound = max(source + self._work_of_loads(new), self._least)
        strikes = record.strikes + 1 if self._exceeds(new, bound) else 0
        if strikes >= _STRIKES:
            raise SolveError(
                f"the step is unstable: the energy grew to {self._internal(new):.3g} J, more than {_FACTOR:g} times "
                f"the {bound:.3g} J from initial state, loads and supports; try a smaller schedule.dt than "
                f'{self.dt:g}, or method.iterations = "converged"'
            )
        return EnergyRecord(start, supplied, strikes)

    def _exceeds(self, state: State, bound: float) -> bool:
        """Return whether kinetic + elastic energy is above the guard's limit; the cheap part is computed first."""
        return self._kinetic(state) > bound and self._internal(state) > _FACTOR * bound

    def _kinetic_bound(self, state: State) -> float:
        return 0.5 * float(np.vdot(self._mass_bound, np.square(state.v, out=self._scratch[0])))

    def _kinetic(self, state: State) -> float:
        return 0.5 * float(np.vdot(state.v, self.body.momentum(state.v, self._scratch[0])))

    def _internal(self, state: State) -> float:
        return self._kinetic(state) + self.body.energy(state.x)

    def _work_of_loads(self, state: State) -> float:
        return abs(float(np.vdot(self.body.load, state.x)) - self._load_at_rest)

    def _energy(self, state: State) -> float:
        return self._internal(state) + self._work_of_loads(state)


def natural_energy(body: Body) -> float:
    """Return the energy [J] below which a motion is rounding noise to a user."""
    modulus, volumes = body.material.wave_modulus, body.mesh.rest_volumes
    return integrate_values(_NATURAL_STRAIN**2 * modulus, volumes)


def work_of_varying_load(body: Body, old: State, new: State, dt: float) -> float:
    """Return |f . motion| of the loads that vary with time in a step [J], with the larger of f before and after it.

    A stepper takes one of the two: an explicit one the first, so that a push of one step does its work after its end.
    """
    if body.varying_load is None:
        return 0.0
    moved = new.x - old.x
    return max(abs(float(np.vdot(body.varying_load(step * dt), moved))) for step in (old.step, new.step))


def work_of_supports(body: Body, old: State, new: State, dt: float, *, scratch: Floats | None = None) -> float:
    """Return |reaction . motion| of the held nodes in a step [J]; `scratch` (2, n, d) is overwritten."""
    if not body.supports.has_motions:
        return 0.0
    held, guides = body.supports.nodes, body.supports.guides
    places: list[Any] = [held]
    if guides is not None:
        places.append(np.divmod(guides.components, body.mesh.dimension))
    moved = [new.x[place] - old.x[place] for place in places]
    if not any(part.any() for part in moved):
        return 0.0
    gained, p = np.empty((2, *new.v.shape)) if scratch is None else scratch
    body.momentum(np.subtract(new.v, old.v, out=gained), p)
    inertia = [p[place] / dt for place in places]
    if body.damping is not None:
        body.momentum(new.v, p)
        inertia = [rate + body.damping.mass * p[place] for rate, place in zip(inertia, places, strict=True)]
    body.damped_force(new.x, new.v, out=p)
    load, work = body.load_at(new.step * dt), 0.0
    for place, part, rate in zip(places, moved, inertia, strict=True):
        power = (rate - p[place] - load[place]) * part
        work += float(np.abs(power.sum(axis=1) if power.ndim > 1 else power).sum())
    return work
