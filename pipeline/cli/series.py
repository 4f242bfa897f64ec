"""The verbs for series that other programs wrote: analyze, compare."""

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.cli.terminal import progress, say
from pipeline.results.analysis_folder import Analysis, Comparison
from pipeline.series import Series, read_series


def add_verbs(verbs: Any, common: argparse.ArgumentParser) -> None:
    """Add what measures series that other programs wrote."""
    foreign = argparse.ArgumentParser(add_help=False)
    foreign.add_argument(
        "--displacement", metavar="FIELD", help='point field added to rest points; "none": points move'
    )
    foreign.add_argument("--rest", metavar="STATE", help="first, points, rest_position or a file")
    foreign.add_argument("--strict", action="store_true", help="refuse a series with missing or broken frames")
    foreign.add_argument("--movie", action="store_true", help="draw a movie too")
    foreign.add_argument("--report", action="store_true", help="write report.html too: all of it in one page")
    foreign.add_argument("--out", type=Path, default=Path("outputs/analysis"), metavar="DIR", help="where results go")

    one = verbs.add_parser("analyze", parents=[common, foreign], help="measure anybody's series")
    one.add_argument("series", metavar="SERIES", help="index, folder, 'pattern*.vtu', .vtkhdf or .xdmf")
    one.set_defaults(run=_analyze)

    many = verbs.add_parser("compare", parents=[common, foreign], help="measure series side by side")
    many.add_argument("series", metavar="SERIES", nargs="+", help="two and more of what analyze takes")
    many.add_argument(
        "--difference", action="store_true", help="differences to the first, of cells and nodes; needs the same cells"
    )
    many.set_defaults(run=_compare)


def _opened(options: argparse.Namespace, path: str) -> Series:
    return read_series(path, displacement=options.displacement, rest=options.rest, strict=options.strict)


def _analyze(options: argparse.Namespace) -> int:
    from pipeline.results.analysis_folder import analyze

    series = _opened(options, options.series)
    with progress(options.quiet) as bar:
        found = analyze(series, options.out, movie=options.movie, on_frame=bar.read, on_drawing=bar.drawn)
    for note in found.notes:
        say(f"note: {note}")
    if not options.quiet:
        worst = f"{found.worst_volume_ratio:.4f} (cell {found.worst_cell}, t = {found.worst_time:.4g} s)"
        print(f"{found.name}: {found.frames} frames; worst volume ratio {worst}", *found.files, sep="\n  ")
    _report(options, found, [series], ["analyze", options.series])
    return 0


def _compare(options: argparse.Namespace) -> int:
    from pipeline.results.analysis_folder import compare

    series = [_opened(options, path) for path in options.series]
    with progress(options.quiet) as bar:
        found = compare(
            series,
            options.out,
            movie=options.movie,
            difference=options.difference,
            on_frame=bar.read,
            on_drawing=bar.drawn,
        )
    for note in found.notes:
        say(f"note: {note}")
    if not options.quiet:
        print(*found.files, sep="\n")
        for one in found.node_distances:
            worst = f"{one.worst:.4g} m (node {one.node}, t = {one.time:.4g} s)"
            print(f"{one.name}: nodes up to {worst} from {found.analyses[0].name}; RMS up to {one.rms:.4g} m")
    _report(options, found, series, ["compare", *options.series])
    return 0


def _report(
    options: argparse.Namespace, found: Analysis | Comparison, series: Sequence[Series], words: Sequence[str]
) -> None:
    """Write report.html where it is asked for, with the command that led to it."""
    if not options.report:
        return
    from pipeline.results.report import write_analysis_report

    given = [("--displacement", options.displacement), ("--rest", options.rest), ("--out", options.out.as_posix())]
    words = [*words, *(word for name, value in given if value for word in (name, value))]
    words += [f"--{name}" for name in ("strict", "movie", "difference", "report") if getattr(options, name, False)]
    path = write_analysis_report(found, series, shlex.join(["pipeline", *words]))
    if not options.quiet:
        print(f"  {path}" if isinstance(found, Analysis) else path)
