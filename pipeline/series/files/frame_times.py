"""Times of frames that an index or their files give as equal: better times or their order distinguish them."""

from collections.abc import Callable, Sequence
from itertools import pairwise

from pipeline.errors import shorten
from pipeline.formats.times import find_resolution


def spread_times(
    times: Sequence[float], texts: Sequence[str], read: Callable[[int], Sequence[float]]
) -> tuple[list[float], list[str]]:
    """Return strictly increasing times [s] for times in order of which some are equal, and notes.

    `read` returns the times in the file of a frame, which are taken if they tell the frames apart. Frames that all have
    one time are counted from 0. Others lie evenly between their time and the least that would be rounded to another.
    """
    runs = _find_runs(times)
    if all(end - start == 1 for start, end in runs):
        return list(times), []
    own = _read_own_times(times, runs, read)
    if own is not None:
        return own, ["frames of equal times are told apart by the times in their files"]
    if len(runs) == 1:
        return [float(i) for i in range(len(times))], [
            f"all frames have the time {times[0]:g} s: they are counted from 0"
        ]
    new, notes = list(times), list[str]()
    for start, end in runs:
        if end - start > 1:
            limit = times[end] if end < len(times) else float("inf")
            before = times[start - 1] if start else float("-inf")
            step = _find_step(times[start], texts[start], end - start, before, limit)
            new[start:end] = [times[start] + k * step for k in range(end - start)]
            text = shorten(texts[start]) or f"{times[start]:g}"
            notes.append(
                f"{end - start} frames have the time {text}, as if it had been rounded: their times are taken as "
                f"{new[start]:.9g} to {new[end - 1]:.9g} s in equal steps"
            )
    return new, notes if len(notes) <= 5 else [*notes[:5], f"and {len(notes) - 5} more times of several frames"]


def _find_runs(times: Sequence[float]) -> list[tuple[int, int]]:
    """Return the first frame of each time and the end."""
    starts = [i for i, time in enumerate(times) if not i or time != times[i - 1]]
    return list(zip(starts, [*starts[1:], len(times)], strict=True))


def _read_own_times(
    times: Sequence[float], runs: Sequence[tuple[int, int]], read: Callable[[int], Sequence[float]]
) -> list[float] | None:
    """Return the times with those of the files if they tell frames of equal times apart and keep the order."""
    new = list(times)
    for start, end in runs:
        for i in range(start, end) if end - start > 1 else ():
            own = read(i)
            if len(own) != 1:
                return None
            new[i] = own[0]
    return new if all(a < b for a, b in pairwise(new)) else None


def _find_step(time: float, text: str, count: int, before: float, limit: float) -> float:
    """Return the step [s] between `count` frames of one time, so that they stay before the limit."""
    half = find_resolution(text or repr(time)) / 2
    room = min(half, limit - time)
    if room <= abs(time) * 1e-12 * count:  # all digits are written, so the times were not rounded
        room = min(limit - time, time - before) if before > float("-inf") else limit - time
    return room / count
