"""Output to the terminal: lines on standard error and progress bars."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from pipeline.problem.problem import Problem
from pipeline.run.frame import Frame
from pipeline.run.recording import RunSummary
from pipeline.stepping.report import RUNG_NAMES


def say(line: str) -> None:
    """Print a line on standard error."""
    print(line, file=sys.stderr)


def show_notes(notes: Iterable[str]) -> None:
    """Print notes on standard error, one per line."""
    for note in notes:
        say(f"note: {note}")


class Bars:
    """Progress bars: one per variant, with steps per second and the worst volume ratio, and one for the movie."""

    def __init__(self, display: Any) -> None:
        self._display = display
        self._tasks: dict[str, Any] = {}

    def show_start(self, name: str, problem: Problem) -> None:
        """Show that a variant is being set up: matrices are factored and, the first time, kernels compiled."""
        total = problem.last_step
        self._show(name, 0, total, "setting up; the first run compiles kernels")

    def show_frame(self, name: str, problem: Problem, frame: Frame, summary: RunSummary) -> None:
        """Show a frame of a variant."""
        total = problem.last_step
        wall = summary.wall_seconds
        rate = f"{summary.steps / wall:6.0f} steps/s" if summary.steps else ""
        rung = f"  {RUNG_NAMES[int(frame.known['rung'])]}" if "rung" in frame.known else ""
        self._show(name, frame.step or 0, total, f"{rate}  worst volume ratio {summary.worst_volume_ratio:.4f}{rung}")

    def show_picture(self, done: int, total: int) -> None:
        """Show a frame of the movie."""
        self._show("movie", done, total, "")

    def show_reading(self, name: str, done: int, total: int) -> None:
        """Show that a frame of a series was read, or a point of a study done."""
        self._show(name, done, total, "")

    def _show(self, name: str, done: int, total: int, text: str) -> None:
        if self._display is None:
            return
        if name not in self._tasks:
            self._display.start()  # only now, so that an earlier error is a single line
            self._tasks[name] = self._display.add_task(name, total=total, text=text)
        self._display.update(self._tasks[name], completed=done, total=total, text=text)


@contextmanager
def show_progress(quiet: bool) -> Iterator[Bars]:
    """Yield progress bars on standard error; none are shown if `quiet`."""
    if quiet:
        yield Bars(None)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:<14}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}"),
    )
    display = Progress(*columns, console=Console(stderr=True))
    try:
        yield Bars(display)
    finally:
        if display.tasks:  # stopping a display that never started prints an empty line
            display.stop()
