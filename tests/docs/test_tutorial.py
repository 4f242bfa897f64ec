"""docs/tutorial.ipynb runs from top to bottom, as for a new user, and is stored without outputs."""

import shutil

import nbformat
import pytest
from nbclient import NotebookClient


def read_notebook(project_root):
    return nbformat.read(project_root / "docs" / "tutorial.ipynb", as_version=4)


def test_the_tutorial_is_valid_and_has_no_outputs(project_root):
    tutorial = read_notebook(project_root)
    nbformat.validate(tutorial)
    code = [cell for cell in tutorial.cells if cell.cell_type == "code"]
    assert code and all(cell.outputs == [] and cell.execution_count is None for cell in code)


@pytest.mark.slow
@pytest.mark.opengl
def test_the_tutorial_runs_from_top_to_bottom(project_root, tmp_path, installed):
    (tmp_path / "docs").mkdir()
    shutil.copytree(project_root / "cases", tmp_path / "cases")
    tutorial = read_notebook(project_root)
    resources = {"metadata": {"path": str(tmp_path / "docs")}}
    NotebookClient(tutorial, timeout=300, kernel_name="python3", resources=resources).execute(env=installed)
    outputs = [output for cell in tutorial.cells for output in cell.get("outputs", ())]
    assert [output["text"] for output in outputs if output.get("name") == "stderr"] == []
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == 4, "three plots and a still"
    text = "".join(output["data"].get("text/plain", "") for output in outputs if "data" in output)
    assert "Worst(volume_ratio=" in text and "'report.html'" in text
    folder = tmp_path / "outputs" / "tutorial" / "bar_small"
    assert {"report.html", "comparison.nc", "still.png", "linear", "polar"} <= {path.name for path in folder.iterdir()}
