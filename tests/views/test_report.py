"""report.html as a file: valid, self-contained, escaped, and in agreement with the datasets."""

import base64
import json
import os
import re
import sys
import zlib
from html.parser import HTMLParser

import msgpack
import numpy as np
import pytest
import pyvista
import xarray

from pipeline.case import load_case
from pipeline.cli import main
from pipeline.errors import OutputError
from pipeline.formats.netcdf import read_dataset
from pipeline.results.analysis_folder import analyze, compare
from pipeline.results.case_run import run_case
from pipeline.results.comparison import find_runs
from pipeline.results.report import write_analysis_report, write_report
from pipeline.series import read_series
from pipeline.views.html import page as web_page
from pipeline.views.html import solids as web_solids
from pipeline.views.html import worst as web_worst
from pipeline.views.html.curves import choose_times, collect_curves
from pipeline.views.html.worst import find_worst_cells
from tests.bodies import PLANAR, skip_figures, write_case

TITLE = 'A <b>bar</b> & "more" </script><script>alert(1)</script>'
VOID = frozenset("meta input img br link".split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the result folder of three variants, with a title that tries to break the page."""
    root = tmp_path_factory.mktemp("page")
    case = load_case(write_case(root, movie={"title": TITLE}))
    with pytest.MonkeyPatch.context() as patch:
        skip_figures(patch)
        return run_case(case, root / "outputs", movie=False).folder


@pytest.fixture(scope="module")
def text(folder) -> str:
    return write_report(folder).read_text(encoding="utf-8")


class Reader(HTMLParser):
    """Tags in the order of opening; `wrong` lists those that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.tags, self.wrong = [], [], []
        self.feed(text)
        self.wrong += self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def all(self, name, attribute):
        return [attributes[attribute] for tag, attributes in self.tags if tag == name and attribute in attributes]


def read_data(text: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text).group(1))


