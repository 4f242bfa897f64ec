"""The probe finds a class that draws, survives those that crash, hang or lie, and names the packages to install."""

import os
import subprocess
import sys

import pytest

from pipeline.errors import OutputError
from pipeline.system import opengl

CRASH = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
FINE_IF = "import sys; sys.exit(None if sys.argv[1] == {!r} else 'no library')"


@pytest.fixture
def fresh(monkeypatch):
    """Resets this process: it has not probed yet and inherits nothing."""
    monkeypatch.setattr(opengl, "_working", None)
    for name in (opengl.FOUND, opengl.VTK_CHOICE, "DISPLAY"):
        monkeypatch.setenv(name, "")  # so that monkeypatch also takes back what ensure_opengl sets
        monkeypatch.delenv(name)
    return monkeypatch


def test_crashing_children_give_one_error_with_the_packages(fresh):
    fresh.setattr(opengl, "_PROBE", CRASH)
    with pytest.raises(OutputError) as caught:
        opengl.ensure_opengl()
    message = str(caught.value)
    assert "vtkEGLRenderWindow: ended by signal 11" in message
    assert "apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri" in message
    assert "OSMesa" in message and "Everything but pictures and movies works" in message
    assert opengl.VTK_CHOICE not in os.environ


@pytest.mark.parametrize("works", opengl.WINDOWS)
def test_the_first_class_that_draws_is_set_and_inherited(fresh, works):
    fresh.setenv("DISPLAY", ":99")
    fresh.setattr(opengl, "_PROBE", FINE_IF.format(works))
    assert opengl.ensure_opengl() == works
    assert os.environ[opengl.VTK_CHOICE] == works
    fresh.setattr(opengl, "_PROBE", CRASH)
    assert opengl.ensure_opengl() == works, "probes once per process"
    fresh.setattr(opengl, "_working", None)
    assert opengl.ensure_opengl() == works, "a child believes its parent"
    fresh.setattr(opengl, "_working", None)
    fresh.setenv("DISPLAY", ":1")
    with pytest.raises(OutputError):  # but not on another display
        opengl.ensure_opengl()


def test_the_users_choice_is_tried_first_and_dropped_if_it_fails(fresh):
    fresh.setenv(opengl.VTK_CHOICE, "vtkOSOpenGLRenderWindow")
    fresh.setattr(opengl, "_PROBE", "")
    assert opengl.ensure_opengl() == "vtkOSOpenGLRenderWindow"
    fresh.setattr(opengl, "_working", None)
    fresh.setattr(opengl, "_PROBE", FINE_IF.format("vtkEGLRenderWindow"))
    fresh.delenv(opengl.FOUND)
    assert opengl.ensure_opengl() == "vtkEGLRenderWindow"


def test_no_display_no_glx(fresh):
    fresh.setattr(opengl, "_PROBE", FINE_IF.format("vtkXOpenGLRenderWindow"))
    with pytest.raises(OutputError, match=r"vtkOSOpenGLRenderWindow: no library\)"):
        opengl.ensure_opengl()


def test_a_child_that_hangs_is_ended(fresh):
    fresh.setattr(opengl, "_PROBE", "import time; time.sleep(60)")
    fresh.setattr(opengl, "PROBE_SECONDS", 0.2)
    with pytest.raises(OutputError, match=r"no picture within 0\.2 s"):
        opengl.ensure_opengl()


def test_a_window_of_another_class_does_not_count(fresh):
    """VTK silently makes another one if the requested one is missing."""
    assert opengl._probe("vtkNoSuchWindow") is not None


@pytest.mark.opengl
def test_this_machine_draws_and_reports_it(fresh):
    environment = {k: v for k, v in os.environ.items() if k not in (opengl.FOUND, opengl.VTK_CHOICE)}
    command = [sys.executable, "-m", "pipeline.system.opengl"]
    run = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.strip() in {f"OpenGL: {window}" for window in opengl.WINDOWS}


def test_the_command_line_names_the_missing_packages(fresh, capsys):
    fresh.setattr(opengl, "_PROBE", CRASH)
    assert opengl.main() == 1
    assert "libegl1 libgl1-mesa-dri" in capsys.readouterr().err


def test_makefile_installs_the_packages_of_the_error(project_root):
    assert f"OPENGL_PACKAGES := {opengl.DEBIAN_PACKAGES}\n" in (project_root / "Makefile").read_text()
