"""Figures of the report: the states that the thesis shows, and growth against rotation."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.formats.atomic import replace_file
from pipeline.series import Series
from pipeline.studies.thesis.growth_law import Growth
from pipeline.system.opengl import ensure_opengl

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANEL = (400, 330)
# angles beyond this part of 90 degrees send sec^2 out of the picture
_STEEPEST = np.radians(85)


def write_states_figure(series: Mapping[str, Series], states: Mapping[str, Sequence[int]], path: Path) -> None:
    """Write a strip a variant with the bodies at the given frames, coloured by volume ratio, one camera for all.

    Raises OutputError without OpenGL or where it cannot write.
    """
    from PIL import Image, ImageDraw

    from pipeline.views.camera import fit_camera
    from pipeline.views.movie.page import load_font
    from pipeline.views.movie.scene import Canvas
    from pipeline.views.palette import Palette
    from pipeline.views.track import choose_color_radius, read_track

    ensure_opengl()
    tracks = [read_track(one, name.replace("_", " ")) for name, one in series.items()]
    shown = [[i for i in states[name] if i < len(one)] for name, one in series.items()]
    radius = choose_color_radius(tracks)
    columns, deep = _choose_grid(max(len(row) for row in shown))
    (width, height), line = _PANEL, 32
    page = Image.new("RGB", (columns * width, len(tracks) * deep * (height + line) + line), "white")
    draw = ImageDraw.Draw(page)
    scene = Canvas(tracks, fit_camera(tracks), Palette(radius), _PANEL)
    try:
        for row, index in ((row, index) for row, frames in enumerate(shown) for index in frames):
            picture = scene.draw([(min(index, len(t.times) - 1), False) for t in tracks])[row]
            down, across = divmod(shown[row].index(index), columns)
            left, top = across * width, (row * deep + down) * (height + line)
            page.paste(picture, (left, top + line))
            text = f"{tracks[row].label}, iteration {index}: V/V₀ up to {tracks[row].high[index]:.3f}"
            draw.text((left + width / 2, top + line / 2), text, "#1b1e28", load_font(16), anchor="mm")
    finally:
        scene.close()
    legend = f"colour: blue V/V₀ ≤ {1 - radius:.2f}, grey 1, red ≥ {1 + radius:.2f}; magenta inverted; thin: rest shape"
    draw.text((page.width / 2, page.height - line / 2), legend, "#5a6070", load_font(16), anchor="mm")
    with replace_file(path) as hidden:
        page.save(hidden, format="PNG", optimize=True)


def _choose_grid(count: int) -> tuple[int, int]:
    """Return columns and rows for some pictures: four in a row at most, and no row of one."""
    columns = count if count <= 4 else 3
    return columns, -(-count // columns)


def write_law_figure(growths: Mapping[str, Growth], path: Path, *, across: str) -> None:
    """Write J against an angle, a panel a scene: every cell of every frame, and the curve sec^2."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from pipeline.views.figures import STYLE

    columns = min(len(growths), 4)
    rows = -(-len(growths) // columns)
    with rc_context(STYLE):
        figure = Figure(figsize=(1.0 + 3.4 * columns, 0.9 + 3.2 * rows), dpi=130)
        FigureCanvasAgg(figure)
        figure.set_layout_engine("constrained")
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes, (name, growth) in zip(grid.ravel(), growths.items(), strict=False):
            axes.set_title(name.replace("_", " "), loc="left", fontsize=11)
            _draw_growth(axes, growth)
        for empty in grid.ravel()[len(growths) :]:
            empty.set_visible(False)
        figure.supxlabel(f"{across} [degrees]", fontsize=10)
        figure.supylabel("volume ratio V / V₀", fontsize=10)
        with replace_file(path) as hidden:
            metadata: dict[str, Any] = {"Software": None}  # the same results are the same bytes
            figure.savefig(hidden, metadata=metadata)


def _draw_growth(axes: "Axes", growth: Growth) -> None:
    """Draw the points of one scene and the curve over them."""
    degrees = np.degrees(growth.angle)
    axes.plot(degrees, growth.ratio, ".", color="#0072B2", markersize=1.6, alpha=0.35, rasterized=True)
    end = min(float(growth.angle.max(initial=1e-4)) * 1.05, float(_STEEPEST))
    curve = np.linspace(0, end, 200)
    axes.plot(np.degrees(curve), 1 / np.cos(curve) ** 2, color="#D55E00", linewidth=1.8, label="sec²")
    high = max(float(growth.ratio.max(initial=1.0)), 1.01)
    low = min(float(growth.ratio.min(initial=1.0)), 0.99)
    axes.set_ylim(low - 0.05 * (high - low), high + 0.08 * (high - low))
    axes.set_xlim(0, float(np.degrees(end)))
    axes.spines["right"].set_visible(False)
    axes.legend(loc="upper left", frameon=False, fontsize=9)
