"""The report on the seeds: verdicts, the law of spurious volume, damping, and two self-contained files."""

import re
from dataclasses import replace

import numpy as np
import pytest

from pipeline import build, cli, load_case
from pipeline.errors import OutputError
from pipeline.fem.element import deformation_gradient
from pipeline.fem.rotation import angle, polar
from pipeline.series import read_series
from pipeline.studies import thesis as reproduction
from pipeline.studies.thesis import ALL_SCENES, reproduce
from pipeline.studies.thesis.corrections import TESTS as CORRECTION_TESTS
from pipeline.studies.thesis.damping import measure_damping
from pipeline.studies.thesis.growth_law import Growth, make_band, read_linear_growth, read_step_growth
from pipeline.studies.thesis.our_runs import RunOutcome, ThesisScene
from pipeline.studies.thesis.published import (
    CORRECTIONS,
    FIGURES,
    NUMBERS,
    SCENES,
    STATEMENTS,
    TIMINGS,
    PublishedNumber,
)
from pipeline.studies.thesis.report import find_kind, make_report
from pipeline.studies.thesis.verbal_claims import TESTS as STATEMENT_TESTS
from pipeline.studies.thesis.verdicts import judge, judge_number
from pipeline.views.html.blocks import Heading, Paragraph, Picture, TableBlock, render_html, render_markdown
from tests.bodies import METHODS, list_states, make_solid, make_spin, make_thesis_bar

NUMBER = PublishedNumber("bar: largest volume", "2.0", 2.0, 0.02, "T 1.2", "bar", "linear", "largest_volume")
SECTIONS = (
    "Published numbers", "Statements of the thesis", "Time per step: tables 7.1 and 7.2", "Every scene and variant",
    "Figures", "The law of spurious volume", "Damping", "Corrections to the seeds", "Made by",
)  # fmt: skip


@pytest.fixture(scope="module")
def bar(cases_folder):
    return build(load_case(cases_folder / "bar_small_as_printed.toml").variant("linear"))


@pytest.fixture(scope="module")
def short(cases_folder, tmp_path_factory):
    """The report of two scenes, three frames each, without movies."""
    out = tmp_path_factory.mktemp("outputs")
    return reproduce(cases_folder, out, scenes=("bar_as_printed", "bar"), frames=3, movie=False)


def make_outcome(tmp_path, **values):
    whole = RunOutcome(
        status="finished", folder=tmp_path, nodes=81, cells=192, steps=100, dt=0.07, largest_ratio=2.0, cell=1,
        iteration=2, smallest_ratio=0.6, largest_volume=2.0, its_rest_volume=1.0, largest_rest_volume=1.0,
        kinetic_left=0.0, seconds_per_step=1e-3,
    )  # fmt: skip
    return replace(whole, **values)


@pytest.mark.parametrize(
    ("as_printed", "calibrated", "verdict"),
    [
        (2.0, 2.0, "reproduced"),
        (1.981, None, "reproduced"),
        (1.1, 2.019, "reproduced with factor 3.5"),
        (None, 1.99, "reproduced with factor 3.5"),
        (1.1, 2.021, "not reproduced: -45.0 % as printed, +1.0 % with factor 3.5"),
        (1.1, None, "not reproduced: -45.0 % as printed"),
        (None, None, "not reproduced: not run"),
        (float("nan"), float("nan"), "not reproduced: +nan % as printed, +nan % with factor 3.5"),
    ],
)
def test_a_verdict_prefers_the_printed_parameters_and_has_its_reason(as_printed, calibrated, verdict):
    assert judge(NUMBER, as_printed, calibrated, 3.5) == verdict
    remarked = judge(replace(NUMBER, remark="by design"), as_printed, calibrated, 3.5)
    assert remarked == f"{verdict} (by design)"
    assert find_kind(remarked) == find_kind(verdict) == re.sub(r" 3\.5|:.*", "", verdict)


