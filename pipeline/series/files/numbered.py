"""Entries of numbered files: their order and times from names and contents, and the parts of a body among them."""

from collections import Counter
from collections.abc import Sequence
from os.path import normpath
from pathlib import Path
from typing import NamedTuple

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.bodies import are_apart
from pipeline.formats.grid import have_same_cells
from pipeline.formats.pvd import IndexEntry
from pipeline.formats.readers import SUFFIXES
from pipeline.series.files.file_names import list_numbers, make_natural_key, make_template, read_decimals
from pipeline.series.files.frame_files import FileTimes, find_fault, find_pieces, read_grid, read_times


class NumberedEntries(NamedTuple):
    """Entries of files, notes on decisions, and files that cannot be read."""

    entries: list[IndexEntry]
    notes: list[str]
    faulty: list[Path]


def list_numbered(where: Path, candidates: Sequence[Path]) -> NumberedEntries:
    """Return the entries of numbered files; raises SeriesError if they are several series or it is not clear."""
    files = _select_files(where, candidates)
    faulty = [file for file in files if find_fault(file) is not None]
    whole = [file for file in files if file not in set(faulty)] if faulty else files
    if not whole:
        return NumberedEntries([], [], faulty)
    times = [read_times(file) for file in whole]
    if any(len(own.values) > 1 for own in times):
        return NumberedEntries(*_list_steps(where, whole, times), faulty)
    known = [own.values[0] for own in times if own.values]
    if known and len(known) < len(whole):
        lacking = next(file for file, own in zip(whole, times, strict=True) if not own.values)
        raise SeriesError(
            f"{where}: {len(known)} files have a time (TimeValue), but {shorten(lacking.name)} has none; write an "
            "index (.pvd) with the times"
        )
    if known and (len(set(known)) > 1 or len(known) == 1):
        entries = [IndexEntry(time, file) for time, file in zip(known, whole, strict=True)]
        return NumberedEntries(entries, _name_fields(times), faulty)
    # counted with those that cannot be read, which are left out later, so that the others keep their numbers
    return NumberedEntries(*_count_frames(where, files, set(faulty), bool(known)), [])


def _select_files(where: Path, candidates: Sequence[Path]) -> list[Path]:
    """Return the files of one series in order; raises SeriesError if there are none or those of several series."""
    visible = [file for file in candidates if not file.name.startswith(".")]
    files = _drop_pieces(visible)
    if not files:
        raise SeriesError(f"{where}: no series there: no index and no {', '.join(SUFFIXES)} file")
    patterns = Counter(make_template(file.name) for file in sorted(files))
    if len(patterns) > 1:
        choices = join_names(f"{pattern} ({count})" for pattern, count in patterns.items())
        raise SeriesError(f"{where}: holds several series; give a pattern: {choices}")
    files.sort(key=make_natural_key)
    decimals = read_decimals(files)
    return files if decimals is None else [file for _, file in sorted(zip(decimals, files, strict=True))]


def _drop_pieces(files: Sequence[Path]) -> list[Path]:
    """Return the files without the pieces of others among them."""
    pieces = {normpath(piece) for file in files for piece in find_pieces(file)}
    return [file for file in files if normpath(file) not in pieces] or list(files)  # a file may name itself


def _list_steps(where: Path, files: Sequence[Path], times: Sequence[FileTimes]) -> tuple[list[IndexEntry], list[str]]:
    """Return the entries of files with several steps each."""
    if not all(own.values for own in times):
        raise SeriesError(f"{where}: some of its files have several times, others none; give a pattern")
    entries = [IndexEntry(t, f, step) for f, own in zip(files, times, strict=True) for step, t in enumerate(own.values)]
    return entries, [f"each file holds several steps: {len(entries)} in all"] if len(files) > 1 else []


def _name_fields(times: Sequence[FileTimes]) -> list[str]:
    """Return a note on the fields that hold the times if they have other names than TimeValue."""
    names = dict.fromkeys(own.field for own in times if own.field)
    return [f"the times are the field {join_names(names)} of the files"] if names else []


def _count_frames(
    where: Path, files: list[Path], faulty: set[Path], have_times: bool
) -> tuple[list[IndexEntry], list[str]]:
    """Return the entries of files without times that differ: counted, or at the times in their names."""
    parts, notes = find_numbered_parts(where, files, faulty)
    if parts is not None:
        numbers = {number: float(i) for i, number in enumerate(sorted({number for number, _ in parts}))}
        entries = [
            IndexEntry(numbers[number], file, part=(str(part),))
            for (number, part), file in zip(parts, files, strict=True)
        ]
        return entries, [*notes, "the files have no times; frames are counted from 0"]
    decimals = read_decimals(files)
    if decimals is not None:
        note = f"the numbers in the names are taken as the times: {decimals[0]:g} to {decimals[-1]:g} s"
        return [IndexEntry(time, file) for time, file in zip(decimals, files, strict=True)], [note]
    reason = "all files have the same time" if have_times else "the files have no times"
    entries = [IndexEntry(float(i), file) for i, file in enumerate(files)]
    return entries, [*notes, f"{reason}; frames are counted from 0"] if len(files) > 1 else []


def find_numbered_parts(
    where: Path, files: Sequence[Path], faulty: set[Path]
) -> tuple[list[tuple[int, int]] | None, list[str]]:
    """Return the numbers of the frame and the part of each file, None if the files are frames of one body, and a note.

    Two numbers that vary by themselves may be those of time and part: the cells and places of bodies decide.
    """
    numbers = list_numbers(files)
    width = len(numbers[0])
    if width < 2 or any(len({own[k] for own in numbers}) == len(files) for k in range(width)):
        return None, []  # one number distinguishes all files
    if width > 2:
        whole = [file for file in files if file not in faulty]
        if _are_frames(whole[0], whole[min(1, len(whole) - 1)]) and _are_frames(whole[0], whole[-1]):
            return None, []
        raise SeriesError(
            f"{where}: {width} numbers vary in the names, such as {shorten(files[-1].name)}, and the files are not "
            "frames of one body: give a pattern that lets one of them vary"
        )
    by_first, by_second = (_find_pair(files, numbers, faulty, k) for k in (0, 1))
    frames = [pair is None or _are_frames(*pair) for pair in (by_first, by_second)]
    if all(frames):
        return None, [f"two numbers vary in the names; {files[0].name} and the others are frames of one body"]
    if not any(frames):
        raise SeriesError(
            f"{where}: two numbers vary in the names, such as {shorten(files[-1].name)}, and it is not clear which is "
            "the part: give a pattern for one part, or write an index (.pvd) with times and parts"
        )
    time, part = (0, 1) if frames[0] else (1, 0)
    name = ("first", "second")[part]
    note = f"the {name} of the numbers in the names is that of a part of the body: the cells or places differ"
    return [(own[time], own[part]) for own in numbers], [note]


def _find_pair(
    files: Sequence[Path], numbers: Sequence[tuple[int, ...]], faulty: set[Path], k: int
) -> tuple[Path, Path] | None:
    """Return two files whose names differ in the k-th number only, None if there are none."""
    found = dict[tuple[int, ...], Path]()
    for file, own in zip(files, numbers, strict=True):
        rest = (*own[:k], *own[k + 1 :])
        if file in faulty:
            continue
        if rest in found:
            return found[rest], file
        found[rest] = file
    return None


def _are_frames(first: Path, second: Path) -> bool:
    """Return whether two files have the same cells in places that overlap."""
    a, b = read_grid(first), read_grid(second)
    return have_same_cells(a, b) and not are_apart(a, b)
