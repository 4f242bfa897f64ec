"""The variants side by side in ParaView, colored by volume ratio.

    paraview --script=open_in_paraview.py          or, in the window: Tools > Python Shell > Run Script
    pvbatch open_in_paraview.py --screenshot picture.png [--time 0.35]     (without a display: xvfb-run -a pvbatch …)

Points are at their deformed positions: do not apply Warp By Vector with `displacement`, which would double the motion.
"""

import math
import os
import sys
from typing import Any

from paraview import simple

# BEGIN VALUES (views/paraview.py writes those of a result folder here)
RADIUS = 1.0  # colors from 1 - RADIUS to 1 + RADIUS
VARIANTS = [("name", "name/series.pvd")]  # name, file
FOLDER = ""  # the folder of this file when it was written
NORMAL = None  # of planar bodies, if known
ASIDE, RAISED, LONG = 0.0, 0.0, 1.0  # the movie's camera: see views/camera.py
# END VALUES

INK = [0.1, 0.1, 0.15]
GAP = 0.25  # between two bodies, in widths of a body
BODY_HEIGHT = 0.7  # largest share of the window's height that a body may fill: labels above, the color bar below
PICTURE_SIZE = [1280, 720]


def find_folder() -> str:
    """Return the folder of this file; if ParaView's window hides it, the one it was written to or started in."""
    own = [os.path.dirname(os.path.abspath(__file__))] if "__file__" in globals() else []
    for folder in [*own, FOLDER, os.getcwd()]:
        if os.path.isfile(os.path.join(folder, *VARIANTS[0][1].split("/"))):
            return folder
    raise SystemExit("open_in_paraview.py: no " + VARIANTS[0][1] + "; start ParaView in the folder of this file")


def open_reader(name: str, path: str) -> Any:
    """Return a reader of a variant's frames."""
    file = os.path.join(find_folder(), *path.split("/"))
    if not os.path.isfile(file):
        raise SystemExit("open_in_paraview.py: no file " + file)
    if file.endswith(".vtkhdf"):
        if simple.GetParaViewVersion() < (5, 13):  # it reads the file without its times, or not at all
            raise SystemExit("open_in_paraview.py: temporal .vtkhdf needs ParaView 5.13 or newer")
        return simple.VTKHDFReader(registrationName=name, FileName=[file])
    return simple.PVDReader(registrationName=name, FileName=file)


def measure_bounds(readers: list[Any]) -> tuple[list[float], list[float]]:
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


def choose_directions(size: list[float]) -> tuple[list[float], list[float], list[float]]:
    """Return unit vectors toward the eye, to the right and up: z is up, the longer of x and y lies across."""
    normal = find_normal(size)
    if normal is not None:
        return face_plane(normal)
    a, b = (ASIDE, -1.0) if size[0] > LONG * size[1] else (1.0, ASIDE)
    flat, length = math.hypot(a, b), math.sqrt(a * a + b * b + RAISED**2)
    eye = [a / length, b / length, RAISED / length]
    right = [-b / flat, a / flat, 0.0]
    up = [eye[1] * right[2] - eye[2] * right[1], eye[2] * right[0] - eye[0] * right[2], flat / length]
    return eye, right, up


def find_normal(size: list[float]) -> Any:
    """Return the normal of planar bodies, given the size of their bounding box; None for others."""
    if NORMAL is not None:
        return list(NORMAL)
    flat = [i for i in range(3) if size[i] < 1e-9 * max(size)]
    return [float(i == flat[-1]) for i in range(3)] if flat else None


def face_plane(normal: list[float]) -> tuple[list[float], list[float], list[float]]:
    """Return unit vectors toward the eye, to the right and up in a plane: z is up, or y in a plane of constant z."""
    x, y, z = normal
    right = [z, 0.0, -x] if abs(z) > 0.999 else [-y, x, 0.0]  # up x normal
    length = math.sqrt(sum(a * a for a in right)) * (1 if max(right, key=abs) > 0 else -1)
    right = [a / length for a in right]
    eye = [n * math.copysign(1.0, length) for n in normal]
    up = [eye[(i + 1) % 3] * right[(i + 2) % 3] - eye[(i + 2) % 3] * right[(i + 1) % 3] for i in range(3)]
    return eye, right, up


