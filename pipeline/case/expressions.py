"""Expressions of the time t, such as "min(t/0.5, 1)": parsed here and never run as Python.

    comparison := sum [("<" | "<=" | ">" | ">=") sum]       1 if true, else 0
    sum        := product (("+" | "-") product)*
    product    := factor (("*" | "/") factor)*
    factor     := ("+" | "-") factor | power
    power      := atom [("**" | "^") factor]                from the right, before a sign: -t**2 is -(t**2)
    atom       := number | "t" | "pi" | "e" | name "(" comparison ("," comparison)* ")" | "(" comparison ")"

Angles are in radians. step(x) is 0 below x = 0 and else 1; ramp(x) rises from 0 at x = 0 to 1 at x = 1 along a line,
smooth(x) along 3 x^2 - 2 x^3, without a kink.
"""

import math
import operator
import re
from collections.abc import Callable
from difflib import get_close_matches

from pipeline.errors import quote_value

TimeFunction = Callable[[float], float]

MOST_CHARACTERS = 1000
_MOST_LEVELS = 40  # of parentheses, signs and powers, each of which nests calls
_TOKEN = re.compile(
    r"\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|([A-Za-z_]\w*)|(\*\*|<=|>=|\S))", re.ASCII
)


def _ramp(x: float) -> float:
    return min(max(x, 0.0), 1.0)


def _smooth(x: float) -> float:
    x = _ramp(x)
    return x * x * (3 - 2 * x)


CONSTANTS = {"pi": math.pi, "e": math.e}
# each with the least and the largest number of its arguments
FUNCTIONS: dict[str, tuple[Callable[..., float], int, float]] = {
    "sin": (math.sin, 1, 1),
    "cos": (math.cos, 1, 1),
    "tan": (math.tan, 1, 1),
    "exp": (math.exp, 1, 1),
    "log": (math.log, 1, 1),
    "sqrt": (math.sqrt, 1, 1),
    "tanh": (math.tanh, 1, 1),
    "abs": (abs, 1, 1),
    "min": (min, 2, math.inf),
    "max": (max, 2, math.inf),
    "step": (lambda x: float(x >= 0), 1, 1),
    "ramp": (_ramp, 1, 1),
    "smooth": (_smooth, 1, 1),
}
_SUMS: dict[str, Callable[[float, float], float]] = {"+": operator.add, "-": operator.sub}
_PRODUCTS: dict[str, Callable[[float, float], float]] = {"*": operator.mul, "/": operator.truediv}
_COMPARISONS: dict[str, Callable[[float, float], float]] = {
    "<": lambda a, b: float(a < b),
    "<=": lambda a, b: float(a <= b),
    ">": lambda a, b: float(a > b),
    ">=": lambda a, b: float(a >= b),
}


def compile_expression(text: str) -> TimeFunction:
    """Return the expression as a function of t; raises ValueError that names the wrong character and a remedy.

    The function raises ArithmeticError or ValueError at times at which the expression has no value.
    """
    if len(text) > MOST_CHARACTERS:
        raise ValueError(f"has {len(text)} characters, more than {MOST_CHARACTERS}; a table can be longer")
    return _Parser(text).parse()


