"""Factors of loads and motions as functions of time: expressions of t, and tables with lines between their rows.

A history is called with a time [s] and returns its factor; `integrate` returns the integral from 0 to a time, exact for
tables, within 1e-12 of the largest factor for expressions. Both depend on the time alone, whatever was asked before.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from math import isfinite
from typing import Protocol

import numpy as np

from pipeline.case.expressions import compile_expression
from pipeline.errors import SolveError, quote_value

Rule = list[tuple[float, float]]

_TOLERANCE = 1e-12
_MOST_HALVINGS = 50  # of a step: then a jump is located as well as a time can be represented
_MOST_PIECES = 5000  # into which an interval is cut: ten times as many as eight jumps in a step take
_POINTS = 5, 8  # of two rules, exact for polynomials of degree 7 and 13


class History(Protocol):
    """A factor as a function of time."""

    def __call__(self, time: float) -> float:
        """Return the factor at a time [s]; raises SolveError if it has none."""
        ...

    def integrate(self, time: float) -> float:
        """Return the integral of the factor from 0 to a time [s]."""
        ...


class TableHistory:
    """Lines between the rows (t, factor), t ascending; constant before the first and after the last row."""

    def __init__(self, rows: Sequence[tuple[float, float]]) -> None:
        self.times, self.factors = [t for t, _ in rows], [factor for _, factor in rows]
        areas = [(b - a) * (f + g) / 2 for (a, f), (b, g) in pairwise(rows)]
        self._areas = [0.0, *np.cumsum(areas).tolist()]
        self._at_zero = self._measure_area(0.0)

    def __call__(self, time: float) -> float:
        """Return the factor at a time [s]."""
        row = bisect_right(self.times, time) - 1
        if row < 0:
            return self.factors[0]
        if row == len(self.times) - 1:
            return self.factors[-1]
        start, end = self.times[row], self.times[row + 1]
        part = (time - start) / (end - start)
        return (1 - part) * self.factors[row] + part * self.factors[row + 1]

    def integrate(self, time: float) -> float:
        """Return the integral of the factor from 0 to a time [s]."""
        return self._measure_area(time) - self._at_zero

    def _measure_area(self, time: float) -> float:
        """Return the integral from the first row to a time."""
        row = max(bisect_right(self.times, time) - 1, 0)
        return self._areas[row] + (time - self.times[row]) * (self.factors[row] + self(time)) / 2


class ExpressionHistory:
    """An expression of t; `interval` [s] is that of the pieces of which integrals are summed."""

    def __init__(self, text: str, interval: float) -> None:
        self.text = text
        self.interval = interval
        self._function = compile_expression(text)
        self._whole, self._sum = 0, 0.0  # intervals from 0 of which the integral is known, and that

    def __call__(self, time: float) -> float:
        """Return the factor at a time [s]; raises SolveError if it has none."""
        try:
            factor = self._function(time)
        except ZeroDivisionError:
            reason = "divides by zero"
        except OverflowError:
            reason = "is too large"
        except ValueError:
            reason = "has no value: log, sqrt and powers need numbers above 0"
        else:
            if isfinite(factor):
                return factor
            reason = f"is {factor}"
        raise SolveError(f"{quote_value(self.text)} {reason} at t = {time:.9g} s")

    def integrate(self, time: float) -> float:
        """Return the integral of the factor from 0 to a time [s]."""
        whole = int(time / self.interval)
        if whole < self._whole:  # in runs times ascend
            self._whole, self._sum = 0, 0.0
        while self._whole < whole:
            start = self._whole * self.interval
            self._sum += integrate_adaptively(self, start, start + self.interval)
            self._whole += 1
        return self._sum + integrate_adaptively(self, whole * self.interval, time)


def integrate_adaptively(function: Callable[[float], float], start: float, end: float) -> float:
    """Return the integral of a function; the interval is halved until two Gauss-Lobatto rules agree.

    Raises SolveError if the function varies too fast.
    """
    if start == end:
        return 0.0
    coarse, fine = map(_find_lobatto_points, _POINTS)

    def sum_values(rule: Rule, start: float, end: float, value_of: Callable[[float], float]) -> float:
        middle, half = (start + end) / 2, (end - start) / 2
        return half * sum(weight * value_of(middle + half * at) for at, weight in rule)

    left = _MOST_PIECES

    def integrate(start: float, end: float, halvings: int) -> float:
        nonlocal left
        left -= 1
        if left < 0:
            raise SolveError(
                f"a history varies too fast to be integrated near t = {start:.9g} s; a table can replace it"
            )
        few, many = (sum_values(rule, start, end, function) for rule in (coarse, fine))
        if abs(many - few) <= tolerance or halvings == _MOST_HALVINGS:
            return many
        middle = (start + end) / 2
        return integrate(start, middle, halvings + 1) + integrate(middle, end, halvings + 1)

    # of the whole interval: near zeros rounding keeps the rules apart
    tolerance = _TOLERANCE * sum_values(fine, start, end, lambda time: abs(function(time)))
    return integrate(start, end, 0)


@cache
def _find_lobatto_points(count: int) -> Rule:
    """Return the points in [-1, 1], ends included, and the weights of a Gauss-Lobatto rule.

    The ends show a kink close to them, which points inside miss.
    """
    P = np.polynomial.Legendre.basis(count - 1)
    at = np.array([-1.0, *np.sort(P.deriv().roots().real), 1.0])
    weights = 2 / (count * (count - 1) * P(at) ** 2)
    return list(zip(at.tolist(), weights.tolist(), strict=True))


def make_history(spec: str | Sequence[tuple[float, float]], interval: float) -> History:
    """Return the history of a case; `interval` [s] is about the time between two evaluations."""
    return ExpressionHistory(spec, interval) if isinstance(spec, str) else TableHistory(spec)
