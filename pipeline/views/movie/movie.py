"""Recorded series side by side, synchronous in time, as an .mp4 and a poster."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.errors import OutputError
from pipeline.formats.atomic import whole_file
from pipeline.series import Series
from pipeline.system.opengl import ensure_opengl
from pipeline.views.camera import fit_camera
from pipeline.views.movie.encoder import Encoder
from pipeline.views.movie.layout import GRIDS, choose_layout
from pipeline.views.movie.page import Page
from pipeline.views.movie.scene import Canvas, PanelState
from pipeline.views.palette import Palette
from pipeline.views.track import Track, choose_color_radius, read_track

if TYPE_CHECKING:
    from PIL import Image

SHORTEST = 2.0  # seconds: below that nothing can be followed
SMALLEST = (320, 180)  # below that the texts cannot be read


@dataclass(frozen=True)
class MovieSummary:
    """What was written: frames and seconds of film, and what a reader should know about it."""

    frames: int
    seconds: float
    speed: float  # simulated seconds a second of film; lower than asked for where the film was too short
    poster_time: float  # when the largest |V / V0 - 1| of all panels is reached [s]
    color_range: tuple[float, float]
    scenes: int  # frames that differ in more than the clock


@dataclass(frozen=True)
class Timeline:
    """The simulated time that each frame of film shows: start + k speed / fps, the last one the end."""

    start: float
    end: float
    speed: float
    frames: int
    fps: float

    def time(self, k: int) -> float:
        """Return the simulated time of frame k [s]."""
        return min(self.start + k * self.speed / self.fps, self.end)


def write_movie(
    series: Sequence[Series], labels: Sequence[str], path: Path, *, title: str, poster: Path | None = None,
    speed: float = 1.0, fps: float = 30, size: tuple[int, int] = (1280, 720),
    on_frame: Callable[[int, int], None] | None = None,
) -> MovieSummary:  # fmt: skip
    """Write one to four series side by side as H.264, and the most telling moment as a PNG.

    Each frame shows of every series the last record that is not later; a series that ends before the
    others keeps its last one, dimmed. `on_frame(done, frames)` is called after each frame of film.
    Raises OutputError without OpenGL or encoder, where a file cannot be written and for impossible sizes.
    """
    _check(series, labels, size, speed, fps)
    ensure_opengl()
    tracks = [read_track(one, label) for one, label in zip(series, labels, strict=True)]
    line = plan_timeline(tracks, speed, fps)
    with _Studio(tracks, title, size, _speed_note(line)) as studio:
        moment = find_poster_time(tracks)
        if poster is not None:
            with whole_file(poster) as temporary:
                studio.picture(moment).save(temporary, format="PNG", optimize=True)
        studio.scenes = 0  # those of the film
        with Encoder(path, size, fps) as encoder:
            for k in range(line.frames):
                encoder.write(studio.picture(line.time(k)).tobytes())
                if on_frame is not None:
                    on_frame(k + 1, line.frames)
        shown = (round(1 - studio.radius, 6), round(1 + studio.radius, 6))
        return MovieSummary(line.frames, line.frames / fps, line.speed, moment, shown, studio.scenes)


def _check(
    series: Sequence[Series], labels: Sequence[str], size: tuple[int, int], speed: float, fps: float
) -> None:  # fmt: skip
    if len(series) not in GRIDS:
        raise OutputError(f"a movie has one to {max(GRIDS)} panels, not {len(series)}")
    if len(labels) != len(series):
        raise OutputError(f"{len(series)} series need as many labels, not {len(labels)}")
    if size[0] % 2 or size[1] % 2 or size[0] < SMALLEST[0] or size[1] < SMALLEST[1]:
        raise OutputError(
            f"movie size {size[0]}x{size[1]}: H.264 needs even numbers, and the texts at least "
            f"{SMALLEST[0]}x{SMALLEST[1]}"
        )
    if not (speed > 0 and fps > 0 and np.isfinite(speed) and np.isfinite(fps)):
        raise OutputError(f"movie speed {speed:g} and fps {fps:g} have to be positive")


def plan_timeline(tracks: Sequence[Track], speed: float, fps: float) -> Timeline:
    """Return the times to show; a motion shorter than 2 s of film is slowed down to that."""
    start = min(float(track.times[0]) for track in tracks)
    end = max(float(track.times[-1]) for track in tracks)
    span = end - start
    if span <= 0:
        return Timeline(start, end, speed, round(SHORTEST * fps), fps)
    seconds = max(span / speed, SHORTEST)
    # one more frame than intervals: the first and the last instant are both shown
    frames = int(np.ceil(seconds * fps - 1e-6)) + 1
    return Timeline(start, end, span / seconds, frames, fps)


def _speed_note(line: Timeline) -> str:
    if line.end <= line.start:
        return "one instant"
    return "real time" if abs(line.speed - 1) < 1e-6 else f"{line.speed:.3g} × real time"


def find_poster_time(tracks: Sequence[Track]) -> float:
    """Return when the largest |V / V0 - 1| of all cells of all panels is reached [s]."""
    peaks = [(float(np.nanmax(t.worst)), float(t.times[int(np.nanargmax(t.worst))])) for t in tracks]
    return max(peaks)[1]


class _Studio:
    """Draws the picture of any time; a scene that has not changed since the last picture is not drawn again."""

    def __init__(self, tracks: Sequence[Track], title: str, size: tuple[int, int], note: str) -> None:
        self._tracks = tracks
        self._end = max(float(track.times[-1]) for track in tracks)
        self.radius, self.scenes = choose_color_radius(tracks), 0
        camera, palette = fit_camera(tracks), Palette(self.radius)
        layout = choose_layout(len(tracks), size, camera)
        left, top, right, bottom = layout.scene(layout.panels[0])
        self._page = Page(tracks, layout, camera, palette, title, note)
        self._scene = Canvas(tracks, camera, palette, (right - left, bottom - top))
        self._last: tuple[list[PanelState], list[Image.Image]] = ([], [])

    def picture(self, time: float) -> "Image.Image":
        """Return the whole page at a time."""
        states = [self._state(track, time) for track in self._tracks]
        if states != self._last[0]:
            self._last = states, self._scene.draw(states)
            self.scenes += 1
        return self._page.compose(self._last[1], states, time)

    def _state(self, track: Track, time: float) -> PanelState:
        index = track.at(time)
        # the last frame of a series that failed is still good at its own time
        ended = index == len(track.times) - 1 and time > track.times[-1] * (1 + 1e-9)
        return index, ended and track.ends_before(self._end)

    def __enter__(self) -> "_Studio":
        return self

    def __exit__(self, *_: object) -> None:
        self._scene.close()
