"""`pipeline reproduce`: every scene of the seeds, and a report of what of the published numbers holds.

published (data) -> measured, law, damping, statements, corrections (computing) -> report, figures, page (rendering)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.case import load_case
from pipeline.errors import SolveError
from pipeline.formats.atomic import write_whole
from pipeline.problem.problem import build
from pipeline.results.case_run import run_case
from pipeline.results.variant_run import Notify
from pipeline.studies.thesis.our_runs import ThesisScene, read_scene
from pipeline.studies.thesis.published import AS_PRINTED, PLANAR_SCENE, SCENES
from pipeline.studies.thesis.report import KINDS, Report, make_report
from pipeline.views.html.blocks import render_html, render_markdown

ALL_SCENES = (*(name + ending for name in SCENES for ending in (AS_PRINTED, "")), PLANAR_SCENE)


@dataclass(frozen=True)
class Reproduction:
    """The two files written, the report, and the scenes that it is about."""

    html: Path
    markdown: Path
    report: Report
    scenes: dict[str, ThesisScene]
    failed: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """Return 3 where a variant failed, else 0."""
        return SolveError.exit_code if self.failed else 0

    @property
    def summary(self) -> str:
        """Return the counts of verdicts in a line."""
        return ", ".join(f"{self.report.count(kind)} {kind}" for kind in KINDS)


def reproduce(
    cases: Path,
    out: Path,
    *,
    scenes: Sequence[str] = ALL_SCENES,
    frames: int | None = None,
    force: bool = False,
    resume: bool = False,
    movie: bool = True,
    notify: Notify | None = None,
    on_drawing: Callable[[int, int], None] | None = None,
) -> Reproduction:
    """Run the scenes of a folder of cases into out/<case>/ and write out/reproduction.html and .md.

    What is up to date is not solved again; `resume` goes on with what is unfinished. `frames` shortens every schedule.
    Raises PipelineError as run_case does.
    """
    overrides = {} if frames is None else {"schedule.frames": frames}
    loaded = [load_case(Path(cases) / f"{name}.toml", overrides=overrides) for name in scenes]
    bar = build(load_case(Path(cases) / f"bar_small{AS_PRINTED}.toml").variant("linear"))
    ran, failed = {}, []
    for case in loaded:
        result = run_case(case, out, force=force, resume=resume, movie=movie, notify=notify, on_drawing=on_drawing)
        ran[case.name] = read_scene(case, result)
        failed += [f"{case.name}/{v.name}" for v in result.variants if v.run.get("status") == "failed"]
    own = Path(out) / "reproduction"
    report = make_report(ran, bar, own)
    files = Path(out) / "reproduction.html", Path(out) / "reproduction.md"
    write_whole(files[0], render_html(report.blocks))
    write_whole(files[1], render_markdown(report.blocks, Path(out)))
    return Reproduction(*files, report, ran, tuple(failed))
