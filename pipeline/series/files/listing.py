"""The instants that a path names: those of an index, of numbered files in a folder, or of one file with many steps."""

import re
from collections.abc import Sequence
from glob import has_magic
from os.path import exists, isdir, isfile  # pathlib's versions raise if a name is longer than the system allows
from pathlib import Path
from typing import NamedTuple

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.pvd import INDEX_SUFFIXES, IndexEntry, read_index
from pipeline.formats.readers import SUFFIXES, is_folder, is_temporal
from pipeline.formats.vtu_steps import find_step_times
from pipeline.series.files.file_names import make_template
from pipeline.series.files.frame_files import find_fault, find_pieces, read_times
from pipeline.series.files.instants import Member, arrange_instants
from pipeline.series.files.numbered import list_numbered
from pipeline.series.files.run_folder import find_unlisted_frames, is_own

_OWN = ("series.pvd", "series.vtkhdf")


class FrameListing(NamedTuple):
    """The instants that can be read, in order of time, and notes on the others."""

    name: str
    folder: Path
    members: tuple[Member, ...]
    notes: tuple[str, ...]
    ours: bool = False


class _Found(NamedTuple):
    """Entries, notes, and the faults of files that have no time."""

    entries: list[IndexEntry]
    notes: list[str]
    faults: list[str]


def list_frames(path: Path, *, strict: bool) -> FrameListing:
    """Return the frames of a path; raises SeriesError if there are none or, with `strict`, if any is missing."""
    index = _find_index(path)
    found = _find_entries(index)
    entries = found.entries
    folder_notes = _find_unlisted(path, index, entries) if index.parent == path and index.name not in _OWN else []
    ours = index.name in _OWN and is_own(index.parent, tuple(entry.file for entry in entries))
    if ours and index.suffix == ".pvd":
        entries += [IndexEntry(*frame) for frame in find_unlisted_frames(index.parent, len(entries))]
    bad = next((entry.time for entry in entries if not abs(entry.time) < float("inf")), None)
    if bad is not None:
        raise SeriesError(f"{index}: the time {bad} is not a number")
    members, notes, lacking = arrange_instants(entries, str(index))
    members, faults = _drop_faulty(members)
    faults = [*found.faults, *faults, *lacking]
    if faults and strict:
        raise SeriesError(f"{index}: {len(faults)} frames cannot be read, first {faults[0]}")
    if not members:
        raise SeriesError(f"{index}: none of its frames can be read: {faults[0]}")
    name, folder = _choose_name(index, path)
    left_out = [f"left out: {text}" for text in faults]
    return FrameListing(name, folder, tuple(members), (*left_out, *folder_notes, *found.notes, *notes), ours)


def _choose_name(index: Path, path: Path) -> tuple[str, Path]:
    """Return the name and the folder of a series.

    A folder and our own indices give the folder's name, a pattern the text before what varies, other files their own.
    """
    folder = index if index.is_dir() and not is_folder(index) else index.parent
    if (isdir(path) and not is_folder(path)) or index.name in _OWN:
        return folder.resolve().name, folder
    if has_magic(index.name) and not exists(index):
        beginning = re.split(r"[*?\[]", index.name)[0].rstrip("-_. ")
        return beginning or folder.resolve().name, folder
    stem = index.name.removesuffix(index.suffix)
    if index.suffix.lower() == ".series":  # their names end with two suffixes
        stem = stem.removesuffix(Path(stem).suffix)
    return stem or index.name, folder


def _find_index(path: Path) -> Path:
    """Return the index in a folder if there is one, else the path itself."""
    if not isdir(path) or is_folder(path):
        return path
    for name in _OWN:
        if (path / name).exists():
            return path / name
    indices = sorted(file for file in path.iterdir() if file.suffix.lower() in INDEX_SUFFIXES or is_temporal(file))
    if len(indices) > 1:
        raise SeriesError(f"{path}: holds several series; name one of {join_names(file.name for file in indices)}")
    return indices[0] if indices else path


def _find_unlisted(folder: Path, index: Path, entries: Sequence[IndexEntry]) -> list[str]:
    """Return a note on data files in a folder that its only index does not list, nor the files that it lists."""
    listed = {entry.file.name for entry in entries}
    pieces = {make_template(piece.name) for piece in find_pieces(entries[0].file)}
    others = [file.name for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.name not in listed]
    patterns = sorted({make_template(name) for name in others} - pieces)
    if not patterns:
        return []
    return [f"{index.name} is read; the folder also has files that it does not list: {join_names(patterns)}"]


