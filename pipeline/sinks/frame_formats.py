"""The formats that the frames of a run can have: a row each."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from pipeline.errors import OutputError
from pipeline.run.frame import Sink
from pipeline.sinks.fields import Precision
from pipeline.sinks.vtkhdf import VtkhdfSink
from pipeline.sinks.vtu import VtuSink, frame_file


@dataclass(frozen=True)
class Format:
    """How frames are written into a folder, and where they are found again."""

    index: str  # the file that readers open
    sink: Callable[[Path, Sequence[float], Precision, int], Sink]  # (folder, times of frames there, _, frames to come)
    place: Callable[[int], tuple[str, int]]  # index of a frame -> the file that it lies in, and the step there
    module: str = ""  # what has to be installed, and the extra that brings it
    extra: str = ""


FORMATS: Mapping[str, Format] = {
    "vtu": Format(
        index="series.pvd",
        sink=lambda folder, earlier, precision, _: VtuSink(folder, earlier=earlier, precision=precision),
        place=lambda frame: (frame_file(frame), 0),
    ),
    "vtkhdf": Format(
        index="series.vtkhdf",
        sink=lambda folder, earlier, precision, frames: VtkhdfSink(
            folder, earlier=earlier, precision=precision, frames=frames
        ),
        place=lambda frame: ("series.vtkhdf", frame),
        module="h5py",
        extra="series",
    ),
}


def ensure_format(name: str) -> Format:
    """Return a row of the table; raises OutputError where the package that it needs is not installed."""
    found = FORMATS[name]
    if found.module and find_spec(found.module) is None:
        raise OutputError(
            f"output.format = {name!r} needs {found.module}, which is not installed: "
            f"pip install 'corotational-pipeline[{found.extra}]'"
        )
    return found
