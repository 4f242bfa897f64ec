"""Finds the OpenGL window class that VTK can draw with on this machine, without ever crashing this process.

VTK's wheels carry no OpenGL. Where the system has none, the first picture ends the whole process with a
segmentation fault, whatever the window class; so each class is tried in a child process that draws one flat
colour and reads it back.
"""

import os
import subprocess
import sys
from collections.abc import Iterator

from pipeline.errors import OutputError

# EGL needs no display, OSMesa no driver either; GLX needs an X server and so is tried last.
WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", "vtkXOpenGLRenderWindow")
VTK_CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"
# What a parent process has found to work, for its children: "class of window|DISPLAY it was tried with".
FOUND = "PIPELINE_OPENGL_FOUND"
# A child takes 0.3 s on a quiet machine; the first one after an installation reads 300 MB of VTK from disk.
PROBE_SECONDS = 60.0
DEBIAN_PACKAGES = "libegl1 libgl1-mesa-dri"
INSTALL = (
    f"on Debian or Ubuntu: apt-get install -y --no-install-recommends {DEBIAN_PACKAGES}; "
    "elsewhere: Mesa's EGL or OSMesa (libEGL.so.1 with a software driver, or libOSMesa.so.8)"
)

_PROBE = """
import resource, sys
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
import vtkmodules.vtkRenderingOpenGL2
window, renderer, pixel = vtkRenderWindow(), vtkRenderer(), vtkUnsignedCharArray()
if window.GetClassName() != sys.argv[1]:
    sys.exit(f"VTK made a {window.GetClassName()}")
renderer.SetBackground(1.0, 0.0, 1.0)
window.SetOffScreenRendering(True)
window.SetMultiSamples(0)
window.SetSize(32, 32)
window.AddRenderer(renderer)
window.Render()
window.GetPixelData(16, 16, 16, 16, 0, pixel, 0)
colour = [pixel.GetValue(i) for i in range(3)]
if colour != [255, 0, 255]:
    sys.exit(f"drew {colour} for [255, 0, 255]")
"""

_working: str | None = None


def ensure_opengl() -> str:
    """Name of the VTK window class that draws here, set in the environment for every window made from now on.

    Probes once per process; processes started from this one inherit the finding. Raises OutputError where
    nothing draws.
    """
    global _working
    if _working is None:
        _working = _inherited() or _first_that_draws()
        os.environ[FOUND] = f"{_working}|{os.environ.get('DISPLAY', '')}"
    os.environ[VTK_CHOICE] = _working
    return _working


def _inherited() -> str | None:
    """What a parent process found with the same display and the same wish, None without one."""
    window, _, display = os.environ.get(FOUND, "").partition("|")
    same = display == os.environ.get("DISPLAY", "") and os.environ.get(VTK_CHOICE) == window
    return window if window and same else None


def _first_that_draws() -> str:
    failures = []
    for window in _candidates():
        failure = _probe(window)
        if failure is None:
            return window
        failures.append(f"{window}: {failure}")
    raise OutputError(
        f"no OpenGL to draw with ({'; '.join(failures)}). "
        f"Everything but pictures and movies is there. To have them, {INSTALL}"
    )


def _candidates() -> Iterator[str]:
    """The user's own choice first, then every class that can work here."""
    wish = os.environ.get(VTK_CHOICE)
    if wish:
        yield wish
    for window in WINDOWS:
        needs_display = window == "vtkXOpenGLRenderWindow"
        if window != wish and (os.environ.get("DISPLAY") or not needs_display):
            yield window


def _probe(window: str) -> str | None:
    """None where a child process could draw in this class of window, else one line that says why not."""
    command = [sys.executable, "-P", "-c", _PROBE, window]
    environment = os.environ | {VTK_CHOICE: window}
    environment.pop("PYTHONFAULTHANDLER", None)  # its traces would drown the reason
    try:
        child = subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBE_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return f"no picture within {PROBE_SECONDS:g} s"
    except OSError as error:
        return f"no child process: {error}"
    if child.returncode == 0:
        return None
    if child.returncode < 0:
        return f"ended by signal {-child.returncode}"
    said = child.stderr.strip().splitlines()
    return said[-1] if said else f"exit status {child.returncode}"


def main() -> int:
    """Exit status of `python -m pipeline.system.opengl`: 0 where pictures can be drawn, 1 where not."""
    try:
        window = ensure_opengl()
    except OutputError as error:
        print(f"OpenGL: {error}", file=sys.stderr)
        return 1
    print(f"OpenGL: {window}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