def show_body(view: Any, reader: Any, name: str, place: list[float], table: Any) -> Any:
    """Show a variant at a place and return its display."""
    moved = simple.Transform(registrationName=name + ", moved", Input=reader)
    moved.Transform.Translate = place
    display = simple.Show(moved, view)
    display.Representation = "Surface With Edges"
    display.EdgeColor = [0.3, 0.32, 0.38]
    display.NonlinearSubdivisionLevel = 2  # sides of curved cells become 4 lines; ParaView itself draws 2
    simple.ColorBy(display, ("CELLS", "volume_ratio"))
    display.LookupTable = table
    return display


def show_text(view: Any, item: Any, size: int) -> Any:
    """Show text and return its display."""
    text = simple.Show(item, view, "TextSourceRepresentation")
    text.Color, text.FontSize = INK, size
    return text


def show_color_bar(view: Any, display: Any, table: Any) -> None:
    """Show the shared color bar: a diverging map about 1, with one range for all times."""
    display.SetScalarBarVisibility(view, True)
    bar = simple.GetScalarBar(table, view)
    bar.Title, bar.ComponentTitle = "volume ratio V / V0", ""
    bar.TitleColor = bar.LabelColor = INK
    bar.Orientation, bar.WindowLocation = "Horizontal", "Lower Center"
    bar.AutomaticLabelFormat, bar.LabelFormat, bar.RangeLabelFormat = 0, "%.2f", "%.2f"
    table.ApplyPreset("Cool to Warm", True)
    table.AutomaticRescaleRangeMode = "Never"
    table.RescaleTransferFunction(1 - RADIUS, 1 + RADIUS)


def place_camera(view: Any, middle: list[float], away: float, eye: list[float], up: list[float], half: float) -> None:
    """Aim the parallel camera at a point; `half` is half the window's height [m]."""
    view.CameraFocalPoint = middle
    view.CameraPosition = [a + away * b for a, b in zip(middle, eye)]
    view.CameraViewUp = up
    view.CameraParallelProjection, view.CameraParallelScale = 1, half


def build_scene() -> Any:
    """Show bodies, labels, color bar and clock; return the view."""
    simple._DisableFirstRenderCameraReset()
    view = simple.GetActiveViewOrCreate("RenderView")
    view.UseColorPaletteForBackground = 0
    view.Background = [1.0, 1.0, 1.0]
    readers = [open_reader(name, path) for name, path in VARIANTS]
    low, high = measure_bounds(readers)
    size = [b - a for a, b in zip(low, high)]
    eye, right, up = choose_directions(size)
    # those of the box as seen from there
    width, height = (sum(abs(a) * b for a, b in zip(axis, size)) for axis in (right, up))
    step, count = width * (1 + GAP), len(readers)
    aspect = view.ViewSize[0] / max(view.ViewSize[1], 1)
    half = 0.5 * max(count * step / aspect, height / BODY_HEIGHT)  # of the window's height, in meters
    table = simple.GetColorTransferFunction("volume_ratio")
    for i, (reader, (name, _)) in enumerate(zip(readers, VARIANTS)):
        display = show_body(view, reader, name, [i * step * a for a in right], table)
        label = simple.Text(registrationName=name + ", label", Text=name.replace("_", " "))
        text = show_text(view, label, 18)
        text.WindowLocation = "Any Location"
        # centered: a letter is about 0.009 of the window's width
        across = 0.5 + (i - (count - 1) / 2) * step / (2 * half * aspect) - 0.0045 * len(name)
        text.Position = [across, min(0.53 + height / (4 * half), 0.94)]
    show_color_bar(view, display, table)
    clock = simple.AnnotateTimeFilter(registrationName="time", Input=readers[0], Format="t = {time:.3f} s")
    show_text(view, clock, 16).WindowLocation = "Lower Right Corner"
    middle = [a + b / 2 + (count - 1) / 2 * step * c for a, b, c in zip(low, size, right)]
    place_camera(view, middle, 3 * (count * step + max(size)), eye, up, half)
    simple.GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
    return view


def read_option(name: str) -> str:
    """Return the argument after an option on the command line; empty if there is none."""
    return sys.argv[sys.argv.index(name) + 1] if name in sys.argv[1:-1] else ""


def main() -> None:
    """Show the scene; write a picture of it if the command line asks for one."""
    picture = read_option("--screenshot")
    if picture:
        simple.GetActiveViewOrCreate("RenderView").ViewSize = PICTURE_SIZE
    view = build_scene()
    simple.GetAnimationScene().AnimationTime = float(read_option("--time") or view.ViewTime)
    simple.Render(view)
    if picture:
        simple.SaveScreenshot(picture, view, ImageResolution=PICTURE_SIZE)


main()
