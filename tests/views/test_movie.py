"""Movies of recorded series, decoded again by ffmpeg."""

from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import OutputError
from pipeline.mesh.simplex import Mesh
from pipeline.mesh.surface import find_boundary_faces
from pipeline.series import Series, read_series
from pipeline.views.camera import fit_camera
from pipeline.views.movie.layout import PictureLayout, choose_layout
from pipeline.views.movie.movie import MovieSummary, find_poster_time, plan_timeline, write_movie
from pipeline.views.track import RADII, choose_color_radius, find_sharp_edges, read_track

SIZE = (640, 360)
TETRA, TRIANGLE = 10, 5


def make_box(cells=(2, 4, 2)):
    """Return points and tets of a box of unit cubes, six tets in each."""
    n = np.array(cells) + 1
    points = np.array(list(product(*(range(k) for k in n))), dtype=float)
    corners = np.array(list(product(*(range(k) for k in cells))))
    tets = []
    for order in permutations(range(3)):
        walk = [corners]
        for axis in order:
            walk.append(walk[-1] + np.eye(3, dtype=int)[axis])
        tet = np.stack([(v[:, 0] * n[1] + v[:, 1]) * n[2] + v[:, 2] for v in walk], axis=1)
        odd = np.linalg.det(np.eye(3)[list(order)]) < 0
        tets.append(tet[:, [0, 2, 1, 3]] if odd else tet)
    return points, np.concatenate(tets)


def make_sheet(nx=8, ny=3):
    points = np.array(list(product(range(nx + 1), range(ny + 1))), dtype=float)
    a = np.array([i * (ny + 1) + j for i, j in product(range(nx), range(ny))])
    lower, upper = np.stack([a, a + ny + 1, a + ny + 2], 1), np.stack([a, a + ny + 2, a + 1], 1)
    return points, np.concatenate([lower, upper])


def shear(points, t):
    """Move along the last axis by the square of the distance from one end, and swell."""
    x = points * (1 + 0.1 * t)
    x[:, -1] -= 0.08 * t * points[:, -2] ** 2
    return x


def record(folder: Path, rest, cells, times, motion=shear) -> Series:
    """Write a series as another program would: inline files and a handmade index."""
    import pyvista

    folder.mkdir()
    kind = TETRA if cells.shape[1] == 4 else TRIANGLE

    def spatial(a):
        return np.pad(a, [(0, 0), (0, 3 - a.shape[1])])

    lines = []
    for i, t in enumerate(times):
        grid = pyvista.UnstructuredGrid({kind: cells}, spatial(motion(rest, t)))
        grid.point_data["rest_position"] = spatial(rest)
        grid.save(folder / f"{i}.vtu")
        lines.append(f'<DataSet timestep="{t!r}" file="{i}.vtu"/>')
    index = f'<VTKFile type="Collection"><Collection>{"".join(lines)}</Collection></VTKFile>'
    (folder / "series.pvd").write_text(index)
    return read_series(folder)


def list_times(count, dt=0.1):
    return [float(dt * i) for i in range(count)]


def decode(path: Path) -> np.ndarray:
    """Return all frames of a movie (frame, row, column, 3), decoded."""
    import imageio_ffmpeg

    frames = imageio_ffmpeg.read_frames(str(path))
    width, height = next(frames)["size"]
    return np.stack([np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in frames])


def film(tmp_path, series, **options) -> tuple[MovieSummary, np.ndarray]:
    path = tmp_path / "out" / "movie.mp4"
    labels = [f"panel {i}" for i in range(len(series))]
    options = {"title": "A test", "fps": 10, "size": SIZE, **options}
    summary = write_movie(series, labels, path, **options)
    assert [f.name for f in path.parent.iterdir() if f.name.startswith(".")] == []
    return summary, decode(path)


def count_colorful(pixels) -> int:
    """Return the number of pixels that are neither white nor any gray: the bodies and the color bar."""
    return int((np.ptp(pixels.astype(int), axis=-1) > 40).sum())


@pytest.mark.opengl
def test_two_panels_are_synchronous_complete_and_exact_in_size(tmp_path):
    coarse = record(tmp_path / "coarse", *make_box(), list_times(6, 0.6))
    fine = record(tmp_path / "fine", *make_box(), list_times(31, 0.1))
    calls = []
    poster = tmp_path / "out" / "poster.png"
    summary, frames = film(tmp_path, [coarse, fine], poster=poster, on_frame=lambda *a: calls.append(a))
    assert summary.frames == 31  # 3 s at 10 frames a second, both ends shown
    assert frames.shape == (31, SIZE[1], SIZE[0], 3)
    assert calls == [(k, 31) for k in range(1, 32)]
    assert summary.speed == pytest.approx(1.0)
    assert summary.scenes == 31
    half, body = SIZE[0] // 2, slice(60, 270)
    change = np.abs(np.diff(frames[:, body].astype(int), axis=0)).max(axis=-1) > 60
    left, right = change[:, :, :half].sum(axis=(1, 2)), change[:, :, half:].sum(axis=(1, 2))
    assert (right > 0).all()
    # the coarse one is recorded at every sixth frame of film, and must not move in between
    changed = np.flatnonzero(left > 30) + 1
    assert changed.tolist() == [6, 12, 18, 24, 30]

    from PIL import Image

    with Image.open(poster) as picture:
        assert picture.size == SIZE
        assert count_colorful(np.asarray(picture)) > 2000
    assert summary.poster_time == pytest.approx(3.0)


