"""The report's blocks, section by section, from scenes that have run; what has to be computed is computed here."""

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.errors import OutputError
from pipeline.problem.problem import Problem
from pipeline.series import Series, read_series
from pipeline.studies.thesis import verbal_claims as statements
from pipeline.studies.thesis.corrections import run_corrections
from pipeline.studies.thesis.damping import measure_damping
from pipeline.studies.thesis.growth_law import Growth, make_band, read_linear_growth, read_step_growth
from pipeline.studies.thesis.our_runs import RunOutcome, ThesisScene
from pipeline.studies.thesis.published import (
    AS_PRINTED,
    FIGURES,
    NUMBERS,
    PLANAR_SCENE,
    SCENES,
    STATEMENTS,
    TIMINGS,
    FigureSet,
    Timing,
)
from pipeline.studies.thesis.report_figures import write_law_figure, write_states_figure
from pipeline.studies.thesis.verdicts import (
    NOT_REPRODUCED,
    OTHER_HARDWARE,
    REPRODUCED,
    Finding,
    find_outcome,
    judge_number,
)
from pipeline.system.version import VERSION
from pipeline.views.html.blocks import Block, Heading, Paragraph, Picture, TableBlock

LINEAR_ABOVE, STEP_ABOVE = 10.0, 10.0  # degrees: below, strain outweighs what the rotation adds


@dataclass(frozen=True)
class Report:
    """The blocks, the findings about every published number and statement as (what, verdict), and notes."""

    blocks: list[Block]
    verdicts: list[tuple[str, str]]
    notes: list[str] = field(default_factory=list)

    def count(self, kind: str) -> int:
        """Return how many verdicts are of a kind: one of KINDS."""
        return sum(find_kind(verdict) == kind for _, verdict in self.verdicts)


def find_kind(verdict: str) -> str:
    """Return the kind of a verdict, without its reason."""
    for kind in (NOT_REPRODUCED, OTHER_HARDWARE):
        if verdict.startswith(kind):
            return kind
    return f"{REPRODUCED} with factor" if "with factor" in verdict else REPRODUCED


KINDS = (REPRODUCED, f"{REPRODUCED} with factor", NOT_REPRODUCED, OTHER_HARDWARE)


def make_report(scenes: Mapping[str, ThesisScene], bar: Problem, folder: Path) -> Report:
    """Return the report of the scenes that ran; `bar` is the linear bar of f = 20 as printed.

    Its own pictures go to a folder. Raises PipelineError where recorded frames cannot be read.
    """
    notes: list[str] = []
    findings = [judge_number(number, scenes) for number in NUMBERS]
    tested = [(statement, *statements.TESTS[statement.test](scenes)) for statement in STATEMENTS]
    timed = [
        (timing, *_compare_times(timing, find_outcome(scenes, timing.scene + AS_PRINTED, timing.variant)))
        for timing in TIMINGS
    ]
    verdicts = [(f.number.what, f.verdict) for f in findings]
    verdicts += [(statement.says, verdict) for statement, _, verdict in tested]
    verdicts += [(f"{t.model}, {t.variant}: seconds a step", row[-1]) for t, row, _ in timed]
    report = Report([], verdicts, notes)
    report.blocks[:] = [
        *_make_opening(report, scenes),
        *_make_numbers(findings),
        Heading("What the thesis says in words"),
        TableBlock(("statement", "where", "found", "verdict"), [(s.says, s.source, f, v) for s, f, v in tested]),
        *_make_times([row for _, row, _ in timed]),
        *_make_variants(scenes),
        *_make_figures(scenes, folder, notes),
        *_make_law(scenes, folder),
        *_make_damping(bar),
        *_make_corrections(bar),
        *_make_notes(scenes, notes),
    ]
    return report


