"""The fields that the frames of a series have: their names, types and shapes, taken over many frames, not from one.

A field that comes later or vanishes is NaN in the other frames, and its type holds the numbers of all of them.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.grid import Grid, LazyArrays, describe_arrays
from pipeline.run.measures import STEPS
from pipeline.series.dataset.field_names import KINDS

_MOST_INLINE, _MOST = 200, 20  # frames that are all looked at: a few ms each, or tens of ms in the other process
_SAMPLE = (0.0, 0.0, 0.5, 1.0)  # parts of the series at which frames are looked at otherwise; the second is frame 1
_WIDEST_EXACT = {8: 2.0**53, 4: 2.0**24}  # bytes of a floating type: all integers up to this are exact


class FieldForm(NamedTuple):
    """A field as it is in the files: its kind (point, cell, field), its name there, type and shape in one frame.

    `shape` is that of one node's or cell's value, or the whole one of numbers of the body. `complete` says whether all
    frames looked at have the field.
    """

    kind: str
    source: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    complete: bool


def choose_frames(count: int, first: Grid, largest: int) -> list[int]:
    """Return the frames to look at: all if they are few and can be kept in `largest` bytes, else a sample."""
    most = _MOST_INLINE if isinstance(first.point_data, LazyArrays) else _MOST
    if count <= most and count * first.nbytes <= largest:
        return list(range(count))
    return sorted({min(round(part * (count - 1)) + (k == 1), count - 1) for k, part in enumerate(_SAMPLE)})


def list_forms(frames: Iterable[tuple[str, Grid]]) -> tuple[list[FieldForm], list[str]]:
    """Return the fields of some frames (file, content), and notes on those that cannot be in a table.

    Points come first, then cells, then numbers of the body, each in the order of the files.
    """
    found: dict[tuple[str, str], list[tuple[str, np.dtype[Any], tuple[int, ...]]]] = defaultdict(list)
    count = 0
    for file, grid in frames:
        count += 1
        for kind in KINDS:
            for name, (dtype, shape) in describe_arrays(getattr(grid, f"{kind}_data")).items():
                found[kind, name].append((file, dtype, _strip_shape(kind, name, shape)))
    forms, notes = [], list[str]()
    for (kind, name), seen in sorted(found.items(), key=lambda item: list(KINDS).index(item[0][0])):
        text = f"the {KINDS[kind]} {shorten(name)}"
        strange = sorted({dtype.kind for _, dtype, _ in seen} - set("fiu"))
        other = next(((file, shape) for file, _, shape in seen if shape != seen[0][2]), None)
        if kind == "field" and seen[0][1] == np.int8 and seen[0][2] != ():
            notes.append(f"{text} is left out: it holds characters")
        elif strange:
            notes.append(f"{text} is left out: it holds {'texts' if set(strange) <= set('SUO') else 'no numbers'}")
        elif other:
            notes.append(
                f"{text} is left out: its shape changes, from {seen[0][2]} in {seen[0][0]} to {other[1]} in {other[0]}"
            )
        else:
            complete = len(seen) == count
            forms.append(
                FieldForm(kind, name, _promote([t for _, t, _ in seen], complete=complete), seen[0][2], complete)
            )
    return forms, notes


def _strip_shape(kind: str, name: str, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of one node's or cell's value; a single number of the body has the shape ()."""
    if kind != "field":
        return shape[1:]
    size = int(np.prod(shape, dtype=np.int64))
    return () if size == 1 and name not in STEPS else (size,)


def _promote(types: Sequence[np.dtype[Any]], *, complete: bool) -> np.dtype[Any]:
    """Return the type that holds the numbers of all; a field that some frames lack needs NaN, so a floating one."""
    dtype = np.result_type(*(one.newbyteorder("=") for one in types))
    return dtype if complete or dtype.kind == "f" else np.dtype(np.float64)


def fit_value(value: NDArray[Any] | None, form: FieldForm, shape: tuple[int, ...], where: str) -> NDArray[Any]:
    """Return a value of one frame in the type of the table, NaN if the frame has none (None).

    Raises SeriesError if the value does not fit: another shape, or numbers that the type of the table cannot hold.
    """
    text = f"{where}: the {KINDS[form.kind]} {shorten(form.source)}"
    remedy = "scan_all = True looks at all frames when the series is opened"
    if value is None:
        if form.dtype.kind != "f":
            raise SeriesError(f"{text} is missing, and integers have no NaN: {remedy}")
        return np.full(shape, np.nan, dtype=form.dtype)
    if value.shape != shape:
        raise SeriesError(
            f"{text} has shape {value.shape}, in the frames looked at {shape}: drop_variables leaves it out"
        )
    if value.dtype == form.dtype:
        return value
    if value.dtype.kind not in "fiu":
        raise SeriesError(f"{text} holds no numbers, unlike in the frames looked at")
    with np.errstate(all="ignore"):
        fitted = value.astype(form.dtype)
    if not _is_equal(value, fitted):
        raise SeriesError(f"{text} is {value.dtype}, and {form.dtype} cannot hold all its numbers: {remedy}")
    return fitted


def _is_equal(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Return whether a conversion of numbers from `a` to `b` changed none of them."""
    if np.can_cast(a.dtype, b.dtype, "safe") and not (a.dtype.kind in "iu" and b.dtype.kind == "f"):
        return True
    if b.dtype.kind == "f" and a.dtype.kind in "iu":
        limit = _WIDEST_EXACT.get(b.dtype.itemsize, 2.0**11)
        return bool(a.size == 0 or (float(a.max()) <= limit and float(a.min()) >= -limit))
    if a.dtype.kind == "f":
        return bool(np.array_equal(b.astype(a.dtype), a, equal_nan=b.dtype.kind == "f"))
    return bool((b.astype(a.dtype) == a).all() and ((a < 0) == (b < 0)).all())


def describe_missing(forms: Iterable[FieldForm]) -> list[str]:
    """Return a note on the fields that some of the frames do not have."""
    names = [form.source for form in forms if not form.complete]
    return [f"not in all frames, NaN in the others: {join_names(names)}"] if names else []
