"""Types of the values in a case file, each with its own message that quotes the wrong value."""

import math
import re
import tomllib
from itertools import pairwise
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    Discriminator,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainValidator,
    Tag,
    WithJsonSchema,
)
from pydantic_core import CoreSchema, PydanticCustomError
from pydantic_core.core_schema import no_info_after_validator_function, no_info_plain_validator_function

from pipeline.case.expressions import compile_expression
from pipeline.errors import quote_value, shorten

# Counts and node numbers stay in 32 bits, as they do in VTK files and in compiled kernels.
LARGEST_INTEGER = 2**31 - 1
# An energy is a product of six such numbers, which double precision can still represent.
LARGEST_NUMBER, SMALLEST_POSITIVE = 1e30, 1e-30
_MOST_REPEATS = 10  # 8^10 children of one cell
FOLDER_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}")
# Choices between types, in the paths of faults; messages leave them out.
VECTOR, TABLE, NUMBER, PYTHON = MARKS = ("[vector]", "[table]", "[number]", "[python]")
# TOML, unlike other languages, requires digits on both sides of a point.
BEFORE_POINT, AFTER_POINT = re.compile(r"(?<![\w.])\.(?=\d)"), re.compile(r"(?<=\d)\.(?!\d)")
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def make_fault(message: str, *key: str) -> PydanticCustomError:
    """Return the error to raise in a validator; `key` is the path from the validated value to the faulty entry."""
    return PydanticCustomError("case", "{message}", {"message": message, "key": key})


def join_key(parts: tuple[str, ...]) -> str:
    """Return a key as TOML writes it: parts joined by dots, quoted if they are not bare keys."""
    return ".".join(shorten(part) if BARE_KEY.fullmatch(part) else f'"{shorten(part)}"' for part in parts)


def suggest_toml(value: object) -> str:
    """Return "; write ..." for text that lacks only digits beside a point to be a number or list, else ""."""
    if not isinstance(value, str):
        return ""
    text = AFTER_POINT.sub(".0", BEFORE_POINT.sub("0.", value.strip()))
    try:
        (meant,) = tomllib.loads(f"value = {text}").values()
    except (ValueError, RecursionError):
        return ""
    finite = isinstance(meant, int | float) and math.isfinite(meant) and not isinstance(meant, bool)
    return f"; write {shorten(text)}" if finite or isinstance(meant, list) else ""


def _check_number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise make_fault(f"{quote_value(value)} is not a number{suggest_toml(value)}")
    try:
        number = float(value)
    except OverflowError:
        raise make_fault(f"{quote_value(value)} is too large") from None
    if not math.isfinite(number):
        raise make_fault(f"{quote_value(value)} is not finite")
    if abs(number) > LARGEST_NUMBER:
        raise make_fault(f"{quote_value(value)} is too large; numbers go up to {LARGEST_NUMBER:g}")
    return number


def _check_positive(value: Any) -> float:
    number = _check_number(value)
    if number <= 0:
        raise make_fault(f"{quote_value(value)} is not positive")
    if number < SMALLEST_POSITIVE:
        raise make_fault(f"{quote_value(value)} is too small; positive numbers start at {SMALLEST_POSITIVE:g}")
    return number


def _check_not_negative(value: Any) -> float:
    number = _check_number(value)
    if number < 0:
        raise make_fault(f"{quote_value(value)} is negative")
    return number


def _check_fraction(value: Any) -> float:
    number = _check_number(value)
    if not SMALLEST_POSITIVE <= number < 1:
        raise make_fault(f"{quote_value(value)} is not between 0 and 1")
    return number


def _check_poisson_ratio(value: Any) -> float:
    number = _check_number(value)
    if number >= 0.5:
        raise make_fault(f"{quote_value(value)} is not below 0.5")
    if number <= -1:
        raise make_fault(f"{quote_value(value)} is not above -1")
    return number