def test_the_page_is_well_formed_and_self_contained(text):
    reader = Reader(text)
    assert reader.wrong == []
    assert text.startswith("<!doctype html>") and dict(reader.tags)["html"] == {"lang": "en"}
    ids = [attributes["id"] for _, attributes in reader.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    links = [address for tag in ("a", "link") for address in reader.all(tag, "href")]
    assert links and {link[1:] for link in links} <= set(ids)
    assert not [
        url for tag in ("script", "img", "video", "iframe") for url in reader.all(tag, "src") if url[:5] != "data:"
    ]
    policy = next(a["content"] for t, a in reader.tags if t == "meta" and "http-equiv" in a)
    assert "default-src 'none'" in policy and "http" not in policy and "unsafe-eval" not in policy
    headings = [tag for tag, _ in reader.tags if re.fullmatch("h[1-6]", tag)]
    assert headings[0] == "h1" and set(headings[1:]) == {"h2"}


def test_texts_of_a_case_are_escaped(text):
    assert "alert(1)" in text and "<script>alert" not in text and "<b>bar" not in text
    assert "A &lt;b&gt;bar&lt;/b&gt; &amp; &quot;more&quot;" in text


def test_the_page_agrees_with_the_datasets(folder, text):
    data = read_data(text)
    assert data["labels"] == ["linear", "gram schmidt", "polar"]
    for name, drawn in zip(("linear", "gram_schmidt", "polar"), data["curves"], strict=True):
        statistics = read_dataset(folder / name / "statistics.nc")
        assert drawn["times"] == pytest.approx(statistics["time"].values)
        assert drawn["total"] == pytest.approx(100 + 100 * statistics["volume_drift"].values, rel=1e-5)
        energies = [statistics[f"{kind}_energy"].values for kind in ("kinetic", "elastic", "potential")]
        assert drawn["energies"]["total"] == pytest.approx(sum(energies), rel=1e-4)
        ratio = statistics["volume_ratio"].values
        frame, cell = np.unravel_index(np.abs(ratio - 1).argmax(), ratio.shape)
        row = f'{name.replace("_", " ")}</th><td class="number">{cell}</td>'
        row += f'<td class="number">{ratio[frame, cell]:.5g}</td>'
        assert row in text
        verb = "grows" if ratio[frame, cell] > 1 else "shrinks"
        assert f"cell {cell} {verb} to {ratio[frame, cell]:.4g} times" in text
        assert drawn["bands"][0][1] == pytest.approx(ratio.max(axis=1), rel=1e-5)
    assert (
        "pipeline run" in text
        and 'shape = "box"' in text
        and f'>numpy</td><td class="number">{np.__version__}<' in text
    )
    assert data["start"] in data["solids"]["bodies"][0]["times"]


def test_the_same_result_is_the_same_page(folder, text):
    assert write_report(folder).read_text(encoding="utf-8") == text


def test_a_scene_holds_the_frames(folder, text):
    packed = re.search(r'id="scene-0">(.*?)</script>', text).group(1)
    scene = msgpack.unpackb(zlib.decompress(base64.b64decode(packed)))
    vertices, series = scene["objects"][0]["vertices"], read_series(folder / "linear")
    assert [key for key in vertices if key.isdigit()] == [str(i) for i in range(len(series))]
    points = np.frombuffer(vertices["4"]["data"], np.float32).reshape(-1, 3)
    # all nodes of this beam lie on its surface
    assert np.abs(points - series.read_frame(4).x).max() < series.mesh.size * 2**-15


def test_without_k3d_the_page_has_the_rest(folder, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "k3d", None)
    text = write_report(folder).read_text(encoding="utf-8")
    assert "k3d is not installed" in text and 'id="bodies"' not in text and 'id="curves"' in text
    assert read_data(text)["solids"] is None and Reader(text).wrong == []


def test_large_results_show_some_frames_and_note_which(folder, monkeypatch):
    series = read_series(folder / "linear")
    monkeypatch.setattr(web_solids, "MOST_FRAMES", 2)
    solids = web_solids.pack_solids([series], ["linear"], [1])
    times = [series.times[i] for i in (0, 1, 3, 4)]
    assert solids.meta["bodies"][0]["times"] == pytest.approx(times)
    assert solids.notes == (
        "linear: the 3D view shows 4 of 5 frames: every 3rd, the last, and the one with the largest volume change",
    )
    monkeypatch.setattr(web_solids, "MOST_FRAMES", 400)
    monkeypatch.setattr(web_solids, "MOST_BYTES", 1)
    assert len(web_solids.pack_solids([series], ["linear"], [0]).meta["bodies"][0]["times"]) == 3


def test_curves_of_long_series_show_some_of_their_frames(monkeypatch, folder):
    statistics = read_dataset(folder / "linear" / "statistics.nc")
    worst = int(np.abs(statistics["volume_ratio"].values - 1).max(axis=1).argmax())
    monkeypatch.setattr("pipeline.views.html.curves.MOST_TIMES", 2)
    assert choose_times(statistics) == sorted({0, worst, 4})
    assert len(collect_curves(statistics)["total"]) == len({0, worst, 4})


def test_worst_cells_are_searched_a_few_frames_at_a_time(monkeypatch):
    from pipeline.mesh.shapes import box

    mesh = box((1.0, 1.0, 1.0), (1, 1, 1))
    ratio = 1 + 0.1 * np.random.default_rng(1).standard_normal((7, len(mesh.cells)))
    ratio[5, 2], ratio[6, 1], ratio[3, 0] = 4.0, -3.5, np.nan
    statistics = xarray.Dataset({"volume_ratio": (("time", "cell"), ratio)}, {"time": np.arange(7) / 2})
    monkeypatch.setattr(web_worst, "_VALUES", 2 * len(mesh.cells))
    cells = find_worst_cells(statistics, mesh, 3)
    assert [(cell.cell, cell.volume_ratio, cell.time) for cell in cells[:2]] == [(1, -3.5, 3.0), (2, 4.0, 2.5)]
    assert cells[1].place == pytest.approx(mesh.points[mesh.cells[2]].mean(axis=0))
    assert len(cells) == 3 and np.isfinite(cells[2].volume_ratio)


def test_small_movies_are_inside_the_page_and_large_ones_beside_it(folder, monkeypatch):
    movie, poster = folder / "comparison.mp4", folder / "comparison.png"
    movie.write_bytes(b"film")
    poster.write_bytes(b"still")
    try:
        inside = write_report(folder).read_text(encoding="utf-8")
        assert 'src="data:video/mp4;base64,ZmlsbQ=="' in inside and 'src="data:image/png;base64,c3RpbGw="' in inside
        monkeypatch.setattr(web_page, "MOST_MOVIE_BYTES", 3)
        beside = write_report(folder).read_text(encoding="utf-8")
        assert 'src="comparison.mp4"' in beside and "too large" in beside
    finally:
        movie.unlink()
        poster.unlink()


def test_a_variant_that_failed_and_one_that_is_missing(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    case = load_case(write_case(tmp_path))
    folder = run_case(case, tmp_path / "outputs", variants=["linear"], movie=False).folder
    run = folder / "linear" / "run.json"
    run.write_text(json.dumps(json.loads(run.read_text()) | {"status": "failed", "message": "it <blew> up"}))
    text = write_report(folder).read_text(encoding="utf-8")
    assert "linear failed: it &lt;blew&gt; up" in text
    assert "polar is not shown: it is not finished" in text
    (folder / "case.toml").write_text((folder / "case.toml").read_text().replace("frames = 4", "frames = 5"))
    with pytest.raises(OutputError, match=r"of another case \(schedule.frames: 4 there, 5 here\); pipeline run"):
        write_report(folder)
    run.write_text(json.dumps(json.loads(run.read_text()) | {"status": "running"}))
    with pytest.raises(OutputError, match="nothing to report: linear is not shown: it is not finished; pipeline run"):
        write_report(folder)


def test_the_page_of_planar_bodies(tmp_path, monkeypatch):
    skip_figures(monkeypatch)
    case = load_case(write_case(tmp_path, **PLANAR, supports=[{"plane": "y", "at": 3.0}]))
    text = write_report(run_case(case, tmp_path / "outputs", movie=False).folder).read_text(encoding="utf-8")
    assert "series of 24 triangles" in text and read_data(text)["energy"] == "J/m"


def test_the_page_of_any_series(folder, tmp_path, monkeypatch, capsys):
    skip_figures(monkeypatch)
    series = read_series(folder / "linear")
    path = write_analysis_report(analyze(series, tmp_path / "one"), [series], "pipeline analyze x")
    text = path.read_text(encoding="utf-8")
    assert path == tmp_path / "one" / "report.html" and "One series of 18 tetrahedra" in text
    assert "pipeline analyze x" in text
    hostile = read_series(folder / "linear", name="</script><i>name")
    text = write_analysis_report(analyze(hostile, tmp_path / "hostile"), [hostile], "").read_text(encoding="utf-8")
    assert read_data(text)["labels"] == ["</script><i>name"] and Reader(text).wrong == [] and "<i>" not in text
    pair = [series, read_series(folder / "polar", name="linear")]
    text = write_analysis_report(compare(pair, tmp_path / "two"), pair, "").read_text(encoding="utf-8")
    assert read_data(text)["labels"] == ["linear", "linear_2"] and "Difference of nodes" not in text
    comparison = compare(pair, tmp_path / "apart", difference=True)
    text = write_analysis_report(comparison, pair, "").read_text(encoding="utf-8")
    assert "from those of linear" in text and f">{comparison.node_distances[0].worst:.4g}</td>" in text
    out = (tmp_path / "three").as_posix()
    source = (folder / "linear").as_posix()
    assert main(["analyze", source, "--report", "--rest", "rest_position", "--out", out]) == 0
    assert capsys.readouterr().out.endswith(f"{out}/report.html\n")
    text = (tmp_path / "three" / "report.html").read_text(encoding="utf-8")
    assert f"pipeline analyze {source} --rest rest_position --out {out} --report" in text


def test_report_and_view_on_the_command_line(folder, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: not opened.append(address))
    page = folder / "report.html"
    page.unlink(missing_ok=True)
    assert main(["report", str(folder)]) == 0
    assert capsys.readouterr().out == f"{page}\n" and page.is_file() and not opened
    page.write_text("earlier")
    assert main(["view", str(folder)]) == 0
    assert opened == [page.absolute().as_uri()] and page.read_text() == "earlier"
    os.utime(folder / "polar" / "run.json", ns=(page.stat().st_mtime_ns + 10**9,) * 2)
    assert main(["view", str(folder), "--no-open"]) == 0
    assert len(opened) == 1 and page.read_text(encoding="utf-8").startswith("<!doctype")
    os.utime(folder / "polar" / "run.json")
    monkeypatch.setattr("webbrowser.open", lambda address: False)
    assert main(["view", str(folder)]) == 0
    assert "no browser could be started" in capsys.readouterr().err


def test_a_folder_without_a_result_is_an_error_of_one_line(tmp_path, capsys):
    for verb in ("report", "view"):
        assert main([verb, str(tmp_path / "none")]) == 2
        assert "CaseError: " in (message := capsys.readouterr().err) and message.count("\n") == 1 and "none" in message


def test_the_result_folder_of_a_case_with_a_mesh_file_is_recognized(tmp_path, monkeypatch, project_root):
    """The relative path of the mesh differs in the result folder, which must not make it another case."""
    skip_figures(monkeypatch)
    (tmp_path / "meshes").mkdir()
    mesh = pyvista.ImageData(dimensions=(2, 2, 2)).to_tetrahedra()
    for name in ("cube.vtu", "other.vtu"):
        mesh.save(tmp_path / "meshes" / name)
    sections = {"supports": [{"plane": "y", "at": 1.0}], "variants": None}
    path = write_case(tmp_path, mesh={"file": "meshes/cube.vtu"}, **sections)
    folder = run_case(load_case(path), tmp_path / "outputs", movie=False).folder
    case = load_case(folder / "case.toml")
    assert list(find_runs(case, folder)) == ["default"]
    assert "One series of 5 tetrahedra" in write_report(folder).read_text(encoding="utf-8")
    text = (folder / "case.toml").read_text()
    (folder / "case.toml").write_text(text.replace("cube.vtu", "other.vtu"))
    assert not find_runs(load_case(folder / "case.toml"), folder)
