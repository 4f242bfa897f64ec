"""One tolerance for times: whether two are the same, and whether one is a whole multiple of another.

Times are products i * dt, sums of steps or decimals read from a file. They differ in the last digits, by far less than
the relative 1e-9 allowed here, and frames are orders of magnitude farther apart.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

TIME_RTOL = 1e-9


def are_same_times(a: "ArrayLike", b: "ArrayLike") -> bool:
    """Return whether two times, or two sequences of times, are equal to within 1e-9 of the largest of them."""
    import numpy as np  # imported here: case files are checked without it

    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if first.shape != second.shape:
        return False
    scale = max(np.abs(first).max(initial=0.0), np.abs(second).max(initial=0.0))
    return bool((np.abs(first - second) <= TIME_RTOL * scale).all())


def count_intervals(span: float, interval: float) -> int | None:
    """Return how many intervals make up a span, None unless that is a whole number of at least one."""
    ratio = span / interval
    if not ratio < 1 / TIME_RTOL:  # the interval is below the tolerance
        return None
    count = round(ratio)
    return count if count >= 1 and abs(ratio - count) <= TIME_RTOL * ratio else None
