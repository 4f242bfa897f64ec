"""The movie of recorded series side by side at the same times: an .mp4 and a poster."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import OutputError
from pipeline.formats.atomic import replace_file
from pipeline.series import Series
from pipeline.system.times import TIME_RTOL
from pipeline.views.camera import fit_camera
from pipeline.views.movie.encoder import Encoder
from pipeline.views.movie.layout import GRIDS, choose_layout
from pipeline.views.movie.page import Page
from pipeline.views.movie.scene import Canvas, PanelState
from pipeline.views.palette import Palette
from pipeline.views.track import Track, choose_color_radius, read_track

if TYPE_CHECKING:
    from PIL import Image

SHORTEST = 2.0  # seconds: a shorter film cannot be followed
SMALLEST = (320, 180)  # the text of a smaller film cannot be read


@dataclass(frozen=True)
class MovieSummary:
    """Length, speed and colors of a finished film."""

    frames: int
    seconds: float
    speed: float  # simulated seconds per second of film; lower than requested if the film would be too short
    poster_time: float  # time of the largest |V / V0 - 1| in any panel [s]
    color_range: tuple[float, float]
    scenes: int  # frames that differ in more than the clock


@dataclass(frozen=True)
class Timeline:
    """The simulated time of each frame of film: start + k speed / fps; the last frame shows the end."""

    start: float
    end: float
    speed: float
    frames: int
    fps: float

    def find_time(self, k: int) -> float:
        """Return the simulated time of frame k [s]."""
        return min(self.start + k * self.speed / self.fps, self.end)


def write_movie(
    series: Sequence[Series], labels: Sequence[str], path: str | os.PathLike[str], *, title: str,
    poster: str | os.PathLike[str] | None = None, speed: float = 1.0, fps: float = 30,
    size: tuple[int, int] = (1280, 720), on_frame: Callable[[int, int], None] | None = None,
) -> MovieSummary:  # fmt: skip
    """Write one to four series side by side as H.264, and the moment of the largest volume change as a PNG.

    Each frame of film shows the last recorded frame of every series up to its time; a series that ends before the
    others keeps its last frame, dimmed. `on_frame(done, frames)` is called after each frame of film. Raises
    OutputError without OpenGL or ffmpeg, if a file cannot be written, and for impossible sizes.
    """
    from pipeline.system.opengl import ensure_opengl  # not at the top: `python -m` runs this module

    _check_arguments(series, labels, size, speed, fps)
    ensure_opengl()
    tracks = [read_track(recorded, label) for recorded, label in zip(series, labels, strict=True)]
    line = plan_timeline(tracks, speed, fps)
    with _Studio(tracks, title, size, _describe_speed(line)) as studio:
        moment = find_poster_time(tracks)
        if poster is not None:
            with replace_file(Path(poster)) as temporary:
                studio.draw(moment).save(temporary, format="PNG", optimize=True)
        studio.scenes = 0  # only those of the film count
        with Encoder(Path(path), size, fps) as encoder:
            for k in range(line.frames):
                encoder.write(studio.draw(line.find_time(k)).tobytes())
                if on_frame is not None:
                    on_frame(k + 1, line.frames)
        shown = (round(1 - studio.radius, 6), round(1 + studio.radius, 6))
        return MovieSummary(line.frames, line.frames / fps, line.speed, moment, shown, studio.scenes)


def _check_arguments(
    series: Sequence[Series], labels: Sequence[str], size: tuple[int, int], speed: float, fps: float
) -> None:  # fmt: skip
    if len(series) not in GRIDS:
        raise OutputError(f"movie: {len(series)} panels: a movie has 1 to {max(GRIDS)}")
    if len(labels) != len(series):
        raise OutputError(f"movie: {len(labels)} labels for {len(series)} series: give one label for each")
    if size[0] % 2 or size[1] % 2 or size[0] < SMALLEST[0] or size[1] < SMALLEST[1]:
        raise OutputError(
            f"movie: size {size[0]}x{size[1]}: both numbers must be even (H.264), and at least "
            f"{SMALLEST[0]}x{SMALLEST[1]} (the texts)"
        )
    if not (speed > 0 and fps > 0 and np.isfinite(speed) and np.isfinite(fps)):
        raise OutputError(f"movie: speed {speed:g} and fps {fps:g} must be positive and finite")


def plan_timeline(tracks: Sequence[Track], speed: float, fps: float) -> Timeline:
    """Return the times to show; a motion shorter than 2 s of film is slowed down to 2 s."""
    start = min(float(track.times[0]) for track in tracks)
    end = max(float(track.times[-1]) for track in tracks)
    span = end - start
    if span <= 0:
        return Timeline(start, end, speed, round(SHORTEST * fps), fps)
    seconds = max(span / speed, SHORTEST)
    # one more frame than intervals, as both the first and the last instant are shown
    frames = int(np.ceil(seconds * fps - 1e-6)) + 1
    return Timeline(start, end, span / seconds, frames, fps)


def _describe_speed(line: Timeline) -> str:
    if line.end <= line.start:
        return "a single instant"
    return "real time" if abs(line.speed - 1) < 1e-6 else f"{line.speed:.3g} × real time"


def find_poster_time(tracks: Sequence[Track]) -> float:
    """Return the time of the largest |V / V0 - 1| of any cell in any panel [s]."""
    changes = [np.nan_to_num(track.worst, nan=-1.0) for track in tracks]
    return max((float(c.max()), float(t.times[int(c.argmax())])) for c, t in zip(changes, tracks, strict=True))[1]


class _Studio:
    """Draws the picture at any time; bodies that have not changed since the last picture are not drawn again."""

    def __init__(self, tracks: Sequence[Track], title: str, size: tuple[int, int], note: str) -> None:
        self._tracks = tracks
        self._end = max(float(track.times[-1]) for track in tracks)
        self.radius, self.scenes = choose_color_radius(tracks), 0
        camera, palette = fit_camera(tracks), Palette(self.radius)
        layout = choose_layout(len(tracks), size, camera)
        left, top, right, bottom = layout.place_body(layout.panels[0])
        self._page = Page(tracks, layout, camera, palette, title, note)
        self._canvas = Canvas(tracks, camera, palette, (right - left, bottom - top))
        self._last: tuple[list[PanelState], list[Image.Image]] = ([], [])

    def draw(self, time: float) -> "Image.Image":
        """Return the whole page at a time [s]."""
        states = [self._find_state(track, time) for track in self._tracks]
        if states != self._last[0]:
            self._last = states, self._canvas.draw(states)
            self.scenes += 1
        return self._page.compose(self._last[1], states, time)

    def _find_state(self, track: Track, time: float) -> PanelState:
        index = track.find_frame(time)
        # the last frame of a series that failed is valid at its own time
        ended = index == len(track.times) - 1 and time > track.times[-1] * (1 + TIME_RTOL)
        return index, ended and track.ends_before(self._end)

    def __enter__(self) -> "_Studio":
        return self

    def __exit__(self, *_: object) -> None:
        self._canvas.close()
