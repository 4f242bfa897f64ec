"""open_in_paraview.py without ParaView: `make test-paraview` runs it in the real one."""

import ast
import sys
from unittest.mock import MagicMock

import numpy as np
import pytest

from pipeline.case import load_case
from pipeline.results.case_run import run_case
from pipeline.views import camera
from pipeline.views.paraview import SCRIPT_NAME, write_script
from tests.bodies import skip_figures, write_case


def read_values(script):
    """The values that were written into a script; it has to be valid for the Python 3.9 of ParaView 5.11."""
    values = {}
    for node in ast.parse(script.read_text(), feature_version=(3, 9)).body:
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], ast.literal_eval(node.value)
            if isinstance(target, ast.Tuple):
                values |= {name.id: part for name, part in zip(target.elts, value, strict=True)}
            else:
                values[target.id] = value
    return values


@pytest.mark.parametrize(("name", "index"), [("vtu", "series.pvd"), ("vtkhdf", "series.vtkhdf")])
def test_each_run_leaves_a_script_that_names_its_variants_by_relative_paths(tmp_path, monkeypatch, name, index):
    skip_figures(monkeypatch)
    result = run_case(load_case(write_case(tmp_path, output={"format": name})), tmp_path / "out", movie=False)
    script = result.folder / SCRIPT_NAME
    values = read_values(script)
    assert script in result.files
    assert values["VARIANTS"] == [(one.name, f"{one.name}/{index}") for one in result.variants]
    assert all((result.folder / path).is_file() for _, path in values["VARIANTS"])
    assert 0 < values["RADIUS"] <= 1
    script.unlink()
    again = run_case(load_case(write_case(tmp_path, output={"format": name})), tmp_path / "out", movie=False)
    assert script in again.files  # made anew though nothing had to be solved


def test_any_name_is_written_as_it_is(tmp_path):
    values = read_values(write_script(tmp_path, {'it\'s \\1 "odd"': "it's/series.pvd"}, radius=0.06))
    assert values["VARIANTS"] == [('it\'s \\1 "odd"', "it's/series.pvd")]
    assert (values["RADIUS"], values["FOLDER"]) == (0.06, str(tmp_path))
    assert (values["ASIDE"], values["RAISED"], values["LONG"]) == (camera.ASIDE, camera.RAISED, camera.LONG)


def test_the_script_runs_whole_against_a_stand_in_for_paraview(tmp_path, monkeypatch):
    simple = MagicMock()
    view = simple.GetActiveViewOrCreate.return_value
    view.ViewSize, view.ViewTime = [1280, 720], 0.0
    reader = simple.PVDReader.return_value
    reader.TimestepValues = [0.0, 0.1]
    reader.GetDataInformation.return_value.GetBounds.return_value = (0.0, 4.0, 0.0, 12.0, 0.0, 4.0)
    monkeypatch.setitem(sys.modules, "paraview", MagicMock(simple=simple))
    monkeypatch.setattr(sys, "argv", ["open_in_paraview.py", "--screenshot", "picture.png"])
    for name in ("linear", "polar"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "series.pvd").touch()
    indices = {name: f"{name}/series.pvd" for name in ("linear", "polar")}
    script = write_script(tmp_path, indices, radius=0.2)
    exec(compile(script.read_text(), script, "exec"), {"__name__": "__main__"})
    assert simple.PVDReader.call_count == 2
    simple.SaveScreenshot.assert_called_once_with("picture.png", view, ImageResolution=[1280, 720])
    table = simple.GetColorTransferFunction.return_value
    table.RescaleTransferFunction.assert_called_once_with(0.8, 1.2)


@pytest.mark.parametrize(
    ("normal", "size", "eye", "right", "up"),
    [
        (None, (4.0, 1.0, 0.0), (0, 0, 1), (1, 0, 0), (0, 1, 0)),
        (None, (4.0, 0.0, 1.0), (0, -1, 0), (1, 0, 0), (0, 0, 1)),
        (None, (0.0, 4.0, 1.0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((0.0, 1.0, 0.0), (4.0, 0.1, 1.0), (0, -1, 0), (1, 0, 0), (0, 0, 1)),
        ((0.6, 0.8, 0.0), (4.0, 3.0, 1.0), (-0.6, -0.8, 0), (0.8, -0.6, 0), (0, 0, 1)),
    ],
)
def test_planar_bodies_are_seen_along_their_normal_as_in_the_film(tmp_path, monkeypatch, normal, size, eye, right, up):
    monkeypatch.setitem(sys.modules, "paraview", MagicMock())
    script = write_script(tmp_path, {"a": "series.pvd"}, radius=0.2, normal=normal and np.array(normal))
    names = {"__name__": "imported"}
    exec(compile(script.read_text().rpartition("\nmain()")[0], script, "exec"), names)
    directions = names["choose_directions"](list(size))
    for direction, expected in zip(directions, (eye, right, up), strict=True):
        assert direction == pytest.approx(expected)
    if normal is not None:
        toward, upward = camera._face_plane(np.array(normal))
        assert toward == pytest.approx(directions[0])
        assert np.cross(upward, toward) / np.linalg.norm(np.cross(upward, toward)) == pytest.approx(directions[1])
