"""Volume drift of deformable solids: measure a series, run a scene, compare the results.

    import pipeline
    result = pipeline.run_case("cases/bar.toml")                  # outputs/bar: frames, datasets, plots, movie
    series = pipeline.read_series("outputs/bar/polar")            # or any solver's .pvd, .vtu, .vtkhdf, .xdmf
    analysis = pipeline.analyze(series, "outputs/analysis")       # volume ratio and rotation of every cell and frame

Frame by frame, with sinks of your choice:

    problem = pipeline.build(pipeline.load_case("cases/bar.toml").variant("polar"))
    pipeline.record(pipeline.frames(problem), [pipeline.VtuSink("bar")])
"""

from pipeline.case import Case, load_case
from pipeline.errors import CaseError, MeshError, OutputError, PipelineError, SeriesError, SolveError
from pipeline.mesh.simplex import Mesh
from pipeline.problem.problem import Problem, build
from pipeline.problem.python_case import make_case
from pipeline.results.analysis_folder import analyze, compare
from pipeline.results.case_run import run_case
from pipeline.results.report import write_report
from pipeline.run.frame import Frame, Sink
from pipeline.run.frames import frames
from pipeline.run.recording import record
from pipeline.series import Series, read_series
from pipeline.sinks.netcdf import NetcdfSink
from pipeline.sinks.vtkhdf import VtkhdfSink
from pipeline.sinks.vtu import VtuSink
from pipeline.system.version import VERSION
from pipeline.views.movie.movie import write_movie

__version__ = VERSION

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