@pytest.mark.opengl
def test_a_short_motion_is_slowed_down_to_two_seconds(tmp_path):
    series = record(tmp_path / "s", *make_box(), list_times(5))
    summary, frames = film(tmp_path, [series])
    assert summary.frames == len(frames) == 21
    assert summary.speed == pytest.approx(0.2)


@pytest.mark.opengl
def test_a_single_frame_gives_a_still_film(tmp_path):
    summary, frames = film(tmp_path, [record(tmp_path / "s", *make_box(), [0.0])])
    assert summary.scenes == 1
    assert len(frames) == 20


@pytest.mark.opengl
def test_a_plane_body_fills_its_panel(tmp_path):
    summary, frames = film(tmp_path, [record(tmp_path / "s", *make_sheet(), list_times(11))])
    assert summary.frames == len(frames)
    body = frames[-1, 60:270]
    assert (np.abs(body.astype(int) - 255).max(axis=-1) > 20).mean() > 0.1
    assert not np.array_equal(frames[0], frames[-1])


@pytest.mark.opengl
def test_a_series_that_ends_early_is_dimmed(tmp_path):
    whole = record(tmp_path / "whole", *make_box(), list_times(21))
    early = record(tmp_path / "early", *make_box(), list_times(11))
    _, frames = film(tmp_path, [early, whole])
    panel = frames[:, 60:270, : SIZE[0] // 2].astype(int)
    drawn = [p[p.min(axis=-1) < 250].mean() for p in (panel[10], panel[12], panel[20])]
    assert drawn[1] > drawn[0] + 25
    assert drawn[2] == pytest.approx(drawn[1], abs=1)
    heading = frames[:, 40:60, : SIZE[0] // 2].astype(int)
    red = (heading[..., 0] - heading[..., 1] > 60).sum(axis=(1, 2))
    assert red[10] == 0 and red[12] > 20


@pytest.mark.opengl
def test_inverted_cells_are_magenta(tmp_path):
    def flip(points, t):
        return points * [1, 1, -1] if t > 0.5 else points

    _, frames = film(tmp_path, [record(tmp_path / "s", *make_box(), list_times(11), flip)])
    magenta = (frames[..., 0] > 120) & (frames[..., 1] < 70) & (frames[..., 2] > 110)
    body = magenta[:, 60:270].sum(axis=(1, 2))
    assert body[0] == 0 and body[-1] > 2000
    assert magenta[0, 300:].sum() > 20  # the legend explains it from the start


@pytest.mark.opengl
@pytest.mark.parametrize("count", [3, 4])
def test_more_panels(tmp_path, count):
    series = [record(tmp_path / str(i), *make_box(), list_times(3)) for i in range(count)]
    _, frames = film(tmp_path, series, fps=5)
    assert frames.shape[1:] == (SIZE[1], SIZE[0], 3)
    assert count_colorful(frames[-1, 60:270]) > 1000


@pytest.mark.opengl
def test_a_missing_encoder_is_an_output_error_and_leaves_nothing(tmp_path, monkeypatch):
    series = record(tmp_path / "s", *make_box(), list_times(3))
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "no-such-ffmpeg"))
    with pytest.raises(OutputError, match="encoder cannot be started"):
        write_movie([series], ["one"], tmp_path / "movie.mp4", title="", size=SIZE)
    assert sorted(f.name for f in tmp_path.iterdir()) == ["s"]


@pytest.mark.opengl
def test_the_message_of_a_failing_encoder_is_quoted_and_the_old_movie_stays(tmp_path, monkeypatch):
    series = record(tmp_path / "s", *make_box(), list_times(3))
    broken = tmp_path / "ffmpeg"
    broken.write_text("#!/bin/sh\necho 'Unknown encoder libx264' >&2\nexit 3\n")
    broken.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(broken))
    (tmp_path / "movie.mp4").write_bytes(b"old")
    with pytest.raises(OutputError, match=r"exit code 3\): Unknown encoder libx264"):
        write_movie([series], ["one"], tmp_path / "movie.mp4", title="", size=SIZE)
    assert (tmp_path / "movie.mp4").read_bytes() == b"old"
    assert sorted(f.name for f in tmp_path.iterdir()) == ["ffmpeg", "movie.mp4", "s"]


