"""What `import pipeline` offers: all of it exists, costs little, takes paths as text and shows itself on one line."""

import ast
import inspect
import os
import subprocess
import sys
from typing import get_args

import pytest

import pipeline
from tests.bodies import skip_figures, write_case

VERBS = "run_case load_case make_case build frames record read_series analyze compare write_report write_movie".split()


def test_everything_that_is_offered_exists():
    assert set(VERBS) <= set(pipeline.__all__)
    assert [name for name in pipeline.__all__ if not hasattr(pipeline, name)] == []


@pytest.mark.parametrize(
    ("function", "parameter"),
    [
        ("run_case", "case"), ("run_case", "out"), ("load_case", "path"), ("read_series", "path"),
        ("analyze", "source"), ("analyze", "out"), ("compare", "out"), ("write_report", "folder"),
        ("write_movie", "path"),
    ],
)  # fmt: skip
def test_paths_may_be_text_or_path_like(function, parameter):
    annotation = inspect.signature(getattr(pipeline, function), eval_str=True).parameters[parameter].annotation
    assert {str, os.PathLike[str]} <= set(get_args(annotation))


@pytest.mark.parametrize("sink", ["VtuSink", "VtkhdfSink", "NetcdfSink"])
def test_sinks_take_paths_as_text(sink):
    first = next(iter(inspect.signature(getattr(pipeline, sink), eval_str=True).parameters.values()))
    assert {str, os.PathLike[str]} <= set(get_args(first.annotation))


def test_objects_are_shown_on_one_line(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    case = pipeline.load_case(write_case(tmp_path))
    problem = pipeline.build(case.variant("polar"))
    result = pipeline.run_case(str(case.path), str(tmp_path / "out"), variants=["polar"], movie=False)
    series = pipeline.read_series(str(result.folder / "polar"))
    frame = next(iter(series))
    body = problem.body
    for shown in (
        case,
        problem,
        result,
        result.variants[0],
        series,
        frame,
        body,
        body.mesh,
        body.pattern,
        body.supports,
    ):
        assert "\n" not in repr(shown) and len(repr(shown)) < 300, type(shown)
    assert "<b>" in case._repr_html_() and "<" in series._repr_html_()


def test_names_are_imported_when_they_are_used():
    tree = ast.parse(inspect.getsource(pipeline))
    typed = {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    typed["__version__"] = "pipeline.system.version:VERSION"
    assert typed == pipeline._PLACES and set(pipeline.__all__) == typed.keys() == set(dir(pipeline))
    code = "import pipeline, sys; print('numpy' in sys.modules, pipeline.Mesh.__name__, 'numpy' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "False Mesh True\n"
    with pytest.raises(AttributeError, match="module 'pipeline' has no attribute 'run_campaign'"):
        _ = pipeline.run_campaign
