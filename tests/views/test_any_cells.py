"""Films, pages and figures of bodies of any kind of cells, and of frames without data."""

import re
import warnings
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
import xarray

from pipeline.analysis.statistics import write_statistics
from pipeline.formats.netcdf import read_dataset
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.shapes import box
from pipeline.mesh.simplex import Mesh
from pipeline.results.analysis_folder import analyze
from pipeline.series import read_series
from pipeline.sinks.vtu import VtuSink
from pipeline.views.camera import fit_camera
from pipeline.views.html.curves import find_worst_frame
from pipeline.views.html.page import PageContent, Side, write_page
from pipeline.views.html.solids import pack_solids
from pipeline.views.html.worst import find_worst_cells
from pipeline.views.movie.movie import find_poster_time
from pipeline.views.palette import INVERTED, UNKNOWN, Palette
from pipeline.views.paraview import SCRIPT_NAME
from pipeline.views.plots import write_volume_figure
from pipeline.views.size_text import describe_size
from pipeline.views.track import choose_color_radius, find_clipped_ends, read_track
from tests.any_bodies import BODIES, FLAT, PLANES, TIMES, MovingBody, make_mesh, stretch, twist, write_files
from tests.bodies import assert_conventional, skip_figures
from tests.views.test_movie import count_colorful, film
from tests.views.test_plots import read_pixels

PLANAR = (*FLAT, *PLANES)


def make_body(name: str, **options) -> MovingBody:
    return MovingBody(make_mesh(name), stretch if name in PLANAR else twist, name=name, **options)


@pytest.mark.parametrize("name", BODIES)
def test_the_track_of_every_kind(name):
    body = make_body(name)
    track = read_track(body, name)
    assert track.points.shape == (len(TIMES), len(track.rest), 3) and np.isfinite(track.points).all()
    assert track.ratio.shape == (len(TIMES), len(track.faces)) and not track.unknown.any()
    assert track.total[0] == pytest.approx(1) and track.total[-1] > 1.05
    assert (track.normal is not None) == (name in PLANAR)
    if name in PLANAR:  # stretched uniformly
        assert track.ratio[-1] == pytest.approx(1 + TIMES[-1], rel=1e-5)
        assert track.total == pytest.approx(1 + np.array(TIMES))
    assert choose_color_radius([track]) > 0.02
    # every drawn point is a node or lies within the box of the nodes
    nodes = np.pad(body.read_positions(3), [(0, 0), (0, 3 - body.mesh.points.shape[1])])
    slack = 0.2 * np.ptp(nodes, axis=0)
    assert (track.points[3] >= nodes.min(axis=0) - slack - 1e-6).all()
    assert (track.points[3] <= nodes.max(axis=0) + slack + 1e-6).all()


@pytest.mark.parametrize("name", BODIES)
def test_files_of_every_kind_are_analyzed(tmp_path, name):
    """Written by VTK, read, measured, and drawn: the numbers are those of the mesh in memory."""
    body = make_body(name)
    result = analyze(read_series(write_files(tmp_path / "files", body.mesh, body.motion)), tmp_path / "out")
    expected, _ = write_statistics(body, tmp_path / "expected.nc")
    single = 1e-6  # VTK's files hold single precision
    assert result.worst_volume_ratio == pytest.approx(expected.worst_volume_ratio, rel=10 * single)
    ours, theirs = read_dataset(result.files[0]), read_dataset(tmp_path / "expected.nc")
    assert_conventional(ours)
    assert ours["total_volume"].values == pytest.approx(theirs["total_volume"].values, rel=10 * single)
    assert ours["total_volume"].attrs["units"] == ("m3" if body.mesh.dimension == 3 else "m2")
    if name != "triangles in xz":
        assert (ours["volume_ratio_min"] <= ours["volume_ratio"] + 1e-9).all()
    assert read_pixels(tmp_path / "out" / "volume.png").shape[0] > 300


@pytest.mark.parametrize("name", BODIES)
def test_frames_for_paraview_of_every_kind(tmp_path, monkeypatch, name):
    """Read by VTK and by our reader: the cells, their volume ratios, and deformed points of the series."""
    import pyvista

    skip_figures(monkeypatch)
    body = make_body(name)
    out, source = tmp_path / "out", read_series(write_files(tmp_path / "files", body.mesh, body.motion))
    result = analyze(source, out, paraview=True)
    assert [path.name for path in result.files] == ["statistics.nc", "volume.png", "series.pvd", SCRIPT_NAME]
    frame = pyvista.read(out / "frames" / "frame_000003.vtu")
    assert np.array_equal(frame.celltypes, source.mesh.cell_array.types)
    ratios = read_dataset(out / "statistics.nc")["volume_ratio"].values[3]
    assert np.array_equal(frame.cell_data["volume_ratio"], ratios)
    again = read_series(out / "series.pvd")
    assert np.array_equal(again.read_positions(3), source.read_positions(3))
    assert again.mesh.rest_volumes == pytest.approx(source.mesh.rest_volumes, rel=1e-12)
    script = (out / SCRIPT_NAME).read_text()
    assert ("NORMAL = None" in script) == (name not in PLANAR)


