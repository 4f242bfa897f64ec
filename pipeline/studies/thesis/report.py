"""The report's blocks, section by section, from scenes that have run, and from computations made here."""

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import OutputError
from pipeline.problem.problem import Problem
from pipeline.series import Series, read_series
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
from pipeline.studies.thesis.verbal_claims import TESTS
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

LINEAR_ABOVE, STEP_ABOVE = 10.0, 10.0  # degrees: below these, strain outweighs the growth by rotation


@dataclass(frozen=True)
class Report:
    """The blocks, the verdict on every published number, statement and time by its name, and notes."""

    blocks: tuple[Block, ...]
    verdicts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...] = ()

    def count_verdicts(self, kind: str) -> int:
        """Return the number of verdicts of a kind: one of KINDS."""
        return sum(find_kind(verdict) == kind for _, verdict in self.verdicts)


def find_kind(verdict: str) -> str:
    """Return the kind of a verdict, without its reason."""
    for kind in (NOT_REPRODUCED, OTHER_HARDWARE):
        if verdict.startswith(kind):
            return kind
    return f"{REPRODUCED} with factor" if "with factor" in verdict else REPRODUCED


KINDS = (REPRODUCED, f"{REPRODUCED} with factor", NOT_REPRODUCED, OTHER_HARDWARE)


def make_report(scenes: Mapping[str, ThesisScene], bar: Problem, folder: Path) -> Report:
    """Return the report on the scenes that ran; `bar` is the linear bar of f = 20 as printed.

    Its own pictures are written to the folder. Raises PipelineError if recorded frames cannot be read.
    """
    findings = [judge_number(number, scenes) for number in NUMBERS]
    tested = [(statement, *TESTS[statement.test](scenes)) for statement in STATEMENTS]
    timed = [
        (timing, *_compare_times(timing, find_outcome(scenes, timing.scene + AS_PRINTED, timing.variant)))
        for timing in TIMINGS
    ]
    verdicts = [(f.number.what, f.verdict) for f in findings]
    verdicts += [(statement.says, verdict) for statement, _, verdict in tested]
    verdicts += [(f"{t.model}, {t.variant}: seconds a step", row[-1]) for t, row, _ in timed]
    figures, notes = _make_figures(scenes, folder)
    blocks = [
        *_make_opening(verdicts, scenes),
        *_make_numbers(findings),
        Heading("Statements of the thesis"),
        TableBlock(("statement", "where", "result", "verdict"), [(s.says, s.source, text, v) for s, text, v in tested]),
        *_make_times([row for _, row, _ in timed]),
        *_make_variants(scenes),
        *figures,
        *_make_law(scenes, folder),
        *_make_damping(bar),
        *_make_corrections(bar),
        *_make_notes(scenes, notes),
    ]
    return Report(tuple(blocks), tuple(verdicts), notes)


def _make_opening(verdicts: Sequence[tuple[str, str]], scenes: Mapping[str, ThesisScene]) -> list[Block]:
    factors = [f"{s.name}: {s.factor_of} × {s.factor:g}" for s in scenes.values() if s.factor_of]
    kinds = [find_kind(verdict) for _, verdict in verdicts]
    rows = [(kind, f"{kinds.count(kind)}") for kind in KINDS]
    return [
        Heading("Reproduction of the seeds", 1),
        Paragraph(
            "The seeds are a thesis (T: linear and corotational finite elements on tetrahedra, backward Euler) and a "
            "web page (W: corotated finite elements on triangles, symplectic Euler). Every number that they publish is "
            "compared with ours below. **As printed**: with the parameters that the seed gives. **With factor**: with "
            "one of them multiplied by a number that was fitted to one published value, not derived. **Other "
            "hardware**: the published result depends on the speed of a machine other than ours, so our "
            "different result neither confirms nor refutes it."
        ),
        TableBlock(("verdict", "count"), rows, "Published numbers, statements and times"),
        Paragraph(f"Factors: {'; '.join(factors) or 'none'}."),
        Paragraph(
            "Unknown, and chosen by us: the meshes of the mushroom and the armadillo (same counts as in the thesis, "
            "other shapes), the armadillo's size and supports, and all parameters of the web page, which gives none "
            "and publishes no numbers."
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
            "The corotational numbers are those of the thesis' own method: one linear solve per step and "
            "rotations by Gram-Schmidt. A volume counts as reproduced within 1 %, an iteration within one, a count "
            "only exactly. The verdict states the deviation of the value itself, not of its growth over 1."
        ),
        TableBlock(("quantity", "published", "where", "as printed", "with factor", "verdict"), rows),
    ]


