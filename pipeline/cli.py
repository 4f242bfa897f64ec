"""The command line: the only place that prints, draws progress, configures logging or exits."""

import argparse
import json
import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.build import Problem
from pipeline.case import Case, load_case, parse_override
from pipeline.errors import PipelineError
from pipeline.frame import Frame, Values
from pipeline.run import RunSummary
from pipeline.series import Series, read_series
from pipeline.version import VERSION

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    options = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.DEBUG if options.verbose else logging.WARNING, format="%(name)s: %(message)s")
    try:
        return int(options.run(options))
    except PipelineError as error:
        if options.debug:
            raise
        _say(f"{type(error).__name__}: {error}")
        return error.exit_code
    except MemoryError as error:
        if options.debug:
            raise
        _say(f"PipelineError: the memory does not suffice ({error}); try a coarser mesh")
        return PipelineError.exit_code
    except KeyboardInterrupt as asked:
        _say(str(asked) or "interrupted; frames written so far are complete")
        return INTERRUPTED


def _say(line: str) -> None:
    print(line, file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("-v", "--verbose", action="store_true", help="log what is done")
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    common.add_argument("--quiet", action="store_true", help="no progress bar, no summary")
    scene = argparse.ArgumentParser(add_help=False)
    scene.add_argument("case", metavar="CASE", type=Path, help="a case file, such as cases/bar.toml")
    scene.add_argument("--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[],
                       help="change a key, such as schedule.dt=0.01; may be repeated")  # fmt: skip
    scene.add_argument("--variant", dest="variants", metavar="NAME", action="append", default=[],
                       help="only this variant; may be repeated")  # fmt: skip
    scene.add_argument("--steps", type=int, metavar="N", help="cut the schedule to N steps")

    parser = argparse.ArgumentParser(prog="pipeline", description="Volume drift of deformable solids.")
    parser.add_argument("--version", action="version", version=f"pipeline {VERSION}")
    verbs = parser.add_subparsers(required=True, metavar="VERB")

    run = verbs.add_parser("run", parents=[common, scene], help="solve a case; write frames, statistics and a movie")
    run.add_argument("--out", type=Path, default=Path("outputs"), metavar="DIR", help="where results go (outputs)")
    run.add_argument("--no-movie", action="store_true", help="no movie, so no OpenGL")
    over = run.add_mutually_exclusive_group()
    over.add_argument("--force", action="store_true", help="solve again and replace what is there")
    over.add_argument("--resume", action="store_true", help="go on with an unfinished run where it stopped")
    run.add_argument("--json", action="store_true", help="print the summary as JSON, and nothing else")
    run.set_defaults(run=_run)

    check = verbs.add_parser("check", parents=[common, scene], help="what can be known of a case before solving it")
    check.add_argument("--json", action="store_true", help="print the numbers as JSON")
    check.set_defaults(run=_check)

    movie = verbs.add_parser("movie", parents=[common], help="draw the movie of a result folder again")
    movie.add_argument("folder", metavar="FOLDER", type=Path, help="a result folder, such as outputs/bar")
    movie.set_defaults(run=_movie)

    again = verbs.add_parser("reproduce", parents=[common], help="run the seeds' scenes; say what of them holds")
    again.add_argument("--cases", type=Path, default=Path("cases"), metavar="DIR", help="where the cases are (cases)")
    again.add_argument("--out", type=Path, default=Path("outputs"), metavar="DIR", help="where results go (outputs)")
    again.add_argument("--force", action="store_true", help="solve again and replace what is there")
    again.set_defaults(run=_reproduce)

    methods = verbs.add_parser("methods", parents=[common], help="what a case may choose from")
    methods.set_defaults(run=_methods)
    _add_series_verbs(verbs, common)
    return parser


def _add_series_verbs(verbs: Any, common: argparse.ArgumentParser) -> None:
    """Add what measures series that other programs wrote."""
    foreign = argparse.ArgumentParser(add_help=False)
    foreign.add_argument(
        "--displacement", metavar="FIELD", help='point field added to rest points; "none": points move'
    )
    foreign.add_argument("--rest", metavar="STATE", help="first, points, rest_position or a file")
    foreign.add_argument("--strict", action="store_true", help="refuse a series with missing or broken frames")
    foreign.add_argument("--movie", action="store_true", help="draw a movie too")
    foreign.add_argument("--out", type=Path, default=Path("outputs/analysis"), metavar="DIR", help="where results go")

    one = verbs.add_parser("analyze", parents=[common, foreign], help="measure anybody's series")
    one.add_argument("series", metavar="SERIES", help="index, folder, 'pattern*.vtu', .vtkhdf or .xdmf")
    one.set_defaults(run=_analyze)

    many = verbs.add_parser("compare", parents=[common, foreign], help="measure series side by side")
    many.add_argument("series", metavar="SERIES", nargs="+", help="two and more of what analyze takes")
    many.add_argument("--difference", action="store_true", help="differences to the first; needs the same cells")
    many.set_defaults(run=_compare)


def _loaded(options: argparse.Namespace) -> Case:
    return load_case(
        options.case, overrides=dict(parse_override(text) for text in options.overrides), steps=options.steps
    )


def _run(options: argparse.Namespace) -> int:
    from pipeline.campaign import run_campaign

    case = _loaded(options)
    quiet = options.quiet or options.json
    with _progress(quiet) as bar:
        result = run_campaign(
            case,
            options.out,
            variants=options.variants,
            force=options.force,
            resume=options.resume,
            movie=not options.no_movie,
            notify=bar.solved,
            on_drawing=bar.drawn,
        )
    if options.json:
        summary = {
            "folder": str(result.folder),
            "variants": {v.name: v.run | {"status": v.status} for v in result.variants},
            "made": [str(path) for path in result.made],
            "notes": list(result.notes),
        }
        print(json.dumps(summary, indent=2))
    for v in result.variants:
        if v.status == "failed":
            _say(f"SolveError: {v.name}: {v.run['message']}; its frames before that are in {v.folder}")
    if not quiet:
        _print_summary(result)
    elif not options.json:
        for note in result.notes:
            _say(f"note: {note}")
    return result.exit_code


def _print_summary(result: Any) -> None:
    """Print a line a variant, the notes and where things are."""
    for v in result.variants:
        worst = v.run.get("worst")
        if v.status == "up to date":
            print(f"{v.name:<14} up to date (--force solves again)")
        elif worst and v.run["seconds_per_step"]:
            print(
                f"{v.name:<14} {v.status}; worst volume ratio {worst['volume_ratio']:.4f} (cell {worst['cell']}, "
                f"t = {worst['time']:.4g} s); {1e3 * v.run['seconds_per_step']:.3g} ms a step, "
                f"{v.run['real_time_factor']:.3g} x real time; solving {v.run['seconds']['solving']:.2g} s, "
                f"writing {v.run['seconds']['writing']:.2g} s"
            )
        else:
            print(f"{v.name:<14} {v.status}")
    for note in result.notes:
        print(f"note: {note}")
    print(f"results in {result.folder}" + "".join(f"\n  {path.name}" for path in result.made))
    for v in result.variants:
        print(f"  {v.name}/series.pvd")


def _check(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from pipeline.build import build
    from pipeline.check import check, lines

    case = _loaded(options)
    problems = {name: build(case.variant(name)) for name in options.variants or case.variant_names}
    found = {name: check(problem) for name, problem in problems.items()}
    for name, problem in problems.items() if not options.json else ():
        print(name, *lines(found[name], problem), sep="\n  ")
    if options.json:
        finite = {
            name: {key: value if value == value else None for key, value in asdict(one).items()}
            for name, one in found.items()
        }
        print(json.dumps(finite, indent=2))
    return 0


def _movie(options: argparse.Namespace) -> int:
    from pipeline.comparison import movie_of_folder

    with _progress(options.quiet) as bar:
        path = movie_of_folder(options.folder, on_drawing=bar.drawn)
    if not options.quiet:
        print(path)
    return 0


def _reproduce(options: argparse.Namespace) -> int:
    from pipeline.reproduction import reproduce

    with _progress(options.quiet) as bar:
        result = reproduce(
            options.cases,
            options.out,
            force=options.force,
            notify=lambda _, problem, *rest: bar.solved(problem.name.split("/")[0], problem, *rest),
            on_drawing=bar.drawn,
        )
    for name in result.failed:
        _say(f"SolveError: {name}: see {result.markdown}")
    if not options.quiet:
        print(result.summary, result.html, result.markdown, sep="\n")
    return result.exit_code


def _methods(options: argparse.Namespace) -> int:
    from pipeline.methods import DESCRIPTIONS

    for key, rows in DESCRIPTIONS.items():
        print(key, *(f"{name:<18} {text}" for name, text in rows.items()), sep="\n  ")
    return 0


def _opened(options: argparse.Namespace, path: str) -> Series:
    return read_series(path, displacement=options.displacement, rest=options.rest, strict=options.strict)


def _analyze(options: argparse.Namespace) -> int:
    from pipeline.analysis import analyze

    with _progress(options.quiet) as bar:
        found = analyze(
            _opened(options, options.series), options.out, movie=options.movie, on_frame=bar.read, on_drawing=bar.drawn
        )
    for note in found.notes:
        _say(f"note: {note}")
    if not options.quiet:
        worst = f"{found.worst_volume_ratio:.4f} (cell {found.worst_cell}, t = {found.worst_time:.4g} s)"
        print(f"{found.name}: {found.frames} frames; worst volume ratio {worst}", *found.made, sep="\n  ")
    return 0


def _compare(options: argparse.Namespace) -> int:
    from pipeline.analysis import compare

    with _progress(options.quiet) as bar:
        found = compare(
            [_opened(options, path) for path in options.series],
            options.out,
            movie=options.movie,
            difference=options.difference,
            on_frame=bar.read,
            on_drawing=bar.drawn,
        )
    for note in found.notes:
        _say(f"note: {note}")
    if not options.quiet:
        print(*found.made, sep="\n")
    return 0


class _Progress:
    """A bar a variant, with steps a second, time left and the worst volume ratio; and one for the movie."""

    def __init__(self, display: Any) -> None:
        self._display = display
        self._tasks: dict[str, Any] = {}

    def solved(self, name: str, problem: Problem, frame: Frame, measured: Values, summary: RunSummary) -> None:
        """Show a frame of a variant."""
        total = problem.frames * problem.steps_per_frame
        wall = summary.work.seconds + summary.writing_seconds
        rate = f"{summary.steps / wall:6.0f} steps/s" if wall else ""
        self._show(name, frame.step or 0, total, f"{rate}  worst V/V0 {summary.worst_volume_ratio:.4f}")

    def drawn(self, done: int, total: int) -> None:
        """Show a frame of the movie."""
        self._show("movie", done, total, "")

    def read(self, name: str, done: int, total: int) -> None:
        """Show a frame of a series that is read."""
        self._show(name, done, total, "")

    def _show(self, name: str, done: int, total: int, text: str) -> None:
        if self._display is None:
            return
        if name not in self._tasks:
            self._display.start()  # not before there is something to show: an error is one line
            self._tasks[name] = self._display.add_task(name, total=total, text=text)
        self._display.update(self._tasks[name], completed=done, total=total, text=text)


@contextmanager
def _progress(quiet: bool) -> Iterator[_Progress]:
    """Yield the progress display, on standard error."""
    if quiet:
        yield _Progress(None)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:<14}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}"),
    )
    display = Progress(*columns, console=Console(stderr=True))
    try:
        yield _Progress(display)
    finally:
        if display.tasks:  # stopping what never started prints an empty line
            display.stop()


if __name__ == "__main__":
    sys.exit(main())