@pytest.mark.opengl
@pytest.mark.parametrize("name", ["hexahedra", "curved tetrahedra", "mixture", "polyhedra", "shell", "triangles in xz"])
def test_films_show_every_kind(tmp_path, name):
    _, pixels = film(tmp_path, [make_body(name)], fps=5)
    assert count_colorful(pixels[-1]) > 0.03 * pixels[-1].shape[0] * pixels[-1].shape[1]


def make_own_points(name: str) -> CellMesh | Mesh:
    """The body with points of its own for every cell."""
    mesh = make_mesh(name)
    cells = mesh.cell_array
    numbers = np.arange(len(cells.connectivity))
    return replace(mesh, points=mesh.points[cells.connectivity], cell_array=cells._replace(connectivity=numbers))


@pytest.mark.parametrize("name", ["hexahedra", "curved tetrahedra", "shell", "tetrahedra"])
def test_cells_with_points_of_their_own_are_drawn_as_one_body(name):
    if name == "tetrahedra":
        plain: CellMesh | Mesh = box((1.0, 2.0, 1.0), (2, 4, 2))
        own: CellMesh | Mesh = Mesh(
            plain.points[plain.cells].reshape(-1, 3), np.arange(plain.cells.size).reshape(-1, 4)
        )
    else:
        plain, own = make_mesh(name), make_own_points(name)
    whole, joined = (read_track(MovingBody(mesh, stretch), "") for mesh in (plain, own))
    assert joined.faces.shape == whole.faces.shape and len(joined.rest) == len(whole.rest)
    corners = [np.sort(track.points[-1][track.faces].reshape(-1, 9), axis=0) for track in (whole, joined)]
    assert corners[0] == pytest.approx(corners[1], abs=1e-6)

    def crack(points, t):  # the nodes of cells behind the middle move away
        x = points.copy()
        x[len(x) // 2 :, 1] += t
        return x

    if name != "shell":
        apart = read_track(MovingBody(own, crack), "")
        assert len(apart.faces) > len(whole.faces)  # the faces in the crack are drawn


def test_planes_are_seen_along_their_normal():
    camera = fit_camera([read_track(make_body("triangles in xz"), "")])
    assert camera.toward == pytest.approx([0, -1, 0]) and camera.right == pytest.approx([1, 0, 0])
    assert camera.up == pytest.approx([0, 0, 1])
    flat = fit_camera([read_track(make_body("polygons"), "")])
    assert flat.toward == pytest.approx([0, 0, 1]) and flat.up == pytest.approx([0, 1, 0])
    both = fit_camera([read_track(make_body(name), "") for name in ("polygons", "triangles in xz")])
    assert np.abs(both.toward).min() > 0.1  # bodies in different planes are seen from aside


# frames without data


def make_gaps() -> dict[str, MovingBody]:
    mesh = make_mesh("hexahedra")
    volume = float(mesh.rest_volumes.sum())
    return {
        "end": MovingBody(mesh, gaps={2: slice(None), 3: slice(None)}, name="end"),
        "middle": MovingBody(mesh, gaps={1: slice(None)}, name="middle"),
        "nodes": MovingBody(mesh, gaps={2: slice(0, 9), 3: slice(0, 9)}, name="nodes"),
        "remeshed": MovingBody(mesh, whole={2: 1.2 * volume, 3: 1.3 * volume}, name="remeshed"),
    }


def test_points_without_data_stay_and_cells_are_gray():
    bodies = make_gaps()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        end, middle, nodes, remeshed = (read_track(body, name) for name, body in bodies.items())
        radius = choose_color_radius([end, middle, nodes, remeshed])
        assert find_clipped_ends([end, remeshed], radius)[0] is False
        assert find_poster_time([end]) == TIMES[1]
    assert np.array_equal(end.points[2], end.points[1]) and np.array_equal(end.points[3], end.points[1])
    assert np.isnan(end.ratio[2:]).all() and np.isnan(end.total[2:]).all()
    assert (Palette(0.1).map_colors(end.ratio[2], dimmed=False) == UNKNOWN).all()
    assert [end.find_gap(i) for i in range(4)] == [None, None, TIMES[2], TIMES[2]]
    assert np.array_equal(middle.points[1], middle.points[0]) and np.isfinite(middle.total[2])
    assert [middle.find_gap(i) for i in range(4)] == [None, TIMES[1], None, None]
    assert 0 < nodes.unknown[2] < nodes.ratio.shape[1] and nodes.find_gap(2) is None
    assert 0 < np.isnan(nodes.ratio[2]).mean() < 1
    assert remeshed.total == pytest.approx([1, remeshed.total[1], 1.2, 1.3]) and remeshed.find_gap(3) == TIMES[2]


def test_a_cell_that_is_inverted_somewhere_is_drawn_inverted():
    """One corner pushed through the body: its cell keeps a positive volume, but det F is negative at the corner."""
    mesh = make_mesh("hexahedra")
    corner = int(np.argmin(mesh.points.sum(axis=1)))

    def push(points, t):
        x = points.copy()
        x[corner] += t * np.array([2.0, 2.6, 2.0])
        return x

    track = read_track(MovingBody(mesh, push), "")
    assert track.low[-1] > 0 and track.inverted.tolist()[0] == 0 and track.inverted[-1] >= 1
    colors = Palette(0.5).map_colors(track.ratio[-1], dimmed=False)
    assert (colors == INVERTED).all(axis=1).any()


@pytest.mark.opengl
def test_the_film_tells_from_when_on_there_are_no_data(tmp_path):
    _, pixels = film(tmp_path, list(make_gaps().values()), fps=5, size=(1280, 720))
    lost, known = pixels[-1, 80:120, :300].astype(int), pixels[0, 80:120, :300].astype(int)
    red = lost[..., 0] - lost[..., 1]
    assert (red > 80).sum() > 50 and (known[..., 0] - known[..., 1] > 80).sum() == 0


def test_frames_for_paraview_have_positions_of_all_nodes(tmp_path, monkeypatch):
    """Frames without any positions are left out; nodes that lack one are at rest, and their cells have no ratio."""
    import pyvista

    for name, kept in (("end", ["0.0", "0.1"]), ("nodes", ["0.0", "0.1", "0.2", "0.3"])):
        body, sink = make_gaps()[name], VtuSink(tmp_path / name)
        write_statistics(body, tmp_path / f"{name}.nc", frames=sink)
        assert re.findall(r'timestep="([^"]*)"', sink.index.read_text()) == kept
    frame = pyvista.read(tmp_path / "nodes" / "frames" / "frame_000003.vtu")
    assert np.isfinite(frame.points).all()
    assert 0 < np.isnan(frame.cell_data["volume_ratio"]).sum() < frame.n_cells


def test_scenes_of_bodies_without_data_have_a_color_for_it():
    pytest.importorskip("k3d")
    bodies = make_gaps()
    solids = pack_solids(list(bodies.values()), list(bodies), [0] * 4)
    assert solids.meta["unknownColor"] == "#" + bytes(UNKNOWN).hex()
    assert solids.meta["bodies"][0]["gaps"] == [None, None, TIMES[2], TIMES[2]]
    assert solids.meta["bodies"][2]["gaps"] == [None] * 4
    plain = pack_solids([make_body("hexahedra")], ["x"], [0])
    assert "unknownColor" not in plain.meta and "gaps" not in plain.meta["bodies"][0]


def test_the_page_of_a_mixture_and_of_lost_data(tmp_path):
    bodies = [make_body("mixture"), make_gaps()["end"]]
    sides = []
    for body in bodies:
        write_statistics(body, tmp_path / body.name / "statistics.nc")
        sides.append(Side(body.name, body, tmp_path / body.name / "statistics.nc"))
    path = write_page(PageContent("Any cells", tuple(sides)), tmp_path / "report.html")
    page = path.read_text(encoding="utf-8")
    text = unescape(re.sub(r"<[^>]*>", " ", page[page.index("<main>") : page.index("</main>")]))
    assert "2 series of 6 pyramids, 2 wedges and 1 hexahedron; 24 hexahedra, 4 frames" in text
    assert "at t = 0.1 s, the last with data, the whole body is" in text
    assert "% at t = 0.1 s" in text and "smallest det F in it" in text


@pytest.mark.browser
def test_the_page_opens_in_a_browser_and_says_from_when_on_there_are_no_data(tmp_path, chromium):
    pytest.importorskip("k3d")
    from playwright.sync_api import sync_playwright

    bodies = [make_gaps()["end"], make_body("curved tetrahedra"), make_body("polyhedra"), make_body("shell")]
    sides = []
    for body in bodies:
        write_statistics(body, tmp_path / body.name / "statistics.nc")
        sides.append(Side(body.name, body, tmp_path / body.name / "statistics.nc"))
    path = write_page(PageContent("Any cells", tuple(sides)), tmp_path / "report.html")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium)
        page, heard = browser.new_page(), []
        page.on("console", lambda message: message.type == "error" and heard.append(message.text))
        page.on("pageerror", lambda error: heard.append(str(error)))
        page.goto(path.as_uri())
        page.wait_for_selector("#bodies[data-ready]", state="attached")
        page.locator("#worst button").nth(6).click()  # of the second body, in the last frame
        captions = page.locator("figure.body figcaption").all_text_contents()
        keys = page.locator("#bar .inverted").all_text_contents()
        browser.close()
    assert heard == [] and keys == ["no data"]
    assert captions[0].startswith("end") and captions[0].endswith(", no cell data from t = 0.200 s")
    assert captions[1:] == ["curved tetrahedra", "polyhedra", "shell"]


