"""Fixtures of all tests: paths, VTK's errors as failures, OpenGL and a browser checked before they are needed."""

import os
import shutil
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from pipeline import build, frames, load_case
from pipeline.errors import OutputError, PipelineError
from pipeline.formats.sandbox import Reader
from pipeline.mesh.simplex import signed_volumes
from pipeline.system.opengl import ensure_opengl

ROOT = Path(__file__).resolve().parent.parent
SKIP_OPENGL = os.environ.get("PIPELINE_SKIP_OPENGL") == "1"
SKIP_BROWSER = os.environ.get("PIPELINE_SKIP_BROWSER") == "1"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

# the same examples every time, on slow machines too: a failure can be repeated
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def project_root() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def cases_folder() -> Path:
    return ROOT / "cases"


@pytest.fixture(scope="module")
def ratios(cases_folder: Path) -> Callable[[str, str], np.ndarray]:
    """A function (case, variant) -> volume ratios (101, cells) of the whole run, solved once."""

    @cache
    def of(case: str, variant: str) -> np.ndarray:
        problem = build(load_case(cases_folder / f"{case}.toml").variant(variant))
        rest = problem.body.mesh.rest_volumes
        return np.array([signed_volumes(f.x, f.mesh.cells) / rest for f in frames(problem)])

    return of


@pytest.fixture
def outputs(tmp_path: Path) -> Path:
    """An empty folder in place of outputs/."""
    folder = tmp_path / "outputs"
    folder.mkdir()
    return folder


@pytest.fixture
def installed(tmp_path: Path, project_root: Path) -> dict[str, str]:
    """An environment in which the entry points of pyproject.toml are those of an installed package."""
    entry = tomllib.loads((project_root / "pyproject.toml").read_text())["project"]["entry-points"]["xarray.backends"]
    info = tmp_path / "site" / "entry_of_this_tree-0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: entry-of-this-tree\nVersion: 0.1\n")
    lines = [f"{name} = {target}" for name, target in entry.items()]
    (info / "entry_points.txt").write_text("[xarray.backends]\n" + "\n".join(lines) + "\n")
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(info.parent), str(project_root)])}


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reads foreign files in this process, so that a test can change their reader."""

    def here(self: Reader, function: str, file: Path, *arguments: object, error: type[PipelineError]) -> Any:
        module, _, name = function.partition(":")
        return getattr(import_module(module), name)(file, *arguments)

    monkeypatch.setattr(Reader, "read", here)


@pytest.fixture(scope="session")
def _vtk_error_log() -> list[str]:
    """Every text that VTK's C++ side reports as an error; otherwise it would go to a log and the test would pass."""
    import pyvista  # first: its import puts a window of its own in place
    from vtkmodules.vtkCommonCore import vtkCommand, vtkStringOutputWindow

    pyvista.OFF_SCREEN = True
    log: list[str] = []

    def note(_window: object, _event: str, text: str) -> None:
        log.append(text.strip())

    note.CallDataType = "string0"  # type: ignore[attr-defined]  # makes VTK pass the text
    window = vtkStringOutputWindow()
    window.AddObserver(vtkCommand.ErrorEvent, note)
    vtkStringOutputWindow.SetInstance(window)
    return log


@pytest.fixture(autouse=True)
def vtk_errors(_vtk_error_log: list[str]) -> Iterator[list[str]]:
    """VTK's errors in this test, which fail it; a test that expects some checks and clears them."""
    _vtk_error_log.clear()
    yield _vtk_error_log
    if _vtk_error_log:
        pytest.fail("VTK reported:\n" + "\n".join(_vtk_error_log), pytrace=False)


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of the browser that the tests marked `browser` drive."""
    return browser_path() or ""


def browser_path() -> str | None:
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("opengl") is not None:
        _need_opengl()
    if item.get_closest_marker("browser") is not None:
        _need_browser()


def _need_opengl() -> None:
    if SKIP_OPENGL:
        pytest.skip("PIPELINE_SKIP_OPENGL=1: pictures are NOT tested")
    missing = None
    try:
        ensure_opengl()
    except OutputError as error:
        missing = f"{error}. PIPELINE_SKIP_OPENGL=1 skips these tests with a message"
    if missing:
        pytest.fail(missing, pytrace=False)


def _need_browser() -> None:
    if SKIP_BROWSER:
        pytest.skip("PIPELINE_SKIP_BROWSER=1: the web page is NOT tested in a browser")
    if browser_path() is None:
        pytest.fail(
            f"no browser ({', '.join(BROWSERS)}); on Debian: apt-get install -y --no-install-recommends chromium. "
            "PIPELINE_SKIP_BROWSER=1 skips these tests with a message",
            pytrace=False,
        )


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> Iterator[Callable[..., Path]]:
    """A function that returns the folder of a maker, which runs once."""
    made: dict[Callable[[Path], None], Path] = {}

    def find(make: Callable[[Path], None]) -> Path:
        if make not in made:
            made[make] = tmp_path_factory.mktemp(make.__name__)
            make(made[make])
        return made[make]

    yield find
    for folder in made.values():
        shutil.rmtree(folder)
