"""Recording: measures frames, writes them into sinks and sums up the run."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from pipeline.linear.work import Work
from pipeline.run.frame import Frame, Sink, Values
from pipeline.run.measures import measure


@dataclass(frozen=True)
class RunSummary:
    """Totals of a recording: frames, work, seconds, and the worst volume ratio.

    `work.seconds` is for solving, `writing_seconds` for measuring and writing, `wall_seconds` for all after set-up.
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
        """Return the solver's seconds per step; NaN before the first step."""
        return self.work.seconds / self.work.steps if self.work.steps else float("nan")


OnFrame = Callable[[Frame, "RunSummary"], None]


class Recording:
    """Measures frames and writes them into sinks, one at a time; `summary` has the totals so far.

    `on_frame` is called after each frame with the frame and the summary. `before` is the summary of the frames that a
    resumed run has already written; the set-up time stays that of the first start.
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
        self.summary = self._add_seconds(_update_summary(self.summary, frame, measured), since=began)
        if self._on_frame is not None:
            self._on_frame(frame, self.summary)

    def drain(self) -> None:
        """Return at once: every frame taken has been written."""

    def close(self) -> None:
        """Close every sink, then raise the first failure."""
        began, failures = time.perf_counter(), []
        for sink in self._sinks:
            try:
                sink.close()
            except Exception as error:
                failures.append(error)
        if self._began:
            self.summary = self._add_seconds(self.summary, since=began)
        if failures:
            raise failures[0]

    def _add_seconds(self, summary: RunSummary, *, since: float) -> RunSummary:
        now = time.perf_counter()
        writing, wall = summary.writing_seconds + now - since, self._earlier + now - self._began
        return replace(summary, writing_seconds=writing, wall_seconds=wall)


class Watcher(Protocol):
    """Takes frames in order: a Recording, or a RemoteRecording in front of one."""

    def take(self, frame: Frame) -> None:
        """Take one frame; raises the failure of this frame or an earlier one."""
        ...

    def drain(self) -> None:
        """Return when every frame taken has been written; raises the failure of one of them."""
        ...

    def close(self) -> None:
        """Finish all frames taken; raises the first failure."""
        ...


def drive(source: Iterator[Frame], watcher: Watcher) -> None:
    """Hand frames to a watcher, and close it in any case."""
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
    """Write frames into sinks, each before the next is solved; returns the totals. Options as in Recording."""
    recording = Recording(sinks, on_frame=on_frame, before=before)
    drive(source, recording)
    return recording.summary


def _update_summary(summary: RunSummary, frame: Frame, measured: Values) -> RunSummary:
    ratio = measured["volume_ratio"]
    cell = int(np.nan_to_num(np.abs(ratio - 1), nan=-1.0).argmax())  # cells without data are not the worst
    worse = abs(ratio[cell] - 1) > abs(summary.worst_volume_ratio - 1)
    work = frame.work or Work()
    setup = work.seconds if not summary.frames else summary.setup_seconds
    return replace(
        summary,
        frames=summary.frames + 1,
        steps=frame.step or 0,
        time=frame.time,
        work=summary.work + work if summary.frames else Work(),
        setup_seconds=setup,
        worst_volume_ratio=float(ratio[cell]) if worse else summary.worst_volume_ratio,
        worst_cell=cell if worse else summary.worst_cell,
        worst_time=frame.time if worse else summary.worst_time,
    )