class _Parser:
    """Reads one expression from left to right; each method returns the function of a part."""

    def __init__(self, text: str) -> None:
        self.tokens = [(m.group(1), m.group(2), m.group(3), m.start(m.lastindex or 0)) for m in _TOKEN.finditer(text)]
        self.end = len(text)
        self.position = 0
        self.levels = 0

    def parse(self) -> TimeFunction:
        """Return the function of the whole expression."""
        if not self.tokens:
            raise ValueError("is empty")
        function = self._read_comparison()
        if self.position < len(self.tokens):
            raise self._make_error(f"unexpected {self._peek()!r}{self._suggest()}")
        return function

    def _peek(self) -> str:
        """Return the text of the next token, "" at the end."""
        return "" if self.position == len(self.tokens) else next(filter(None, self.tokens[self.position][:3]))

    def _take(self, *wanted: str) -> str:
        """Return the next token and pass it if it is one of those wanted, else ""."""
        token = self._peek()
        if token not in wanted:
            return ""
        self.position += 1
        return token

    def _make_error(self, message: str) -> ValueError:
        place = self.end if self.position >= len(self.tokens) else self.tokens[self.position][3]
        return ValueError(f"{message} (character {place + 1})")

    def _suggest(self) -> str:
        """Return the remedy for the unexpected token."""
        number, name, sign, _ = self.tokens[self.position]
        if number or name or sign == "(":
            return "; an operator is missing, such as *"
        if sign in _COMPARISONS:
            return "; multiply comparisons: (t > 1)*(t < 2)"
        return {"=": "; write <, <=, > or >=", ")": "; it closes nothing", ",": "; decimals need a point"}.get(sign, "")

    def _read_comparison(self) -> TimeFunction:
        left = self._read_sum()
        sign = self._take(*_COMPARISONS)
        return _combine(_COMPARISONS[sign], left, self._read_sum()) if sign else left

    def _read_sum(self) -> TimeFunction:
        total = self._read_product()
        while sign := self._take(*_SUMS):
            total = _combine(_SUMS[sign], total, self._read_product())
        return total

    def _read_product(self) -> TimeFunction:
        product = self._read_factor()
        while sign := self._take(*_PRODUCTS):
            product = _combine(_PRODUCTS[sign], product, self._read_factor())
        return product

    def _read_factor(self) -> TimeFunction:
        self.levels += 1
        if self.levels > _MOST_LEVELS:
            raise self._make_error(f"nests more than {_MOST_LEVELS} levels; a table can replace it")
        if sign := self._take("+", "-"):
            inner = self._read_factor()
            result: TimeFunction = (lambda t: -inner(t)) if sign == "-" else inner
        else:
            result = self._read_power()
        self.levels -= 1
        return result

    def _read_power(self) -> TimeFunction:
        base = self._read_atom()
        # the operator ** makes complex numbers of negative bases
        return _combine(math.pow, base, self._read_factor()) if self._take("**", "^") else base

    def _read_atom(self) -> TimeFunction:
        if self.position == len(self.tokens):
            raise self._make_error("ends too early: a number, t or a function is missing")
        number, name, sign, _ = self.tokens[self.position]
        if number:
            value = float(number)
            if not math.isfinite(value):
                raise self._make_error(f"{number} is too large")
            self.position += 1
            return lambda t: value
        if name:
            return self._read_name(name)
        if not self._take("("):
            raise self._make_error(f"{quote_value(sign)} is not a number, t, a function or (")
        inner = self._read_comparison()
        self._close("(")
        return inner

    def _read_name(self, name: str) -> TimeFunction:
        if name not in FUNCTIONS:
            if name != "t" and name not in CONSTANTS:
                near = get_close_matches(name, [*FUNCTIONS, *CONSTANTS], n=1)
                remedy = f"did you mean {near[0]}?" if near else f"use t, pi, e and {', '.join(FUNCTIONS)}"
                raise self._make_error(f"{quote_value(name)} is unknown; {remedy}")
            self.position += 1
            constant = CONSTANTS.get(name)
            return (lambda t: t) if constant is None else (lambda t: constant)
        start = self.position
        self.position += 1
        if not self._take("("):
            raise self._make_error(f"{name} needs parentheses: {name}(...)")
        parts = [self._read_comparison()]
        while self._take(","):
            parts.append(self._read_comparison())
        self._close(f"{name}(")
        function, least, most = FUNCTIONS[name]
        if not least <= len(parts) <= most:
            self.position = start
            wanted = "one value" if most == 1 else f"{least} values or more"
            raise self._make_error(f"{name} takes {wanted}, not {len(parts)}")
        if len(parts) == 1:
            (inner,) = parts
            return lambda t: function(inner(t))
        return lambda t: function(*[part(t) for part in parts])

    def _close(self, opening: str) -> None:
        if not self._take(")"):
            token = self._peek()
            reason = f"unexpected {token!r}{self._suggest()}" if token else f"{opening} is not closed; add )"
            raise self._make_error(reason)


def _combine(operation: Callable[[float, float], float], left: TimeFunction, right: TimeFunction) -> TimeFunction:
    return lambda t: operation(left(t), right(t))
