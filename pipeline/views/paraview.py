"""open_in_paraview.py: a script for ParaView's Python that shows the variants of a result folder side by side."""

from collections.abc import Mapping
from pathlib import Path

from pipeline.formats.atomic import write_whole

SCRIPT_NAME = "open_in_paraview.py"
_GAP = 0.25  # of a body's width, between two of them


def write_script(folder: Path, indices: Mapping[str, str], *, radius: float) -> Path:
    """Write the script for variants by name, each with the file that lists its frames, and return its path.

    `radius` is r of the common color range [1 - r, 1 + r] of the volume ratio. Raises OutputError.
    """
    path = folder / SCRIPT_NAME
    text = _SCRIPT
    for mark, value in {
        "@VARIANTS@": _listed(indices),
        "@RADIUS@": f"{radius:g}",
        "@GAP@": f"{_GAP:g}",
        "@FOLDER@": repr(str(folder.resolve())),
    }.items():
        text = text.replace(mark, value)
    write_whole(path, text)
    return path


def _listed(indices: Mapping[str, str]) -> str:
    rows = [f"    ({name!r}, {index!r}),\n" for name, index in indices.items()]
    return "".join(["[\n", *rows, "]"])


_SCRIPT = '''"""The variants side by side in ParaView, colored by volume ratio.

    paraview --script=open_in_paraview.py          or, in the window: Tools > Python Shell > Run Script
    pvbatch open_in_paraview.py --screenshot picture.png [--time 0.35]     (without a screen: xvfb-run -a pvbatch …)

Points are where the bodies are now: do not apply Warp By Vector with `displacement`, that would double the motion.
"""

import math
import os
import sys

from paraview import simple

RADIUS = @RADIUS@  # colors from 1 - RADIUS to 1 + RADIUS
VARIANTS = @VARIANTS@  # name, file
INK = [0.1, 0.1, 0.15]


def folder():
    """Return the folder of this file; ParaView's window does not tell it: then where it was written, or started."""
    here = [os.path.dirname(os.path.abspath(__file__))] if "__file__" in globals() else []
    for place in [*here, @FOLDER@, os.getcwd()]:
        if os.path.isfile(os.path.join(place, *VARIANTS[0][1].split("/"))):
            return place
    raise SystemExit("open_in_paraview.py: no " + VARIANTS[0][1] + "; start ParaView in the folder of this file")


def source(name, path):
    """Return a reader of a variant's frames."""
    file = os.path.join(folder(), *path.split("/"))
    if not os.path.isfile(file):
        raise SystemExit("open_in_paraview.py: no file " + file)
    if file.endswith(".vtkhdf"):
        if simple.GetParaViewVersion() < (5, 13):  # it reads the file without its times, or not at all
            raise SystemExit("open_in_paraview.py: temporal .vtkhdf needs ParaView 5.13 or newer")
        return simple.VTKHDFReader(registrationName=name, FileName=[file])
    return simple.PVDReader(registrationName=name, FileName=file)


def whole_bounds(readers):
    """Return the bounds of all bodies over a few frames of the motion."""
    low, high = [1e300] * 3, [-1e300] * 3
    for reader in readers:
        times = list(reader.TimestepValues) or [0.0]
        for time in {times[round(i * (len(times) - 1) / 10)] for i in range(11)}:
            reader.UpdatePipeline(time)
            bounds = reader.GetDataInformation().GetBounds()
            low = [min(a, b) for a, b in zip(low, bounds[0::2])]
            high = [max(a, b) for a, b in zip(high, bounds[1::2])]
    return low, high


def show(view, reader, name, place, table):
    """Show a variant at a place."""
    moved = simple.Transform(registrationName=name + ", moved", Input=reader)
    moved.Transform.Translate = place
    display = simple.Show(moved, view)
    display.Representation = "Surface With Edges"
    display.EdgeColor = [0.3, 0.32, 0.38]
    simple.ColorBy(display, ("CELLS", "volume_ratio"))
    display.LookupTable = table
    return display


def write(view, item, where, size):
    """Show a text, at a corner or at (x, y) of the window."""
    text = simple.Show(item, view, "TextSourceRepresentation")
    text.Color, text.FontSize = INK, size
    text.WindowLocation = where if isinstance(where, str) else "Any Location"
    if not isinstance(where, str):
        text.Position = where


def color_bar(view, display, table):
    """Show the one bar: a diverging map about 1, its range fixed for all times."""
    display.SetScalarBarVisibility(view, True)
    bar = simple.GetScalarBar(table, view)
    bar.Title, bar.ComponentTitle = "volume ratio V / V0", ""
    bar.TitleColor = bar.LabelColor = INK
    bar.Orientation, bar.WindowLocation = "Horizontal", "Lower Center"
    bar.AutomaticLabelFormat, bar.LabelFormat, bar.RangeLabelFormat = 0, "%.2f", "%.2f"
    table.ApplyPreset("Cool to Warm", True)
    table.AutomaticRescaleRangeMode = "Never"
    table.RescaleTransferFunction(1 - RADIUS, 1 + RADIUS)


def scene():
    """Lay everything out; return the view."""
    simple._DisableFirstRenderCameraReset()
    view = simple.GetActiveViewOrCreate("RenderView")
    view.UseColorPaletteForBackground = 0
    view.Background = [1.0, 1.0, 1.0]
    readers = [source(name, path) for name, path in VARIANTS]
    low, high = whole_bounds(readers)
    size = [b - a for a, b in zip(low, high)]
    eye, right, up = directions(size)
    # a box of these sides, seen from there
    width, height = (sum(abs(a) * b for a, b in zip(axis, size)) for axis in (right, up))
    step = width * (1 + @GAP@)
    table = simple.GetColorTransferFunction("volume_ratio")
    for i, (reader, (name, _)) in enumerate(zip(readers, VARIANTS)):
        display = show(view, reader, name, [i * step * a for a in right], table)
    count = len(readers)
    aspect = view.ViewSize[0] / max(view.ViewSize[1], 1)
    half = 0.5 * max(count * step / aspect, height / 0.7)  # of the window's height, in meters
    for i, (name, _) in enumerate(VARIANTS):
        place = 0.5 + (i - (count - 1) / 2) * step / (2 * half * aspect)
        label = simple.Text(registrationName=name + ", label", Text=name.replace("_", " "))
        write(view, label, [place - 0.0045 * len(name), min(0.53 + height / (4 * half), 0.94)], 18)
    color_bar(view, display, table)
    clock = simple.AnnotateTimeFilter(registrationName="time", Input=readers[0], Format="t = {time:.3f} s")
    write(view, clock, "Lower Right Corner", 16)
    middle = [a + b / 2 + (count - 1) / 2 * step * c for a, b, c in zip(low, size, right)]
    away = 3 * (count * step + max(size))
    view.CameraFocalPoint = middle
    view.CameraPosition = [a + away * b for a, b in zip(middle, eye)]
    view.CameraViewUp = up
    view.CameraParallelProjection, view.CameraParallelScale = 1, half
    simple.GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
    return view


def directions(size):
    """Return unit vectors to the eye, to the right and up: z up, the longer of x and y to the side."""
    if size[2] < 1e-9 * max(size):  # planar
        return [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]
    a, b = (-0.42, -1.0) if size[0] > 1.5 * size[1] else (1.0, -0.42)
    flat, length = math.hypot(a, b), math.sqrt(a * a + b * b + 0.34**2)
    eye = [a / length, b / length, 0.34 / length]
    right = [-b / flat, a / flat, 0.0]
    up = [eye[1] * right[2] - eye[2] * right[1], eye[2] * right[0] - eye[0] * right[2], flat / length]
    return eye, right, up


def option(name):
    """Return what follows an option on the command line, None without it."""
    return sys.argv[sys.argv.index(name) + 1] if name in sys.argv[1:-1] else None


def main():
    """Show the scene; write a picture of it where that is asked for."""
    picture = option("--screenshot")
    if picture:
        simple.GetActiveViewOrCreate("RenderView").ViewSize = [1280, 720]
    view = scene()
    simple.GetAnimationScene().AnimationTime = float(option("--time") or view.ViewTime)
    simple.Render(view)
    if picture:
        simple.SaveScreenshot(picture, view, ImageResolution=[1280, 720])


main()
'''
