"""Volume drift of deformable solids: measure a series, run a scene, compare the results.

    import pipeline
    result = pipeline.run_case("cases/bar.toml")                  # outputs/bar: frames, datasets, plots, movie
    series = pipeline.read_series("outputs/bar/polar")            # or any solver's .pvd, .vtu, .vtkhdf, .xdmf
    analysis = pipeline.analyze(series, "outputs/analysis")       # volume ratio and rotation of every cell and frame

Frame by frame, with sinks of your choice:

    problem = pipeline.build(pipeline.load_case("cases/bar.toml").variant("polar"))
    pipeline.record(pipeline.frames(problem), [pipeline.VtuSink("bar")])
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline.case import Case, load_case
    from pipeline.errors import CaseError, MeshError, OutputError, PipelineError, SeriesError, SolveError
    from pipeline.mesh.simplex import Mesh
    from pipeline.problem.problem import Problem, build
    from pipeline.problem.python_case import make_case
    from pipeline.results.analysis_folder import analyze, compare
    from pipeline.results.case_run import run_case
    from pipeline.results.report import write_report
    from pipeline.run.frame import Frame, Sink
    from pipeline.run.frame_iterator import frames
    from pipeline.run.recording import record
    from pipeline.series import Series, read_series
    from pipeline.sinks.netcdf import NetcdfSink
    from pipeline.sinks.vtkhdf import VtkhdfSink
    from pipeline.sinks.vtu import VtuSink
    from pipeline.views.movie.movie import write_movie

    __version__: str

# Each name is imported when it is first used: `import pipeline` costs nothing, and neither do our child processes.
_PLACES = {
    "Case": "pipeline.case:Case",
    "CaseError": "pipeline.errors:CaseError",
    "Frame": "pipeline.run.frame:Frame",
    "Mesh": "pipeline.mesh.simplex:Mesh",
    "MeshError": "pipeline.errors:MeshError",
    "NetcdfSink": "pipeline.sinks.netcdf:NetcdfSink",
    "OutputError": "pipeline.errors:OutputError",
    "PipelineError": "pipeline.errors:PipelineError",
    "Problem": "pipeline.problem.problem:Problem",
    "Series": "pipeline.series:Series",
    "SeriesError": "pipeline.errors:SeriesError",
    "Sink": "pipeline.run.frame:Sink",
    "SolveError": "pipeline.errors:SolveError",
    "VtkhdfSink": "pipeline.sinks.vtkhdf:VtkhdfSink",
    "VtuSink": "pipeline.sinks.vtu:VtuSink",
    "__version__": "pipeline.system.version:VERSION",
    "analyze": "pipeline.results.analysis_folder:analyze",
    "build": "pipeline.problem.problem:build",
    "compare": "pipeline.results.analysis_folder:compare",
    "frames": "pipeline.run.frame_iterator:frames",
    "load_case": "pipeline.case:load_case",
    "make_case": "pipeline.problem.python_case:make_case",
    "read_series": "pipeline.series:read_series",
    "record": "pipeline.run.recording:record",
    "run_case": "pipeline.results.case_run:run_case",
    "write_movie": "pipeline.views.movie.movie:write_movie",
    "write_report": "pipeline.results.report:write_report",
}

__all__ = [
    "Case",
    "CaseError",
    "Frame",
    "Mesh",
    "MeshError",
    "NetcdfSink",
    "OutputError",
    "PipelineError",
    "Problem",
    "Series",
    "SeriesError",
    "Sink",
    "SolveError",
    "VtkhdfSink",
    "VtuSink",
    "__version__",
    "analyze",
    "build",
    "compare",
    "frames",
    "load_case",
    "make_case",
    "read_series",
    "record",
    "run_case",
    "write_movie",
    "write_report",
]


def __getattr__(name: str) -> Any:
    """Return a name of the face, imported now."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, attribute = _PLACES[name].partition(":")
    value = globals()[name] = getattr(import_module(module), attribute)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
