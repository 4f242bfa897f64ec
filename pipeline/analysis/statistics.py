"""statistics.nc of any recorded series, measured again from its positions."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.errors import SeriesError
from pipeline.formats.atomic import replace_file
from pipeline.run.frame import Frame, Sink, Values
from pipeline.run.recording import RunSummary, record
from pipeline.series import Series
from pipeline.sinks.netcdf import NetcdfSink


def write_statistics(
    series: Series, path: Path, on_frame: Callable[[int, int], None] | None = None, *, frames: Sink | None = None
) -> tuple[RunSummary, tuple[str, ...]]:
    """Write statistics.nc of a series, frame by frame; return the summary with its worst volume ratio, and notes.

    The notes sum up frames without numbers of all cells. `on_frame(done, frames)` is called after each frame; `frames`
    takes each that has positions, nodes without any at their rest positions. Raises SeriesError if a frame cannot be
    read or if no frame has numbers of cells, OutputError if a file cannot be written.
    """

    def report(frame: Frame, _: RunSummary) -> None:
        if on_frame is not None:
            on_frame(frame.index + 1, len(series))

    gaps = _GapCounter()
    with replace_file(path) as hidden:
        sinks: list[Sink] = [_SteadySink(NetcdfSink(hidden, title=series.name)), gaps]
        sinks += [] if frames is None else [_WholeSink(frames)]
        summary = record(iter(series), sinks, on_frame=report)
        if gaps.known == 0:
            raise SeriesError(f"{series.name}: no cell can be measured in any of its frames: {gaps.reason}")
    return summary, gaps.summarize()


class _SteadySink:
    """A sink that passes on the same numbers in every frame, those of the first; NaN if a frame lacks one."""

    def __init__(self, sink: NetcdfSink) -> None:
        self._sink = sink
        self._first: Values = {}

    def write(self, frame: Frame, measured: Values) -> None:
        self._first = self._first or {name: np.full(np.shape(value), np.nan) for name, value in measured.items()}
        self._sink.write(frame, {name: measured.get(name, missing) for name, missing in self._first.items()})

    def close(self) -> None:
        self._sink.close()


class _WholeSink:
    """A sink that passes frames on with positions of all nodes, as programs that draw them need; others are skipped."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink

    def write(self, frame: Frame, measured: Values) -> None:
        lost = np.asarray(~np.isfinite(frame.x).all(axis=1))
        if lost.all():
            return
        x = np.where(lost[:, None], frame.mesh.points, frame.x) if lost.any() else frame.x
        self._sink.write(replace(frame, x=x), measured)

    def close(self) -> None:
        self._sink.close()


class _GapCounter:
    """A sink that counts cells without numbers: `known` cells of all frames have them; `reason` is the first fault."""

    def __init__(self) -> None:
        self.known, self.reason = 0, ""
        self._frames: list[tuple[float, int, bool]] = []  # time, cells without numbers, whether the body has some
        self._cells = self._last = 0

    def write(self, frame: Frame, measured: Values) -> None:
        ratio = measured["volume_ratio"]
        missing = int((~np.isfinite(ratio)).sum())
        self._cells, self._last = len(ratio), frame.index
        self.known += len(ratio) - missing
        if missing:
            self._frames.append((frame.time, missing, bool(frame.whole)))
            self.reason = self.reason or frame.fault or "positions are not finite"

    def close(self) -> None:
        """Do nothing."""

    def summarize(self) -> tuple[str, ...]:
        """Return a note on the frames without numbers of all cells; none if there are none."""
        if not self._frames:
            return ()
        (start, *_), (end, *_), count = self._frames[0], self._frames[-1], len(self._frames)
        most = max(missing for _, missing, _ in self._frames)
        cells = "no cell has numbers" if most == self._cells else f"up to {most} of {self._cells} cells have no numbers"
        span = f"{count} frames from t = {start:.4g} to {end:.4g} s" if count > 1 else f"the frame of t = {start:.4g} s"
        whole = "; the volume of the whole body goes on" if all(has for *_, has in self._frames) else ""
        return (f"in {span} {cells}{whole} ({self.reason})",)
