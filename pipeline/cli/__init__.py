"""The command line: the only place that prints, draws progress, configures logging or exits."""

import argparse
import logging
import os
from collections.abc import Sequence

from pipeline.cli import reference, report, scenes, series, study
from pipeline.cli.options import make_shared_options
from pipeline.cli.terminal import say
from pipeline.errors import PipelineError
from pipeline.system.version import VERSION

INTERRUPTED = 130
_DESCRIPTION = (
    "Measure, compare and show how much volume deformable bodies gain or lose; run scenes with linear and corotational "
    "elasticity."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    options = _make_parser().parse_args(arguments)
    logging.basicConfig(level=logging.DEBUG if options.verbose else logging.WARNING, format="%(name)s: %(message)s")
    try:
        return int(options.run(options))
    except PipelineError as error:
        if options.debug:
            raise
        say(f"{type(error).__name__}: {error}")
        return error.exit_code
    except MemoryError as error:
        if options.debug:
            raise
        say(f"PipelineError: not enough memory ({error}); try a coarser mesh")
        return PipelineError.exit_code
    except BrokenPipeError:  # the reader of the output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 0
    except KeyboardInterrupt as interrupt:
        say(str(interrupt) or "interrupted; frames written so far are complete")
        return INTERRUPTED


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="pipeline", description=_DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"pipeline {VERSION}")
    verbs, shared = parser.add_subparsers(required=True, metavar="VERB"), make_shared_options()
    for module in (scenes, study, series, report, reference):
        module.add_verbs(verbs, shared)
    return parser
