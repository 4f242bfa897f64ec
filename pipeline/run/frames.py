"""A run is an iterator of frames; recording is what drives it."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SolveError
from pipeline.fem.body import Body
from pipeline.fem.rotation import axial
from pipeline.linear.work import Work
from pipeline.problem.build import Problem
from pipeline.run.frame import Frame, Sink, Values
from pipeline.run.measures import STEPS, measure, spatial
from pipeline.stepping.state import State, Stepper

# [m, m/s]: volumes and energies of what is larger would overflow
_BEYOND = 1e75

AfterStep = Callable[[State, Work], None]


@dataclass(frozen=True)
class RunSummary:
    """What a recording was: frames, work, seconds of set-up, solving and writing apart, worst volume ratio.

    `writing_seconds` is measuring and writing; `wall_seconds` is all from the first frame on, without the set-up.
    """

    frames: int
    steps: int
    time: float
    work: Work
    setup_seconds: float
    writing_seconds: float
    wall_seconds: float
    worst_volume_ratio: float
    worst_cell: int
    worst_time: float

    @property
    def seconds_per_step(self) -> float:
        """Return the solver's seconds a step; NaN before the first."""
        return self.work.seconds / self.work.steps if self.work.steps else float("nan")


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
    while state.step < problem.frames * problem.steps_per_frame:
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


OnFrame = Callable[[Frame, "RunSummary"], None]


class Recording:
    """Frames measured and written into sinks, one at a time; `summary` is what the run was so far.

    `on_frame` is called after each frame with the frame and the summary. `before` is the summary of the
    frames that a resumed run has written already; the set-up of the first start stays the one told.
    """

    def __init__(
        self, sinks: Sequence[Sink], *, on_frame: OnFrame | None = None, before: RunSummary | None = None
    ) -> None:
        self.summary = before or RunSummary(0, 0, 0.0, Work(), 0.0, 0.0, 0.0, 1.0, 0, 0.0)
        self._sinks, self._on_frame = tuple(sinks), on_frame
        self._earlier, self._began = self.summary.wall_seconds, 0.0

    def take(self, frame: Frame) -> None:
        """Measure and write one frame."""
        began = time.perf_counter()
        self._began = self._began or began
        measured = measure(frame)
        for sink in self._sinks:
            sink.write(frame, measured)
        self.summary = self._timed(_continued(self.summary, frame, measured), since=began)
        if self._on_frame is not None:
            self._on_frame(frame, self.summary)

    def drain(self) -> None:
        """Return at once: every frame taken is written."""

    def close(self) -> None:
        """Close every sink; the first failure is raised after the others had their turn."""
        began, failures = time.perf_counter(), []
        for sink in self._sinks:
            try:
                sink.close()
            except Exception as error:
                failures.append(error)
        if self._began:
            self.summary = self._timed(self.summary, since=began)
        if failures:
            raise failures[0]

    def _timed(self, summary: RunSummary, *, since: float) -> RunSummary:
        now = time.perf_counter()
        writing, wall = summary.writing_seconds + now - since, self._earlier + now - self._began
        return replace(summary, writing_seconds=writing, wall_seconds=wall)


class Watcher(Protocol):
    """Takes frames in order: a Recording, or what stands before one."""

    def take(self, frame: Frame) -> None:
        """Take one frame; raises what taking it, or an earlier one, failed with."""
        ...

    def drain(self) -> None:
        """Return when every frame taken is written; raises what one of them failed with."""
        ...

    def close(self) -> None:
        """End with all frames taken."""
        ...


def drive(source: Iterator[Frame], watcher: Watcher) -> None:
    """Hand frames to a watcher, which is closed whatever happens."""
    try:
        for frame in source:
            watcher.take(frame)
    finally:
        watcher.close()


def record(
    source: Iterator[Frame],
    sinks: Sequence[Sink],
    *,
    on_frame: OnFrame | None = None,
    before: RunSummary | None = None,
) -> RunSummary:
    """Drive frames into sinks, each before the next is solved, and return what the run was; options as of Recording."""
    recording = Recording(sinks, on_frame=on_frame, before=before)
    drive(source, recording)
    return recording.summary


def _continued(summary: RunSummary, frame: Frame, measured: Values) -> RunSummary:
    ratio = measured["volume_ratio"]
    cell = int(np.abs(ratio - 1).argmax())
    worse = abs(ratio[cell] - 1) > abs(summary.worst_volume_ratio - 1)
    work = frame.work or Work()
    setup = work.seconds if not summary.frames else summary.setup_seconds
    return replace(
        summary,
        frames=summary.frames + 1,
        steps=frame.step or 0,
        time=frame.time,
        work=replace(summary.work + work, history=()) if summary.frames else Work(),
        setup_seconds=setup,
        worst_volume_ratio=float(ratio[cell]) if worse else summary.worst_volume_ratio,
        worst_cell=cell if worse else summary.worst_cell,
        worst_time=frame.time if worse else summary.worst_time,
    )