def _format_value(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def _compare_times(timing: Timing, ours: RunOutcome | None) -> tuple[tuple[str, ...], float]:
    """Return the row of a published time, and its ratio to ours."""
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
        Heading("Time per step: tables 7.1 and 7.2"),
        Paragraph(
            "Times depend on the machine and the program. The thesis used MATLAB on hardware that it does "
            f"not name; ours ran on this machine ({platform.system()} {platform.machine()}, {_read_processor()}), "
            "with compiled libraries under Python, and counts solving only, without measuring and writing, "
            f"OMP_NUM_THREADS = {os.environ.get('OMP_NUM_THREADS', 'not set')}. A real-time factor is Δt over the "
            "time of a step: above 1 the motion is computed faster than it happens. The counts are equal; the meshes "
            "of the mushroom and the armadillo are ours."
        ),
        TableBlock(head, rows[:half], "Table 7.1: linear, backward Euler (scenes as printed)"),
        TableBlock(head, rows[half:], "Table 7.2: corotational, one solve a step (scenes as printed)"),
    ]


def _read_processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown processor"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown processor")


def _make_variants(scenes: Mapping[str, ThesisScene]) -> list[Block]:
    rows = [
        (
            scene.name, name, run.status, f"{run.largest_ratio:.4f}", f"{run.iteration}", f"{run.cell}",
            f"{run.smallest_ratio:.4f}", f"{1e3 * run.seconds_per_step:.3g}", f"{run.dt / run.seconds_per_step:.3g}",
        )
        for scene in scenes.values()
        for name, run in scene.outcomes.items()
    ]  # fmt: skip
    head = (
        "scene", "variant", "run", "largest V/V0", "at step", "in cell", "smallest V/V0", "ms a step",
        "real-time factor",
    )  # fmt: skip
    return [Heading("Every scene and variant"), TableBlock(head, rows, "Extremes over all cells and recorded frames")]


def _make_figures(scenes: Mapping[str, ThesisScene], folder: Path) -> tuple[list[Block], tuple[str, ...]]:
    """Return the blocks of our figures beside those of the thesis, and notes about figures that failed."""
    notes: list[str] = []
    blocks: list[Block] = [
        Heading("Figures"),
        Paragraph(
            "The thesis plots the volume of every tetrahedron over time, with and without the corotational correction, "
            "and shows the body at some iterations. Ours follow, first as printed, then with the factor."
        ),
    ]
    for figures in FIGURES:
        set_blocks, set_notes = _make_figure_set(figures, scenes, folder)
        blocks += set_blocks
        notes += set_notes
    if PLANAR_SCENE in scenes:
        blocks.append(Heading("Web page: cantilever of triangles", 3))
        blocks += _list_pictures(scenes[PLANAR_SCENE], "W shows an interactive cantilever; parameters are ours.")
    return blocks, tuple(notes)


def _make_figure_set(
    figures: FigureSet, scenes: Mapping[str, ThesisScene], folder: Path
) -> tuple[list[Block], list[str]]:
    """Return the blocks of one scene as printed and with the factor, and notes about figures that failed."""
    blocks: list[Block] = [Heading(f"{figures.title}: figures {figures.figures}", 3)]
    notes = []
    for name, how in ((figures.scene + AS_PRINTED, "as printed"), (figures.scene, "with factor")):
        if name not in scenes:
            blocks.append(Paragraph(f"`{name}` was not run."))
            continue
        scene = scenes[name]
        text = f"{how} {scene.factor:g} on the {scene.factor_of}" if scene.factor_of else how
        blocks += _list_pictures(scene, f"{figures.title}, {text}.")
        states = {variant: frames for variant, frames in figures.states.items() if variant in scene.outcomes}
        if how == "with factor" and states:
            path = folder / f"states_{name}.png"
            caption = f"{figures.title}, {text}. {figures.states_are} Thin lines: the body at rest."
            try:
                series = {variant: read_series(scene.outcomes[variant].folder) for variant in states}
                write_states_figure(series, states, path)
                blocks.append(Picture(path, caption))
            except OutputError as error:
                notes.append(f"{name}: the states are not drawn ({error})")
    return blocks, notes


