"""Instants of the entries of an index, or of numbered files: files of one time are parts, or frames of rounded times.

Attributes, names, numbers and, at last, the cells and places of the bodies in the files decide. If these do not, the
caller is asked. A restart replaces the frames after its begin. Every decision is a note.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from filecmp import cmp as is_same_content
from itertools import combinations, pairwise
from pathlib import Path
from typing import NamedTuple

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.bodies import are_apart
from pipeline.formats.grid import Grid, have_same_cells
from pipeline.formats.pvd import IndexEntry
from pipeline.series.files.file_names import list_numbers, make_natural_key, make_template, read_decimals
from pipeline.series.files.frame_files import find_fault, read_grid, read_times
from pipeline.series.files.frame_times import spread_times
from pipeline.series.files.numbered import find_numbered_parts

_ROUNDING = 1e-5  # of the time between two instants: parts may write their times with seven digits
_MOST_READ = 8  # files of one time that are compared


class Member(NamedTuple):
    """One instant: its time [s], its file and the step in it; `others` are files of further parts of the body."""

    time: float
    file: Path
    step: int = 0
    others: tuple[Path, ...] = ()


_Parts = list[tuple[str, ...]]  # the part of the body that each entry is
_Groups = list[list[int]]  # entries of one time and part
_Rule = Callable[[Sequence[IndexEntry], _Groups, str], _Parts | None]


class Instants(NamedTuple):
    """Instants in order of time, notes on decisions, and faults of instants that were left out."""

    members: list[Member]
    notes: list[str]
    faults: list[str]


def arrange_instants(entries: Sequence[IndexEntry], where: str) -> Instants:
    """Return the instants of entries; raises SeriesError if the evidence does not decide."""
    times = [entry.time for entry in entries]
    aligned, parts, notes = _align_times(entries, where)
    if not parts:
        _check_declared(entries, where)
        if all(a < b for a, b in pairwise(times)):  # the usual case
            return Instants([Member(entry.time, entry.file, entry.step) for entry in entries], [], [])
        parts, notes = _find_parts(entries, where)
    entries = aligned
    kept, restart_notes = _drop_replaced(entries, parts, where)
    instants, repeat_notes = _drop_repeated(entries, _group_instants(entries, parts, kept, where))
    instants, faults = _drop_incomplete(entries, parts, instants)
    if len(set(parts)) > 1:
        _check_parts(entries, parts, instants)
    in_order = sorted(instants, key=lambda own: entries[own[0]].time)
    if in_order != instants:
        notes.append("the times were not in order; the frames were sorted by time")
    firsts = [entries[own[0]] for own in in_order]
    new_times, time_notes = spread_times(
        [entry.time for entry in firsts], [entry.text for entry in firsts], lambda i: read_times(firsts[i].file).values
    )
    members = [
        Member(time, entries[own[0]].file, entries[own[0]].step, tuple(entries[i].file for i in own[1:]))
        for time, own in zip(new_times, in_order, strict=True)
    ]
    return Instants(members, [*notes, *restart_notes, *repeat_notes, *time_notes], faults)


def _align_times(entries: Sequence[IndexEntry], where: str) -> tuple[Sequence[IndexEntry], _Parts, list[str]]:
    """Return entries with one time for all parts of an instant if their times differ by rounding, the parts and notes.

    The times lie in groups of equal size, each far shorter than the time to the next. No parts: the times are right.
    """
    times = sorted(entry.time for entry in entries)
    gaps = [b - a for a, b in pairwise(times)]
    widest = max(gaps, default=0.0)
    firsts = [0, *(i + 1 for i, gap in enumerate(gaps) if gap > _ROUNDING * widest)]
    size = len(times) // len(firsts) if firsts else 0
    if size < 2 or len(firsts) < 2 or min(gaps) == 0 or firsts != list(range(0, len(times), size)):
        return entries, [], []
    group = {time: times[i - i % size] for i, time in enumerate(times)}
    aligned = [entry._replace(time=group[entry.time]) for entry in entries]
    parts, notes = _find_parts(aligned, where)
    if len(set(parts)) < 2:
        return entries, [], []
    return aligned, parts, [*notes, "the times of the parts differ by rounding; the first of each group is taken"]


def _check_declared(entries: Sequence[IndexEntry], where: str) -> None:
    """Raise SeriesError if an index has several parts, each at several times, but never two at one time.

    A part that occurs once is none: some programs count frames there.
    """
    counts = Counter(entry.part for entry in entries)
    if len(counts) < 2 or min(counts.values()) < 2:
        return
    if len({entry.time for entry in entries}) == len(entries):
        raise SeriesError(
            f"{where}: it lists {len(counts)} parts (group, part), but never two at one time: frames of one body, or "
            "parts whose times differ by rounding? Give parts equal times, or frames one part"
        )


def _find_parts(entries: Sequence[IndexEntry], where: str) -> tuple[_Parts, list[str]]:
    """Return the part of the body that each entry is, and notes: entries of one time are different parts, or frames."""
    parts: _Parts = [()] * len(entries)
    notes = list[str]()
    rules: tuple[tuple[str, _Rule], ...] = (
        ("", _take_declared),
        (", by their names", _take_templates),
        (", by a number in their names", _take_number),
        (", by their cells and places", _take_order),
    )
    for evidence, rule in rules:
        groups = _group_equal(entries, parts)
        if not groups:
            break
        more = rule(entries, groups, where)
        if more is not None:
            parts = [(*own, *further) for own, further in zip(parts, more, strict=True)]
            count = len(set(parts))
            notes.append(f"the files of one time are {count} parts of the body{evidence}")
    return parts, notes


def _group_equal(entries: Sequence[IndexEntry], parts: _Parts) -> _Groups:
    """Return the entries of equal time and part, two or more each, in order of the first."""
    groups = defaultdict[tuple[float, tuple[str, ...]], list[int]](list)
    for i, (entry, part) in enumerate(zip(entries, parts, strict=True)):
        groups[entry.time, part].append(i)
    return [own for own in groups.values() if len({(entries[i].file, entries[i].step) for i in own}) > 1]


def _take_declared(entries: Sequence[IndexEntry], groups: _Groups, _where: str) -> _Parts | None:
    """Return the attributes group and part of the index if they differ within a time."""
    differ = any(len({entries[i].part for i in own}) > 1 for own in groups)
    return [entry.part for entry in entries] if differ else None


def _take_templates(entries: Sequence[IndexEntry], groups: _Groups, _where: str) -> _Parts | None:
    """Return the names without numbers if they differ within a time."""
    names: _Parts = [(make_template(entry.file.as_posix()),) for entry in entries]
    return names if any(len({names[i] for i in own}) > 1 for own in groups) else None


def _take_number(entries: Sequence[IndexEntry], groups: _Groups, where: str) -> _Parts | None:
    """Return the number in the names that takes the same values at all times, for each value of the other numbers.

    If there is only one time, the cells and places of the bodies decide between numbers. Raises SeriesError if they
    do not.
    """
    files = [entry.file for entry in entries]
    if len({entries[own[0]].time for own in groups}) == 1:
        if len(groups) > 1 or len(groups[0]) < len(entries):
            return None
        found, _ = find_numbered_parts(Path(where), files, {file for file in files if find_fault(file)})
        return None if found is None else [(str(part),) for _, part in found]
    numbers = list_numbers(files)
    fitting = list[int]()
    for k in range(len(numbers[0])):
        values = defaultdict[tuple[int, tuple[int, ...]], list[int]](list)
        for n, i in ((n, i) for n, own in enumerate(groups) for i in own):
            values[n, (*numbers[i][:k], *numbers[i][k + 1 :])].append(numbers[i][k])
        sets = {tuple(sorted(own)) for own in values.values()}
        if len(sets) == 1 and len(set(own := sets.pop())) == len(own) > 1:
            fitting.append(k)
    if len(fitting) > 1:
        raise SeriesError(
            f"{where}: several numbers in the names, such as {shorten(files[-1].name)}, may be that of a part: number "
            'the parts in the index (part="0", part="1")'
        )
    return [(str(own[fitting[0]]),) for own in numbers] if fitting else None


def _take_order(entries: Sequence[IndexEntry], groups: _Groups, where: str) -> _Parts | None:
    """Return the order within a time if the cells or the places of the bodies show that the files are parts.

    None if they are frames of one body. Raises SeriesError if neither is clear.
    """
    groups = [own for own in groups if own == list(range(own[0], own[0] + len(own)))]  # others: a restart
    if not groups:
        return None
    first = groups[0][:_MOST_READ]
    if any(find_fault(entries[i].file) for i in first):
        return None  # reported later
    grids = [read_grid(entries[i].file, entries[i].step) for i in first]
    apart = all(are_apart(a, b) for a, b in combinations(grids, 2))
    same = all(have_same_cells(grids[0], grid) for grid in grids[1:])
    uniform = len({len(own) for own in groups}) == 1 and sum(map(len, groups)) == len(entries)
    if same and not (apart and uniform):
        return None
    recurs = _recur(entries, groups, grids)
    if uniform and (recurs if len(groups) > 1 else apart and not same):
        order = {i: (str(k),) for own in groups for k, i in enumerate(own)}
        return [order[i] for i in range(len(entries))]
    names = join_names(entries[i].file.name for i in first)
    raise SeriesError(
        f"{where}: {names} have the time {entries[first[0]].time:g} s: parts of a body, or frames whose time was "
        'rounded? Number parts in the index (part="0", part="1"), or write times with more digits'
    )


def _recur(entries: Sequence[IndexEntry], groups: _Groups, grids: Sequence[Grid]) -> bool:
    """Return whether the files of the next time have the cells of those of the first time, in their order."""
    if len(groups) < 2:
        return False
    nexts = [entries[i] for i in groups[1][: len(grids)]]
    if any(find_fault(entry.file) for entry in nexts):
        return False
    return all(have_same_cells(read_grid(e.file, e.step), g) for e, g in zip(nexts, grids, strict=True))


def _drop_replaced(entries: Sequence[IndexEntry], parts: _Parts, where: str) -> tuple[list[int], list[str]]:
    """Return the entries that no restart replaced, in order, and a note; raises SeriesError if two runs follow.

    In an index that lists all parts of a time together, a restart of one part is that of all.
    """
    places = defaultdict[tuple[str, ...], list[int]](list)
    for i, part in enumerate(parts):
        places[part].append(i)
    restarting = {part for part, own in places.items() if _has_restart(entries, own)}
    if not restarting:
        return list(range(len(entries))), []
    pairs = pairwise(zip(entries, parts, strict=True))
    together = any(a.time == b.time and part != other for (a, part), (b, other) in pairs)
    kept = defaultdict[tuple[str, ...], list[int]](list)
    for i, (entry, part) in enumerate(zip(entries, parts, strict=True)):
        own = kept[part]
        if part in restarting and own and entry.time < entries[own[-1]].time:
            for other in list(kept.values()) if together else [own]:
                while other and entries[other[-1]].time >= entry.time:
                    other.pop()
            if not own and entry.file not in {entries[k].file for k in places[part] if k < i}:
                raise SeriesError(
                    f"{where}: the times begin again with {entry.time:g} s at {shorten(entry.file.name)}: two runs, or "
                    "two steps of an analysis; name the files of one by a pattern, or write an index of its own"
                )
        own.append(i)
    left = sorted(i for own in kept.values() for i in own)
    note = f"the times go back, as after a restart: {len(entries) - len(left)} files that it replaced were left out"
    return left, [note]


def _drop_repeated(entries: Sequence[IndexEntry], instants: list[list[int]]) -> tuple[list[list[int]], list[str]]:
    """Return the instants without those whose time and content are those of the next, and a note."""
    ends = [*instants[1:], []]
    unique = [
        own for own, following in zip(instants, ends, strict=True)
        if len(own) != len(following)
        or not all(_is_repeated(entries[i], entries[k]) for i, k in zip(own, following, strict=True))
    ]  # fmt: skip
    if len(unique) == len(instants):
        return instants, []
    count = len(instants) - len(unique)
    return unique, [f"{count} frames have the time and the content of the next one and were left out"]


def _is_repeated(entry: IndexEntry, following: IndexEntry) -> bool:
    """Return whether the next entry has the same time and content."""
    if entry.time != following.time or entry.step != following.step:
        return False
    if entry.file == following.file:
        return True
    try:
        return is_same_content(entry.file, following.file, shallow=False)
    except OSError:  # reported later
        return False


def _has_restart(entries: Sequence[IndexEntry], own: list[int]) -> bool:
    """Return whether times that go back are those of a restart: a time recurs, or the names are in order."""
    times = [entries[i].time for i in own]
    if all(a <= b for a, b in pairwise(times)) or all(a > b for a, b in pairwise(times)):
        return False
    changes = [t for t, last in zip(times, [None, *times], strict=False) if t != last]
    if len(set(changes)) < len(changes):
        return True
    files = [entries[i].file for i in own]
    decimals = read_decimals(files)
    if decimals is not None:
        return all(a < b for a, b in pairwise(decimals))
    return all(a < b for a, b in pairwise(map(make_natural_key, files)))


def _group_instants(entries: Sequence[IndexEntry], parts: _Parts, kept: list[int], where: str) -> list[list[int]]:
    """Return the entries of each instant, its parts in their order: the k-th of each part at a time go together.

    Raises SeriesError if parts occur at a time more or less often than others.
    """
    order = {part: k for k, part in enumerate(dict.fromkeys(parts))}
    seen = defaultdict[float, Counter[tuple[str, ...]]](Counter)
    instants = defaultdict[tuple[float, int], list[int]](list)
    for i in kept:
        counts = seen[entries[i].time]
        instants[entries[i].time, counts[parts[i]]].append(i)
        counts[parts[i]] += 1
    unclear = next((time for time, counts in seen.items() if len(set(counts.values())) > 1), None)
    if unclear is not None:
        raise SeriesError(
            f"{where}: at t = {unclear:g} s some parts of the body occur more often than others, as after a restart: "
            "it is not clear which belong together; remove the older ones from the index"
        )
    return [sorted(own, key=lambda i: order[parts[i]]) for own in instants.values()]


def _drop_incomplete(
    entries: Sequence[IndexEntry], parts: _Parts, instants: list[list[int]]
) -> tuple[list[list[int]], list[str]]:
    """Return the instants without those that lack a part which others before and after have, or which end the list."""
    present = [{parts[i] for i in own} for own in instants]
    first = {part: min(k for k, own in enumerate(present) if part in own) for part in set().union(*present)}
    last = {part: max(k for k, own in enumerate(present) if part in own) for part in first}
    end = len(instants) - 1
    whole, faults = list[list[int]](), list[str]()
    for k, own in enumerate(instants):
        # another part may begin or end for good: then the mesh changes
        ends = {p for p in first if k == end == last[p] + 1}
        lacking = ends | {p for p in first if first[p] < k < last[p]} - present[k]
        if lacking:
            count = len(present[k] | lacking)
            faults.append(f"t = {entries[own[0]].time:g} s has {len(own)} of {count} parts of the body")
        else:
            whole.append(own)
    return whole, faults


def _check_parts(entries: Sequence[IndexEntry], parts: _Parts, instants: list[list[int]]) -> None:
    """Raise SeriesError if parts of an instant are the same body in almost the same place."""
    checked = set[frozenset[tuple[str, ...]]]()
    for own in instants:
        combination = frozenset(parts[i] for i in own)
        if len(own) < 2 or combination in checked or len(checked) >= _MOST_READ:
            continue
        if any(find_fault(entries[i].file) for i in own):
            continue
        checked.add(combination)
        read_grid(entries[own[0]].file, entries[own[0]].step, others=tuple(entries[i].file for i in own[1:]))
        grids = [(entries[i].file.name, read_grid(entries[i].file, entries[i].step)) for i in own[:_MOST_READ]]
        for (name, a), (other, b) in combinations(grids, 2):
            if have_same_cells(a, b) and not are_apart(a, b) and not (a.points == b.points).all():
                raise SeriesError(
                    f"{entries[own[0]].file.parent}: {shorten(name)} and {shorten(other)} at t = "
                    f"{entries[own[0]].time:g} s are the same body in almost the same place, not parts of one: name "
                    "the files of one series by a pattern, or write true parts as one grid"
                )