def _make_opening(report: Report, scenes: Mapping[str, ThesisScene]) -> list[Block]:
    factors = [f"{s.name}: {s.factor_of} × {s.factor:g}" for s in scenes.values() if s.factor_of]
    rows = [(kind, f"{report.count(kind)}") for kind in KINDS]
    return [
        Heading("What of the seeds is reproduced", 1),
        Paragraph(
            "The seeds are a thesis (T: linear and corotational finite elements on tetrahedra, backward Euler) and a "
            "web page (W: corotated finite elements on triangles, symplectic Euler). Every number that they publish "
            "stands below beside ours. **As printed** means: with the parameters that the seed states. **With "
            "factor** means: with one of them multiplied by a number that was fitted to one published value "
            "and has no derivation. **Other hardware** means: what is published depends on the speed of a machine "
            "that is not ours, so that another result neither confirms nor refutes it."
        ),
        TableBlock(("verdict", "count"), rows, "Published numbers, statements and times"),
        Paragraph(f"Factors: {'; '.join(factors) or 'none'}."),
        Paragraph(
            "Not known and chosen by us: the meshes of mushroom and armadillo (the counts are those of the thesis, the "
            "shapes are not its own), the armadillo's size and supports, and all parameters of the web page, which "
            "states none and publishes no number."
        ),
    ]


def _make_numbers(findings: Sequence[Finding]) -> list[Block]:
    rows = [
        (
            f.number.what,
            f.number.printed,
            f.number.source,
            _format_value(f.as_printed),
            _format_value(f.calibrated),
            f.verdict,
        )
        for f in findings
    ]
    return [
        Heading("Published numbers"),
        Paragraph(
            "The corotational numbers are those of the thesis' own method: one linear solve a step, rotations by "
            "Gram-Schmidt. A volume counts as reproduced within 1 %, an iteration within one, a count exactly. The "
            "verdict gives the deviation of the value itself, not of its growth over 1."
        ),
        TableBlock(("quantity", "published", "where", "as printed", "with factor", "verdict"), rows),
    ]


def _format_value(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def _compare_times(timing: Timing, ours: RunOutcome | None) -> tuple[tuple[str, ...], float]:
    """Return the row of a published time, and how many times as fast ours was."""
    dt = ours.dt if ours is not None else float("nan")
    published = (f"{1e3 * timing.seconds:.4g}", f"{timing.images}", f"{dt / timing.seconds:.3g}" if ours else "-")
    head = (timing.model, timing.variant.replace("_", "-"), timing.nodes, f"{timing.cells}", *published)
    if ours is None:
        return (*head, "-", "-", "-", f"{NOT_REPRODUCED}: not run"), float("nan")
    times, s = timing.seconds / ours.seconds_per_step, ours.seconds_per_step
    ratio = f"ours is {times:.3g} × as fast" if times >= 1 else f"ours is {1 / times:.3g} × as slow"
    verdict = f"{OTHER_HARDWARE} and software: {ratio}"
    return (*head, f"{1e3 * s:.3g}", f"{1 / s:.0f}", f"{dt / s:.3g}", verdict), times


def _make_times(rows: Sequence[Sequence[str]]) -> list[Block]:
    head = (
        "model", "method", "nodes", "tets", "T: ms a step", "T: images/s", "T: real-time factor",
        "ours: ms a step", "ours: images/s", "ours: real-time factor", "verdict",
    )  # fmt: skip
    half = len(rows) // 2
    return [
        Heading("Times a step: tables 7.1 and 7.2"),
        Paragraph(
            "Times are of the machine and the program that made them. The thesis used MATLAB on hardware that it does "
            f"not name; ours ran on this machine ({platform.system()} {platform.machine()}, {_read_processor()}), "
            "compiled libraries under Python, solving alone: neither measuring nor writing, "
            f"OMP_NUM_THREADS = {os.environ.get('OMP_NUM_THREADS', 'not set')}. A real-time factor is Δt over the "
            "time of a step: above 1 the motion is computed faster than it happens. The counts are the same, the "
            "meshes of mushroom and armadillo are ours."
        ),
        TableBlock(head, rows[:half], "Table 7.1: linear, backward Euler (scenes as printed)"),
        TableBlock(head, rows[half:], "Table 7.2: corotational, one solve a step (scenes as printed)"),
    ]


def _read_processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "processor not named"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "not named")


