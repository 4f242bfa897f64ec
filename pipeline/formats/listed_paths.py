"""Files that another file names: within its folder, or data files beside that folder; no others are opened."""

from functools import lru_cache
from os.path import abspath, exists, isfile, normpath, realpath
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

from pipeline.errors import SeriesError
from pipeline.formats.preflight import find_outside_name

# ".." may lead to these only, and not further than the folder that holds the index's folder
_DATA_SUFFIXES = (".vtu", ".pvtu", ".vtp", ".pvtp", ".vtk", ".vtm", ".vtmb", ".vtpd", ".vtpc", ".vtkhdf")
ABOVE = "files in a folder beside that of the index are read"
ABSOLUTE = "the index names its files by absolute paths; those in its own folder are read"
MOVED = "the index names its files by absolute paths that do not exist here; files of the same names beside it are read"


class LocatedFile(NamedTuple):
    """The file that a name means, and a note if that was a decision."""

    path: Path
    note: str = ""


def locate_file(owner: Path, name: str) -> LocatedFile:
    """Return the file that `owner` names; raises SeriesError if the name leads out of the folders that may be read."""
    fault = find_outside_name(name)
    folder = owner.parent
    plain = name.replace("\\", "/")
    if fault is None:
        return LocatedFile(folder / (name if plain == name or exists(folder / name) else plain))
    if "\0" not in name:
        located = _locate_absolute(folder, name, plain) if _is_absolute(name) else _locate_above(folder, plain)
        if located is not None:
            return located
    raise SeriesError(f"{owner}: {fault}")


def _is_absolute(name: str) -> bool:
    windows = PureWindowsPath(name)
    return PurePosixPath(name).is_absolute() or windows.is_absolute() or bool(windows.drive)


def _locate_absolute(folder: Path, name: str, plain: str) -> LocatedFile | None:
    """Return the file within the folder that an absolute name means, there or before the folder was moved."""
    target = normpath(plain)
    for root in _find_roots(str(folder)):
        if target.startswith(root):
            return LocatedFile(folder / target[len(root) :], ABSOLUTE)
    if exists(name):  # it means that file, not one of the same name
        return None
    parts = [part for part in target.split("/") if part]
    tails = (folder.joinpath(*parts[i:]) for i in range(1 if len(parts) > 1 else 0, len(parts)))
    found = next((tail for tail in tails if isfile(tail)), None)
    return None if found is None else LocatedFile(found, MOVED)


def _locate_above(folder: Path, plain: str) -> LocatedFile | None:
    """Return the data file in a folder beside this one."""
    target = abspath(folder / plain)
    above = str(Path(abspath(folder)).parent).rstrip("/") + "/"
    if not target.startswith(above) or not target.lower().endswith(_DATA_SUFFIXES):
        return None
    return LocatedFile(folder / plain, ABOVE)


@lru_cache(maxsize=16)
def _find_roots(folder: str) -> tuple[str, ...]:
    """Return the absolute paths of a folder, as written and with links resolved, each with a separator at the end."""
    roots = (abspath(folder), realpath(folder))
    return tuple(dict.fromkeys(root.replace("\\", "/").rstrip("/") + "/" for root in roots))