def check_integer(value: Any) -> int:
    """Return the value if it is a 32-bit integer; 2.0 and true are not integers."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise make_fault(f"{quote_value(value)} is not an integer")
    if abs(value) > LARGEST_INTEGER:
        raise make_fault(f"{quote_value(value)} is too large")
    return value


def _check_count(value: Any) -> int:
    if check_integer(value) < 1:
        raise make_fault(f"{value} is not positive")
    return int(value)


def _check_repeats(value: Any) -> int:
    if not 0 <= check_integer(value) <= _MOST_REPEATS:
        raise make_fault(f"{value} is not between 0 and {_MOST_REPEATS}")
    return int(value)


def _check_order(value: Any) -> int:
    if check_integer(value) not in (1, 2):
        raise make_fault(f"{value} is not 1 or 2")
    return int(value)


def _check_node_number(value: Any) -> int:
    if check_integer(value) < 0:
        raise make_fault(f"{value} is negative; nodes are counted from 0")
    return int(value)


def _check_iterations(value: Any) -> Any:
    counted = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= LARGEST_INTEGER
    if counted or value == "converged":
        return value
    raise make_fault(f'{quote_value(value)} is not a positive integer or "converged"')


def _check_text(value: Any) -> str:
    if not isinstance(value, str):
        raise make_fault(f"{quote_value(value)} is not a string")
    if not value:
        raise make_fault("is empty")
    if not value.isprintable():
        raise make_fault(f"{quote_value(value)} has unprintable characters")
    return value


def check_folder_name(value: Any) -> str:
    """Return the value if it can name a folder on every system."""
    if not FOLDER_NAME.fullmatch(_check_text(value)):
        wanted = "use up to 100 letters, digits, _, - and ., not starting with ."
        raise make_fault(f"{quote_value(value)} cannot name a folder; {wanted}")
    return str(value)


class OneOf:
    """Annotation of a string that is one of some names."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def check(self, value: Any) -> str:
        """Return the value; raises a fault that lists the names."""
        if not isinstance(value, str) or value not in self.names:
            raise make_fault(f"{quote_value(value)} is not one of {', '.join(self.names)}")
        return value

    def __get_pydantic_core_schema__(self, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_plain_validator_function(self.check)

    def __get_pydantic_json_schema__(self, _schema: CoreSchema, _handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "string", "enum": list(self.names)}


class Length:
    """Annotation of a list that has `least` to `most` entries."""

    def __init__(self, least: int, most: int | None = None) -> None:
        self.least, self.most = least, most

    def check(self, values: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the list; raises a fault with its length and the right one."""
        if self.most is None and len(values) < self.least:
            raise make_fault("is empty")
        if self.most is not None and not self.least <= len(values) <= self.most:
            wanted = str(self.least) if self.most == self.least else f"{self.least} or {self.most}"
            raise make_fault(f"has {len(values)} {'entry' if len(values) == 1 else 'entries'}, not {wanted}")
        return values

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        limits = {"minItems": self.least} | ({} if self.most is None else {"maxItems": self.most})
        return handler(schema) | limits


def _check_direction(values: tuple[float, ...]) -> tuple[float, ...]:
    if not any(values):
        raise make_fault("a zero vector is not a direction")
    return values


def _check_different(values: tuple[Any, ...]) -> tuple[Any, ...]:
    for i, value in enumerate(values):
        if value in values[:i]:
            raise make_fault(f"{quote_value(value)} is listed twice", str(i))
    return values


def _check_even(value: Any) -> int:
    if _check_count(value) % 2:
        raise make_fault(f"{value} is not even; video encoders need it")
    return int(value)


def _check_frame_rate(value: Any) -> int:
    if not 1 <= check_integer(value) <= 120:
        raise make_fault(f"{value} is not between 1 and 120")
    return int(value)


def _check_history(value: Any) -> str | tuple[tuple[float, float], ...]:
    """Return an expression of t, or the rows of a table as pairs of numbers."""
    if isinstance(value, str):
        try:
            compile_expression(value)
        except ValueError as error:
            raise make_fault(f"{quote_value(value)}: {error}") from None
        return value
    if not isinstance(value, list | tuple):
        raise make_fault(
            f'{quote_value(value)} is neither an expression of t in quotes, such as "min(t/0.5, 1)", nor a table '
            "[[t, value], ...]"
        )
    if len(value) < 2:
        raise make_fault(f"has {len(value)} row{'s' * (len(value) != 1)}; a table needs two or more, each [t, value]")
    rows = tuple(_check_row(index, row) for index, row in enumerate(value))
    for index, ((before, _), (after, _)) in enumerate(pairwise(rows)):
        if after <= before:
            raise make_fault(f"t = {after:g} is not above t = {before:g} of the row before", str(index + 1))
    return rows


def _check_row(index: int, row: Any) -> tuple[float, float]:
    if not isinstance(row, list | tuple) or len(row) != 2:
        raise make_fault(f"{quote_value(row)} is not [t, value]", str(index))
    for part, entry in enumerate(row):
        try:
            _check_number(entry)
        except PydanticCustomError as error:
            raise make_fault(str((error.context or {})["message"]), str(index), str(part)) from None
    return float(row[0]), float(row[1])


def _as_json(kind: str, **limits: Any) -> WithJsonSchema:
    """Return the JSON Schema of a type that has its own validator."""
    return WithJsonSchema({"type": kind, **limits})


FiniteNumber = Annotated[float, PlainValidator(_check_number), _as_json("number")]
Positive = Annotated[float, PlainValidator(_check_positive), _as_json("number", exclusiveMinimum=0)]
NotNegative = Annotated[float, PlainValidator(_check_not_negative), _as_json("number", minimum=0)]
Fraction = Annotated[float, PlainValidator(_check_fraction), _as_json("number", exclusiveMinimum=0, exclusiveMaximum=1)]
PoissonRatio = Annotated[
    float, PlainValidator(_check_poisson_ratio), _as_json("number", exclusiveMinimum=-1, exclusiveMaximum=0.5)
]
Integer = Annotated[int, PlainValidator(check_integer), _as_json("integer")]
Count = Annotated[int, PlainValidator(_check_count), _as_json("integer", minimum=1)]
Repeats = Annotated[int, PlainValidator(_check_repeats), _as_json("integer", minimum=0, maximum=_MOST_REPEATS)]
ElementOrder = Annotated[int, PlainValidator(_check_order), _as_json("integer", minimum=1, maximum=2)]
NodeNumber = Annotated[int, PlainValidator(_check_node_number), _as_json("integer", minimum=0)]
Iterations = Annotated[
    int | str,
    PlainValidator(_check_iterations),
    WithJsonSchema({"anyOf": [{"type": "integer", "minimum": 1}, {"const": "converged"}]}),
]
EvenCount = Annotated[int, PlainValidator(_check_even), _as_json("integer", minimum=2, multipleOf=2)]
FrameRate = Annotated[int, PlainValidator(_check_frame_rate), _as_json("integer", minimum=1, maximum=120)]
Text = Annotated[str, PlainValidator(_check_text), _as_json("string", minLength=1)]
FolderName = Annotated[str, PlainValidator(check_folder_name), _as_json("string", pattern=f"^{FOLDER_NAME.pattern}$")]
TimeFactor = Annotated[
    str | tuple[tuple[float, float], ...],
    PlainValidator(_check_history),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "string", "minLength": 1},
                {
                    "type": "array",
                    "items": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
                },
            ]
        }
    ),
]
AxisName = Annotated[str, OneOf("x", "y", "z")]
AxisNames = Annotated[tuple[AxisName, ...], Length(1), AfterValidator(_check_different)]
Vector = Annotated[tuple[FiniteNumber, ...], Length(2, 3)]
VectorOrNumber = Annotated[
    Annotated[Vector, Tag(VECTOR)] | Annotated[FiniteNumber, Tag(NUMBER)],
    Discriminator(lambda value: VECTOR if isinstance(value, list | tuple) else NUMBER),
]
Direction = Annotated[tuple[FiniteNumber, ...], Length(3, 3), AfterValidator(_check_direction)]
Lengths = Annotated[tuple[Positive, ...], Length(2, 3)]
Counts = Annotated[tuple[Count, ...], Length(2, 3)]
NodeNumbers = Annotated[tuple[NodeNumber, ...], Length(1)]
PictureSize = Annotated[tuple[EvenCount, ...], Length(2, 2)]
