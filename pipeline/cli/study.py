"""The verb `study NAME`, for questions that take many runs. A study is a row of STUDIES."""

import argparse
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pipeline.case import Case, load_case, parse_override
from pipeline.cli.options import SharedOptions, find_default
from pipeline.cli.terminal import say, show_progress
from pipeline.errors import CaseError, SolveError, quote_value

if TYPE_CHECKING:
    from pipeline.studies.tradeoff.settings import Plan


class Study(NamedTuple):
    """A line of help, a function that adds the options, and one that runs the study and returns the exit code."""

    text: str
    add_options: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


class _StudyParser(argparse.ArgumentParser):
    """Adds a study's options only if it is named: their defaults and choices are in modules that are slow to import."""

    study: Study | None = None

    def parse_known_args(self, *arguments: Any, **keywords: Any) -> Any:
        if self.study is not None:
            self.study.add_options(self)
        return super().parse_known_args(*arguments, **keywords)


def add_verbs(verbs: Any, shared: SharedOptions) -> None:
    """Add the verb `study` with the names of STUDIES."""
    study = verbs.add_parser("study", help="answer a question that takes many runs of a case")
    names = study.add_subparsers(required=True, metavar="NAME", parser_class=_StudyParser)
    for name, row in STUDIES.items():
        parser = names.add_parser(name, parents=shared, help=row.text, description=row.text)
        parser.add_argument("--out", type=Path, default=Path("outputs/studies") / name, metavar="DIR",
                            help="folder for results (%(default)s)")  # fmt: skip
        parser.set_defaults(run=partial(_run_interruptibly, row.run))
        parser.study = row


def _run_interruptibly(run: Callable[[argparse.Namespace], int], options: argparse.Namespace) -> int:
    """Return the exit code of a study; if it is interrupted, the message says how to continue."""
    try:
        return run(options)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; the same command continues from the points that are done") from None


def _add_scheduler(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scheduler", metavar="ADDRESS", help="an existing dask scheduler, such as tcp://host:8786")


def _add_overrides(parser: argparse.ArgumentParser, example: str) -> None:
    parser.add_argument("--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[],
                        help=f"change a key of the case first, such as {example}; may be repeated")  # fmt: skip


def _add_tradeoff_options(parser: argparse.ArgumentParser) -> None:
    from pipeline.studies.tradeoff.chosen_variant import NAME
    from pipeline.studies.tradeoff.settings import DT_FACTORS, make_plan
    from pipeline.studies.tradeoff.study import study_tradeoff

    factors = ", ".join(str(Fraction(factor)) for factor in DT_FACTORS)
    parser.add_argument("cases", metavar="CASE", type=Path, nargs="+", help="case files")
    parser.add_argument("--tolerance", type=float, default=find_default(make_plan, "tolerance"), metavar="T",
                        help="accepted node distance over size, and half of |J - J_ref| (%(default)s)")  # fmt: skip
    parser.add_argument("--dt", dest="dts", type=float, nargs="+", default=[], metavar="S",
                        help=f"step sizes to try, all divisors of the longest ({factors} of the case's)")  # fmt: skip
    parser.add_argument("--refine", type=float, nargs="+", default=[], metavar="N",
                        help="meshes to try: N times the cells along each axis (1 2, and 0.5 for order 2)")  # fmt: skip
    parser.add_argument("--order", dest="orders", type=int, nargs="+", default=[], metavar="N",
                        help="orders of elements to try (1 2)")  # fmt: skip
    parser.add_argument("--repeats", type=int, default=find_default(study_tradeoff, "repeats"), metavar="N",
                        help="runs per setting; its time is their median (%(default)s)")  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="try three step sizes, on the case's mesh only")
    parser.add_argument("--steps", type=int, metavar="N", help="shorten the schedule to N steps of the case")
    parser.add_argument("--apply", action="store_true", help=f'append the choice to the case file as variant "{NAME}"')
    _add_overrides(parser, "material.youngs_modulus=1e6")
    _add_scheduler(parser)


def _tradeoff(options: argparse.Namespace) -> int:
    from pipeline.studies.tradeoff.settings import make_plan

    plans = [
        make_plan(
            case,
            tolerance=options.tolerance,
            dts=options.dts,
            refinements=options.refine,
            orders=options.orders,
            steps=options.steps,
            quick=options.quick,
        )
        for case in _tradeoff_cases(options)
    ]
    exit_code = 0
    for plan in plans:
        try:
            _print_tradeoff(plan, options)
        except SolveError as error:  # the other cases are still studied
            say(f"SolveError: {error}")
            exit_code = error.exit_code
    return exit_code


