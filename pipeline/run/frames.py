"""A run is an iterator of frames, which recording.py drives."""

import time
from collections.abc import Callable, Iterator

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.rotation import axial
from pipeline.linear.work import Work
from pipeline.problem.problem import Problem
from pipeline.run.frame import Frame
from pipeline.run.measures import STEPS, spatial
from pipeline.stepping.state import State, Stepper

# [m, m/s]: volumes and energies of what is larger would overflow
_BEYOND = 1e75

AfterStep = Callable[[State, Work], None]


def frames(
    problem: Problem, start: State | None = None, *, begun: Work | None = None, after_step: AfterStep | None = None
) -> Iterator[Frame]:
    """Yield the start's frame and one every steps_per_frame steps, to the end of the schedule.

    Raises SolveError where a step fails; the frames before it stand. `work.seconds` of the first frame is the set-up,
    unless `begun`, the work since the frame before `start`, says that the run goes on; a start between two frames has
    no frame. `after_step` gets each new state and the work since the frame before, and is called before its frame.
    """
    state = problem.start if start is None else start
    began = time.perf_counter()
    stepper = problem.prepare()
    work = Work(seconds=time.perf_counter() - began) if begun is None else begun
    if state.step % problem.steps_per_frame == 0:
        yield _frame(problem, state, work)
        work = Work()
    while state.step < problem.last_step:
        state, done = _timed_step(stepper, state)
        if problem.method.model == "auto":
            done.history = ((done.rung, done.solves, done.indicator),)
        work += done
        if after_step is not None:
            after_step(state, work)
        if state.step % problem.steps_per_frame == 0:
            yield _frame(problem, state, work)
            work = Work()


def _timed_step(stepper: Stepper, state: State) -> tuple[State, Work]:
    began = time.perf_counter()
    at = f"at step {state.step + 1}, t = {(state.step + 1) * stepper.dt:g} s"
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # judged by the next line instead
            new, work = stepper.step(state)
    except SolveError as error:
        raise SolveError(f"{error} ({at})") from error
    # written so that NaN fails too
    if not (np.vdot(new.x, new.x) < _BEYOND**2 and np.vdot(new.v, new.v) < _BEYOND**2):
        raise SolveError(f"positions are no longer finite {at}; try a smaller schedule.dt than {stepper.dt:g}")
    work.seconds += time.perf_counter() - began
    return new, work


def _frame(problem: Problem, state: State, work: Work) -> Frame:
    return Frame(
        index=state.step // problem.steps_per_frame,
        time=state.step * problem.dt,
        mesh=problem.body.mesh,
        x=state.x,
        step=state.step,
        v=state.v,
        known=dynamics(problem.body, state, state.step * problem.dt) | _effort(problem, work),
        work=work,
        state=state,
    )


def _effort(problem: Problem, work: Work) -> dict[str, Floats]:
    """Return what the steps since the frame before took, by the names of measures.VARIABLES and STEPS."""
    effort = {"newton_iterations": np.asarray(float(work.iterations))}
    if problem.method.model != "auto":
        return effort
    # as many numbers in every frame: none of the steps before the first one has happened
    steps = np.full((problem.steps_per_frame, 3), np.nan)
    steps[len(steps) - len(work.history) :] = np.reshape(work.history, (-1, 3))
    whole = {"rung": np.asarray(float(work.rung)), "indicator": np.asarray(work.indicator)}
    return effort | whole | dict(zip(STEPS, steps.T.copy(), strict=True))


def dynamics(body: Body, state: State, time: float) -> dict[str, Floats]:
    """Return the energies [J] and momenta of a state at a time [s], by the names of measures.VARIABLES."""
    p = body.momentum(state.v)
    xp = np.zeros((3, 3))  # sum_n x_n p_n^T, whose skew part is the sum of x_n x p_n
    xp[: body.mesh.dimension, : body.mesh.dimension] = state.x.T @ p
    turning = axial(xp.T - xp)
    return {
        "kinetic_energy": np.asarray(0.5 * np.vdot(state.v, p)),
        "elastic_energy": np.asarray(body.energy(state.x)),
        "potential_energy": np.asarray(-np.vdot(body.load_at(time), state.x - body.mesh.points)),
        "linear_momentum": spatial(p.sum(axis=0)),
        "angular_momentum": turning,
    }
