"""Finds the OpenGL window class that VTK can draw with on this machine, without ever crashing this process.

VTK's wheels contain no OpenGL. If the system has none, the first picture kills the whole process with a segmentation
fault, whatever the window class; so each class is tried in a child process that draws one flat color and reads it back.
"""

import os
import subprocess
import sys
from collections.abc import Iterator

from pipeline.errors import OutputError
from pipeline.system.child import make_command

# EGL needs no display, and OSMesa no driver either; GLX needs an X server and so is tried last.
WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow", "vtkXOpenGLRenderWindow")
VTK_CHOICE = "VTK_DEFAULT_OPENGL_WINDOW"
# the window class that works in the parent process, for its children: "window class|DISPLAY it was tried with"
FOUND = "PIPELINE_OPENGL_FOUND"
# A child takes 0.3 s on a quiet machine; the first one after an installation reads 300 MB of VTK from disk.
PROBE_SECONDS = 60.0
DEBIAN_PACKAGES = "libegl1 libgl1-mesa-dri"
INSTALL = (
    f"on Debian or Ubuntu: apt-get install -y --no-install-recommends {DEBIAN_PACKAGES}; "
    "elsewhere: Mesa's EGL or OSMesa (libEGL.so.1 with a software driver, or libOSMesa.so.8)"
)

_PROBE = "import sys; from pipeline.system.opengl import draw_pixel; draw_pixel(sys.argv[1])"

_working: str | None = None


def ensure_opengl() -> str:
    """Return the VTK window class that draws here, and set it in the environment for every window made from now on.

    Probes once per process; processes started from this one inherit the result. Raises OutputError if none draws.
    """
    global _working
    if _working is None:
        _working = _read_inherited() or _find_first()
        os.environ[FOUND] = f"{_working}|{os.environ.get('DISPLAY', '')}"
    os.environ[VTK_CHOICE] = _working
    return _working


def _read_inherited() -> str | None:
    """Return the window class that a parent process found with the same display and choice, None if there is none."""
    window, _, display = os.environ.get(FOUND, "").partition("|")
    same = display == os.environ.get("DISPLAY", "") and os.environ.get(VTK_CHOICE) == window
    return window if window and same else None


def _find_first() -> str:
    failures = []
    for window in _iterate_candidates():
        failure = _probe(window)
        if failure is None:
            return window
        failures.append(f"{window}: {failure}")
    raise OutputError(
        f"no OpenGL to draw with ({'; '.join(failures)}). "
        f"Everything but pictures and movies works without it. To have them, {INSTALL}"
    )


def _iterate_candidates() -> Iterator[str]:
    """Yield the user's own choice, then every class that can work here."""
    choice = os.environ.get(VTK_CHOICE)
    if choice:
        yield choice
    for window in WINDOWS:
        needs_display = window == "vtkXOpenGLRenderWindow"
        if window != choice and (os.environ.get("DISPLAY") or not needs_display):
            yield window


def _probe(window: str) -> str | None:
    """Return None if a child process can draw in this class of window, else the reason on one line."""
    environment = os.environ | {VTK_CHOICE: window}
    environment.pop("PYTHONFAULTHANDLER", None)  # its traces would hide the reason
    try:
        child = subprocess.run(
            make_command(_PROBE, window),
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
    lines = child.stderr.strip().splitlines()
    return lines[-1] if lines else f"exit status {child.returncode}"


def draw_pixel(window_class: str) -> None:
    """Draw one flat color in this class of window and read it back; exits with one line if that fails.

    Called in a child process only: VTK may crash it.
    """
    from vtkmodules import vtkRenderingOpenGL2  # noqa: F401  (registers the window classes)
    from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
    from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow

    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    window, renderer, pixel = vtkRenderWindow(), vtkRenderer(), vtkUnsignedCharArray()
    if window.GetClassName() != window_class:
        raise SystemExit(f"VTK made a {window.GetClassName()}")
    renderer.SetBackground(1.0, 0.0, 1.0)
    window.SetOffScreenRendering(True)
    window.SetMultiSamples(0)
    window.SetSize(32, 32)
    window.AddRenderer(renderer)
    window.Render()
    window.GetPixelData(16, 16, 16, 16, 0, pixel, 0)
    color = [pixel.GetValue(i) for i in range(3)]
    if color != [255, 0, 255]:
        raise SystemExit(f"drew {color} for [255, 0, 255]")


def main() -> int:
    """Return the exit status of `python -m pipeline.system.opengl`: 0 if pictures can be drawn, otherwise 1."""
    try:
        window = ensure_opengl()
    except OutputError as error:
        print(f"OpenGL: {error}", file=sys.stderr)
        return 1
    print(f"OpenGL: {window}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
