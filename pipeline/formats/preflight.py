"""Checks a file's own claims before it is read: counts against its size, entities, names of other files."""

import re
from collections.abc import Iterator
from os.path import normpath
from pathlib import Path, PurePosixPath, PureWindowsPath

from pipeline.errors import shorten

_XML = (".vtu", ".pvtu", ".vtp", ".pvtp", ".vtm", ".vtmb", ".vtpd", ".vtpc", ".pvd", ".xdmf", ".xmf")
_HEAD = 1 << 16
_PROLOGUE = 1 << 20
# bytes that one byte of a file can decode to: text takes two characters a number; for each compressor, its best
_GROWTH = {b"": 2, b"vtkLZ4DataCompressor": 260, b"vtkZLibDataCompressor": 1100, b"vtkLZMADataCompressor": 8000}
_POINT_BYTES, _CELL_BYTES = 12, 9  # three single-precision numbers; a type, an offset and one corner
_PIECE = re.compile(rb"<Piece\b[^>]*>")
_LEGACY = re.compile(rb"^\s*(POINTS)\s+(\d+)", re.MULTILINE)
_HDF = re.compile(rb'Format="HDF"[^>]*>\s*([^<:]+):')
_OTHER_ROOTS = frozenset("\\:")  # without these only / can make a name absolute
_WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")  # of UTF-16; UTF-32 begins with these, or with zeros
_NO_ELEMENTS = re.compile(rb"<!--.*?(?:-->|\Z)|<\?.*?(?:\?>|\Z)", re.DOTALL)  # comments, instructions
_SOURCE = re.compile(rb'<Piece\b[^>]*\bSource="([^"]*)"')


def find_refusal(file: Path) -> str | None:
    """Return the reason not to read a file at all, None if there is none."""
    suffix = file.suffix.lower()
    if suffix in _XML and (reason := find_unsafe_xml(file)):
        return reason
    if suffix in (".vtu", ".vtp", ".vtk"):
        return _find_excess_counts(file)
    if suffix in (".pvtu", ".xdmf", ".xmf"):
        for name in _read_names(file, _SOURCE if suffix == ".pvtu" else _HDF):
            if not _is_inside(file, name) and (reason := find_outside_name(name)):
                return reason
    return None


def _is_inside(file: Path, name: str) -> bool:
    """Return whether a name is an absolute path in the folder of the file that has it."""
    return Path(name).is_absolute() and Path(name).resolve().is_relative_to(file.parent.resolve())


def find_outside_name(name: str) -> str | None:
    """Return the reason to refuse a file name found in a file, None if it lies in or below that file's folder."""
    path = normpath(name.replace("\\", "/"))
    if not _OTHER_ROOTS.intersection(name) and path[0] != "/" and path.split("/")[0] != "..":
        return None  # the usual case: an index may name thousands of frames
    absolute = PurePosixPath(name).is_absolute() or PureWindowsPath(name).is_absolute() or PureWindowsPath(name).drive
    if absolute or path.split("/")[0] == "..":
        return f"it names a file outside its own folder ({shorten(name, 200)}); put it beside its files"
    return None


def find_unsafe_xml(file: Path) -> str | None:
    """Return the fault before the first element, if any: entities can expand beyond any memory."""
    with file.open("rb") as stream:
        prologue = stream.read(_PROLOGUE)
    if is_wide(prologue):
        return "it is written in UTF-16 or UTF-32; write it in UTF-8"
    prologue = _NO_ELEMENTS.sub(b"", prologue)
    root = re.search(rb"<[A-Za-z_]", prologue)
    if root is None:
        return "it is not XML"
    return "it declares entities, which no such file needs" if b"<!ENTITY" in prologue[: root.start()] else None


def is_wide(content: bytes) -> bool:
    """Return whether a text seems to have two or four bytes per character: a search would miss words in it."""
    return content.startswith(_WIDE_MARKS) or b"\0" in content[:4]


def _find_excess_counts(file: Path) -> str | None:
    """Return the counts in a file's head if its bytes cannot hold that much, None if they can."""
    with file.open("rb") as stream:
        head = stream.read(_HEAD)
    compressor = re.search(rb'compressor="(\w+)"', head)
    growth = _GROWTH.get(compressor[1] if compressor else b"", max(_GROWTH.values()))
    points = sum(_read_counts(rb"NumberOfPoints", head)) + sum(int(match[2]) for match in _LEGACY.finditer(head))
    cells = sum(_read_counts(rb"NumberOfCells", head))
    size = file.stat().st_size
    if points * _POINT_BYTES + cells * _CELL_BYTES <= growth * size:
        return None
    return f"it declares {points} points and {cells} cells, more than its {size} bytes can hold"


def _read_counts(key: bytes, head: bytes) -> Iterator[int]:
    """Yield the values of an attribute of all pieces."""
    for piece in _PIECE.findall(head):
        match = re.search(rb"\b" + key + rb'\s*=\s*["\']\s*(\d{1,30})', piece)
        if match:
            yield int(match[1])


def _read_names(file: Path, pattern: re.Pattern[bytes]) -> Iterator[str]:
    """Yield the names of other files in a possibly large file."""
    with file.open("rb") as stream:
        rest = b""
        while block := stream.read(1 << 20):
            yield from (name.decode(errors="replace").strip() for name in pattern.findall(rest + block))
            rest = block[-1000:]
