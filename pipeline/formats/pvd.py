"""ParaView's indices of time series: .pvd (XML), read and written, and .series (JSON), read."""

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from math import nan
from pathlib import Path
from typing import Any, NamedTuple, cast
from xml.parsers.expat import errors as expat
from xml.sax.saxutils import quoteattr

from pipeline.errors import SeriesError, shorten
from pipeline.formats.listed_paths import locate_file
from pipeline.formats.preflight import find_refusal
from pipeline.formats.times import has_comma, parse_time

INDEX_SUFFIXES = (".pvd", ".series")
_LARGEST = 1 << 28  # [byte]: a million entries take a third of it
# the faults of a document that merely ends too early
_CUT_OFF = {
    expat.codes[text]
    for text in (expat.XML_ERROR_NO_ELEMENTS, expat.XML_ERROR_UNCLOSED_TOKEN, expat.XML_ERROR_PARTIAL_CHAR)
}
_HEAD = b"""<?xml version="1.0"?>
<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">
  <Collection>
"""
_TAIL = b"  </Collection>\n</VTKFile>\n"


class IndexEntry(NamedTuple):
    """A file at a time [s], NaN if the index has none; the step in it, the time's text, and the part of the body."""

    time: float
    file: Path
    step: int = 0
    text: str = ""
    part: tuple[str, ...] = ()


def read_index(index: Path) -> tuple[list[IndexEntry], list[str]]:
    """Return the entries of an index, at least one, and notes; raises SeriesError."""
    try:
        if index.stat().st_size > _LARGEST:
            raise ValueError(f"it has more than {_LARGEST} bytes")
        rows, notes = _read_pvd(index) if index.suffix.lower() == ".pvd" else (_read_json(index), [])
        entries = _make_entries(index, rows, notes)
    except OSError as error:
        raise SeriesError(f"{index}: no series there ({error.strerror})") from error
    except (ET.ParseError, KeyError, ValueError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        raise SeriesError(f"{index}: not a ParaView index: {shorten(str(error), 200)}") from error
    if not entries:
        raise SeriesError(f"{index}: it lists no frames")
    return entries, notes


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


def _make_entries(index: Path, rows: list[dict[str, str]], notes: list[str]) -> list[IndexEntry]:
    """Return the entries of rows of attributes; appends notes on times and paths."""
    entries, found = [], dict[str, str]()  # notes by kind
    for row in rows:
        file, note = locate_file(index, row["file"])
        text = row.get("timestep", "")
        part = (row.get("group", ""), row.get("part", "")) if len(row) > 2 else ()
        entries.append(IndexEntry(parse_time(text) if text else nan, file, 0, text, part))
        if note:
            found[note] = note
        if "," in text and has_comma(text):
            found.setdefault(",", f"the comma in times such as {shorten(text)} is taken as a decimal point")
    notes += found.values()
    return entries


def _read_pvd(index: Path) -> tuple[list[dict[str, str]], list[str]]:
    """Return the attributes of each entry, and a note if the file ends too early."""
    if reason := find_refusal(index):
        raise ValueError(reason)
    content = index.read_bytes()
    try:
        return [element.attrib for element in ET.fromstring(content).findall("./Collection/DataSet")], []
    except ET.ParseError as error:
        rows = _read_complete_rows(content) if error.code in _CUT_OFF else []
        if not rows:
            raise
    return rows, [f"the index ends too early, as if its program had been stopped; {len(rows)} entries are read"]


def _read_complete_rows(content: bytes) -> list[dict[str, str]]:
    """Return the attributes of each complete entry of an index that ends too early."""
    parser: ET.XMLPullParser[Any] = ET.XMLPullParser(["end"])
    parser.feed(content)
    ends = cast("Iterator[tuple[str, ET.Element]]", parser.read_events())
    return [element.attrib for _, element in ends if element.tag == "DataSet"]


def _read_json(index: Path) -> list[dict[str, str]]:
    """Return the attributes of each entry, as a .pvd has them."""
    entries = json.loads(index.read_text(encoding="utf-8"))["files"]
    return [{"timestep": _write_time(entry["time"]), "file": entry["name"]} for entry in entries]


def _write_time(value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"the time {value!r} is not a number")
    return value if isinstance(value, str) else repr(float(value))
