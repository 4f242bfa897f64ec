"""The bodies: surfaces drawn off screen by VTK, updated in place from frame to frame.

They are drawn at twice the size and averaged: smoother than 4x multisampling, and five times faster without a GPU.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Ints
from pipeline.views.camera import Camera
from pipeline.views.palette import OUTLINE, Palette
from pipeline.views.track import Track, find_sharp_edges

if TYPE_CHECKING:
    from PIL import Image

OVERSAMPLING = 2
CREASE_COLOR, EDGE_COLOR = (0.16, 0.18, 0.24), (0.13, 0.15, 0.22)
PanelState = tuple[int, bool]  # index of the frame shown, whether the series has ended
# mostly ambient: a shaded color must still be found on the color bar; the faint remainder shows the relief
AMBIENT, DIFFUSE = 0.62, 0.50
EDGE_OPACITY = 0.42  # the largest, of the lines between cells: they show, but cells keep their colors


class Canvas:
    """All panels side by side in one off-screen window; `draw` returns one picture for each panel.

    Call ensure_opengl() first.
    """

    def __init__(self, tracks: Sequence[Track], camera: Camera, palette: Palette, panel: tuple[int, int]) -> None:
        import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  (registers the OpenGL classes)
        from vtkmodules.vtkRenderingCore import vtkRenderWindow, vtkWindowToImageFilter

        self._panel, self._count = panel, len(tracks)
        window: Any = vtkRenderWindow()
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(0)
        window.SetSize(OVERSAMPLING * panel[0] * len(tracks), OVERSAMPLING * panel[1])
        self._bodies = [_Body(track, camera, palette, panel) for track in tracks]
        for i, body in enumerate(self._bodies):
            body.renderer.SetViewport(i / len(tracks), 0, (i + 1) / len(tracks), 1)
            window.AddRenderer(body.renderer)
        self._window = window
        self._grabber: Any = vtkWindowToImageFilter()
        self._grabber.SetInput(window)
        self._grabber.SetInputBufferTypeToRGB()
        self._grabber.ReadFrontBufferOff()
        self._grabber.ShouldRerenderOff()

    def draw(self, states: Sequence[PanelState]) -> "list[Image.Image]":
        """Return the picture of every panel, each of the panel's size."""
        from PIL import Image
        from vtkmodules.util.numpy_support import vtk_to_numpy

        for body, (index, dimmed) in zip(self._bodies, states, strict=True):
            body.show(index, dimmed)
        self._window.Render()
        self._grabber.Modified()
        self._grabber.Update()
        size = self._grabber.GetOutput().GetDimensions()[:2]
        pixels = vtk_to_numpy(self._grabber.GetOutput().GetPointData().GetScalars())
        # -1, as VTK's first row is the lowest
        whole = Image.frombuffer("RGB", size, pixels, "raw", "RGB", 0, -1).reduce(OVERSAMPLING)
        width, height = self._panel
        return [whole.crop((i * width, 0, (i + 1) * width, height)) for i in range(self._count)]

    def close(self) -> None:
        """Free the window."""
        self._window.Finalize()


class _Body:
    """One panel: the deforming surface with its creases, and the outline of the rest shape."""

    def __init__(self, track: Track, camera: Camera, palette: Palette, panel: tuple[int, int]) -> None:
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonCore import vtkPoints
        from vtkmodules.vtkCommonDataModel import vtkPolyData

        self.track, self._palette = track, palette
        # VTK shares the memory of these two arrays: a new frame only has to be written into them
        self._points = track.rest.copy()
        self._colors = np.zeros((len(track.faces), 3), dtype=np.uint8)
        self._vtk_points: Any = vtkPoints()
        self._vtk_points.SetData(numpy_to_vtk(self._points))
        self._vtk_colors: Any = numpy_to_vtk(self._colors)
        creases, contour = find_sharp_edges(track.rest, track.faces, camera.toward)
        pixel = camera.fit_pixel(*panel)
        self._surface: Any = vtkPolyData()
        self._surface.SetPoints(self._vtk_points)
        self._surface.SetPolys(_make_cell_array(track.faces))
        self._surface.GetCellData().SetScalars(self._vtk_colors)
        self._creases = _make_lines(self._vtk_points, creases)
        rest_points: Any = vtkPoints()
        rest_points.SetData(numpy_to_vtk(track.rest, deep=True))
        scale = OVERSAMPLING * min(1.0, panel[1] / 400)
        self.renderer = _make_renderer(camera, pixel * panel[1] / 2)
        opacity = _fade_edges(track, pixel)
        actor = _make_surface_actor(self._surface, flat=track.normal is not None)
        self.renderer.AddActor(actor)
        self._lines: Any = None
        if track.lines is None:
            _show_sides(actor, opacity, 0.8 * scale)
        elif opacity > 0:
            self._lines = _make_lines(self._vtk_points, track.lines)
            self.renderer.AddActor(_make_line_actor(self._lines, EDGE_COLOR, 0.8 * scale, opacity))
        self._crease_actor = _make_line_actor(self._creases, CREASE_COLOR, 1.1 * scale)
        self.renderer.AddActor(self._crease_actor)
        r, g, b = OUTLINE
        outline = _make_lines(rest_points, np.concatenate([creases, contour]))
        self.renderer.AddActor(_make_line_actor(outline, (r / 255, g / 255, b / 255), 1.2 * scale))

    def show(self, index: int, dimmed: bool) -> None:
        """Update the surface to one frame."""
        self._points[:] = self.track.points[index]
        self._colors[:] = self._palette.map_colors(self.track.ratio[index], dimmed)
        self._crease_actor.GetProperty().SetOpacity(0.3 if dimmed else 1.0)
        for changed in (self._vtk_points, self._vtk_colors, self._surface, self._creases, self._lines):
            if changed is not None:
                changed.Modified()