def _tradeoff_cases(options: argparse.Namespace) -> list[Case]:
    """Return the cases that the options name and change; raises CaseError if an option is wrong."""
    if not 0 < options.tolerance < 1:
        raise CaseError(f"--tolerance {options.tolerance:g}: must be between 0 and 1")
    if options.repeats < 1:
        raise CaseError(f"--repeats {options.repeats}: must be 1 or more")
    if options.apply and options.overrides:
        raise CaseError("--apply: with --set the choice would be for another case; edit the case file instead")
    if options.apply and options.steps is not None:
        raise CaseError("--apply: with --steps the choice would be for the beginning only; leave --steps out")
    overrides = dict(parse_override(text) for text in options.overrides)
    cases = {path: load_case(path, overrides=overrides) for path in options.cases}
    names = [case.name for case in cases.values()]
    for case in cases.values():
        if names.count(case.name) > 1:
            raise case.make_error(
                "name", f"{quote_value(case.name)} is also the name of another case: both would use one folder"
            )
    return list(cases.values())


def _print_tradeoff(plan: "Plan", options: argparse.Namespace) -> None:
    """Run the study of one case and print its answer."""
    from pipeline.studies.tradeoff.study import study_tradeoff

    with show_progress(options.quiet) as bar:
        result = study_tradeoff(
            plan,
            options.out / plan.case.name,
            repeats=options.repeats,
            scheduler=options.scheduler,
            write_variant=options.apply,
            on_point=lambda _, done, total: bar.show_reading(plan.case.name, done, total),
        )
    print(result.sentence)
    if not options.quiet:
        print(*(f"  {line}" for line in (*result.lines, *result.files)), sep="\n", flush=True)


def _add_stability_options(parser: argparse.ArgumentParser) -> None:
    from pipeline.studies.stability.slices import SLICES
    from pipeline.studies.stability.study import study_stability

    parser.add_argument("case", metavar="CASE", type=Path, help="a case file")
    parser.add_argument("--slice", dest="slices", metavar="NAME", action="append", default=[],
                        help=f"only this slice; may be repeated: {', '.join(SLICES)}")  # fmt: skip
    parser.add_argument("--steps", type=int, default=find_default(study_stability, "steps"), metavar="N",
                        help="steps of a trial, five times as many if explicit (%(default)s)")  # fmt: skip
    parser.add_argument("--tolerance", type=float, default=find_default(study_stability, "tolerance"), metavar="T",
                        help="accepted |J - J_ref|, and node distance over size (%(default)s)")  # fmt: skip
    _add_overrides(parser, "initial.factor=1")
    _add_scheduler(parser)


def _stability(options: argparse.Namespace) -> int:
    from pipeline.studies.stability.study import study_stability

    case = load_case(options.case, overrides=dict(parse_override(text) for text in options.overrides))
    with show_progress(options.quiet) as bar:
        result = study_stability(
            case,
            options.out,
            slices=options.slices,
            steps=options.steps,
            tolerance=options.tolerance,
            scheduler=options.scheduler,
            on_point=lambda _, done, total: bar.show_reading(case.name, done, total),
        )
    print(*result.list_sentences(), sep="\n")
    if not options.quiet:
        print(*(f"  {path}" for path in result.files), sep="\n")
    return 0


def _add_scaling_options(parser: argparse.ArgumentParser) -> None:
    from pipeline.studies.scaling.step_cost import METHODS
    from pipeline.studies.scaling.study import study_scaling

    parser.add_argument("cases", metavar="CASE", type=Path, nargs="+", help="case files")
    parser.add_argument("--cells", metavar="NXxNYxNZ", nargs="+", default=[],
                        help="boxes to try, such as 2x8x2 8x26x8 (the case's own mesh)")  # fmt: skip
    parser.add_argument("--method", dest="methods", metavar="NAME", action="append", default=[],
                        help=f"only this method; may be repeated: {', '.join(METHODS)}")  # fmt: skip
    parser.add_argument("--rtol", type=float, default=find_default(study_scaling, "rtol"), metavar="R",
                        help="relative residual of the linear systems (%(default)s)")  # fmt: skip


def _scaling(options: argparse.Namespace) -> int:
    from pipeline.studies.scaling.study import parse_cells, study_scaling

    with show_progress(options.quiet) as bar:
        result = study_scaling(
            [load_case(path) for path in options.cases],
            options.out,
            cells=[parse_cells(text) for text in options.cells],
            methods=options.methods or None,
            rtol=options.rtol,
            on_point=lambda done, total: bar.show_reading("scaling", done, total),
        )
    print(*result.format_lines(), sep="\n")
    if not options.quiet:
        print(f"bandwidth {result.bandwidth:.1f} GB/s", *(f"  {path}" for path in result.files), sep="\n")
    return 0


STUDIES: Mapping[str, Study] = {
    "scaling": Study("measure how the cost of a step grows with the mesh", _add_scaling_options, _scaling),
    "stability": Study("find the extremes at which each method breaks", _add_stability_options, _stability),
    "tradeoff": Study("find the cheapest setting that is accurate enough", _add_tradeoff_options, _tradeoff),
}
