"""Types of a case file's values, each with its own message, which quotes the wrong value."""

import math
import re
import tomllib
from typing import Annotated, Any

from pydantic import AfterValidator, PlainValidator
from pydantic_core import PydanticCustomError

from pipeline.errors import quote_value, shorten

# Counts and node numbers stay in 32 bits, as they do in VTK files and in compiled kernels.
LARGEST_INTEGER = 2**31 - 1
# Energies multiply six such numbers, which double precision holds.
LARGEST_NUMBER, SMALLEST_POSITIVE = 1e30, 1e-30
FOLDER_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}")
# what TOML asks for and other languages do not: digits on both sides of a point
BEFORE_POINT, AFTER_POINT = re.compile(r"(?<![\w.])\.(?=\d)"), re.compile(r"(?<=\d)\.(?!\d)")
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def fault(message: str, *key: str) -> PydanticCustomError:
    """The error to raise in a validator; `key` leads from the place of the validator to the faulty entry."""
    return PydanticCustomError("case", "{message}", {"message": message, "key": key})


def dotted(parts: tuple[str, ...]) -> str:
    """A key as it is written in TOML: parts joined by dots, quoted where a bare key would not do."""
    return ".".join(shorten(part) if BARE_KEY.fullmatch(part) else f'"{shorten(part)}"' for part in parts)


def as_toml(value: object) -> str:
    """The words "; write ..." for a text that is a number or a list once its points have digits on both sides."""
    if not isinstance(value, str):
        return ""
    text = AFTER_POINT.sub(".0", BEFORE_POINT.sub("0.", value.strip()))
    try:
        (meant,) = tomllib.loads(f"value = {text}").values()
    except (ValueError, RecursionError):
        return ""
    finite = isinstance(meant, int | float) and math.isfinite(meant) and not isinstance(meant, bool)
    return f"; write {shorten(text)}" if finite or isinstance(meant, list) else ""


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise fault(f"{quote_value(value)} is not a number{as_toml(value)}")
    try:
        number = float(value)
    except OverflowError:
        raise fault(f"{quote_value(value)} is too large") from None
    if not math.isfinite(number):
        raise fault(f"{quote_value(value)} is not finite")
    if abs(number) > LARGEST_NUMBER:
        raise fault(f"{quote_value(value)} is too large; numbers go up to {LARGEST_NUMBER:g}")
    return number


def _positive(value: Any) -> float:
    number = _number(value)
    if number <= 0:
        raise fault(f"{quote_value(value)} is not positive")
    if number < SMALLEST_POSITIVE:
        raise fault(f"{quote_value(value)} is too small; positive numbers start at {SMALLEST_POSITIVE:g}")
    return number


def _fraction(value: Any) -> float:
    number = _number(value)
    if not SMALLEST_POSITIVE <= number < 1:
        raise fault(f"{quote_value(value)} is not between 0 and 1")
    return number


def _poisson_ratio(value: Any) -> float:
    number = _number(value)
    if number >= 0.5:
        raise fault(f"{quote_value(value)} is not below 0.5")
    if number <= -1:
        raise fault(f"{quote_value(value)} is not above -1")
    return number


def integer(value: Any) -> int:
    """The value, if it is an integer of a sane size; 2.0 and true are none."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise fault(f"{quote_value(value)} is not an integer")
    if abs(value) > LARGEST_INTEGER:
        raise fault(f"{quote_value(value)} is too large")
    return value


def _count(value: Any) -> int:
    if integer(value) < 1:
        raise fault(f"{value} is not positive")
    return int(value)


def _node_number(value: Any) -> int:
    if integer(value) < 0:
        raise fault(f"{value} is negative; nodes are counted from 0")
    return int(value)


def _iterations(value: Any) -> Any:
    counted = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= LARGEST_INTEGER
    if counted or value == "converged":
        return value
    raise fault(f'{quote_value(value)} is not a positive integer or "converged"')


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise fault(f"{quote_value(value)} is not a string")
    if not value:
        raise fault("is empty")
    if not value.isprintable():
        raise fault(f"{quote_value(value)} has unprintable characters")
    return value


def folder_name(value: Any) -> str:
    """The value, if it can name a folder on every system."""
    if not FOLDER_NAME.fullmatch(_text(value)):
        wanted = "use up to 100 letters, digits, _, - and ., not starting with ."
        raise fault(f"{quote_value(value)} cannot name a folder; {wanted}")
    return str(value)


def choice(*names: str) -> PlainValidator:
    """A validator that lets one of the names pass."""

    def chosen(value: Any) -> str:
        if not isinstance(value, str) or value not in names:
            raise fault(f"{quote_value(value)} is not one of {', '.join(names)}")
        return value

    return PlainValidator(chosen)


def entries(least: int, most: int | None = None) -> AfterValidator:
    """A validator of a list's length."""
    wanted = str(least) if most == least else f"{least} or {most}"

    def counted(values: tuple[Any, ...]) -> tuple[Any, ...]:
        if most is None and len(values) < least:
            raise fault("is empty")
        if most is not None and not least <= len(values) <= most:
            raise fault(f"has {len(values)} {'entry' if len(values) == 1 else 'entries'}, not {wanted}")
        return values

    return AfterValidator(counted)


def _direction(values: tuple[float, ...]) -> tuple[float, ...]:
    if not any(values):
        raise fault("a zero vector is not a direction")
    return values


def _even(value: Any) -> int:
    if _count(value) % 2:
        raise fault(f"{value} is not even; video encoders need it")
    return int(value)


def _frame_rate(value: Any) -> int:
    if not 1 <= integer(value) <= 120:
        raise fault(f"{value} is not between 1 and 120")
    return int(value)


Number = Annotated[float, PlainValidator(_number)]
Positive = Annotated[float, PlainValidator(_positive)]
Fraction = Annotated[float, PlainValidator(_fraction)]
PoissonRatio = Annotated[float, PlainValidator(_poisson_ratio)]
Count = Annotated[int, PlainValidator(_count)]
NodeNumber = Annotated[int, PlainValidator(_node_number)]
Iterations = Annotated[int | str, PlainValidator(_iterations)]
EvenCount = Annotated[int, PlainValidator(_even)]
FrameRate = Annotated[int, PlainValidator(_frame_rate)]
Text = Annotated[str, PlainValidator(_text)]
FolderName = Annotated[str, PlainValidator(folder_name)]
AxisName = Annotated[str, choice("x", "y", "z")]
Vector = Annotated[tuple[Number, ...], entries(2, 3)]
Direction = Annotated[tuple[Number, ...], entries(3, 3), AfterValidator(_direction)]
