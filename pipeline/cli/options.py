"""Options that several verbs share, and defaults of options, taken from the functions that they are passed to."""

import argparse
import inspect
from collections.abc import Callable
from typing import Any, NamedTuple


class SharedOptions(NamedTuple):
    """Parents of the verbs' parsers: options of every verb, and --quiet for those that show progress."""

    common: argparse.ArgumentParser
    quiet: argparse.ArgumentParser


def make_shared_options() -> SharedOptions:
    """Return the parents of the verbs' parsers."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("-v", "--verbose", action="store_true", help="show log messages, including those of libraries")
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    quiet = argparse.ArgumentParser(add_help=False)
    quiet.add_argument("--quiet", action="store_true", help="no progress bar and no details")
    return SharedOptions(common, quiet)


def find_default(function: Callable[..., Any], parameter: str) -> Any:
    """Return the default of a function's parameter."""
    return inspect.signature(function).parameters[parameter].default