def _list_pictures(scene: ThesisScene, text: str) -> list[Block]:
    """Return the pictures that the run of a scene drew."""
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
            "A cell without strain in the frame of its solve ends at V/V₀ = sec² of the angle between that frame and "
            "the rotation that it reaches. The linear law has one frame, so the angle is the cell's whole rotation; "
            "one solve a step uses the rotation before the step. For a homogeneous rotation this is exact (tested to "
            "1e-9). In a scene real strain is added: hence the band."
        ),
    ]
    kinds: tuple[tuple[str, str, Callable[[Series], Growth], float, str], ...] = (
        ("linear", "growth_linear.png", read_linear_growth, LINEAR_ABOVE, "rotation angle of a cell"),
        ("polar", "growth_one_solve.png", read_step_growth, STEP_ABOVE, "rotation of a cell in one step"),
    )
    for variant, file, read_growth, above, across in kinds:
        growths = _read_growths(scenes, variant, read_growth)
        if not growths:
            blocks.append(Paragraph(f"No scene with the variant `{variant}` was run."))
            continue
        write_law_figure(growths, folder / file, across=across)
        blocks.append(Picture(folder / file, f"`{variant}`: growth against the {across}; all cells, all frames."))
        blocks.append(_make_bands(growths, variant, above, across))
    return blocks


def _read_growths(
    scenes: Mapping[str, ThesisScene], variant: str, read_growth: Callable[[Series], Growth]
) -> dict[str, Growth]:
    names = [name + ending for ending in (AS_PRINTED, "") for name in SCENES]
    runs = {name: find_outcome(scenes, name, variant) for name in names}
    return {name: read_growth(read_series(run.folder)) for name, run in runs.items() if run is not None}


def _make_bands(growths: Mapping[str, Growth], variant: str, above: float, across: str) -> TableBlock:
    rows = []
    for name, growth in growths.items():
        band = make_band(growth, above)
        if band is None:
            largest = f"{growth.largest_degrees:.3g}"
            rows.append((name, "0", "-", "-", "-", largest, "-", f"no cell turns by {above:g} degrees"))
            continue
        verdict = "median within 1 %" if abs(band.median - 1) <= 0.01 else f"median {100 * (band.median - 1):+.1f} %"
        row = (f"{band.low:.3f}", f"{band.median:.3f}", f"{band.high:.3f}", f"{band.largest_angle:.1f}")
        rows.append((name, f"{band.count}", *row, f"{band.largest_growth:.3f}", verdict))
    head = ("scene", "cells × frames", "5 %", "median", "95 %", "largest angle", "sec² of it", "law")
    return TableBlock(head, rows, f"`{variant}`: V/V₀ over sec² of the {across}, for angles above {above:g} degrees")


def _make_damping(bar: Problem) -> list[Block]:
    rows = [
        (f"{i}", f"{m.omega:.4g}", f"{m.z:.4f}", f"{100 * m.formula:.4f} %", f"{100 * m.measured:.4f} %")
        for i, m in enumerate(measure_damping(bar), start=1)
    ]
    return [
        Heading("Damping"),
        Paragraph(
            "“Oscillates until it stops” describes the integrator: the material has no viscosity. Backward Euler "
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
            "The program follows the formulas under “correct”. Rows with results were run for this report: the printed "
            "and the corrected formula on the thesis' bar of f = 20 as printed."
        ),
        TableBlock(("where", "printed", "correct", "result of the printed", "result of the corrected"), rows),
    ]


def _make_notes(scenes: Mapping[str, ThesisScene], notes: Sequence[str]) -> list[Block]:
    texts = [f"{scene.name}: {note}" for scene in scenes.values() for note in scene.notes] + list(notes)
    blocks: list[Block] = [Heading("Made by"), Paragraph(f"`pipeline reproduce`, version {VERSION}.")]
    return blocks + ([TableBlock(("note",), [(note,) for note in dict.fromkeys(texts)])] if texts else [])
