"""open_in_paraview.py without ParaView: `make test-paraview` runs it in the real one."""

import ast
import re

import pytest

from pipeline.case import load_case
from pipeline.results.run_case import run_campaign
from pipeline.views.paraview import SCRIPT_NAME, write_script
from tests.bodies import without_figures, write_case


def constants(script):
    assigned = [node for node in ast.parse(script.read_text()).body if isinstance(node, ast.Assign)]
    found = {node.targets[0].id: node.value for node in assigned if isinstance(node.targets[0], ast.Name)}
    return {name: ast.literal_eval(found[name]) for name in ("VARIANTS", "RADIUS")}


@pytest.mark.parametrize(("name", "index"), [("vtu", "series.pvd"), ("vtkhdf", "series.vtkhdf")])
def test_each_run_leaves_a_script_that_names_its_variants_by_relative_paths(tmp_path, monkeypatch, name, index):
    without_figures(monkeypatch)
    result = run_campaign(load_case(write_case(tmp_path, output={"format": name})), tmp_path / "out", movie=False)
    script = result.folder / SCRIPT_NAME
    found = constants(script)
    assert script in result.made
    assert found["VARIANTS"] == [(one.name, f"{one.name}/{index}") for one in result.variants]
    assert all((result.folder / path).is_file() for _, path in found["VARIANTS"])
    assert 0 < found["RADIUS"] <= 1
    script.unlink()
    again = run_campaign(load_case(write_case(tmp_path, output={"format": name})), tmp_path / "out", movie=False)
    assert script in again.made  # made anew though nothing had to be solved


def test_any_name_is_written_as_it_is(tmp_path):
    script = write_script(tmp_path, {'it\'s \\ "odd"': "it's/series.pvd"}, radius=0.06)
    assert constants(script) == {"VARIANTS": [('it\'s \\ "odd"', "it's/series.pvd")], "RADIUS": 0.06}
    assert not re.findall(r"@[A-Z]+@", script.read_text())