def _find_entries(index: Path) -> _Found:
    if isdir(index) and not is_folder(index):
        return _number_files(index, [file for file in index.iterdir() if file.suffix.lower() in SUFFIXES])
    if has_magic(str(index)) and not exists(index):
        base = Path(index.anchor) if index.is_absolute() else Path()
        return _number_files(index, list(base.glob(str(index.relative_to(base) if index.is_absolute() else index))))
    if not exists(index):
        raise SeriesError(f"{index}: no series there (No such file or directory)")
    if index.suffix.lower() in INDEX_SUFFIXES:
        return _list_index(index)
    if is_temporal(index):
        times = read_times(index).values or (0.0,)
        return _Found([IndexEntry(time, index, step) for step, time in enumerate(times)], [], [])
    return _number_files(index, [index])


def _number_files(where: Path, candidates: Sequence[Path]) -> _Found:
    entries, notes, faulty = list_numbered(where, candidates)
    return _Found(entries, notes, [f"{shorten(file.name)} {find_fault(file)}" for file in faulty])


def _list_index(index: Path) -> _Found:
    """Return the entries of an index, with times from the files if the index gives none."""
    entries, notes = read_index(index)
    if any(not entry.text for entry in entries):
        entries, more = _find_missing_times(index, entries)
        notes += more
    kinds = {str(entry.file)[-5:]: entry.file for entry in entries}
    if any(is_temporal(file) or _has_steps(file) for file in (entries[0].file, *kinds.values())):
        entries = [_find_step(entry) for entry in entries]
    return _Found(entries, notes, [])


def _has_steps(file: Path) -> bool:
    """Return whether a .vtu or .vtp holds several steps."""
    return file.suffix.lower() in (".vtu", ".vtp") and isfile(file) and find_step_times(file) is not None


def _find_missing_times(index: Path, rows: Sequence[IndexEntry]) -> tuple[list[IndexEntry], list[str]]:
    """Return the entries of rows of which some have no time, and a note; raises SeriesError if the files have none."""
    lacking = [row for row in rows if not row.text]
    own = [read_times(row.file).values if find_fault(row.file) is None else () for row in lacking]
    if all(len(values) == 1 for values in own):
        times = dict(zip(map(id, lacking), (values[0] for values in own), strict=True))
        note = f"the index has no time for {len(lacking)} files; those in the files are taken"
    elif len(lacking) == len(rows) and not any(own):
        times = dict.fromkeys(map(id, lacking), 0.0)
        note = "the index has no times, nor have its files"
    else:
        first = next(row.file.name for row, values in zip(lacking, own, strict=True) if len(values) != 1)
        raise SeriesError(f"{index}: it gives no time (timestep) for {shorten(first)}, nor is one in the file; add it")
    return [row if row.text else row._replace(time=times[id(row)]) for row in rows], [note]


def _find_step(entry: IndexEntry) -> IndexEntry:
    """Return the entry with the step of its file that has its time, if the file holds a whole series."""
    if not (is_temporal(entry.file) or _has_steps(entry.file)) or find_fault(entry.file) is not None:
        return entry
    times = read_times(entry.file).values
    if len(times) < 2:
        return entry
    step = min(range(len(times)), key=lambda i: abs(times[i] - entry.time))
    if abs(times[step] - entry.time) > 1e-6 * max(abs(times[-1] - times[0]), abs(entry.time)):
        raise SeriesError(f"{entry.file}: it has {len(times)} steps, none of them at t = {entry.time:g} s")
    return entry._replace(step=step)


def _drop_faulty(members: list[Member]) -> tuple[list[Member], list[str]]:
    """Return the members whose files are whole, and the fault of each of the others."""
    files = {file for member in members for file in (member.file, *member.others)}
    faults = {file: find_fault(file) for file in files}
    if not any(faults.values()):  # the usual case; saves two passes over thousands of frames
        return members, []
    whole, texts = list[Member](), list[str]()
    for member in members:
        faulty = next((file for file in (member.file, *member.others) if faults[file]), None)
        if faulty is None:
            whole.append(member)
        else:
            texts.append(f"{shorten(faulty.name)} at t = {member.time:g} s {faults[faulty]}")
    return whole, texts
