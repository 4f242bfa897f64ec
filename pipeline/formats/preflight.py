"""What a file says of itself, held against its size before anything is read: counts, entities, names of other files."""

import re
from collections.abc import Iterator
from os.path import normpath
from pathlib import Path, PurePosixPath, PureWindowsPath

from pipeline.errors import shorten

_XML = (".vtu", ".pvtu", ".vtp", ".pvd", ".xdmf", ".xmf")
_HEAD = 1 << 16
_PROLOGUE = 1 << 20
# what a byte of a file becomes at most: text has two characters a number; the best that each compressor does
_GROWTH = {b"": 2, b"vtkLZ4DataCompressor": 260, b"vtkZLibDataCompressor": 1100, b"vtkLZMADataCompressor": 8000}
_POINT_BYTES, _CELL_BYTES = 12, 9  # three single numbers; a type, an offset and one corner
_PIECE = re.compile(rb"<Piece\b[^>]*>")
_LEGACY = re.compile(rb"^\s*(POINTS)\s+(\d+)", re.MULTILINE)
_HDF = re.compile(rb'Format="HDF"[^>]*>\s*([^<:]+):')
_OTHER_ROOTS = frozenset("\\:")  # without these a name has no root but /
_WIDE = (b"\xff\xfe", b"\xfe\xff")  # the marks of UTF-16; those of UTF-32 have these, or zeros
_SILENT = re.compile(rb"<!--.*?(?:-->|\Z)|<\?.*?(?:\?>|\Z)", re.DOTALL)  # comments, instructions
_SOURCE = re.compile(rb'<Piece\b[^>]*\bSource="([^"]*)"')


def refusal(file: Path) -> str | None:
    """Return why a file is not even to be tried, None where nothing speaks against it."""
    suffix = file.suffix.lower()
    if suffix in _XML and (why := _unsafe_xml(file)):
        return why
    if suffix in (".vtu", ".vtp", ".vtk"):
        return _too_many(file)
    if suffix in (".pvtu", ".xdmf", ".xmf"):
        for name in _named(file, _SOURCE if suffix == ".pvtu" else _HDF):
            if why := leaving(name):
                return why
    return None


def leaving(name: str) -> str | None:
    """Return what is wrong with the name that a file gives of another one, which must lie in or below its folder."""
    inside = normpath(name.replace("\\", "/"))
    if not _OTHER_ROOTS.intersection(name) and inside[0] != "/" and inside.split("/")[0] != "..":
        return None  # what an index of thousands of frames says
    absolute = PurePosixPath(name).is_absolute() or PureWindowsPath(name).is_absolute() or PureWindowsPath(name).drive
    if absolute or inside.split("/")[0] == "..":
        return f"it names a file outside its own folder ({shorten(name, 200)}); put it beside its files"
    return None


def _unsafe_xml(file: Path) -> str | None:
    """Return what is wrong before the first element: entities can stand for more than any memory holds."""
    with file.open("rb") as opened:
        prologue = opened.read(_PROLOGUE)
    if wide(prologue):
        return "it is written in UTF-16 or UTF-32; write it in UTF-8"
    prologue = _SILENT.sub(b"", prologue)  # what looks like an element there is none
    root = re.search(rb"<[A-Za-z_]", prologue)
    if root is None:
        return "it is no XML"
    return "it declares entities, which no such file needs" if b"<!ENTITY" in prologue[: root.start()] else None


def wide(content: bytes) -> bool:
    """Return whether a text begins as those of two or four bytes a character do, where a search would miss words."""
    return content.startswith(_WIDE) or b"\0" in content[:4]


def _too_many(file: Path) -> str | None:
    """Return by how much the counts in a file's head exceed what its bytes can hold."""
    with file.open("rb") as opened:
        head = opened.read(_HEAD)
    compressor = re.search(rb'compressor="(\w+)"', head)
    growth = _GROWTH.get(compressor[1] if compressor else b"", max(_GROWTH.values()))
    points = sum(_numbers(rb"NumberOfPoints", head)) + sum(int(found[2]) for found in _LEGACY.finditer(head))
    cells = sum(_numbers(rb"NumberOfCells", head))
    size = file.stat().st_size
    if points * _POINT_BYTES + cells * _CELL_BYTES <= growth * size:
        return None
    return f"it declares {points} points and {cells} cells, more than its {size} bytes can hold"


def _numbers(key: bytes, head: bytes) -> Iterator[int]:
    """Yield the values of an attribute of all pieces."""
    for piece in _PIECE.findall(head):
        found = re.search(rb"\b" + key + rb'\s*=\s*["\']\s*(\d{1,30})', piece)
        if found:
            yield int(found[1])


def _named(file: Path, pattern: re.Pattern[bytes]) -> Iterator[str]:
    """Yield the names of other files in a file, which may be large."""
    with file.open("rb") as opened:
        rest = b""
        while block := opened.read(1 << 20):
            yield from (name.decode(errors="replace").strip() for name in pattern.findall(rest + block))
            rest = block[-1000:]
