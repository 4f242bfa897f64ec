"""`pipeline reproduce`: every scene of the seeds, and a report that compares each published number with ours.

published (data) -> our_runs, verdicts, growth_law, damping, verbal_claims, corrections (computing) -> report, figures
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.case import load_case
from pipeline.errors import SolveError
from pipeline.formats.atomic import write_whole
from pipeline.problem.problem import build
from pipeline.results.case_run import run_case
from pipeline.results.variant_run import OnVariantFrame
from pipeline.studies.thesis.our_runs import ThesisScene, read_scene
from pipeline.studies.thesis.published import AS_PRINTED, PLANAR_SCENE, SCENES
from pipeline.studies.thesis.report import KINDS, Report, make_report
from pipeline.views.html.blocks import render_html, render_markdown

ALL_SCENES = (*(name + ending for name in SCENES for ending in (AS_PRINTED, "")), PLANAR_SCENE)


@dataclass(frozen=True)
class Reproduction:
    """The two files written, the report, its scenes, and the variants that failed."""

    html: Path
    markdown: Path
    report: Report
    scenes: dict[str, ThesisScene]
    failed: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Reproduction {self.markdown}: {self.summary}>"

    @property
    def exit_code(self) -> int:
        """Return 3 if a variant failed, else 0."""
        return SolveError.exit_code if self.failed else 0

    @property
    def summary(self) -> str:
        """Return the counts of verdicts in one line."""
        return ", ".join(f"{self.report.count_verdicts(kind)} {kind}" for kind in KINDS)


def reproduce(
    cases: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    scenes: Sequence[str] = ALL_SCENES,
    frames: int | None = None,
    force: bool = False,
    resume: bool = False,
    movie: bool = True,
    on_frame: OnVariantFrame | None = None,
    on_drawing: Callable[[int, int], None] | None = None,
) -> Reproduction:
    """Return the report on the scenes of a folder of cases, after writing out/reproduction.html and .md.

    Each scene is run into out/<case>/ unless it is up to date; `resume` continues unfinished runs. `frames` shortens
    every schedule. Raises PipelineError as run_case does.
    """
    target = Path(out)
    overrides = {} if frames is None else {"schedule.frames": frames}
    scene_cases = [load_case(Path(cases) / f"{name}.toml", overrides=overrides) for name in scenes]
    bar = build(load_case(Path(cases) / f"bar_small{AS_PRINTED}.toml").variant("linear"))
    thesis_scenes, failed = {}, []
    for case in scene_cases:
        result = run_case(
            case, target, force=force, resume=resume, movie=movie, on_frame=on_frame, on_drawing=on_drawing
        )
        thesis_scenes[case.name] = read_scene(case, result)
        failed += [f"{case.name}/{v.name}" for v in result.variants if v.run.get("status") == "failed"]
    report = make_report(thesis_scenes, bar, target / "reproduction")
    html, markdown = target / "reproduction.html", target / "reproduction.md"
    write_whole(html, render_html(report.blocks))
    write_whole(markdown, render_markdown(report.blocks, target))
    return Reproduction(html, markdown, report, thesis_scenes, tuple(failed))
