"""report.html of a result folder, or of an analysis of any series."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Any

from pipeline.case import Case
from pipeline.errors import OutputError
from pipeline.results.analysis_folder import Analysis, Comparison
from pipeline.results.comparison import MOVIE_FILES, find_runs, make_title
from pipeline.results.folder_kinds import load_result_case
from pipeline.results.variant_run import UNFINISHED, describe_difference, read_run, result_settings
from pipeline.series import Series, read_series
from pipeline.system.version import VERSION
from pipeline.views.html.blocks import Block, CodeListing, Heading, Paragraph, TableBlock
from pipeline.views.html.page import PageContent, Side, write_page
from pipeline.views.html.solids import OnFrameRead
from pipeline.views.paraview import SCRIPT_NAME as SCRIPT

REPORT = "report.html"
_REPEAT = "How to repeat this"


def write_report(folder: str | os.PathLike[str], on_frame: OnFrameRead | None = None) -> Path:
    """Write report.html of a result folder from its frames and datasets, and return its path.

    `on_frame(variant, done, frames)` is called after each frame that is read. Raises CaseError if there is no case.toml
    in the folder, OutputError if no variant has a frame or the page cannot be written, SeriesError if a frame cannot be
    read.
    """
    folder = Path(folder)
    case = load_result_case(folder)
    runs = {name: run for name, run in find_runs(case, folder).items() if run["status"] not in UNFINISHED}
    missing = [
        f"{name} is not shown: {_explain_absence(case, folder, name)}"
        for name in case.variant_names
        if name not in runs
    ]
    if not runs:
        raise OutputError(f"{folder}: nothing to report: {missing[0]}; pipeline run solves it")
    sides = [
        Side(
            name.replace("_", " "), replace(read_series(folder / name), name=name), folder / name / "statistics.nc",
            _list_facts(run),
        )
        for name, run in runs.items()
    ]  # fmt: skip
    notes = missing + [f"{name} failed: {run['message']}" for name, run in runs.items() if run["status"] == "failed"]
    notes += [note for run in runs.values() for note in run["notes"]]
    movie, poster = (folder / name for name in MOVIE_FILES)
    closing = [*_list_settings(case, folder), *_list_versions(next(iter(runs.values()))), *_list_commands(folder)]
    result = PageContent(
        make_title(case), tuple(sides), closing, notes,
        movie if movie.is_file() else None, poster if poster.is_file() else None,
    )  # fmt: skip
    return write_page(result, folder / REPORT, on_frame)


def _explain_absence(case: Case, folder: Path, name: str) -> str:
    """Return why a variant is not shown."""
    run = read_run(folder / name)
    if not run.get("frames") or run["status"] in UNFINISHED:
        return "it is not finished"
    changes = describe_difference(run["case"], result_settings(case.variant(name)))
    return f"its folder has the result of another case ({changes})"


def is_report_current(folder: str | os.PathLike[str]) -> bool:
    """Return whether a folder has a report.html that is newer than the files it was made from."""
    folder = Path(folder)
    page = folder / REPORT
    if not page.is_file():
        return False
    written = page.stat().st_mtime_ns
    names = ("case.toml", "*.nc", "*.mp4", "*/run.json", "*/statistics.nc")
    return all(path.stat().st_mtime_ns <= written for name in names for path in folder.glob(name))


def write_analysis_report(analysis: Analysis | Comparison, series: Sequence[Series], command: str) -> Path:
    """Write report.html into the folder of an analysis of `series` and return its path; raises PipelineError.

    `command` is shown in the page as the way to repeat the analysis.
    """
    analyses = analysis.analyses if isinstance(analysis, Comparison) else (analysis,)
    sides = tuple(
        Side(part.name, replace(source, name=part.name), part.folder / "statistics.nc")
        for part, source in zip(analyses, series, strict=True)
    )
    movie, poster = (analysis.folder / f"movie.{ending}" for ending in ("mp4", "png"))
    closing: list[Block] = _list_node_distances(analysis) if isinstance(analysis, Comparison) else []
    closing += [Heading(_REPEAT), CodeListing(command), Paragraph(f"Measured by pipeline {VERSION}.")]
    result = PageContent(
        ", ".join(side.label for side in sides), sides, closing, analysis.notes,
        movie if movie in analysis.files else None, poster if poster in analysis.files else None,
    )  # fmt: skip
    return write_page(result, analysis.folder / REPORT)


def _list_node_distances(analysis: Comparison) -> list[Block]:
    """Return the distances of the nodes from those of the first series, if they were computed."""
    if not analysis.node_distances:
        return []
    head = ("series", "worst node [m]", "which", "at t [s]", "largest RMS [m]", "at t [s]")
    rows = [
        (d.name, f"{d.worst:.4g}", str(d.node), f"{d.time:.4g}", f"{d.rms:.4g}", f"{d.rms_time:.4g}")
        for d in analysis.node_distances
    ]
    text = f"Distances of the nodes from those of {analysis.analyses[0].name}; distance.png shows them over time."
    return [Heading("Node distances"), Paragraph(text), TableBlock(head, rows)]


def _list_facts(run: Mapping[str, Any]) -> dict[str, str]:
    """Return the status and the work of a run as text."""
    facts = {"run": run["status"], "steps": str(run["work"]["steps"]), "solves": str(run["work"]["solves"])}
    if run.get("seconds_per_step"):
        facts["ms per step"] = f"{1e3 * run['seconds_per_step']:.3g}"
        facts["times real time"] = f"{run['real_time_factor']:.3g}"
    return facts


def _list_settings(case: Case, folder: Path) -> list[Block]:
    text = "The case as it was run, with all defaults; it is `case.toml` in the result folder."
    return [Heading("Settings"), Paragraph(text), CodeListing(case.to_toml(folder))]


def _list_versions(run: Mapping[str, Any]) -> list[Block]:
    rows = [(name, str(value)) for part in ("versions", "machine") for name, value in run[part].items()]
    return [Heading("Versions"), TableBlock(("package or machine", "version"), rows)]


def _list_commands(folder: Path) -> list[Block]:
    place = quote(folder.as_posix())
    lines = (
        f"pipeline run {place}/case.toml --out again    # solve the same case again",
        f"pipeline movie {place}    # draw the movie again from the frames",
        f"pipeline report {place}    # write this page again",
        f"paraview --script={place}/{SCRIPT}    # open every frame in ParaView",
    )
    return [Heading(_REPEAT), CodeListing("\n".join(lines))]
