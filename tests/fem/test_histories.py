"""Histories: values of tables and expressions, integrals against closed forms, errors that name t."""

import math
import time

import pytest

from pipeline.errors import SolveError
from pipeline.fem.histories import make_history

ROWS = [(0.1, 0.0), (0.5, 2.0), (1.0, -1.0)]


@pytest.mark.parametrize(
    ("t", "value"), [(-1.0, 0.0), (0.0, 0.0), (0.1, 0.0), (0.3, 1.0), (0.5, 2.0), (0.75, 0.5), (1.0, -1.0), (9.0, -1.0)]
)
def test_a_table_has_lines_between_its_rows_and_is_constant_outside(t, value):
    assert make_history(ROWS, 0.01)(t) == pytest.approx(value, abs=1e-15)


@pytest.mark.parametrize(
    ("spec", "integral"),
    [
        ("min(t/0.5, 1)", lambda t: t * t if t < 0.5 else t - 0.25),
        ("step(t - 0.31)*3", lambda t: 3 * max(t - 0.31, 0.0)),
        ("sin(300*t)", lambda t: (1 - math.cos(300 * t)) / 300),
        ("sqrt(t)", lambda t: t**1.5 / 1.5),
        ("(t - 0.1)^5", lambda t: ((t - 0.1) ** 6 - 0.1**6) / 6),
        ("-2", lambda t: -2 * t),
        ("0", lambda t: 0.0),
        ([(0.0, 0.0), (0.5, 1.0)], lambda t: t * t if t < 0.5 else t - 0.25),
        ([(-1.0, 1.0), (1.0, 3.0)], lambda t: 2 * t + t * t / 2 if t < 1 else 2.5 + 3 * (t - 1)),
        ([(1.0, 2.0), (2.0, 2.0)], lambda t: 2 * t),
    ],
    ids=lambda value: "exact" if callable(value) else str(value),
)
@pytest.mark.parametrize("interval", [0.07, 1e-3])
def test_integrals_are_exact(spec, integral, interval):
    history = make_history(spec, interval)
    for t in (0.0, 0.03, 0.07, 0.31, 0.5, 1.0, 2.0):
        assert history.integrate(t) == pytest.approx(integral(t), rel=1e-11, abs=1e-13)


def test_an_integral_does_not_depend_on_the_times_asked_before():
    one, other = (make_history("exp(sin(20*t))*step(t-0.2)", 0.01) for _ in range(2))
    stepwise = [one.integrate(k * 0.01) for k in range(100)]
    assert other.integrate(0.99) == stepwise[-1] and other.integrate(0.42) == stepwise[42]


@pytest.mark.parametrize(
    ("text", "t", "message"),
    [
        ("1/t", 0.0, "'1/t' divides by zero at t = 0 s"),
        ("log(t - 1)", 0.5, "'log(t - 1)' has no value: log, sqrt and powers need numbers above 0 at t = 0.5 s"),
        ("exp(t)", 1000.0, "'exp(t)' is too large at t = 1000 s"),
        ("1e300*1e300*t", 2.0, "'1e300*1e300*t' is inf at t = 2 s"),
        ("1e300*1e300*t", 0.0, "'1e300*1e300*t' is nan at t = 0 s"),
    ],
)
def test_a_history_without_a_value_says_at_which_time(text, t, message):
    with pytest.raises(SolveError) as caught:
        make_history(text, 0.1)(t)
    assert str(caught.value) == message


def test_an_integral_that_would_take_forever_is_refused():
    began = time.perf_counter()
    with pytest.raises(SolveError, match="varies too fast to be integrated near t = "):
        make_history("sin(1e9*t)", 0.07).integrate(1.0)
    assert time.perf_counter() - began < 10