def test_the_worst_frame_may_lack_some_cells(tmp_path):
    for name, frame in (("end", 1), ("nodes", 3)):
        write_statistics(make_gaps()[name], tmp_path / f"{name}.nc")
        assert find_worst_frame(read_dataset(tmp_path / f"{name}.nc")) == frame


def test_worst_cells_have_their_extremes(tmp_path):
    body = make_body("curved tetrahedra")
    write_statistics(body, tmp_path / "statistics.nc")
    statistics = read_dataset(tmp_path / "statistics.nc")
    cell = find_worst_cells(statistics, body.mesh, 1)[0]
    low, high = cell.extremes
    assert low < cell.volume_ratio < high
    assert high == pytest.approx(float(statistics["volume_ratio_max"].sel(time=cell.time)[cell.cell]))
    assert find_worst_cells(statistics.drop_vars("volume_ratio_min"), body.mesh, 1)[0].extremes is None


def test_the_figure_has_dotted_lines_of_the_extremes(tmp_path):
    time, cells = np.linspace(0, 1, 20), 30
    ratio = 1 + 0.1 * np.outer(time, np.linspace(0, 1, cells))[None]
    plain = xarray.Dataset(
        {"volume_ratio": (("variant", "time", "cell"), ratio), "rest_volume": ("cell", np.arange(1.0, cells + 1))},
        {"time": time, "variant": ["a"]},
    )
    plain["rest_volume"].attrs["units"] = "m3"
    wide = plain.assign(
        volume_ratio_min=(("variant", "time", "cell"), ratio - 0.3),
        volume_ratio_max=(("variant", "time", "cell"), ratio + 0.3),
    )
    for name, dataset in (("plain", plain), ("wide", wide)):
        write_volume_figure(dataset, tmp_path / f"{name}.png", title="t")
    assert not np.array_equal(read_pixels(tmp_path / "plain.png"), read_pixels(tmp_path / "wide.png"))
    with warnings.catch_warnings():  # holes of any kind
        warnings.simplefilter("error")
        holes = wide.copy(deep=True)
        holes["volume_ratio"][0, 4] = np.nan
        holes["volume_ratio"][0, 7:9, 3] = np.nan
        write_volume_figure(holes, tmp_path / "holes.png", title="t")
        many = holes.isel(cell=np.arange(2100) % cells)
        write_volume_figure(many, tmp_path / "many.png", title="t")


@pytest.mark.parametrize(
    ("total", "text"),
    [
        (
            [1, 1.65, 1.00003],
            "at the end the whole body is 0.003 % larger than at rest; it was 65 % larger than at rest at",
        ),
        ([1, 5, 10], "at the end the whole body is 10 times as large as at rest"),
        (
            [1, 11.0, 1.2],
            "at the end the whole body is 20 % larger than at rest; it was 11 times as large as at rest at",
        ),
        ([1, 0.99, 0.98], "at the end the whole body is 2 % smaller than at rest"),
        ([1, 0.5, 0.05], "at the end the whole body is only 0.05 times as large as at rest"),
        ([1, 0.5, -0.1], "at the end the whole body is inverted (its volume is -0.1 times that at rest)"),
        ([1, 1.2, np.nan], "at t = 1 s, the last with data, the whole body is 20 % larger than at rest"),
        ([np.nan] * 3, "the volume of the whole body is unknown"),
    ],
)
def test_sizes_in_words(total, text):
    sentence = describe_size(np.arange(3.0), np.array(total, dtype=float))
    assert sentence.startswith(text) and "e+" not in sentence
    assert sentence == text or text.endswith(" at")
