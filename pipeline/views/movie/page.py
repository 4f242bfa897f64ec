"""The page around the bodies: title, panel texts, curves of total volume, color bar and clock, drawn by PIL.

Static parts are drawn once; each frame pastes the bodies into a copy and adds its numbers.
"""

from collections.abc import Sequence
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.views.camera import Camera
from pipeline.views.movie.layout import PictureLayout, Rect
from pipeline.views.movie.scene import OVERSAMPLING, PanelState
from pipeline.views.palette import (
    CURVE_AHEAD,
    FAILED,
    FAINT,
    FILM_INK,
    FILM_RULE,
    INVERTED,
    OUTLINE,
    SOFT,
    UNKNOWN,
    Palette,
)
from pipeline.views.track import Track, find_clipped_ends

if TYPE_CHECKING:
    from PIL import Image, ImageFont

Color = str | tuple[int, int, int]
USUAL = "total volume 100.0 %     V/V₀ from 0.00 to 0.000"  # the text that sizes the numbers of a panel


@cache
def load_font(size: int, bold: bool = False) -> "ImageFont.FreeTypeFont":
    """Return DejaVu Sans as bundled with matplotlib, so that the picture is the same on every machine."""
    import matplotlib
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), size)


def _fit_font(draw: Any, text: str, size: float, width: float, bold: bool = False) -> "ImageFont.FreeTypeFont":
    """Return the largest font up to a size in which text is no wider than `width`; at least 6 pixels."""
    pixels = int(size)
    while pixels > 6 and draw.textlength(text, load_font(pixels, bold)) > width:
        pixels -= 1
    return load_font(max(pixels, 6), bold)