@pytest.mark.opengl
def test_an_interruption_leaves_nothing(tmp_path):
    series = record(tmp_path / "s", *make_box(), list_times(3))

    def interrupt(done, _):
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_movie([series], ["one"], tmp_path / "movie.mp4", title="", size=SIZE, on_frame=interrupt)
    assert sorted(f.name for f in tmp_path.iterdir()) == ["s"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": (641, 360)}, "641x360: both numbers must be even"),
        ({"size": (64, 36)}, "at least 320x180"),
        ({"speed": 0.0}, "speed 0"),
        ({"fps": -1}, "fps -1"),
    ],
)
def test_impossible_requests(tmp_path, options, message):
    series = record(tmp_path / "s", *make_box(), list_times(2))
    with pytest.raises(OutputError, match=message):
        write_movie([series], ["one"], tmp_path / "movie.mp4", title="", **options)


def test_wrong_numbers_of_panels_and_labels(tmp_path):
    series = record(tmp_path / "s", *make_box(), list_times(2))
    with pytest.raises(OutputError, match="5 panels: a movie has 1 to 4"):
        write_movie([series] * 5, ["a"] * 5, tmp_path / "movie.mp4", title="")
    with pytest.raises(OutputError, match="one label for each"):
        write_movie([series], [], tmp_path / "movie.mp4", title="")


def test_every_frame_is_shown_if_the_rate_allows_it(tmp_path):
    # 0.07 and its multiples have no exact binary form
    track = read_track(record(tmp_path / "s", *make_box((1, 1, 1)), [0.07 * i for i in range(40)]), "")
    line = plan_timeline([track], 1.0, 30)
    assert {track.find_frame(line.find_time(k)) for k in range(line.frames)} == set(range(40))
    assert line.find_time(line.frames - 1) == track.times[-1]
    assert track.find_frame(-1.0) == 0
    assert [track.find_frame(t) for t in track.times] == list(range(40))


def test_only_a_missing_frame_counts_as_an_early_end(tmp_path):
    track = read_track(record(tmp_path / "s", *make_box((1, 1, 1)), list_times(5, 0.3)), "")
    assert not track.ends_before(1.2)
    assert not track.ends_before(1.25)  # a shorter interval of another series divides the end differently
    assert track.ends_before(1.5)


def test_colors_hold_most_cells_and_the_poster_the_worst(tmp_path):
    def pulse(points, t):
        return points * (1 + (0.1 if t == 0.2 else 0.01 * t))

    track = read_track(record(tmp_path / "s", *make_box((1, 2, 1)), list_times(21), pulse), "")
    assert find_poster_time([track]) == pytest.approx(0.2)
    assert track.total[2] == pytest.approx(1.1**3)
    assert track.worst[2] == pytest.approx(1.1**3 - 1)
    radius = choose_color_radius([track])
    assert radius == 0.1  # slow growth reaches 1.02^3 - 1 = 0.061; the one outlier 0.331

    def damp(points, t):
        return points * (1 + 0.1 * np.exp(-t))

    # the long rest afterwards does not count
    rested = read_track(record(tmp_path / "rested", *make_box((1, 1, 1)), list_times(60, 0.5), damp), "")
    assert choose_color_radius([rested]) >= 0.2
    still = read_track(record(tmp_path / "still", *make_box((1, 1, 1)), list_times(2), lambda p, t: p), "")
    assert choose_color_radius([still]) == RADII[0]


def test_the_camera_sees_the_whole_motion_but_not_an_explosion(tmp_path):
    def burst(points, t):
        return points * (1e6 if t > 0.15 else 1 + t)

    track = read_track(record(tmp_path / "s", *make_box(), list_times(3), burst), "")
    camera = fit_camera([track])
    projected = track.points[1] @ np.stack([camera.right, camera.up, camera.toward]).T
    assert (projected >= camera.low - 1e-5).all() and (projected <= camera.high + 1e-5).all()
    assert (camera.high - camera.low).max() < 10
    assert camera.right[1] > 0.9 and camera.up[2] > 0.9  # y to the right, z up
    flat = fit_camera([read_track(record(tmp_path / "flat", *make_sheet(), list_times(2)), "")])
    assert flat.toward.tolist() == [0, 0, 1] and flat.up.tolist() == [0, 1, 0]


def test_the_outline_of_a_box_is_its_twelve_edges():
    mesh = Mesh(*make_box((2, 3, 2)))
    faces, _ = find_boundary_faces(mesh)
    creases, contour = find_sharp_edges(mesh.points.astype(np.float32), faces, np.array([0.8, -0.5, 0.3]))
    assert len(creases) == 4 * (2 + 3 + 2)
    assert len(contour) == 0


def test_panels_and_footer_do_not_overlap(tmp_path):
    track = read_track(record(tmp_path / "s", *make_box(), list_times(2)), "")
    for count in (1, 2, 3, 4):
        layout = choose_layout(count, (1280, 720), fit_camera([track]))
        assert len(layout.panels) == count
        assert all(bottom <= layout.footer and right <= 1280 for _, _, right, bottom in layout.panels)
        for panel in layout.panels:
            assert layout.place_body(panel)[3] <= layout.place_curve(panel)[1]
    assert PictureLayout((1280, 720), 2, 2, 4).panels[3][:2] == (640, 58 + (620 - 58) // 2)