def _make_variants(scenes: Mapping[str, ThesisScene]) -> list[Block]:
    rows = [
        (
            scene.name, name, one.status, f"{one.largest_ratio:.4f}", f"{one.iteration}", f"{one.cell}",
            f"{one.smallest_ratio:.4f}", f"{1e3 * one.seconds_per_step:.3g}", f"{one.dt / one.seconds_per_step:.3g}",
        )
        for scene in scenes.values()
        for name, one in scene.outcomes.items()
    ]  # fmt: skip
    head = (
        "scene", "variant", "run", "largest V/V0", "at step", "in cell", "smallest V/V0", "ms a step",
        "real-time factor",
    )  # fmt: skip
    return [Heading("Every scene and variant"), TableBlock(head, rows, "Extremes over all cells and recorded frames")]


def _make_figures(scenes: Mapping[str, ThesisScene], folder: Path, notes: list[str]) -> list[Block]:
    blocks: list[Block] = [
        Heading("Figures"),
        Paragraph(
            "The thesis plots the volume of every tetrahedron over time, without the corotational correction beside "
            "with it, and shows the body at some iterations. Below are ours: as printed, then with the factor."
        ),
    ]
    for figures in FIGURES:
        blocks += _make_figure_set(figures, scenes, folder, notes)
    if PLANAR_SCENE in scenes:
        blocks.append(Heading("Web page: cantilever of triangles", 3))
        blocks += _list_pictures(scenes[PLANAR_SCENE], "W shows an interactive cantilever; parameters are ours.")
    return blocks


def _make_figure_set(
    figures: FigureSet, scenes: Mapping[str, ThesisScene], folder: Path, notes: list[str]
) -> list[Block]:
    blocks: list[Block] = [Heading(f"{figures.title}: figures {figures.figures}", 3)]
    for name, how in ((figures.scene + AS_PRINTED, "as printed"), (figures.scene, "with factor")):
        if name not in scenes:
            blocks.append(Paragraph(f"`{name}` was not run."))
            continue
        scene = scenes[name]
        text = f"{how} {scene.factor:g} on the {scene.factor_of}" if scene.factor_of else how
        blocks += _list_pictures(scene, f"{figures.title}, {text}.")
        usable = {v: i for v, i in figures.states.items() if v in scene.outcomes}
        if how == "with factor" and usable:
            path = folder / f"states_{name}.png"
            try:
                write_states_figure({v: read_series(scene.outcomes[v].folder) for v in usable}, usable, path)
                blocks.append(
                    Picture(
                        path,
                        f"{figures.title}, {text}. {figures.states_are} Thin lines: the body at rest.",
                    )
                )
            except OutputError as error:
                notes.append(f"{name}: the states are not drawn ({error})")
    return blocks


def _list_pictures(scene: ThesisScene, text: str) -> list[Block]:
    """Return the pictures that a scene's campaign drew."""
    kinds = {"volume.png": "Volume ratio of every cell over time", "comparison.png": "The moment of largest deviation"}
    return [
        Picture(scene.folder / name, f"{kind}. {text} (`{scene.name}`)")
        for name, kind in kinds.items()
        if (scene.folder / name).exists()
    ]


