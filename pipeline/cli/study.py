"""The verb `study NAME`: questions that take many runs. A study is a row of STUDIES."""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pipeline.case import Case, load_case, parse_override
from pipeline.cli.terminal import progress, say
from pipeline.errors import CaseError, SolveError, quote_value

if TYPE_CHECKING:
    from pipeline.studies.tradeoff.settings import Plan


class Study(NamedTuple):
    """A line of help, what adds the arguments, and what runs it and returns the exit code."""

    text: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def add_verbs(verbs: Any, common: argparse.ArgumentParser) -> None:
    """Add the verb `study` with the names of STUDIES."""
    study = verbs.add_parser("study", help="questions that take many runs of a case")
    names = study.add_subparsers(required=True, metavar="NAME")
    for name, row in STUDIES.items():
        one = names.add_parser(name, parents=[common, _sweeping(name)], help=row.text, description=row.text)
        row.add_arguments(one)
        one.set_defaults(run=partial(_interruptible, row.run))


def _interruptible(run: Callable[[argparse.Namespace], int], options: argparse.Namespace) -> int:
    """Return the exit code of a study; an interruption says what stands."""
    try:
        return run(options)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; the points done so far stand, the same command goes on") from None


def _sweeping(name: str) -> argparse.ArgumentParser:
    """Return what every study takes: where its points are computed and where they stand."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="an existing dask scheduler, such as tcp://host:8786")
    parser.add_argument("--out", type=Path, default=Path("outputs/studies") / name, metavar="DIR",
                        help=f"where results go (outputs/studies/{name}); what is there is not done again")  # fmt: skip
    return parser


def _tradeoff_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", metavar="CASE", type=Path, nargs="+", help="case files")
    parser.add_argument("--tolerance", type=float, default=0.01, metavar="T",
                        help="what is enough of node distance over size and half |J - J_ref| (0.01)")  # fmt: skip
    parser.add_argument("--dt", dest="dts", type=float, nargs="+", default=[], metavar="S",
                        help="steps to try, divisors of the longest (2, 1, 1/2, 1/4, 1/8 of the case's)")  # fmt: skip
    parser.add_argument("--refine", type=int, nargs="+", default=[], metavar="N",
                        help="meshes to try: cells times N, for boxes and rectangles (1 2)")  # fmt: skip
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="runs that a time is the median of (3)")
    parser.add_argument("--quick", action="store_true", help="three steps, the case's mesh only")
    parser.add_argument("--steps", type=int, metavar="N", help="cut the schedule to N steps of the case")
    parser.add_argument("--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[],
                        help="change a key first, such as material.youngs_modulus=1e6; may be repeated")  # fmt: skip
    parser.add_argument("--apply", action="store_true",
                        help='append the choice to the case file, as its variant "adequate"')  # fmt: skip


def _tradeoff(options: argparse.Namespace) -> int:
    from pipeline.studies.tradeoff.settings import make_plan

    plans = [
        make_plan(
            case,
            tolerance=options.tolerance,
            dts=options.dts,
            refinements=options.refine,
            steps=options.steps,
            quick=options.quick,
        )
        for case in _tradeoff_cases(options)
    ]
    worst = 0
    for plan in plans:
        try:
            _print_tradeoff(plan, options)
        except SolveError as error:  # the other cases have their turn
            say(f"SolveError: {error}")
            worst = error.exit_code
    return worst


def _tradeoff_cases(options: argparse.Namespace) -> list[Case]:
    """Return the cases that the options name and change; raises CaseError where the options are wrong."""
    if not 0 < options.tolerance < 1:
        raise CaseError(f"--tolerance {options.tolerance:g}: is not between 0 and 1")
    if options.repeats < 1:
        raise CaseError(f"--repeats {options.repeats}: is not 1 or more")
    if options.apply and options.overrides:
        raise CaseError("--apply: with --set the choice would be that of another case; edit the case file first")
    if options.apply and options.steps is not None:
        raise CaseError("--apply: with --steps the choice would be that of the beginning only; leave --steps out")
    overrides = dict(parse_override(text) for text in options.overrides)
    cases = {path: load_case(path, overrides=overrides) for path in options.cases}
    names = [case.name for case in cases.values()]
    for case in cases.values():
        if names.count(case.name) > 1:
            raise case.make_error(
                "name", f"{quote_value(case.name)} is the name of another case too: one folder for both"
            )
    return list(cases.values())


def _print_tradeoff(plan: "Plan", options: argparse.Namespace) -> None:
    """Run the study of one case and print its answer."""
    from pipeline.studies.tradeoff.study import study_tradeoff

    with progress(options.quiet) as bar:
        found = study_tradeoff(
            plan,
            options.out / plan.case.name,
            repeats=options.repeats,
            scheduler=options.scheduler,
            write_variant=options.apply,
            on_point=lambda _, done, total: bar.show_reading(plan.case.name, done, total),
        )
    print(found.sentence)
    if not options.quiet:
        print(*(f"  {line}" for line in (*found.lines, *found.files)), sep="\n", flush=True)


def _stability_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("case", metavar="CASE", type=Path, help="a case file")
    parser.add_argument("--slice", dest="slices", metavar="NAME", action="append", default=[],
                        help="only this; may be repeated: dt, spin, poisson_ratio, youngs_modulus, density, sliver, "
                             "scramble, inversion")  # fmt: skip
    parser.add_argument("--steps", type=int, default=50, metavar="N",
                        help="steps of an implicit trial; explicit ones take five times as many (50)")  # fmt: skip
    parser.add_argument("--tolerance", type=float, default=0.05, metavar="T",
                        help="what survives: worst |J - J_ref|, and worst node distance over size (0.05)")  # fmt: skip
    parser.add_argument("--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[],
                        help="change a key first, such as initial.factor=1; may be repeated")  # fmt: skip


def _stability(options: argparse.Namespace) -> int:
    from pipeline.studies.stability.study import study_stability

    case = load_case(options.case, overrides=dict(parse_override(text) for text in options.overrides))
    with progress(options.quiet) as bar:
        found = study_stability(
            case,
            options.out,
            slices=options.slices,
            steps=options.steps,
            tolerance=options.tolerance,
            scheduler=options.scheduler,
            on_point=lambda _, done, total: bar.show_reading(case.name, done, total),
        )
    print(*found.list_sentences(), sep="\n")
    if not options.quiet:
        print(*(f"  {path}" for path in found.files), sep="\n")
    return 0


def _scaling_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cases", metavar="CASE", type=Path, nargs="+", help="case files")
    parser.add_argument("--cells", metavar="NXxNYxNZ", nargs="+", default=[],
                        help="boxes to try, such as 2x8x2 8x26x8; without them the case's own mesh")  # fmt: skip
    parser.add_argument("--method", dest="methods", metavar="NAME", action="append", default=[],
                        help="only this; may be repeated: linear, one_solve, gram_schmidt, auto, converged, "
                             "explicit")  # fmt: skip
    parser.add_argument("--rtol", type=float, default=1e-6, metavar="R",
                        help="relative residual of the linear systems (1e-6)")  # fmt: skip


def _scaling(options: argparse.Namespace) -> int:
    from pipeline.studies.scaling.study import parse_cells, study_scaling

    if options.scheduler:
        raise CaseError("--scheduler: costs are measured on this machine, one process after the other; leave it out")
    with progress(options.quiet) as bar:
        found = study_scaling(
            [load_case(path) for path in options.cases],
            options.out,
            cells=[parse_cells(text) for text in options.cells],
            methods=options.methods or None,
            rtol=options.rtol,
            on_point=lambda done, total: bar.show_reading("scaling", done, total),
        )
    print(
        *found.format_lines(), f"bandwidth {found.bandwidth:.1f} GB/s", *(f"  {path}" for path in found.files), sep="\n"
    )
    return 0


STUDIES: Mapping[str, Study] = {
    "scaling": Study("how the cost of a step grows with the mesh, method by method", _scaling_arguments, _scaling),
    "stability": Study("what breaks at the extremes, method by method", _stability_arguments, _stability),
    "tradeoff": Study("which setting is enough: work against precision", _tradeoff_arguments, _tradeoff),
}
