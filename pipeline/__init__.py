"""Volume drift of deformable solids: run a scene, record it, measure it.

In five lines:

    from pipeline import build, frames, load_case, read_series, record
    from pipeline.sinks.vtu import VtuSink
    case = load_case("cases/bar.toml").variant("polar")
    summary = record(frames(build(case)), [VtuSink("bar")])
    series = read_series("bar")
"""

from pipeline.build import build
from pipeline.case import load_case
from pipeline.errors import PipelineError
from pipeline.run import frames, record
from pipeline.series import read_series
from pipeline.version import VERSION

__version__ = VERSION

__all__ = ["PipelineError", "__version__", "build", "frames", "load_case", "read_series", "record"]
