"""The verbs for cases and their results: `run`, `check`, `movie`, `reproduce`, `methods`."""

import argparse
import json
from pathlib import Path
from typing import Any

from pipeline.case import Case, load_case, parse_override
from pipeline.cli.options import SharedOptions, find_default
from pipeline.cli.terminal import say, show_notes, show_progress
from pipeline.results.case_run import CaseResult, run_case


def add_verbs(verbs: Any, shared: SharedOptions) -> None:
    """Add the verbs for cases and their results."""
    scene = argparse.ArgumentParser(add_help=False)
    scene.add_argument("case", metavar="CASE", type=Path, help="a case file, such as cases/bar.toml")
    scene.add_argument("--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[],
                       help="change a key, such as schedule.dt=0.01; may be repeated")  # fmt: skip
    scene.add_argument("--variant", dest="variants", metavar="NAME", action="append", default=[],
                       help="only this variant; may be repeated")  # fmt: skip
    scene.add_argument("--steps", type=int, metavar="N", help="shorten the schedule to N steps")

    run = verbs.add_parser(
        "run", parents=[*shared, scene], help="solve a case; write frames, statistics, figures and a movie"
    )
    _add_result_options(run, "run")
    run.add_argument("--no-movie", action="store_true", help="do not draw a movie, which needs OpenGL")
    run.add_argument("--json", action="store_true", help="print only a summary, as JSON")
    run.set_defaults(run=_run)

    check = verbs.add_parser(
        "check", parents=[shared.common, scene], help="print the sizes, mesh quality, frequency and damping of a case"
    )
    check.add_argument("--json", action="store_true", help="print the numbers as JSON")
    check.set_defaults(run=_check)

    movie = verbs.add_parser("movie", parents=shared, help="draw the movie of a result folder again")
    movie.add_argument("folder", metavar="FOLDER", type=Path, help="a result folder, such as outputs/bar")
    movie.set_defaults(run=_movie)

    repeat = verbs.add_parser(
        "reproduce", parents=shared, help="run the thesis' scenes and compare each published number"
    )
    repeat.add_argument(
        "--cases", type=Path, default=Path("cases"), metavar="DIR", help="folder with the cases (%(default)s)"
    )
    _add_result_options(repeat, "scene")
    repeat.set_defaults(run=_reproduce)

    methods = verbs.add_parser(
        "methods", parents=[shared.common], help="list the laws, steppers and solvers that a case can choose"
    )
    methods.set_defaults(run=_methods)


def _add_result_options(parser: argparse.ArgumentParser, unit: str) -> None:
    """Add the options for the folder of results and for earlier results in it."""
    parser.add_argument("--out", type=Path, default=Path(find_default(run_case, "out")), metavar="DIR",
                        help="folder for results (%(default)s)")  # fmt: skip
    earlier = parser.add_mutually_exclusive_group()
    earlier.add_argument("--force", action="store_true", help="solve again and replace existing results")
    earlier.add_argument("--resume", action="store_true", help=f"continue an unfinished {unit}")


def load_chosen_case(options: argparse.Namespace) -> Case:
    """Return the case that the options name, with the changes that they ask for."""
    return load_case(
        options.case, overrides=dict(parse_override(text) for text in options.overrides), steps=options.steps
    )


def _run(options: argparse.Namespace) -> int:
    case = load_chosen_case(options)
    quiet = options.quiet or options.json
    with show_progress(quiet) as bar:
        result = run_case(
            case,
            options.out,
            variants=options.variants,
            force=options.force,
            resume=options.resume,
            movie=not options.no_movie,
            on_frame=bar.show_frame,
            on_start=bar.show_start,
            on_drawing=bar.show_picture,
        )
    if options.json:
        summary = {
            "folder": str(result.folder),
            "variants": {v.name: v.run | {"status": v.status} for v in result.variants},
            "files": [str(path) for path in result.files],
            "notes": list(result.notes),
        }
        print(json.dumps(summary, indent=2))
    for v in result.variants:
        if v.status == "failed":
            say(f"SolveError: {v.name}: {v.run['message']}; the frames before it are in {v.folder}")
    if not quiet:
        _print_summary(result)
    if not options.json:
        show_notes(result.notes)
    return result.exit_code


def _print_summary(result: CaseResult) -> None:
    """Print a line per variant and the files."""
    for v in result.variants:
        worst = v.run.get("worst")
        if v.status == "up to date":
            print(f"{v.name:<14} up to date (--force solves again)")
        elif worst and v.run["seconds_per_step"]:
            print(
                f"{v.name:<14} {v.status}; worst volume ratio {worst['volume_ratio']:.4f} (cell {worst['cell']}, "
                f"t = {worst['time']:.4g} s); {1e3 * v.run['seconds_per_step']:.3g} ms per step, "
                f"{v.run['real_time_factor']:.3g} x real time; solving {v.run['seconds']['solving']:.2g} s, "
                f"writing {v.run['seconds']['writing']:.2g} s"
            )
        else:
            print(f"{v.name:<14} {v.status}")
    print(f"results in {result.folder}" + "".join(f"\n  {path.name}" for path in result.files))
    for v in result.variants:
        print(f"  {v.index.relative_to(result.folder)}")


def _check(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from pipeline.problem.check import check_problem, format_check
    from pipeline.problem.problem import build

    case = load_chosen_case(options)
    problems = {name: build(case.variant(name)) for name in options.variants or case.variant_names}
    checks = {name: check_problem(problem) for name, problem in problems.items()}
    names_of: dict[tuple[str, ...], list[str]] = {}
    for name, problem in problems.items():
        names_of.setdefault(tuple(format_check(checks[name], problem)), []).append(name)
    for block, names in names_of.items() if not options.json else ():
        print(", ".join(names), *block, sep="\n  ")
    if options.json:
        finite = {
            name: {key: value if value == value else None for key, value in asdict(numbers).items()}
            for name, numbers in checks.items()
        }
        print(json.dumps(finite, indent=2))
    return 0


def _movie(options: argparse.Namespace) -> int:
    from pipeline.results.comparison import redraw_movie

    with show_progress(options.quiet) as bar:
        path = redraw_movie(options.folder, on_drawing=bar.show_picture)
    if not options.quiet:
        print(path)
    return 0


def _reproduce(options: argparse.Namespace) -> int:
    from pipeline.studies.thesis import reproduce

    with show_progress(options.quiet) as bar:
        result = reproduce(
            options.cases,
            options.out,
            force=options.force,
            resume=options.resume,
            on_frame=lambda _, problem, *rest: bar.show_frame(problem.name.split("/")[0], problem, *rest),
            on_drawing=bar.show_picture,
        )
    for name in result.failed:
        say(f"SolveError: {name}: see {result.markdown}")
    if not options.quiet:
        print(result.summary, result.html, result.markdown, sep="\n")
    return result.exit_code


def _methods(options: argparse.Namespace) -> int:
    from pipeline.problem.methods import describe_choices

    for key, rows in describe_choices().items():
        print(key, *(f"{name:<18} {text}" for name, text in rows.items()), sep="\n  ")
    return 0
