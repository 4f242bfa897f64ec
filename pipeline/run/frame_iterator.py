"""A run is an iterator of frames, which recording.py drives."""

import time
from collections.abc import Callable, Iterator

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.loads import integrate_density
from pipeline.fem.rotation import axial
from pipeline.linear.work import Work
from pipeline.problem.problem import Problem
from pipeline.run.frame import Frame
from pipeline.run.measures import STEPS, pad_to_space
from pipeline.stepping.report import Effort, StepReport
from pipeline.stepping.state import State, Stepper

# [m, m/s]: volumes and energies of larger numbers would overflow
_BEYOND = 1e75

AfterStep = Callable[[State, Effort], None]


def frames(
    problem: Problem, start: State | None = None, *, effort: Effort | None = None, after_step: AfterStep | None = None
) -> Iterator[Frame]:
    """Yield a frame of the start and one every steps_per_frame steps, to the end of the schedule.

    Raises SolveError if a step fails, after the earlier frames. The first frame's `work.seconds` is the set-up time.
    To resume a run, pass a `start` and the `effort` since the last written frame; a start between two frames yields
    no frame of its own. `after_step` gets each new state and the effort since the last frame, before its frame is made.
    """
    state = problem.start if start is None else start
    began = time.perf_counter()
    stepper = problem.prepare()
    effort = Effort(Work(seconds=time.perf_counter() - began)) if effort is None else effort
    if state.step % problem.steps_per_frame == 0:
        yield _make_frame(problem, state, effort, stepwise=stepper.chooses_model)
        effort = Effort(Work())
    while state.step < problem.last_step:
        state, report = _run_step(stepper, state)
        effort += report
        if after_step is not None:
            after_step(state, effort)
        if state.step % problem.steps_per_frame == 0:
            yield _make_frame(problem, state, effort, stepwise=stepper.chooses_model)
            effort = Effort(Work())


def _run_step(stepper: Stepper, state: State) -> tuple[State, StepReport]:
    """Return the next state and its report, with seconds; raises SolveError that names step and time."""
    began = time.perf_counter()
    at = f"at step {state.step + 1}, t = {(state.step + 1) * stepper.dt:g} s"
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the check below detects overflow
            new, report = stepper.step(state)
    except SolveError as error:
        raise SolveError(f"{error} ({at})") from error
    # written so that NaN fails too
    if not (np.vdot(new.x, new.x) < _BEYOND**2 and np.vdot(new.v, new.v) < _BEYOND**2):
        raise SolveError(f"positions are no longer finite {at}; try a smaller schedule.dt than {stepper.dt:g}")
    report.work.seconds += time.perf_counter() - began
    return new, report


def _make_frame(problem: Problem, state: State, effort: Effort, *, stepwise: bool) -> Frame:
    known = measure_dynamics(problem.body, state, state.step * problem.dt)
    known["newton_iterations"] = np.asarray(float(effort.work.iterations))
    return Frame(
        index=state.step // problem.steps_per_frame,
        time=state.step * problem.dt,
        mesh=problem.body.mesh,
        x=state.x,
        step=state.step,
        v=state.v,
        known=known | (_list_choices(effort, problem.steps_per_frame) if stepwise else {}),
        work=effort.work,
        state=state,
        materials=problem.materials,
    )


def _list_choices(effort: Effort, count: int) -> dict[str, Floats]:
    """Return the choices of the last `count` steps, by the names in measures.VARIABLES and STEPS.

    Every frame has `count` numbers: those for steps before the first one are NaN.
    """
    rung = max((choice.rung for choice in effort.choices), default=0)
    indicator = max((choice.indicator for choice in effort.choices), default=0.0)
    steps = np.full((count, 3), np.nan)
    steps[count - len(effort.choices) :] = np.reshape(effort.choices, (-1, 3))
    whole = {"rung": np.asarray(float(rung)), "indicator": np.asarray(indicator)}
    return whole | dict(zip(STEPS, steps.T.copy(), strict=True))


def measure_dynamics(body: Body, state: State, time: float) -> dict[str, Floats]:
    """Return the energies [J] and momenta of a state at a time [s], by the names in measures.VARIABLES."""
    p = body.momentum(state.v)
    xp = np.zeros((3, 3))  # sum_n x_n p_n^T, whose skew part is the sum of x_n x p_n
    xp[: body.mesh.dimension, : body.mesh.dimension] = state.x.T @ p
    density, center = body.material.density, dict[str, Floats]()
    if isinstance(density, np.ndarray):  # else it is the center of volume, which frames of other programs have, too
        masses = integrate_density(body.mesh, density)
        center["center_of_mass"] = pad_to_space(masses @ state.x / masses.sum())
    return center | {
        "kinetic_energy": np.asarray(0.5 * np.vdot(state.v, p)),
        "elastic_energy": np.asarray(body.energy(state.x)),
        "potential_energy": np.asarray(-np.vdot(body.load_at(time), state.x - body.mesh.points)),
        "linear_momentum": pad_to_space(p.sum(axis=0)),
        "angular_momentum": axial(xp.T - xp),
    }