def _make_cell_array(cells: Ints) -> Any:
    """Return triangles (f, 3) or lines (k, 2) as VTK's cells."""
    from vtkmodules.util.numpy_support import numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    array: Any = vtkCellArray()
    offsets = np.arange(len(cells) + 1, dtype=np.int64) * cells.shape[1]
    flat = np.ascontiguousarray(cells, dtype=np.int64).ravel()
    array.SetData(numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(flat, deep=True))
    return array


def _make_lines(points: Any, edges: Ints) -> Any:
    from vtkmodules.vtkCommonDataModel import vtkPolyData

    data: Any = vtkPolyData()
    data.SetPoints(points)
    data.SetLines(_make_cell_array(edges))
    return data


def _make_surface_actor(data: Any, *, flat: bool) -> Any:
    from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

    mapper: Any = vtkPolyDataMapper()
    mapper.SetInputData(data)
    mapper.SetColorModeToDirectScalars()
    # pushes the surface back a little, so that lines on it are drawn whole
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(1.0, 1.0)
    actor: Any = vtkActor()
    actor.SetMapper(mapper)
    look = actor.GetProperty()
    look.SetInterpolationToFlat()
    # in the plane there is nothing to shade
    look.SetAmbient(1.0 if flat else AMBIENT)
    look.SetDiffuse(0.0 if flat else DIFFUSE)
    return actor


def _fade_edges(track: Track, pixel: float) -> float:
    """Return the opacity of the lines between cells: those of a few pixels would hide the colors."""
    corners = track.rest[track.faces]
    if track.lines is None:
        size = float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))
    else:  # a face of a cell may be many triangles
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        ends = track.rest[track.lines]
        around = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())
        size = 2 * float(areas.sum()) / max(around, 1e-300)  # the side, in a mesh of squares
    # they fade out from 18 pixels down to 3
    return float(np.clip((size / pixel - 3) / 15, 0.0, 1.0)) * EDGE_OPACITY


def _show_sides(actor: Any, opacity: float, width: float) -> None:
    """Let an actor draw the sides of its triangles."""
    if not opacity:
        return
    look = actor.GetProperty()
    look.EdgeVisibilityOn()
    look.SetEdgeColor(*EDGE_COLOR)
    look.SetEdgeOpacity(opacity)
    look.SetLineWidth(width)


def _make_line_actor(data: Any, color: tuple[float, float, float], width: float, opacity: float = 1.0) -> Any:
    from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

    mapper: Any = vtkPolyDataMapper()
    mapper.SetInputData(data)
    actor: Any = vtkActor()
    actor.SetMapper(mapper)
    look = actor.GetProperty()
    look.LightingOff()
    look.SetColor(*color)
    look.SetOpacity(opacity)
    look.SetLineWidth(width)
    return actor


def _make_renderer(camera: Camera, half_height: float) -> Any:
    """Return a white renderer with the parallel camera and a light of its own."""
    from vtkmodules.vtkRenderingCore import vtkLight, vtkRenderer

    renderer: Any = vtkRenderer()
    renderer.SetBackground(1, 1, 1)
    # automatic lights, and those of a plotter, reach every viewport and overexpose the colors
    renderer.AutomaticLightCreationOff()
    light: Any = vtkLight()
    light.SetLightTypeToCameraLight()
    light.SetPosition(0.05, 0.30, 0.95)
    light.SetFocalPoint(0, 0, 0)
    renderer.AddLight(light)
    view = renderer.GetActiveCamera()
    depth = float(camera.high[2] - camera.low[2]) + half_height
    view.SetFocalPoint(*camera.center)
    view.SetPosition(*(camera.center + 2 * depth * camera.toward))
    view.SetViewUp(*camera.up)
    view.ParallelProjectionOn()
    view.SetParallelScale(half_height)
    view.SetClippingRange(0.5 * depth, 3.5 * depth)
    return renderer
