"""The exceptions of this package, and how their messages quote values.

The command line turns each error into one line and an exit code.
"""

from collections.abc import Iterable, Mapping

LONGEST_QUOTE = 60
_LONGEST_LIST = 20


class PipelineError(Exception):
    """A fault that the user can mend: the message names the file, the key or step, the number and the remedy."""

    exit_code = 2


class CaseError(PipelineError):
    """A case file, an override or a combination of its settings is wrong."""


class MeshError(PipelineError):
    """A mesh cannot be simulated or measured."""


class SeriesError(PipelineError):
    """A recorded time series cannot be read or measured."""


class MeshChangedError(SeriesError):
    """The cells of a frame are not those of the first frame of its series."""


class SolveError(PipelineError):
    """A step could not be computed; the results before it are kept."""

    exit_code = 3


class OutputError(PipelineError):
    """A result could not be written or drawn."""

    exit_code = 4


def quote_value(value: object) -> str:
    """Return a value as messages quote it: one line, printable, at most 60 characters."""
    if isinstance(value, bool):
        return "true" if value else "false"
    try:
        text = repr(dict(value)) if isinstance(value, Mapping) else repr(value)
    except ValueError:  # an integer beyond Python's limit of digits
        return "a number of thousands of digits"
    return shorten(text)


def shorten(text: str, longest: int = LONGEST_QUOTE) -> str:
    """Return the text, or its beginning, on one line, printable and not longer than `longest`."""
    text = text[: longest + 1]  # escaping can only lengthen it
    text = text if text.isprintable() else ascii(text)[1:-1]
    return text if len(text) <= longest else text[: longest - 3] + "..."


def join_names(names: Iterable[str]) -> str:
    """Return names as messages list them: separated by commas, each shortened, at most 20 of them."""
    texts = [shorten(name) for name in names]
    more = len(texts) - _LONGEST_LIST
    return ", ".join(texts[:_LONGEST_LIST]) + (f" and {more} more" if more > 0 else "")
