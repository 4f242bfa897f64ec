"""Surfaces over time for k3d's WebGL viewer: a packed scene for each body, and data about them for the page.

Colors are stored as places on the color map in 254 steps, and coordinates are rounded to a 32768th of the body's
size: both are invisible, and together they halve the page.
"""

import base64
import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import distribution
from importlib.resources import files
from importlib.util import find_spec
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.mesh.simplex import Mesh
from pipeline.mesh.skin import find_skin
from pipeline.series import Series
from pipeline.views.camera import Camera, fit_camera
from pipeline.views.html.curves import round_numbers
from pipeline.views.palette import INVERTED, OUTLINE, UNKNOWN, Palette
from pipeline.views.track import (
    Track,
    choose_color_radius,
    find_clipped_ends,
    find_sharp_edges,
    join_nodes,
    list_drawn_points,
    read_track,
)

OnFrameRead = Callable[[str, int, int], None]  # label of the series, frames done, frames in all
MOST_BYTES = 16_000_000  # of coordinates and colors before they are packed: 5 to 8 MB of page
MOST_FRAMES = 400  # of a body
MOST_EDGES = 4000  # faces of a body; with more, the edges of its cells are not drawn
_STEPS, _GRAIN = 254, 2.0**-15
_UNKNOWN = -2.0  # place on the color map
_OUTLINE = int.from_bytes(bytes(OUTLINE), "big")


@dataclass(frozen=True)
class Solids:
    """The viewer's program and a packed scene for each body; `meta` for JSON; notes on frames left out."""

    program: str
    licenses: str  # of the program: they must be distributed with it
    scenes: tuple[str, ...]
    meta: dict[str, Any]
    notes: tuple[str, ...]


def pack_solids(
    series: Sequence[Series], labels: Sequence[str], moments: Sequence[int], on_frame: OnFrameRead | None = None
) -> Solids | None:
    """Return the surfaces of series over time, or None if k3d is not installed.

    Long series and large meshes show only some of their frames: every k-th, the last, and that of `moments` (one
    frame for each series). `on_frame(label, done, frames)` is called after each. Raises SeriesError if a frame cannot
    be read.
    """
    if find_spec("k3d") is None:
        return None
    tracks, notes = [], []
    most = _count_affordable_frames(series)
    for recorded, label, moment in zip(series, labels, moments, strict=True):
        frames, every = _choose_frames(len(recorded), most, moment)
        if every > 1:
            notes.append(
                f"{label}: the 3D view shows {len(frames)} of {len(recorded)} frames: every {_format_ordinal(every)}, "
                "the last, and the one with the largest volume change"
            )
        report = (lambda: None) if on_frame is None else _count_calls(on_frame, label, len(frames))
        tracks.append(read_track(recorded.select_frames(frames), label, report))
    radius, camera = choose_color_radius(tracks), fit_camera(tracks)
    palette = Palette(radius)
    below, above = find_clipped_ends(tracks, radius)
    meta = {
        "bodies": [_describe_body(track, camera) for track in tracks],
        "camera": {name: round_numbers(getattr(camera, name)) for name in ("right", "up", "toward")},
        "radius": radius,
        "below": below,
        "above": above,
        "inverted": bool(any(t.inverted.any() for t in tracks)),
        **({"unknownColor": "#" + bytes(UNKNOWN).hex()} if any(t.unknown.any() for t in tracks) else {}),
        "colors": ["#" + bytes(palette.table[i]).hex() for i in np.linspace(0, 255, 17).astype(int)],
        "invertedColor": "#" + bytes(INVERTED).hex(),
    }
    points = np.concatenate([list_drawn_points(track) for track in tracks])
    bounds = (*points.min(axis=0).tolist(), *points.max(axis=0).tolist())
    scenes = tuple(_pack_scene(track, palette, camera.toward, bounds) for track in tracks)
    return Solids(_pack_viewer(), _read_licenses(), scenes, meta, tuple(notes))


def _count_calls(on_frame: OnFrameRead, label: str, frames: int) -> Callable[[], None]:
    """Return a function that passes the number of its calls to `on_frame`."""
    done = count(1)
    return lambda: on_frame(label, next(done), frames)


def _describe_body(track: Track, camera: Camera) -> dict[str, Any]:
    """Return a body's label, the times of its frames, and its bounds along the camera's right, up and toward."""
    projected = list_drawn_points(track) @ np.stack([camera.right, camera.up, camera.toward]).T
    bounds = {"low": round_numbers(projected.min(axis=0)), "high": round_numbers(projected.max(axis=0))}
    gaps = [track.find_gap(i) for i in range(len(track.times))] if track.unknown.any() else []
    without = {"gaps": [None if gap is None else float(f"{gap:.9g}") for gap in gaps]} if gaps else {}
    return {"label": track.label, "times": round_numbers(track.times, digits=9), **bounds, **without}


