"""The verbs `analyze` and `compare`, for series of any program."""

import argparse
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.cli.options import SharedOptions
from pipeline.cli.terminal import show_notes, show_progress
from pipeline.results.analysis_folder import Analysis, Comparison
from pipeline.results.folder_kinds import check_series_folder
from pipeline.series import Series, read_series

_FOLDER = Path("outputs/analysis")
_LONGEST_NAME = 120  # of a folder


def add_verbs(verbs: Any, shared: SharedOptions) -> None:
    """Add the verbs `analyze` and `compare`."""
    foreign = argparse.ArgumentParser(add_help=False)
    foreign.add_argument(
        "--displacement", metavar="FIELD", help='displacement: a point field, or X,Y,Z; "none": points move'
    )
    foreign.add_argument(
        "--rest", metavar="STATE", help="rest state: first (frame), points, rest_position (a point field) or a file"
    )
    foreign.add_argument("--strict", action="store_true", help="refuse a series that has missing or damaged frames")
    foreign.add_argument("--movie", action="store_true", help="also draw a movie")
    foreign.add_argument(
        "--paraview", action="store_true", help="also write frames with volume ratios, and a script for ParaView"
    )
    foreign.add_argument("--report", action="store_true", help="also write report.html, the results on one page")
    foreign.add_argument("--out", type=Path, metavar="DIR", help=f"folder for results ({_FOLDER}/NAME)")

    analyze = verbs.add_parser(
        "analyze", parents=[*shared, foreign], help="measure the volumes and rotations of any program's series"
    )
    analyze.add_argument(
        "series", metavar="SERIES", help="an index (.pvd, .series), a folder, 'pattern*.vtu', .vtkhdf or .xdmf"
    )
    analyze.set_defaults(run=_analyze)

    compare = verbs.add_parser("compare", parents=[*shared, foreign], help="measure several series side by side")
    compare.add_argument("series", metavar="SERIES", nargs="+", help="two or more series, as for analyze")
    compare.add_argument(
        "--difference",
        action="store_true",
        help="also compare cells and nodes with those of the first series; other meshes are sampled at its places",
    )
    compare.set_defaults(run=_compare)


def _read(options: argparse.Namespace, path: str) -> Series:
    check_series_folder(Path(path))
    return read_series(path, displacement=options.displacement, rest=options.rest, strict=options.strict)


def _analyze(options: argparse.Namespace) -> int:
    from pipeline.results.analysis_folder import analyze

    series = _read(options, options.series)
    options.out = options.out or _FOLDER / series.name
    if not options.quiet:
        print(series.describe_decisions(), flush=True)
    with show_progress(options.quiet) as bar:
        analysis = analyze(
            series, options.out, movie=options.movie, paraview=options.paraview, on_frame=bar.show_reading,
            on_drawing=bar.show_picture,
        )  # fmt: skip
    show_notes(analysis.notes)
    if not options.quiet:
        worst = f"{analysis.worst_volume_ratio:.4f} (cell {analysis.worst_cell}, t = {analysis.worst_time:.4g} s)"
        print(f"{analysis.name}: {analysis.frames} frames; worst volume ratio {worst}", *analysis.files, sep="\n  ")
    _report(options, analysis, [series], ["analyze", options.series])
    return 0


def _compare(options: argparse.Namespace) -> int:
    from pipeline.results.analysis_folder import compare

    series = _name_by_folders([_read(options, path) for path in options.series])
    options.out = options.out or _FOLDER / "_and_".join(s.name for s in series)[:_LONGEST_NAME]
    with show_progress(options.quiet) as bar:
        comparison = compare(
            series,
            options.out,
            movie=options.movie,
            difference=options.difference,
            paraview=options.paraview,
            on_frame=bar.show_reading,
            on_drawing=bar.show_picture,
        )
    show_notes(comparison.notes)
    if not options.quiet:
        print(*comparison.files, sep="\n")
        for distance in comparison.node_distances:
            worst = f"{distance.worst:.4g} m (node {distance.node}, t = {distance.time:.4g} s)"
            first = comparison.analyses[0].name
            print(f"{distance.name}: nodes up to {worst} from {first}; RMS up to {distance.rms:.4g} m")
    _report(options, comparison, series, ["compare", *options.series])
    return 0


def _name_by_folders(series: list[Series]) -> list[Series]:
    """Return the series, named by their folders if their own names are equal: a/out.pvd and b/out.pvd are a and b."""
    folders = [s.folder.resolve().name for s in series]
    if len({s.name for s in series}) == len(series) or len(set(folders)) < len(series):
        return series
    return [replace(s, name=folder) for s, folder in zip(series, folders, strict=True)]


def _report(
    options: argparse.Namespace, result: Analysis | Comparison, series: Sequence[Series], words: Sequence[str]
) -> None:
    """Write report.html if it was requested, with the command that repeats the analysis."""
    if not options.report:
        return
    from pipeline.results.report import write_analysis_report

    values = [("--displacement", options.displacement), ("--rest", options.rest), ("--out", options.out.as_posix())]
    words = [*words, *(word for name, value in values if value for word in (name, value))]
    words += [
        f"--{name}" for name in ("strict", "movie", "difference", "paraview", "report") if getattr(options, name, False)
    ]
    path = write_analysis_report(result, series, shlex.join(["pipeline", *words]))
    if not options.quiet:
        print(f"  {path}" if isinstance(result, Analysis) else path)
