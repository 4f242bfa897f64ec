"""The layout of a page of any size, in whole pixels: title, a grid of panels, footer."""

from dataclasses import dataclass

from pipeline.views.camera import Camera

Rect = tuple[int, int, int, int]  # left, top, right, bottom
GRIDS = {1: ((1, 1),), 2: ((1, 2), (2, 1)), 3: ((1, 3), (3, 1)), 4: ((1, 4), (2, 2))}  # rows, columns
TITLE, HEADER, CURVE, FOOTER = 58, 54, 62, 100  # heights at 720 lines


@dataclass(frozen=True)
class PictureLayout:
    """A page of panels: each has its label and numbers above the body, and the curve of total volume below it."""

    size: tuple[int, int]
    rows: int
    columns: int
    count: int

    @property
    def unit(self) -> float:
        """Return the scale of the page: 1 at 1280 x 720."""
        return min(self.size[0] / 1280, self.size[1] / 720)

    @property
    def footer(self) -> int:
        """Return the line at which the footer begins."""
        return self.size[1] - round(FOOTER * self.unit)

    @property
    def panels(self) -> list[Rect]:
        """Return the rectangle of every panel, row by row."""
        top = round(TITLE * self.unit)
        width, height = self.size[0] // self.columns, (self.footer - top) // self.rows
        return [
            ((i % self.columns) * width, top + (i // self.columns) * height,
             (i % self.columns + 1) * width, top + (i // self.columns + 1) * height)
            for i in range(self.count)
        ]  # fmt: skip

    @property
    def rules(self) -> list[Rect]:
        """Return the lines between panels."""
        gap, lines = round(8 * self.unit), []
        for left, top, right, bottom in self.panels:
            if right < self.size[0] - self.columns:
                lines.append((right, top + gap, right, bottom - gap))
            if bottom < self.footer - self.rows:
                lines.append((left + gap, bottom, right - gap, bottom))
        return lines

    def place_body(self, panel: Rect) -> Rect:
        """Return the rectangle of a panel's body; 2 pixels at the sides are left for the rules."""
        left, top, right, bottom = panel
        return left + 2, top + round(HEADER * self.unit), right - 2, bottom - round(CURVE * self.unit)

    def place_curve(self, panel: Rect) -> Rect:
        """Return the rectangle of the axes of a panel's curve, without its labels."""
        left, _, right, bottom = panel
        s, width = self.unit, right - left
        margin = max(0.06 * width, 16 * s)
        return (
            round(left + margin + 108 * s), bottom - round(42 * s), round(right - margin), bottom - round(14 * s)
        )  # fmt: skip


def choose_layout(count: int, size: tuple[int, int], camera: Camera) -> PictureLayout:
    """Return the grid that shows bodies largest; a single row, unless another grid is a third better."""

    def fit_pixel(layout: PictureLayout) -> float:
        left, top, right, bottom = layout.place_body(layout.panels[0])
        return camera.fit_pixel(max(right - left, 1), max(bottom - top, 1))

    layouts = [PictureLayout(size, rows, columns, count) for rows, columns in GRIDS[count]]
    best = min(layouts, key=fit_pixel)
    return best if fit_pixel(best) * 4 / 3 < fit_pixel(layouts[0]) else layouts[0]
