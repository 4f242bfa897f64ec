"""The instants that a path names: those of an index, of numbered files in a folder, or of one file with many steps."""

import re
from collections import defaultdict
from collections.abc import Iterable
from glob import has_magic
from os.path import exists, isdir  # pathlib's versions raise if a name is longer than the system allows
from pathlib import Path
from typing import NamedTuple

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.pvd import INDEX_SUFFIXES, read_index
from pipeline.formats.readers import SUFFIXES, is_temporal
from pipeline.series.frame_files import find_fault, read_times
from pipeline.series.run_folder import find_unlisted_frames, is_own

_OWN = ("series.pvd", "series.vtkhdf")


class Member(NamedTuple):
    """One instant: its time [s], its file and the step in it; `others` are files of further parts of the body."""

    time: float
    file: Path
    step: int = 0
    others: tuple[Path, ...] = ()


class FrameListing(NamedTuple):
    """The instants that can be read, in order of time, and notes on the others."""

    name: str
    folder: Path
    members: tuple[Member, ...]
    notes: tuple[str, ...]
    ours: bool = False


def list_frames(path: Path, *, strict: bool) -> FrameListing:
    """Return the frames of a path; raises SeriesError if there are none or, with `strict`, if any is missing."""
    index = _find_index(path)
    members, notes = _list_members(index)
    ours = index.name in _OWN and is_own(index.parent, tuple(member.file for member in members))
    if ours and index.suffix == ".pvd":
        members += [Member(*frame) for frame in find_unlisted_frames(index.parent, len(members))]
    members, faults = _drop_faulty(members)
    if faults and strict:
        raise SeriesError(f"{index}: {len(faults)} frames cannot be read, first {faults[0]}")
    notes += [f"left out: {text}" for text in faults]
    if not members:
        raise SeriesError(f"{index}: none of its frames can be read: {faults[0]}")
    in_order = sorted(members, key=lambda member: member.time)
    if in_order != members:
        notes.append("the times were not in order; the frames were sorted by time")
    last = {member.time: member for member in in_order}
    if len(last) < len(in_order):
        notes.append(f"{len(in_order) - len(last)} frames have the time of a later one and were left out")
    bad = [time for time in last if not abs(time) < float("inf")]
    if bad:
        raise SeriesError(f"{index}: the time {bad[0]} is not a number")
    name, folder = _choose_name(index)
    return FrameListing(name, folder, tuple(last.values()), tuple(notes), ours)


def _choose_name(index: Path) -> tuple[str, Path]:
    """Return the name and the folder of a series: our own indices, patterns and folders take the folder's name."""
    if index.is_dir():
        return index.resolve().name, index
    folder = index.parent
    if index.suffix == ".pvd" or index.name == "series.vtkhdf":
        return folder.resolve().name, folder
    return (folder.resolve().name if has_magic(index.name) else index.name.split(".")[0]), folder


def _find_index(path: Path) -> Path:
    """Return the index in a folder if there is one, else the path itself."""
    if not isdir(path):
        return path
    for name in _OWN:
        if (path / name).exists():
            return path / name
    indices = sorted(file for file in path.iterdir() if file.suffix in INDEX_SUFFIXES or is_temporal(file))
    if len(indices) > 1:
        raise SeriesError(f"{path}: holds several series; name one of {join_names(file.name for file in indices)}")
    return indices[0] if indices else path


def _list_members(index: Path) -> tuple[list[Member], list[str]]:
    if isdir(index):
        return _list_numbered(index, (file for file in index.iterdir() if file.suffix in SUFFIXES))
    if has_magic(str(index)) and not exists(index):
        base = Path(index.anchor) if index.is_absolute() else Path()
        return _list_numbered(index, base.glob(str(index.relative_to(base) if index.is_absolute() else index)))
    if not exists(index):
        raise SeriesError(f"{index}: no series there (No such file or directory)")
    if index.suffix in INDEX_SUFFIXES:
        return [Member(time, file) for time, file in read_index(index)], []
    if is_temporal(index):
        times = read_times(index) or [0.0]
        return [Member(time, index, step) for step, time in enumerate(times)], []
    return _list_numbered(index, [index])


def _list_numbered(where: Path, candidates: Iterable[Path]) -> tuple[list[Member], list[str]]:
    """Return the instants of numbered files in order, and notes; without times of their own they are counted from 0."""
    files = sorted((file for file in candidates if not file.name.startswith(".")), key=_make_natural_key)
    if any(file.suffix == ".pvtu" for file in files):  # the other files are its pieces
        files = [file for file in files if file.suffix == ".pvtu"]
    if not files:
        raise SeriesError(f"{where}: no series there: no index and no {', '.join(SUFFIXES)} file")
    stems = defaultdict[str, int](int)
    for file in files:
        stems[re.sub(r"\d+", "*", file.name)] += 1
    if len(stems) > 1:
        patterns = join_names(f"{stem} ({count})" for stem, count in stems.items())
        raise SeriesError(f"{where}: holds several series; give a pattern: {patterns}")
    times = [read_times(file) if find_fault(file) is None else None for file in files]
    known = [file_times[0] for file_times in times if file_times]
    if len(known) == len(files):
        return [Member(time, file) for time, file in zip(known, files, strict=True)], []
    if not known:
        note = "the files have no times; frames are counted from 0" if len(files) > 1 else ""
        return [Member(float(i), file) for i, file in enumerate(files)], [note] if note else []
    # files that cannot be read have no time either; their faults are reported later
    unknown = [file for file, own in zip(files, times, strict=True) if not own and find_fault(file) is None]
    if unknown:
        raise SeriesError(f"{where}: {len(known)} files have a time (TimeValue), but {unknown[0].name} has none")
    return [Member(own[0] if own else float("nan"), file) for own, file in zip(times, files, strict=True)], []


def _make_natural_key(file: Path) -> list[tuple[int, str]]:
    """Return a key that sorts frame_9 before frame_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", str(file))]


def _drop_faulty(members: list[Member]) -> tuple[list[Member], list[str]]:
    """Return the members whose files are whole, and the fault of each of the others."""
    faults = {file: find_fault(file) for file in {member.file for member in members}}
    if not any(faults.values()):  # the usual case; saves two passes over thousands of frames
        return members, []
    when = {m: f" at t = {m.time:g} s" if m.time == m.time else "" for m in members}
    texts = [f"{shorten(m.file.name)}{when[m]} {faults[m.file]}" for m in members if faults[m.file]]
    return [member for member in members if not faults[member.file]], texts
