"""Volume drift of deformable solids: run a scene, record it, measure it.

In five lines:

    from pipeline import build, frames, load_case, read_series, record
    from pipeline.sinks.vtu import VtuSink
    case = load_case("cases/bar.toml").variant("polar")
    summary = record(frames(build(case)), [VtuSink("bar")])
    series = read_series("bar")
"""

from pipeline.case import load_case
from pipeline.errors import PipelineError
from pipeline.problem.problem import build
from pipeline.problem.python_case import make_case
from pipeline.run.frames import frames
from pipeline.run.recording import record
from pipeline.series import read_series
from pipeline.system.version import VERSION

__version__ = VERSION

__all__ = ["PipelineError", "__version__", "build", "frames", "load_case", "make_case", "read_series", "record"]
