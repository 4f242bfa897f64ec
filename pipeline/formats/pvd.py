"""ParaView's indices of time series: .pvd (XML), read and written, and .series (JSON), read."""

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import quoteattr

from pipeline.errors import SeriesError, shorten
from pipeline.formats.preflight import find_outside_name, find_refusal

INDEX_SUFFIXES = (".pvd", ".series")
_HEAD = b"""<?xml version="1.0"?>
<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">
  <Collection>
"""
_TAIL = b"  </Collection>\n</VTKFile>\n"


def read_index(index: Path) -> list[tuple[float, Path]]:
    """Return the times [s] and files that an index lists, at least one; raises SeriesError."""
    try:
        frames = _read_pvd(index) if index.suffix == ".pvd" else _read_json(index)
    except OSError as error:
        raise SeriesError(f"{index}: no series there ({error.strerror})") from error
    except (ET.ParseError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise SeriesError(f"{index}: not a ParaView index: {shorten(str(error), 200)}") from error
    if not frames:
        raise SeriesError(f"{index}: it lists no frames")
    return frames


def encode_pvd(frames: Iterable[tuple[float, str]]) -> bytes:
    """Return a .pvd of (time [s], file) pairs."""
    return complete_pvd(encode_pvd_rows(frames))


def encode_pvd_rows(frames: Iterable[tuple[float, str]]) -> bytes:
    """Return the lines of a .pvd for (time [s], file) pairs, without its head and its end."""
    rows = (f"    <DataSet timestep={quoteattr(repr(t))} file={quoteattr(name)}/>\n" for t, name in frames)
    return "".join(rows).encode()


def complete_pvd(rows: bytes | bytearray) -> bytes:
    """Return a .pvd with these lines."""
    return b"".join((_HEAD, rows, _TAIL))


def _read_pvd(index: Path) -> list[tuple[float, Path]]:
    if reason := find_refusal(index):
        raise ValueError(reason)
    entries = ET.parse(index).getroot().findall("./Collection/DataSet")
    parts = {entry.get("part", "0") for entry in entries}
    if len(parts) > 1:
        raise SeriesError(f"{index}: lists {len(parts)} parts per frame; write them as one grid (pyvista: merge)")
    return [(float(entry.attrib["timestep"]), _resolve(index, entry.attrib["file"])) for entry in entries]


def _read_json(index: Path) -> list[tuple[float, Path]]:
    entries = json.loads(index.read_text(encoding="utf-8"))["files"]
    return [(float(entry["time"]), _resolve(index, entry["name"])) for entry in entries]


def _resolve(index: Path, name: str) -> Path:
    """Return the file that an index names; raises SeriesError if it lies outside the index's folder."""
    if reason := find_outside_name(name):
        raise SeriesError(f"{index}: {reason}")
    return index.parent / name
