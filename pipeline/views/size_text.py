"""The size of a whole body over time in words: at the end, and at its largest change if that was much larger."""

import numpy as np

from pipeline.arrays import Floats

_MUCH = 2.0  # times the change at the end
_VISIBLE = 0.1  # percent: a smaller largest change is not worth a sentence


def describe_size(times: Floats, total: Floats) -> str:
    """Return a sentence about total volumes over the total rest volume (t,) at times [s]; NaN is left out."""
    known = np.isfinite(total)
    if not known.any():
        return "the volume of the whole body is unknown"
    t, ratio = times[known], total[known]
    when = "at the end" if known[-1] else f"at t = {t[-1]:.4g} s, the last with data,"
    peak = int(np.abs(ratio - 1).argmax())
    text = f"{when} the whole body is {compare_with_rest(ratio[-1])}"
    change, largest = 100 * abs(ratio[-1] - 1), 100 * abs(ratio[peak] - 1)
    if largest > max(_MUCH * change, _VISIBLE):
        return f"{text}; it was {compare_with_rest(ratio[peak])} at t = {t[peak]:.4g} s"
    return text


def compare_with_rest(ratio: float) -> str:
    """Return a ratio of volumes as a comparison with the body at rest."""
    percent = 100 * (ratio - 1)
    if ratio <= 0:
        return f"inverted (its volume is {ratio:.3g} times that at rest)"
    if percent >= 99.5:  # from here on percents hide the size: 900 % larger is 10 times as large
        return f"{ratio:.3g} times as large as at rest"
    if ratio < 0.095:
        return f"only {ratio:.2g} times as large as at rest"
    return f"{abs(percent):.2g} % {'larger' if percent > 0 else 'smaller'} than at rest"