def test_times_of_other_hardware_are_a_kind_of_their_own(short):
    verdicts = dict(short.report.verdicts)
    assert verdicts["bar, linear: seconds a step"].startswith("other hardware and software: ours is ")
    assert verdicts["mushroom, linear: seconds a step"] == "not reproduced: not run"
    assert find_kind(verdicts["bar, linear: seconds a step"]) == "other hardware"
    assert verdicts["the corotational method is not"] == "other hardware: not on ours, with compiled sparse solvers"
    kinds = {kind: short.report.count_verdicts(kind) for kind in reproduction.KINDS}
    assert kinds["other hardware"] == 3 and "3 other hardware" in short.summary
    assert not any("seconds" in what and find_kind(text) == "not reproduced" and "not run" not in text
                   for what, text in short.report.verdicts)  # fmt: skip


def test_an_iteration_is_not_judged_in_percent():
    assert judge(replace(NUMBER, quantity="iteration"), 3.0, 17.0, 3.5) == (
        "not reproduced: 3 as printed, 17 with factor 3.5"
    )


def test_a_number_is_read_from_both_scenes_and_a_difference_is_subtracted(tmp_path):
    scenes = {
        name: ThesisScene(
            name, tmp_path, 3.0, "initial velocity", {"linear": make_outcome(tmp_path, largest_volume=volume)}
        )
        for name, volume in {"bar": 3.0, "bar_small": 1.0, "bar_as_printed": 1.5}.items()
    }
    found = judge_number(replace(NUMBER, less="bar_small"), scenes)
    assert (found.as_printed, found.calibrated) == (None, 2.0)
    assert found.verdict == "reproduced with factor 3"
    failed = {"bar": replace(scenes["bar"], outcomes={"linear": make_outcome(tmp_path, status="failed")})}
    assert judge_number(NUMBER, failed).verdict == "not reproduced: not run"


def test_published_data_refer_to_existing_scenes_tests_and_fields():
    assert {n.scene for n in NUMBERS} | {t.scene for t in TIMINGS} | {f.scene for f in FIGURES} == set(SCENES)
    assert {row.test for row in CORRECTIONS} - {""} == set(CORRECTION_TESTS)
    assert {s.test for s in STATEMENTS} == set(STATEMENT_TESTS)
    fields = RunOutcome.__dataclass_fields__
    assert all(n.quantity in fields for n in NUMBERS)
    shown = {number for f in FIGURES for number in re.findall(r"\d\.\d+", f.figures)}
    assert shown == {"5.4", "5.7", "5.10"} | {f"7.{i}" for i in range(1, 16)}


def measure_growth(mesh, x_used, x):
    """The growth at positions x of a solve that used the rotations at x_used."""
    before, F = (deformation_gradient(mesh, points) for points in (x_used, x))
    return Growth(angle(np.swapaxes(polar(before), 1, 2) @ polar(F)), np.linalg.det(F))


@pytest.mark.parametrize("axis", [[1.0, 0, 0], [0, 0, 1.0], [0.3, -0.5, 0.8]])
@pytest.mark.parametrize("dt", [0.01, 0.3])
def test_a_homogeneous_rotation_obeys_the_law_exactly(axis, dt):
    """Linear: every step of a free spin; one solve: its first step, before which it has no strain."""
    mesh = make_thesis_bar()
    omega = np.array(axis) * 1.5
    for name, steps, sources in (("linear", 5, [0] * 5), ("polar", 1, [0])):
        body = make_solid(mesh, **METHODS[name])
        states = list_states(body, dt, steps, make_spin(body, omega))
        for source, state in zip(sources, states[1:], strict=True):
            growth = measure_growth(mesh, states[source].x, state.x)
            assert growth.over_law == pytest.approx(1.0, abs=1e-9)
            assert growth.ratio == pytest.approx(1 + (np.linalg.norm(omega) * dt * state.step) ** 2, rel=1e-9)


