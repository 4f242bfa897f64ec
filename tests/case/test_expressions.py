"""Expressions of t: values, precedence as in Python, bounds, and errors that name the character and the remedy."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.case.expressions import FUNCTIONS, MOST_CHARACTERS, compile_expression


@pytest.mark.parametrize(
    ("text", "t", "value"),
    [
        ("min(t/0.5, 1)", 0.25, 0.5),
        ("min(t/0.5, 1)", 3.0, 1.0),
        ("-t**2", 3.0, -9.0),
        ("2^3^2", 0.0, 512.0),
        ("2**-1", 0.0, 0.5),
        ("(-8)**3", 0.0, -512.0),
        ("1 - 2 - 3", 0.0, -4.0),
        ("8/4/2", 0.0, 1.0),
        ("+t - -t", 2.0, 4.0),
        (".5*t + 5.e-1", 1.0, 1.0),
        ("1.5E2", 0.0, 150.0),
        ("sin(2*pi*t)", 0.25, 1.0),
        ("e", 0.0, math.e),
        ("(t > 1)*(t <= 2)*5", 2.0, 5.0),
        ("(t > 1)*(t <= 2)*5", 1.0, 0.0),
        ("(t >= 1) + (t < 1)", 0.3, 1.0),
        ("max(1, t, 3, 2)", 2.5, 3.0),
        ("step(t - 1)", 1.0, 1.0),
        ("step(t - 1)", 0.999, 0.0),
        ("ramp(t/2)", 1.0, 0.5),
        ("ramp(t/2)", 5.0, 1.0),
        ("ramp(-t)", 5.0, 0.0),
        ("smooth(t)", 0.25, 0.15625),
        ("tanh(abs(-t)) + cos(t) + tan(t) + exp(t) + log(e) + sqrt(4)", 0.0, 5.0),
    ],
)
def test_an_expression_has_the_value_of_its_formula(text, t, value):
    assert compile_expression(text)(t) == pytest.approx(value, rel=1e-15, abs=1e-15)


def nest(inner):
    pair = st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "**", " - ", " * "]), inner)
    return st.one_of(
        pair.map("".join),
        inner.map("({})".format),
        inner.map("-{}".format),
        inner.map("sin({})".format),
        st.tuples(inner, inner).map(lambda two: f"max({two[0]}, {two[1]})"),
    )


FORMULAS = st.recursive(st.sampled_from(["t", "2", "0.5", "pi", "3.25"]), nest, max_leaves=8)


@settings(max_examples=400, deadline=None)
@given(text=FORMULAS, t=st.floats(0, 4))
def test_precedence_is_that_of_python(text, t):
    """Checked with formulas made here, which Python may read; one whose value is no finite number fails in both."""
    names = {"t": t, "pi": math.pi, "sin": math.sin, "max": max}
    try:
        wanted = eval(text, {"__builtins__": {}}, names)
        wanted = wanted if isinstance(wanted, float | int) else math.nan
    except ArithmeticError:
        wanted = math.nan
    try:
        value = compile_expression(text)(t)
    except (ArithmeticError, ValueError):
        value = math.nan
    if math.isfinite(wanted) and math.isfinite(value):
        assert value == pytest.approx(wanted, rel=1e-12, abs=1e-300)
    else:
        assert not math.isfinite(wanted) or "**" in text  # a negative base, complex in Python
        assert not math.isfinite(value) or not math.isfinite(wanted)


WRONG = {
    "": "is empty",
    "   ": "is empty",
    "t +": "ends too early: a number, t or a function is missing (character 4)",
    "2t": "unexpected 't'; an operator is missing, such as * (character 2)",
    "2(t)": "unexpected '('; an operator is missing, such as * (character 2)",
    "sin t": "sin needs parentheses: sin(...) (character 5)",
    "sine(t)": "'sine' is unknown; did you mean sin? (character 1)",
    "x": "'x' is unknown; use t, pi, e and sin, ",
    "T": "'T' is unknown; use t, pi, e and ",
    "min(t)": "min takes 2 values or more, not 1 (character 1)",
    "sin(t, 1)": "sin takes one value, not 2 (character 1)",
    "sin()": "')' is not a number, t, a function or ( (character 5)",
    "max(1, 2,)": "')' is not a number, t, a function or ( (character 10)",
    "min(t, 2": "min( is not closed; add ) (character 9)",
    "(t": "( is not closed; add ) (character 3)",
    "t)": "unexpected ')'; it closes nothing (character 2)",
    "1 < t < 2": "unexpected '<'; multiply comparisons: (t > 1)*(t < 2) (character 7)",
    "t == 2": "unexpected '='; write <, <=, > or >= (character 3)",
    "1,5*t": "unexpected ','; decimals need a point (character 2)",
    "1e999": "1e999 is too large (character 1)",
    "t²": "unexpected '²' (character 2)",
    "٣*t": "'٣' is not a number, t, a function or ( (character 1)",
    "t.real": "unexpected '.' (character 2)",
    "t[0]": "unexpected '[' (character 2)",
    "'t'": '"\'" is not a number, t, a function or ( (character 1)',
    "lambda: 1": "'lambda' is unknown; ",
    "__import__('os').system('ls')": "'__import__' is unknown; ",
    "t if t else 1": "unexpected 'if'; an operator is missing, such as * (character 3)",
    "*t": "'*' is not a number, t, a function or ( (character 1)",
    "t//2": "'/' is not a number, t, a function or ( (character 3)",
    "(" * 60 + "t" + ")" * 60: "nests more than 40 levels; a table can replace it (character 41)",
    "-" * 60 + "t": "nests more than 40 levels; a table can replace it (character 41)",
    "t" + "**t" * 60: "nests more than 40 levels; a table can replace it (character 121)",
    "1" * (MOST_CHARACTERS + 1): f"has {MOST_CHARACTERS + 1} characters, more than {MOST_CHARACTERS}; a table can be",
}


@pytest.mark.parametrize(("text", "message"), WRONG.items(), ids=[text[:20] for text in WRONG])
def test_a_wrong_expression_is_told_with_its_place_and_a_remedy(text, message):
    with pytest.raises(ValueError) as caught:
        compile_expression(text)
    assert str(caught.value).startswith(message)


def test_the_longest_expression_can_be_evaluated():
    assert compile_expression("+".join(["t"] * (MOST_CHARACTERS // 2)))(1.0) == MOST_CHARACTERS // 2


@settings(max_examples=500, deadline=None)
@given(st.text(alphabet="t0123456789.+-*/^()<>=, e_abinxspqr", max_size=40) | st.text(max_size=20))
def test_junk_is_an_error_or_a_function(text):
    try:
        function = compile_expression(text)
    except ValueError as error:
        assert str(error)
        return
    try:
        function(0.3)
    except (ArithmeticError, ValueError):
        return


def test_all_functions_take_and_return_numbers():
    for name, (_, least, _) in FUNCTIONS.items():
        text = f"{name}({', '.join(['t'] * least)})"
        assert isinstance(compile_expression(text)(0.5), float), text
