"""Figures of the report: the states that the thesis shows, and growth against rotation."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.formats.atomic import replace_file
from pipeline.series import Series
from pipeline.studies.thesis.growth_law import Growth
from pipeline.system.opengl import ensure_opengl
from pipeline.views.figures import make_panels, open_figure
from pipeline.views.palette import BLUE, INK, SOFT, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANEL = (400, 330)
_CAPTION_HEIGHT = 32
_STEEPEST = np.radians(85)  # beyond this, sec^2 leaves the picture


def write_states_figure(series: Mapping[str, Series], states: Mapping[str, Sequence[int]], path: Path) -> None:
    """Write a strip for each variant with the bodies at these frames, colored by volume ratio, one camera for all.

    Raises OutputError without OpenGL or if the file cannot be written.
    """
    from PIL import Image, ImageDraw

    from pipeline.views.camera import fit_camera
    from pipeline.views.movie.page import load_font
    from pipeline.views.movie.scene import Canvas
    from pipeline.views.palette import Palette
    from pipeline.views.track import choose_color_radius, read_track

    ensure_opengl()
    tracks = [read_track(run, name.replace("_", " ")) for name, run in series.items()]
    strips = [[i for i in states[name] if i < len(run)] for name, run in series.items()]
    radius = choose_color_radius(tracks)
    columns, rows = _choose_grid(max(len(strip) for strip in strips))
    (width, height), line = _PANEL, _CAPTION_HEIGHT
    page = Image.new("RGB", (columns * width, len(tracks) * rows * (height + line) + line), "white")
    draw = ImageDraw.Draw(page)
    canvas = Canvas(tracks, fit_camera(tracks), Palette(radius), _PANEL)
    try:
        for strip, index in ((strip, index) for strip, frames in enumerate(strips) for index in frames):
            picture = canvas.draw([(min(index, len(track.times) - 1), False) for track in tracks])[strip]
            row, column = divmod(strips[strip].index(index), columns)
            left, top = column * width, (strip * rows + row) * (height + line)
            page.paste(picture, (left, top + line))
            text = f"{tracks[strip].label}, iteration {index}: V/V₀ up to {tracks[strip].high[index]:.3f}"
            draw.text((left + width / 2, top + line / 2), text, INK, load_font(16), anchor="mm")
    finally:
        canvas.close()
    legend = f"color: blue V/V₀ ≤ {1 - radius:.2f}, gray 1, red ≥ {1 + radius:.2f}; magenta inverted; thin: rest shape"
    draw.text((page.width / 2, page.height - line / 2), legend, SOFT, load_font(16), anchor="mm")
    with replace_file(path) as hidden:
        page.save(hidden, format="PNG", optimize=True)


def _choose_grid(count: int) -> tuple[int, int]:
    """Return columns and rows for some pictures: at most four in a single row, three in each of several."""
    columns = count if count <= 4 else 3
    return columns, -(-count // columns)


def write_law_figure(growths: Mapping[str, Growth], path: Path, *, across: str) -> None:
    """Write J against an angle, a panel for each scene: every cell of every frame, and the curve sec^2."""
    columns = min(len(growths), 4)
    rows = -(-len(growths) // columns)
    with open_figure(path, (1.0 + 3.4 * columns, 0.9 + 3.2 * rows), dpi=130) as figure:
        panels = make_panels(figure, len(growths), columns)
        for axes, (name, growth) in zip(panels, growths.items(), strict=True):
            axes.set_title(name.replace("_", " "), loc="left", fontsize=11)
            _draw_growth(axes, growth)
        figure.supxlabel(f"{across} [degrees]", fontsize=10)
        figure.supylabel("volume ratio V / V₀", fontsize=10)


def _draw_growth(axes: "Axes", growth: Growth) -> None:
    """Draw the points of one scene and the curve over them."""
    degrees = np.degrees(growth.angle)
    axes.plot(degrees, growth.ratio, ".", color=BLUE, markersize=1.6, alpha=0.35, rasterized=True)
    end = min(float(growth.angle.max(initial=1e-4)) * 1.05, float(_STEEPEST))
    curve = np.linspace(0, end, 200)
    axes.plot(np.degrees(curve), 1 / np.cos(curve) ** 2, color=VERMILION, linewidth=1.8, label="sec²")
    high = max(float(growth.ratio.max(initial=1.0)), 1.01)
    low = min(float(growth.ratio.min(initial=1.0)), 0.99)
    axes.set_ylim(low - 0.05 * (high - low), high + 0.08 * (high - low))
    axes.set_xlim(0, float(np.degrees(end)))
    axes.spines["right"].set_visible(False)
    axes.legend(loc="upper left", frameon=False, fontsize=9)