def test_a_band_has_the_cells_that_turned_far_enough():
    turned = np.radians([5.0, 20.0, 40.0, 60.0])
    growth = Growth(turned, np.array([9.0, 1.0, 1.0, 1.0]) / np.cos(turned) ** 2)
    found = make_band(growth, 10.0)
    assert found is not None
    assert (found.count, found.median) == (3, pytest.approx(1.0))
    assert found.low == pytest.approx(1.0) and found.high == pytest.approx(1.0)
    assert found.largest_angle == pytest.approx(60.0) and found.largest_growth == pytest.approx(4.0)
    assert make_band(growth, 70.0) is None


def test_the_measured_damping_of_backward_euler_is_its_formula(bar):
    modes = measure_damping(bar, 6)
    assert [m.measured for m in modes] == pytest.approx([m.formula for m in modes], rel=1e-9)
    assert modes[0].omega == pytest.approx(10.424, abs=5e-4)  # measured with another program
    assert modes[0].formula == pytest.approx(0.32, abs=0.005)


def test_the_report_has_every_section_and_row(short):
    for text in (short.html.read_text(encoding="utf-8"), short.markdown.read_text(encoding="utf-8")):
        assert all(section in text for section in SECTIONS)
        plain = re.sub(r"<[^>]*>", "", text)
        for row in (*NUMBERS, *STATEMENTS):
            assert getattr(row, "what", None) or row.says in plain
        assert all(row.where in plain for row in CORRECTIONS)
        assert "Table 7.1" in text and "Table 7.2" in text
    counts = [short.report.count_verdicts(kind) for kind in reproduction.KINDS]
    assert sum(counts) == len(NUMBERS) + len(STATEMENTS) + len(TIMINGS)
    assert short.exit_code == 0


def test_the_page_is_self_contained(short):
    page = short.html.read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>") and page.rstrip().endswith("</html>")
    without_pictures = re.sub(r"base64,[A-Za-z0-9+/=]+", "", page)
    assert re.search(r"https?:|//[a-z]|<script|<link|@import|url\(", without_pictures) is None
    sources = re.findall(r'src="([^"]{40})', page)
    assert len(sources) >= 4 and all(source.startswith("data:image/png;base64,iVBOR") for source in sources)
    assert "prefers-color-scheme: dark" in page
    tags = [len(re.findall(rf"<{end}{tag}\b", page)) for tag in ("table", "figure", "tr", "td") for end in ("", "/")]
    assert tags[::2] == tags[1::2]


def test_the_pictures_of_the_markdown_exist(short):
    links = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", short.markdown.read_text(encoding="utf-8"))
    assert len(links) >= 4
    assert all((short.markdown.parent / link).stat().st_size > 5000 for link in links)


def test_up_to_date_scenes_are_not_solved_again(short, cases_folder):
    again = []
    second = reproduce(
        cases_folder, short.html.parent, scenes=("bar_as_printed", "bar"), frames=3, movie=False,
        on_frame=lambda *about: again.append(about),
    )  # fmt: skip
    assert again == []
    assert second.html.read_text() == short.html.read_text()


@pytest.mark.opengl
def test_the_states_that_the_thesis_shows_are_drawn(short):
    assert (short.html.parent / "reproduction" / "states_bar.png").stat().st_size > 20_000


def test_scenes_that_were_not_run_are_named(bar, tmp_path):
    report = make_report({}, bar, tmp_path)
    # the stability of a free spin needs no scene, and neither do corrections and damping
    assert report.count_verdicts("not reproduced") == len(report.verdicts)
    text = render_markdown(report.blocks, tmp_path)
    assert text.count("not reproduced: not run") == len(report.verdicts) - 1
    assert "`bar_as_printed` was not run." in text