def _count_affordable_frames(series: Sequence[Series]) -> int:
    """Return the number of frames per series that fit into the page."""
    size = 0
    for recorded in series:
        skin = find_skin(recorded.mesh, join_nodes(recorded))
        simple = isinstance(recorded.mesh, Mesh)
        bodies = 2 if _shows_edges(skin.triangles, None if simple else skin.lines) else 1  # the edges are another body
        size += 4 * len(skin.triangles) + 12 * bodies * skin.count
    return max(2, min(MOST_FRAMES, MOST_BYTES // size))


def _shows_edges(faces: Ints, lines: Ints | None) -> bool:
    """Return whether the edges of cells are few enough to be drawn; a triangle has one and a half lines."""
    return (len(faces) if lines is None else len(lines) * 2 // 3) <= MOST_EDGES


def _choose_frames(frames: int, most: int, moment: int) -> tuple[list[int], int]:
    """Return the frames to show, in order, and k: they are every k-th, the last and `moment`."""
    every = -(-frames // most)
    return sorted({*range(0, frames, every), frames - 1, moment}), every


def _format_ordinal(n: int) -> str:
    return f"{n}{'th' if n % 100 in (11, 12, 13) else {1: 'st', 2: 'nd', 3: 'rd'}.get(n % 10, 'th')}"


def _pack_scene(track: Track, palette: Palette, toward: Floats, bounds: tuple[float, ...]) -> str:
    """Return k3d's binary snapshot of a body, in base64; its times are the indices of frames."""
    import k3d

    size = float(np.linalg.norm(np.ptp(track.rest, axis=0)))
    points = {str(i): _round_points(p, size) for i, p in enumerate(track.points)}
    colors = {str(i): _place_on_map(ratio, palette.radius) for i, ratio in enumerate(track.ratio)}
    faces = track.faces.astype(np.uint32)
    unknown = bool(track.unknown.any())
    lowest = _UNKNOWN if unknown else -1.0
    look: dict[str, Any] = {
        "color_map": _make_color_map(palette, unknown=unknown), "color_range": [lowest, _STEPS], "side": "double",
    }  # fmt: skip
    plot = k3d.plot(
        grid_visible=False, menu_visibility=False, camera_auto_fit=False, axes_helper=0,
        grid_auto_fit=False, grid=bounds,  # the viewer derives its depth range from these
        colorbar_object_id=0, time_interpolation=False, camera_fov=20.0,
        lighting=1.5 if track.normal is None else 1.15,  # faces toward the viewer get the colors of the bar
    )  # fmt: skip
    plot += k3d.mesh(points, faces, triangles_attribute=colors, name="body", **look)
    if _shows_edges(track.faces, track.lines):
        if track.lines is None:
            plot += k3d.mesh(points, faces, color=0x21262F, wireframe=True, opacity=0.25, name="edges")
        else:
            lines = track.lines.astype(np.uint32)
            plot += k3d.lines(points, lines, indices_type="segment", shader="simple", color=0x5A606B, name="edges")
    crease, contour = find_sharp_edges(track.rest, track.faces, toward)
    edges: Ints = np.concatenate([crease, contour])
    plot += k3d.lines(
        track.rest, edges.astype(np.uint32), indices_type="segment", shader="simple", color=_OUTLINE, name="rest shape"
    )
    for i, item in enumerate(plot.objects):
        item.id = i + 1  # not an address in memory, so that the same results give the same bytes
    return base64.b64encode(plot.get_binary_snapshot()).decode("ascii")


def _round_points(points: NDArray[np.float32], size: float) -> NDArray[np.float32]:
    grain = 2.0 ** np.ceil(np.log2(max(size, 1e-30))) * _GRAIN
    return np.asarray(np.round(np.nan_to_num(points) / grain) * grain, dtype=np.float32)


def _place_on_map(ratio: NDArray[np.float32], radius: float) -> NDArray[np.float32]:
    """Return the places of volume ratios on the color map, 0 to 254; -1 if inverted, -2 without data."""
    place = np.clip(((ratio - 1) / (2 * radius) + 0.5) * _STEPS, 0, _STEPS).round()
    return np.where(np.isnan(ratio), _UNKNOWN, np.where(ratio > 0, place, -1.0)).astype(np.float32)


def _make_color_map(palette: Palette, *, unknown: bool) -> list[float]:
    """Return [place, red, green, blue, ...] of the movie's colors, preceded by those of inverted and unknown cells."""
    before: list[tuple[float, tuple[int, int, int]]] = [(_UNKNOWN, UNKNOWN)] if unknown else []
    before += [(-1.0, INVERTED)]
    lowest = before[0][0]
    span = _STEPS - lowest
    stops = [((place + step - lowest) / span, np.array(rgb)) for place, rgb in before for step in (0.0, 0.5)]
    stops += [((i - lowest) / span, palette.table[round(i * 255 / _STEPS)]) for i in range(0, _STEPS + 1, 2)]
    return [float(v) for place, rgb in stops for v in (place, *(rgb / 255))]


def _pack_viewer() -> str:
    """Return k3d's viewer, in zlib and base64, without its unused fonts for formulas, a third of its size."""
    program = files("k3d").joinpath("static/standalone.js").read_bytes()
    program = re.sub(rb"data:font/woff2;base64,[A-Za-z0-9+/=]+", b"data:,", program)
    program = re.sub(rb',url\(fonts/[^)]*\) format\("\w+"\)', b"", program)
    return base64.b64encode(zlib.compress(program, 9)).decode("ascii")


def _read_licenses() -> str:
    """Return the licenses of k3d and of the libraries inside its viewer."""
    licenses = [
        path.read_text() for path in distribution("k3d").files or () if path.parts[-2:] == ("licenses", "LICENSE.txt")
    ]
    return "\n".join([*licenses, files("k3d").joinpath("static/standalone.js.LICENSE.txt").read_text(encoding="utf-8")])
