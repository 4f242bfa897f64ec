"""The formats in which the frames of a run can be written: one row each."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from pipeline.errors import OutputError
from pipeline.run.frame import Sink
from pipeline.sinks.fields import Precision
from pipeline.sinks.vtkhdf import VtkhdfSink
from pipeline.sinks.vtu import VtuSink, name_frame_file


@dataclass(frozen=True)
class FrameFormat:
    """The sink that writes frames into a folder, and the place of each frame there."""

    index: str  # the file that readers open
    make_sink: Callable[[Path, Sequence[float], Precision, int], Sink]  # (folder, earlier times, precision, frames)
    locate: Callable[[int], tuple[str, int]]  # index of a frame -> its file, and its step in that file
    module: str = ""  # the package that must be installed
    extra: str = ""  # our extra that installs it


FORMATS: Mapping[str, FrameFormat] = {
    "vtu": FrameFormat(
        index="series.pvd",
        make_sink=lambda folder, earlier, precision, _: VtuSink(folder, earlier=earlier, precision=precision),
        locate=lambda frame: (name_frame_file(frame), 0),
    ),
    "vtkhdf": FrameFormat(
        index="series.vtkhdf",
        make_sink=lambda folder, earlier, precision, frames: VtkhdfSink(
            folder, earlier=earlier, precision=precision, frames=frames
        ),
        locate=lambda frame: ("series.vtkhdf", frame),
        module="h5py",
        extra="series",
    ),
}


def ensure_format(name: str) -> FrameFormat:
    """Return a row of the table; raises OutputError if the package that it needs is not installed."""
    row = FORMATS[name]
    if row.module and find_spec(row.module) is None:
        raise OutputError(
            f"output.format = {name!r} needs {row.module}, which is not installed: "
            f"pip install 'corotational-pipeline[{row.extra}]'"
        )
    return row
