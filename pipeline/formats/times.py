"""Times as programs write them: the text in an index, the resolution of that text, and fields of a file."""

import re
from collections.abc import Iterable
from decimal import Decimal, InvalidOperation

from pipeline.errors import shorten

# in order of precedence; compared in lower case without separators
_TIME_FIELDS = ("timevalue", "timevalues", "time", "simulationtime", "simtime", "currenttime", "t")
_ODD = frozenset(",_dD")
_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eEdD][-+]?\d+)?")


def parse_time(text: str) -> float:
    """Return the time of a text: also with a decimal comma (0,5) or Fortran's exponent (2.0D-1); raises ValueError."""
    if text.isascii() and not _ODD.intersection(text):  # the usual case: an index may hold thousands of times
        try:
            return float(text)
        except ValueError:
            pass
    plain = text.strip()
    if _COMMA.fullmatch(plain):
        plain = plain.replace(",", ".")
    plain = re.sub(r"(?<=[\d.])[dD](?=[-+]?\d)", "e", plain)
    try:
        if "_" in plain:  # Python's own notation
            raise ValueError
        return float(plain)
    except ValueError:
        raise ValueError(f"the time {shorten(text)!r} is not a number") from None


def has_comma(text: str) -> bool:
    """Return whether a text is a number with a decimal comma."""
    return "," in text and _COMMA.fullmatch(text.strip()) is not None


def find_resolution(text: str) -> float:
    """Return the unit of the last digit of a number's text: 1e6 for 8e+06, 0.01 for 0.25; 0 if it is not a number."""
    try:
        exponent = Decimal(text.strip().replace(",", ".").lower().replace("d", "e")).as_tuple().exponent
        return float(10**exponent) if isinstance(exponent, int) and abs(exponent) < 300 else 0.0
    except (InvalidOperation, OverflowError):
        return 0.0


def find_time_field(names: Iterable[str]) -> str | None:
    """Return the field that holds a file's time: TimeValue, or a common other name; None if there is none."""
    known = {re.sub(r"[_\W]", "", name.lower()): name for name in names}
    return next((known[name] for name in _TIME_FIELDS if name in known), None)