class Page:
    """A page with all panels; `compose` returns its picture at one time."""

    def __init__(
        self, tracks: Sequence[Track], layout: PictureLayout, camera: Camera, palette: Palette, title: str, note: str
    ) -> None:
        self._tracks, self._layout, self._palette = tracks, layout, palette
        self._start = min(float(track.times[0]) for track in tracks)
        self._end = max(float(track.times[-1]) for track in tracks)
        digits = 3 if palette.radius < 0.1 else 2
        self._ratio_format = f".{digits}f"
        totals = np.concatenate([[1.0], *(track.total[np.isfinite(track.total)] for track in tracks)])
        # the axis spans at least half a percent: rounding must not look like a drift
        self._total_low = min(float(totals.min()), 0.9975)
        self._total_high = max(float(totals.max()), 1.0025)
        # enough decimals to tell the frames apart
        step = min((float(np.diff(t.times).min()) for t in tracks if len(t.times) > 1), default=1.0)
        self._time_digits = int(np.clip(np.ceil(-np.log10(max(step, 1e-9))), 2, 6))
        self._still = self._draw_still(title, note, camera)

    def compose(self, panels: "Sequence[Image.Image]", states: Sequence[PanelState], time: float) -> "Image.Image":
        """Return the page with these pictures of the bodies, their numbers, and the clock at this time."""
        from PIL import ImageDraw

        page = self._still.copy()
        draw = ImageDraw.Draw(page)
        for track, rect, picture, state in zip(self._tracks, self._layout.panels, panels, states, strict=True):
            page.paste(picture, self._layout.place_body(rect)[:2])
            self._write_numbers(draw, track, rect, state)
            self._mark_curve(page, track, rect, state[0])
        s, layout = self._layout.unit, self._layout
        clock = f"t = {time:.{self._time_digits}f} s"
        place = (layout.size[0] - 32 * s, layout.footer + 44 * s)
        draw.text(place, clock, FILM_INK, load_font(round(19 * s)), anchor="rm")
        return page

    def _write_numbers(self, draw: Any, track: Track, rect: Rect, state: PanelState) -> None:
        index, ended = state
        left, top, right, _ = rect
        s, width = self._layout.unit, right - left
        low, high = (format(v, self._ratio_format) for v in (track.low[index], track.high[index]))
        gap, total, parts = track.find_gap(index), track.total[index], list[tuple[str, Color]]()
        span = f"     V/V₀ from {low} to {high}" if gap is None else ""
        if ended:
            parts.append((f"ends at t = {track.times[-1]:.{self._time_digits}f} s", FAILED))
        elif np.isfinite(total):
            span = f"total volume {100 * total:.1f} %{span}"
        if span.strip():
            parts.append((span if parts else span.strip(), SOFT))
        if track.inverted[index] and not ended:
            parts.append((f"     {track.inverted[index]} inverted", INVERTED))
        if gap is not None:
            space = "     " if parts else ""
            parts.append((f"{space}no cell data from t = {gap:.{self._time_digits}f} s", FAILED))
        elif track.unknown[index]:
            parts.append((f"     {track.unknown[index]} cells without data", FAILED))
        line = "".join(text for text, _ in parts)
        # sized for the usual text, so that the panels of a page agree in size if possible
        size = min(15 * s, 15 * s * (width - 16 * s) / draw.textlength(USUAL, load_font(round(15 * s))))
        face = _fit_font(draw, line, size, width - 8 * s)
        lengths = [draw.textlength(text, face) for text, _ in parts]
        x = (left + right - sum(lengths)) / 2
        for (text, color), length in zip(parts, lengths, strict=True):
            draw.text((x, top + 40 * s), text, color, face, anchor="lm")
            x += length

    def _mark_curve(self, page: "Image.Image", track: Track, rect: Rect, index: int) -> None:
        """Darken the curve up to the present and put a dot on it."""
        left, top, right, bottom = self._layout.place_curve(rect)
        x, y = self._project_curve(track, rect)[index]
        pad = round(4 * self._layout.unit)
        until = round(np.clip(x, left, right))
        box = (left - pad, top - pad, until, bottom + pad)
        if until > box[0]:
            page.paste(self._passed.crop(box), box[:2])
        if not np.isfinite(y):
            return
        radius, fine = 4.2 * self._layout.unit, 8
        side = int(2 * radius) + 4
        corner = (int(x - side / 2), int(y - side / 2))
        dot = _draw_dot(side, fine, radius, round((x - corner[0]) * fine), round((y - corner[1]) * fine))
        page.paste(FILM_INK, (*corner, corner[0] + side, corner[1] + side), dot)

    def _project_curve(self, track: Track, rect: Rect) -> list[tuple[float, float]]:
        left, top, right, bottom = self._layout.place_curve(rect)
        across = (track.times - self._start) / max(self._end - self._start, 1e-300)
        upward = (track.total - self._total_low) / (self._total_high - self._total_low)
        upward = np.clip(upward, 0.0, 1.0)
        xs, ys = left + across * (right - left), bottom - upward * (bottom - top)
        return list(zip(xs.tolist(), ys.tolist(), strict=True))

    def _draw_still(self, title: str, note: str, camera: Camera) -> "Image.Image":
        """Return the static page with the curves as still ahead; store the page with them as passed, for pasting."""
        from PIL import Image, ImageDraw

        pages = []
        for curve in (FILM_INK, CURVE_AHEAD):
            size = (OVERSAMPLING * self._layout.size[0], OVERSAMPLING * self._layout.size[1])
            page = Image.new("RGB", size, "white")
            draw = ImageDraw.Draw(page)
            self._draw_frame(draw, title)
            for track, rect in zip(self._tracks, self._layout.panels, strict=True):
                self._draw_curve(draw, track, rect, curve)
            self._draw_color_bar(page, draw)
            self._draw_legend(draw, note, camera)
            pages.append(page.reduce(OVERSAMPLING))
        self._passed, ahead = pages
        return ahead

    def _draw_frame(self, draw: Any, title: str) -> None:
        """Draw title, panel labels and the rules between panels, at twice the size."""
        o, layout, s = OVERSAMPLING, self._layout, self._layout.unit
        width = layout.size[0]
        face = _fit_font(draw, title, 25 * o * s, o * (width - 40 * s), bold=True)
        draw.text((o * width / 2, o * 32 * s), title, FILM_INK, face, anchor="mm")
        for track, (left, top, right, _) in zip(self._tracks, layout.panels, strict=True):
            face = _fit_font(draw, track.label, 19 * o * s, o * (right - left - 16 * s), bold=True)
            draw.text((o * (left + right) / 2, o * (top + 15 * s)), track.label, FILM_INK, face, anchor="mm")
        for line in layout.rules:
            draw.line([o * c for c in line], FILM_RULE, o)

    def _draw_curve(self, draw: Any, track: Track, rect: Rect, color: Color) -> None:
        """Draw total volume over time, with lines at 100 % and at the limits of the axis shared by all panels."""
        o, s = OVERSAMPLING, self._layout.unit
        left, top, right, bottom = (float(o * c) for c in self._layout.place_curve(rect))
        span = self._total_high - self._total_low
        level = bottom - (1 - self._total_low) / span * (bottom - top)
        face = load_font(max(round(11.5 * o * s), 6))
        marks = [(level, 1.0)]
        for y, value in ((top, self._total_high), (bottom, self._total_low)):
            if abs(y - level) > 13 * o * s:
                marks.append((y, value))
        digits = 0 if span > 0.1 else 1 if span > 0.01 else 2
        for y, value in marks:
            draw.line([left, y, right, y], FILM_RULE if value != 1.0 else FAINT, o)
            draw.text((left - 8 * o * s, y), f"{100 * value:.{digits}f} %", SOFT, face, anchor="rm")
        points = [(o * x, o * y) for x, y in self._project_curve(track, rect)]
        for known, group in groupby(points, key=lambda point: bool(np.isfinite(point[1]))):
            part = list(group)
            if known and len(part) > 1:
                draw.line(part, color, round(1.7 * o * s), joint="curve")
        name_x = (o * rect[0] + left - 62 * o * s) / 2
        for i, word in enumerate(("total", "volume")):
            draw.text((name_x, (top + bottom) / 2 + (i - 0.5) * 15 * o * s), word, SOFT, face, anchor="mm")

    def _draw_color_bar(self, page: "Image.Image", draw: Any) -> None:
        """Draw the shared bar; an end that values exceed is pointed and marked ≤ or ≥."""
        from PIL import Image

        o, s, layout = OVERSAMPLING, self._layout.unit, self._layout
        width, height = round(o * min(500 * s, 0.42 * layout.size[0])), round(o * 15 * s)
        left, top = (o * layout.size[0] - width) // 2, round(o * (layout.footer + 38 * s))
        strip = Image.fromarray(np.ascontiguousarray(self._palette.table[None]))
        page.paste(strip.resize((width, height), Image.Resampling.BILINEAR), (left, top))
        radius, table = self._palette.radius, self._palette.table
        below, above = find_clipped_ends(self._tracks, radius)
        for clipped, x, tip, color in (
            (below, left, -0.8 * height, table[0]),
            (above, left + width - 1, 0.8 * height, table[-1]),
        ):
            if clipped:
                corners = [(x, top), (x, top + height - 1), (x + tip, top + height / 2)]
                draw.polygon(corners, tuple(int(c) for c in color))
        face = load_font(max(round(13 * o * s), 6))
        for i in range(5):
            sign = "≤ " if i == 0 and below else "≥ " if i == 4 and above else ""
            text = f"{sign}{1 - radius + i * radius / 2:.2f}"
            draw.text((left + i * width / 4, top + height + 13 * o * s), text, FILM_INK, face, anchor="mm")
        caption = "volume ratio V / V₀   (1 = volume preserved)"
        draw.text(
            (o * layout.size[0] / 2, top - 15 * o * s), caption, FILM_INK, load_font(round(14 * o * s)), anchor="mm"
        )

    def _draw_legend(self, draw: Any, note: str, camera: Camera) -> None:
        """Draw the axes and the key of lines and colors (left), and the speed of the movie (right)."""
        o, s, layout = OVERSAMPLING, self._layout.unit, self._layout
        face = load_font(max(round(13 * o * s), 6))
        origin = np.array([50 * o * s, o * (layout.footer + 62 * s)])
        for i, name in enumerate("xyz"):
            arm = np.array([camera.right[i], -camera.up[i]]) * 27 * o * s
            if np.linalg.norm(arm) < 6 * o * s:
                continue  # it points at the viewer
            draw.line([*origin, *(origin + arm)], SOFT, round(1.4 * o * s))
            tip = origin + arm * (1 + 9 * o * s / np.linalg.norm(arm))
            draw.text(tuple(tip), name, SOFT, face, anchor="mm")
        x, y = 104 * o * s, o * (layout.footer + 44 * s)
        rows = [(OUTLINE, "rest shape")]
        if any(track.inverted.any() for track in self._tracks):
            curved = any(track.lines is not None for track in self._tracks)
            rows.append((INVERTED, f"inverted ({'det F' if curved else 'V'} ≤ 0)"))
        if any(track.unknown.any() for track in self._tracks):
            rows.append((UNKNOWN, "no data"))
        for i, (color, text) in enumerate(rows):
            row = y + (i if len(rows) < 3 else i - 0.5) * 22 * o * s
            if color != OUTLINE:
                draw.rectangle([x, row - 5 * o * s, x + 20 * o * s, row + 5 * o * s], color)
            else:
                draw.line([x, row, x + 20 * o * s, row], color, round(1.4 * o * s))
            draw.text((x + 29 * o * s, row), text, SOFT, face, anchor="lm")
        place = (o * (layout.size[0] - 32 * s), o * (layout.footer + 68 * s))
        draw.text(place, note, SOFT, face, anchor="rm")


@cache
def _draw_dot(side: int, fine: int, radius: float, x: int, y: int) -> "Image.Image":
    """Return the mask of a round dot with its center at (x, y) / fine in a square."""
    from PIL import Image, ImageDraw

    mask = Image.new("L", (side * fine, side * fine), 0)
    r = radius * fine
    ImageDraw.Draw(mask).ellipse([x - r, y - r, x + r, y + r], fill=255)
    return mask.reduce(fine)
