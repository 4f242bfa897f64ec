"""The bodies themselves: surfaces drawn off screen by VTK, updated in place from frame to frame.

Rendered at twice the size and averaged down: smoother than 4x multisampling and five times faster without a GPU.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.views.camera import Camera
from pipeline.views.palette import Palette
from pipeline.views.track import Track, find_sharp_edges

if TYPE_CHECKING:
    from PIL import Image

OVERSAMPLING = 2
CREASE_COLOUR, OUTLINE_COLOUR, EDGE_COLOUR = (0.16, 0.18, 0.24), (0.56, 0.58, 0.63), (0.13, 0.15, 0.22)
PanelState = tuple[int, bool]  # frame shown, whether the series has ended


class Canvas:
    """All panels in one off-screen window, side by side; `draw` returns one picture a panel.

    ensure_opengl() has to be called before.
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
        self._grab: Any = vtkWindowToImageFilter()
        self._grab.SetInput(window)
        self._grab.SetInputBufferTypeToRGB()
        self._grab.ReadFrontBufferOff()
        self._grab.ShouldRerenderOff()

    def draw(self, states: Sequence[PanelState]) -> "list[Image.Image]":
        """Return the picture of every panel, at its own size."""
        from PIL import Image
        from vtkmodules.util.numpy_support import vtk_to_numpy

        for body, (index, dimmed) in zip(self._bodies, states, strict=True):
            body.show(index, dimmed)
        self._window.Render()
        self._grab.Modified()
        self._grab.Update()
        size = self._grab.GetOutput().GetDimensions()[:2]
        pixels = vtk_to_numpy(self._grab.GetOutput().GetPointData().GetScalars())
        # VTK's first row is the lowest: hence -1
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
        # VTK looks into these two arrays: writing to them is all that a new frame takes
        self._points = track.rest.copy()
        self._colors = np.zeros((len(track.faces), 3), dtype=np.uint8)
        self._vtk_points: Any = vtkPoints()
        self._vtk_points.SetData(numpy_to_vtk(self._points))
        self._vtk_colors: Any = numpy_to_vtk(self._colors)
        creases, contour = find_sharp_edges(track.rest, track.faces, camera.toward)
        meters = camera.pixel_size(*panel)
        self._surface: Any = vtkPolyData()
        self._surface.SetPoints(self._vtk_points)
        self._surface.SetPolys(_cell_array(track.faces))
        self._surface.GetCellData().SetScalars(self._vtk_colors)
        self._creases = _lines(self._vtk_points, creases)
        rest_points: Any = vtkPoints()
        rest_points.SetData(numpy_to_vtk(track.rest, deep=True))
        scale = OVERSAMPLING * min(1.0, panel[1] / 400)
        self.renderer = _renderer(camera, meters * panel[1] / 2)
        self.renderer.AddActor(_surface_actor(self._surface, track, meters, scale))
        self._crease_actor = _line_actor(self._creases, CREASE_COLOUR, 1.1 * scale)
        self.renderer.AddActor(self._crease_actor)
        outline = _lines(rest_points, np.concatenate([creases, contour]))
        self.renderer.AddActor(_line_actor(outline, OUTLINE_COLOUR, 1.2 * scale))

    def show(self, index: int, dimmed: bool) -> None:
        """Put one frame in place."""
        self._points[:] = self.track.points[index]
        self._colors[:] = self._palette.map_colors(self.track.ratio[index], dimmed)
        self._crease_actor.GetProperty().SetOpacity(0.3 if dimmed else 1.0)
        for changed in (self._vtk_points, self._vtk_colors, self._surface, self._creases):
            changed.Modified()


def _cell_array(cells: Ints) -> Any:
    """Return VTK's cells for triangles (f, 3) or lines (k, 2)."""
    from vtkmodules.util.numpy_support import numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    array: Any = vtkCellArray()
    offsets = np.arange(len(cells) + 1, dtype=np.int64) * cells.shape[1]
    flat = np.ascontiguousarray(cells, dtype=np.int64).ravel()
    array.SetData(numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(flat, deep=True))
    return array


def _lines(points: Any, edges: Ints) -> Any:
    from vtkmodules.vtkCommonDataModel import vtkPolyData

    data: Any = vtkPolyData()
    data.SetPoints(points)
    data.SetLines(_cell_array(edges))
    return data


def _surface_actor(data: Any, track: Track, meters: float, scale: float) -> Any:
    from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

    mapper: Any = vtkPolyDataMapper()
    mapper.SetInputData(data)
    mapper.SetColorModeToDirectScalars()
    # pushes the surface back a little, so that lines lying on it are drawn whole
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(1.0, 1.0)
    actor: Any = vtkActor()
    actor.SetMapper(mapper)
    look = actor.GetProperty()
    look.SetInterpolationToFlat()
    # mostly ambient: a shaded color must still be found on the color bar; in the plane there is nothing to shade
    look.SetAmbient(1.0 if track.dimension == 2 else 0.62)
    look.SetDiffuse(0.0 if track.dimension == 2 else 0.50)
    corners = track.rest[track.faces]
    edge_pixels = float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))) / meters
    # below some pixels an edge, the lines would cover the colors: they fade out
    opacity = float(np.clip((edge_pixels - 3) / 15, 0.0, 1.0)) * 0.42
    if opacity > 0:
        look.EdgeVisibilityOn()
        look.SetEdgeColor(*EDGE_COLOUR)
        look.SetEdgeOpacity(opacity)
        look.SetLineWidth(0.8 * scale)
    return actor


def _line_actor(data: Any, color: tuple[float, float, float], width: float) -> Any:
    from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper

    mapper: Any = vtkPolyDataMapper()
    mapper.SetInputData(data)
    actor: Any = vtkActor()
    actor.SetMapper(mapper)
    look = actor.GetProperty()
    look.LightingOff()
    look.SetColor(*color)
    look.SetLineWidth(width)
    return actor


def _renderer(camera: Camera, half_height: float) -> Any:
    """Return a white renderer with the parallel camera and one light of its own."""
    from vtkmodules.vtkRenderingCore import vtkLight, vtkRenderer

    renderer: Any = vtkRenderer()
    renderer.SetBackground(1, 1, 1)
    # lights made automatically or added to a plotter reach every viewport and burn the colors out
    renderer.AutomaticLightCreationOff()
    light: Any = vtkLight()
    light.SetLightTypeToCameraLight()
    light.SetPosition(0.05, 0.30, 0.95)
    light.SetFocalPoint(0, 0, 0)
    renderer.AddLight(light)
    view = renderer.GetActiveCamera()
    depth = float(camera.high[2] - camera.low[2]) + half_height
    center: Floats = camera.center
    view.SetFocalPoint(*center)
    view.SetPosition(*(center + 2 * depth * camera.toward))
    view.SetViewUp(*camera.up)
    view.ParallelProjectionOn()
    view.SetParallelScale(half_height)
    view.SetClippingRange(0.5 * depth, 3.5 * depth)
    return renderer