def _make_law(scenes: Mapping[str, ThesisScene], folder: Path) -> list[Block]:
    blocks: list[Block] = [
        Heading("The law of spurious volume"),
        Paragraph(
            "A cell without strain in the frame that its solve used ends at V/V₀ = sec² of the angle between that "
            "frame and the rotation it reached: the linear law used none, so the angle is the cell's whole rotation; "
            "one solve a step used the rotation before the step. On a homogeneous rotation this is exact (a test holds "
            "it to 1e-9). In a scene real strain comes on top: hence the band."
        ),
    ]
    kinds: tuple[tuple[str, str, Callable[[Series], Growth], float, str], ...] = (
        ("linear", "growth_linear.png", read_linear_growth, LINEAR_ABOVE, "rotation angle of a cell"),
        ("polar", "growth_one_solve.png", read_step_growth, STEP_ABOVE, "rotation of a cell in one step"),
    )
    for variant, file, measured, above, across in kinds:
        growths = _read_growths(scenes, variant, measured)
        if not growths:
            blocks.append(Paragraph(f"No scene with the variant `{variant}` was run."))
            continue
        write_law_figure(growths, folder / file, across=across)
        blocks.append(Picture(folder / file, f"`{variant}`: growth against the {across}; all cells, all frames."))
        blocks.append(_make_bands(growths, variant, above, across))
    return blocks


def _read_growths(
    scenes: Mapping[str, ThesisScene], variant: str, measured: Callable[[Series], Growth]
) -> dict[str, Growth]:
    names = [name + ending for ending in (AS_PRINTED, "") for name in SCENES]
    runs = {name: find_outcome(scenes, name, variant) for name in names}
    return {name: measured(read_series(run.folder)) for name, run in runs.items() if run is not None}


def _make_bands(growths: Mapping[str, Growth], variant: str, above: float, across: str) -> TableBlock:
    rows = []
    for name, growth in growths.items():
        found = make_band(growth, above)
        if found is None:
            largest = f"{growth.largest_degrees:.3g}"
            rows.append((name, "0", "-", "-", "-", largest, "-", f"nothing turns by {above:g} degrees"))
            continue
        verdict = "median within 1 %" if abs(found.median - 1) <= 0.01 else f"median {100 * (found.median - 1):+.1f} %"
        row = (f"{found.low:.3f}", f"{found.median:.3f}", f"{found.high:.3f}", f"{found.largest_angle:.1f}")
        rows.append((name, f"{found.count}", *row, f"{found.largest_law:.3f}", verdict))
    head = ("scene", "cells × frames", "5 %", "median", "95 %", "largest angle", "sec² of it", "law")
    return TableBlock(head, rows, f"`{variant}`: V/V₀ over sec² of the {across}, where that is above {above:g} degrees")


def _make_damping(bar: Problem) -> list[Block]:
    rows = [
        (f"{i}", f"{m.omega:.4g}", f"{m.z:.4f}", f"{100 * m.formula:.4f} %", f"{100 * m.measured:.4f} %")
        for i, m in enumerate(measure_damping(bar), start=1)
    ]
    return [
        Heading("Damping"),
        Paragraph(
            "“Oscillates until it stops” is the integrator, not the material, which has no viscosity. Backward Euler "
            "damps a mode of frequency ω by ζ = ln(1 + z²) / √(ln²(1 + z²) + 4 atan² z) with z = ω Δt. Measured: four "
            "steps from the mode itself."
        ),
        TableBlock(
            ("mode", "ω [rad/s]", "z", "ζ, formula", "ζ, measured"), rows, f"The thesis' bar, Δt = {bar.dt:g} s"
        ),
    ]


def _make_corrections(bar: Problem) -> list[Block]:
    rows = [(c.where, c.printed, c.correct, fails, holds) for c, fails, holds in run_corrections(bar)]
    return [
        Heading("Corrections to the seeds"),
        Paragraph(
            "The program follows the formulas under “correct”. Where numbers stand, the printed formula was run just "
            "now on the thesis' bar of f = 20, as printed, next to the corrected one."
        ),
        TableBlock(("where", "printed", "correct", "the printed one, run", "the corrected one, run"), rows),
    ]


def _make_notes(scenes: Mapping[str, ThesisScene], notes: Sequence[str]) -> list[Block]:
    said = [f"{scene.name}: {note}" for scene in scenes.values() for note in scene.notes] + list(notes)
    blocks: list[Block] = [Heading("Made by"), Paragraph(f"`pipeline reproduce`, version {VERSION}.")]
    return blocks + ([TableBlock(("note",), [(note,) for note in dict.fromkeys(said)])] if said else [])
