"""Compares the sizes that solvers' files declare with their lengths.

VTK's readers return zeros or stray numbers for what is missing at the end of a file.
"""

import warnings
from pathlib import Path

import numpy as np

from pipeline.formats.preflight import find_outside_name

_NETCDF = (b"CDF\x01", b"CDF\x02")  # the classic formats; HDF5 checks its length itself
_WORDS = 64  # of a d3plot's control block
_DESCRIPTION = 80  # bytes: the line of text at the beginning of EnSight's files


def find_exodus_fault(file: Path, _count: int) -> str | None:
    """Return why an Exodus file in a classic netCDF format is shorter than it declares, None if it is not."""
    with file.open("rb") as stream:
        if stream.read(4) not in _NETCDF:
            return None
    from scipy.io import netcdf_file

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # scipy warns if arrays outlive the file
            netcdf_file(str(file), "r", mmap=True).close()
    except Exception as error:  # whatever its parser raises
        return f"it is shorter than it declares, or damaged ({' '.join(str(error).split())[:100]})"
    return None


def find_dyna_fault(file: Path, count: int) -> str | None:
    """Return why the files of a d3plot are too short for its geometry and `count` states, None if they are not.

    The sizes are lower bounds: states of shells are not counted, because those of rigid bodies have none.
    """
    content = np.fromfile(file, dtype="u1", count=8 * _WORDS).tobytes()
    for kind in ("<i4", ">i4", "<i8", ">i8"):
        size = np.dtype(kind).itemsize
        words = np.frombuffer(content[: _WORDS * size], dtype=kind).astype(np.int64)
        if len(words) == _WORDS and 2 <= words[15] <= 7:
            break
    else:
        return "its control block is damaged"
    nodes, solids, thick, beams, shells = (int(words[i]) for i in (16, 23, 40, 28, 31))
    geometry = _WORDS + 3 * nodes + 9 * (solids + thick) + 6 * beams + 5 * shells + int(words[39])
    state = 1 + int(words[18]) + 3 * nodes * int((words[20:23] != 0).sum()) + solids * int(words[27])
    family = [other for other in file.parent.glob(f"{file.name}[0-9]*") if other.name[len(file.name) :].isdigit()]
    whole = sum(other.stat().st_size for other in (file, *family)) // size
    if min(nodes, solids, thick, beams, shells, state) < 0 or file.stat().st_size // size < geometry:
        return f"it declares {nodes} nodes and {solids} solids, more than its {file.stat().st_size} bytes can hold"
    if whole < geometry + count * state:
        return f"its files have {whole} words; {count} states need {geometry + count * state}: the last one is cut off"
    return None


def find_ensight_fault(file: Path, _count: int) -> str | None:
    """Return which file of an EnSight case is shorter than the same field at other times, None if there is none.

    Only if the geometry has one size: then each file of a field has the same length, but for a line of description.
    """
    sections: dict[str, list[str]] = {"GEOMETRY": [], "VARIABLE": []}
    section = ""
    for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
        if line.strip() in ("FORMAT", "GEOMETRY", "VARIABLE", "TIME", "FILE", "MATERIAL", "BLOCK_CONTINUATION"):
            section = line.strip()
        elif ":" in line and section in sections and line.split():
            sections[section].append(line.split()[-1].strip('"'))
    for pattern in (name for names in sections.values() for name in names):
        if reason := find_outside_name(pattern):
            return reason
    lengths = {pattern: _list_lengths(file.parent, pattern) for names in sections.values() for pattern in names}
    if any(_are_cut(lengths[pattern]) for pattern in sections["GEOMETRY"]):
        return None
    for pattern in sections["VARIABLE"]:
        if _are_cut(lengths[pattern]):
            shortest = min(lengths[pattern], key=lambda name: lengths[pattern][name])
            most = max(lengths[pattern].values())
            return f"{shortest} has {lengths[pattern][shortest]} bytes, at another time it has {most}: it is cut off"
    return None


def _list_lengths(folder: Path, pattern: str) -> dict[str, int]:
    """Return the lengths of the files that a pattern names, in which * stands for a digit."""
    return {str(f.relative_to(folder)): f.stat().st_size for f in folder.glob(pattern.replace("*", "[0-9]"))}


def _are_cut(lengths: dict[str, int]) -> bool:
    return bool(lengths) and max(lengths.values()) - min(lengths.values()) > _DESCRIPTION
