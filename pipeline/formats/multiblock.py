"""Files that only name others: pieces of ranks (.pvtu, .pvtp), blocks (.vtm, .vtmb), partitions (.vtpd, .vtpc).

Each piece is read by itself and becomes a part of one grid. Only the XML is read here.
"""

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from os.path import isfile
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.grid import Grid
from pipeline.formats.listed_paths import locate_file
from pipeline.formats.parts import BodyPart, join_parts
from pipeline.formats.preflight import find_unsafe_xml
from pipeline.formats.times import find_time_field
from pipeline.formats.vtu_read import decode_array

PIECEWISE_SUFFIXES = (".pvtu", ".pvtp", ".vtm", ".vtmb", ".vtpd", ".vtpc")
_LARGEST, _MOST_PIECES = 1 << 26, 100_000  # [byte]; a name takes some 100
_HEAD = 4096
_DEEPEST = 8
_EMPTY_PIECE = re.compile(rb"<Piece\b[^>]*>")
_NO_CELLS = re.compile(rb"\bNumberOf(?:Cells|Polys|Strips)\s*=\s*[\"']\s*0*[1-9]")


class Piece(NamedTuple):
    """A file that holds a piece, and the name of its block."""

    name: str
    file: Path


class _BlockContent(NamedTuple):
    """The pieces, in order, and the times and notes of a file."""

    pieces: tuple[Piece, ...]
    times: tuple[float, ...]
    notes: tuple[str, ...]


def is_piecewise(file: Path) -> bool:
    """Return whether a file only names pieces, blocks or partitions."""
    return file.suffix.lower() in PIECEWISE_SUFFIXES


def list_pieces(file: Path) -> tuple[Piece, ...]:
    """Return the pieces that a file names, at least one; raises SeriesError if it is damaged."""
    return _read_content(file).pieces


def read_pieces(file: Path, read: Callable[[Path], Grid], suffixes: tuple[str, ...]) -> Grid:
    """Return the pieces of a file as one grid; raises SeriesError if one cannot be read.

    `read` reads a piece, which may be such a file itself. Pieces without cells are skipped; those whose suffix is not
    among `suffixes` are left out with a note.
    """
    content = _read_content(file)
    unknown = [p for p in content.pieces if p.file.suffix.lower() not in suffixes]
    known = [p for p in content.pieces if p not in unknown]
    missing = next((p for p in known if not isfile(p.file)), None)
    if missing is not None:
        raise SeriesError(f"{file}: its piece {shorten(missing.file.name)} is missing")
    parts = [BodyPart(p.name, read(p.file)) for p in known if not is_empty_piece(p.file)]
    if not parts:
        kinds = join_names(sorted({p.file.suffix for p in unknown})) if unknown else "none with cells"
        raise SeriesError(f"{file}: none of its {len(content.pieces)} pieces can be read ({kinds})")
    grid = join_parts(parts, str(file))
    notes = list(content.notes)
    if unknown:
        names = join_names(f"{p.name} ({p.file.name})" for p in unknown)
        notes.append(f"{len(unknown)} blocks of a kind that is not read are left out: {names}")
    return replace(grid, notes=(*grid.notes, *notes))


def read_own_times(file: Path) -> tuple[float, ...]:
    """Return the times [s] that a file itself holds, beside the names of its pieces."""
    return _read_content(file).times


def find_first_piece(file: Path) -> Path | None:
    """Return the first piece that exists and has cells, None if there is none."""
    return next((p.file for p in list_pieces(file) if isfile(p.file) and not is_empty_piece(p.file)), None)


def check_depth(file: Path, depth: int) -> None:
    """Raise SeriesError if files name files more deeply than any program writes: one may name itself."""
    if depth > _DEEPEST:
        raise SeriesError(f"{file}: files name each other more than {_DEEPEST} deep")


def is_empty_piece(file: Path) -> bool:
    """Return whether the head of a VTK XML file says that it has no cells: ranks without any write such pieces."""
    if file.suffix.lower() not in (".vtu", ".vtp"):
        return False
    with file.open("rb") as stream:
        pieces = _EMPTY_PIECE.findall(stream.read(_HEAD))
    return bool(pieces) and not any(_NO_CELLS.search(piece) for piece in pieces)


def _read_content(file: Path) -> _BlockContent:
    """Return the content of a file, parsed again only after it has changed."""
    try:
        status = os.stat(file)
        return _parse_content(file, status.st_mtime_ns, status.st_size)
    except OSError as error:
        raise SeriesError(f"{file}: cannot be read ({error.strerror})") from error
    except (ET.ParseError, KeyError, ValueError, OverflowError) as error:
        raise SeriesError(f"{file}: cannot be read ({shorten(str(error), 200)})") from error


@lru_cache(maxsize=256)  # listing asks for the pieces of every frame, reading asks again
def _parse_content(file: Path, _modified: int, size: int) -> _BlockContent:
    if size > _LARGEST:
        raise ValueError(f"it has {size} bytes, too many for a file that names others")
    if reason := find_unsafe_xml(file):
        raise ValueError(reason)
    parser: ET.XMLPullParser[Any] = ET.XMLPullParser(("start", "end"))
    parser.feed(file.read_bytes())
    pieces, notes, names, times = list[Piece](), dict[str, None](), list[str](), tuple[float, ...]()
    root: ET.Element | None = None
    for event, element in cast("Iterator[tuple[str, ET.Element]]", parser.read_events()):
        root = element if root is None else root
        if event == "start":
            names.append(element.get("name") or f"{element.tag.lower()} {element.get('index', len(pieces))}")
            if name := element.get("Source") or element.get("file"):
                located = locate_file(file, name)
                notes |= {located.note: None} if located.note else {}
                pieces.append(Piece(_name_piece(names, name, element), located.path))
        else:
            names.pop()
            if element.tag == "DataArray" and find_time_field([element.get("Name", "")]):
                times = tuple(decode_array(element, root).astype(np.float64).ravel().tolist())
    parser.close()
    if len(pieces) > _MOST_PIECES:
        raise ValueError(f"it names {len(pieces)} pieces, more than {_MOST_PIECES}")
    if not pieces:
        raise ValueError("it names no pieces")
    return _BlockContent(tuple(pieces), times, tuple(notes))


def _name_piece(names: list[str], source: str, element: ET.Element) -> str:
    """Return the name of a piece: those of its blocks, or the file's if there are none."""
    if "Source" in element.attrib:
        return Path(source.replace("\\", "/")).stem
    return "/".join(names[2:]) or source  # without the document and its kind
