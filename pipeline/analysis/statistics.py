"""statistics.nc of any recorded series, measured again from its positions."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.formats.atomic import replace_file
from pipeline.run.frame import Frame, Values
from pipeline.run.recording import RunSummary, record
from pipeline.series import Series
from pipeline.sinks.netcdf import NetcdfSink


def write_statistics(series: Series, path: Path, on_frame: Callable[[int, int], None] | None = None) -> RunSummary:
    """Write statistics.nc of a series, frame by frame; return the summary with its worst volume ratio.

    `on_frame(done, frames)` is called after each frame. Raises SeriesError if a frame cannot be read, OutputError if
    the file cannot be written.
    """

    def report(frame: Frame, _: RunSummary) -> None:
        if on_frame is not None:
            on_frame(frame.index + 1, len(series))

    with replace_file(path) as hidden:
        return record(iter(series), [_SteadySink(NetcdfSink(hidden, title=series.name))], on_frame=report)


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