def test_texts_are_escaped(tmp_path):
    blocks = [Heading("a < b", 1), Paragraph("x & `y<z` **strong**"), TableBlock(("|",), [("a|b", "<i>")])]
    page = render_html(blocks)
    assert "a &lt; b" in page and "x &amp; <code>y&lt;z</code> <strong>strong</strong>" in page and "<i>" not in page
    assert r"a\|b" in render_markdown(blocks, tmp_path)


def test_a_missing_picture_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match=r"gone\.png"):
        render_html([Heading("t", 1), Picture(tmp_path / "gone.png", "gone")])


def test_the_command_passes_its_options_on(monkeypatch, tmp_path, short, capsys):
    passed = {}

    def stand_in(cases, out, **options):
        passed.update(cases=cases, out=out, force=options["force"])
        return short

    monkeypatch.setattr(reproduction, "reproduce", stand_in)
    assert cli.main(["reproduce", "--cases", "elsewhere", "--out", str(tmp_path), "--force"]) == 0
    assert (str(passed["cases"]), passed["out"], passed["force"]) == ("elsewhere", tmp_path, True)
    out = capsys.readouterr().out
    assert "not reproduced" in out and "reproduction.html" in out


def test_every_scene_of_the_seeds_has_its_case_and_four_methods(cases_folder):
    for name in ALL_SCENES:
        names = load_case(cases_folder / f"{name}.toml").variant_names
        assert name == "beam2d" or names == ("linear", "gram_schmidt", "polar", "converged")


def test_the_gallery_has_every_case(project_root, cases_folder):
    gallery = (project_root / "docs" / "gallery" / "README.md").read_text(encoding="utf-8")
    for name in ALL_SCENES:
        assert f"({name}.png)" in gallery
    for name in re.findall(r"\(([a-z0-9_]+)\.png\)", gallery):
        assert (cases_folder / f"{name}.toml").exists()


# verdict of a published number about the bar, first words
BAR_VERDICTS = {
    "bar: nodes": "reproduced",
    "bar: tetrahedra": "reproduced",
    "bar: volume of every tetrahedron [m3]": "reproduced",
    "bar, f = 20, linear: largest volume [m3]": "reproduced with factor 3.12",
    "bar, f = 40, linear: largest volume [m3]": "reproduced with factor 3.12",
    "bar, linear: f = 40 minus f = 20 [m3]": "reproduced with factor 3.12",
    "bar, f = 20, corotational: largest volume [m3]": "not reproduced: -17.0 % as printed, -8.2 % with factor 3.12",
    "bar, f = 40, corotational: largest volume [m3]": "not reproduced: -23.9 % as printed, +1.9 % with factor 3.12",
    "bar, corotational: f = 40 minus f = 20 [m3]": "not reproduced: -72.9 % as printed, +73.3 % with factor 3.12",
}
# 5 and 95 % of J / sec^2 above 10 degrees, measured with another program (linear) and read off here (polar)
BANDS = {
    ("bar_as_printed", "linear"): (0.971, 1.032),
    ("bar", "linear"): (0.889, 1.087),
    ("bar_as_printed", "polar"): (0.974, 1.020),
    ("bar", "polar"): (0.941, 1.059),
}


@pytest.mark.slow
def test_the_bar_in_full(cases_folder, tmp_path):
    scenes = [name for name in ALL_SCENES if name.startswith("bar")]
    done = reproduce(cases_folder, tmp_path, scenes=scenes, movie=False)
    verdicts = dict(done.report.verdicts)
    for what, begins in BAR_VERDICTS.items():
        assert verdicts[what].startswith(begins), (what, verdicts[what])
    assert {what for what in verdicts if what.startswith("bar") and "seconds" not in what} == set(BAR_VERDICTS)
    for (scene, variant), edges in BANDS.items():
        measured = {"linear": read_linear_growth, "polar": read_step_growth}[variant]
        found = make_band(measured(read_series(tmp_path / scene / variant)), 10.0)
        assert found is not None
        assert found.median == pytest.approx(1.0, abs=0.01)
        assert (found.low, found.high) == pytest.approx(edges, abs=6e-4)
