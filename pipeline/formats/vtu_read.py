"""Frames of .vtu files as most programs write them: numbers within the XML, in base64, plain or packed by zlib.

VTK reads these too, but all arrays of a file or none, at the price of loading VTK. Here an array is decoded when it is
asked for, and cells that are spelt like those of the frame before are not decoded at all. What is written in any other
way (appended, ASCII, several pieces, ghost cells, polyhedra), or does not add up, is left to VTK. Nothing
but Python and numpy handles the bytes: a damaged file cannot take the process along.
"""

import os
import re
import struct
import zlib
from binascii import a2b_base64
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Ints
from pipeline.errors import SeriesError
from pipeline.formats import preflight as claims
from pipeline.formats.cell_types import CORNERS

# the names of types in .vtu, and numpy's
TYPES = {f"{word}Int{8 * n}": f"{kind}{n}" for word, kind in (("", "i"), ("U", "u")) for n in (1, 2, 4, 8)} | {
    "Float32": "f4",
    "Float64": "f8",
}
_COMPRESSORS = {None: False, "vtkZLibDataCompressor": True}
_ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
_HEADERS = {"UInt32": "I", "UInt64": "Q"}  # as struct names them
_WORDS = {"I": 4, "Q": 8}
_SECTIONS = {"PointData": "NumberOfPoints", "CellData": "NumberOfCells"}
_HEAD, _ELSEWHERE = 4096, (b'format="appended"', b'format="ascii"')  # not worth reading the rest
# decoded whole, what takes more than this and more than so many times its file is for the guarded child process
_LEAST_BYTES, _BYTES_PER_BYTE = 2 * 10**9, 40
# parsing takes up to four times the file; marks are what elements and attributes are made of, some 100 bytes each
_LARGEST, _MOST_MARKS = _LEAST_BYTES // 4, 10**6
_LONG, _LONG_TAG = 200, 10_000  # bytes of a text that is worth keeping from the parser, and of a tag that has none
_TAG = re.compile(rb"""/?[\w:.-]+(?:\s+[\w:.-]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*/?""")


class Packed(NamedTuple):
    """An array as it stands in the file: what it becomes, and the texts of its header and its numbers."""

    dtype: str
    shape: tuple[int, ...]
    sizes: tuple[int, ...]  # bytes of each block when decoded
    packed: tuple[int, ...]  # bytes of each block in the file; none where nothing is compressed
    text: bytes

    @property
    def nbytes(self) -> int:
        """Return how many bytes it has when decoded."""
        return sum(self.sizes)


class Inline(NamedTuple):
    """One file: arrays by their names, still packed, but for the cells (types, offsets, connectivity)."""

    points: Packed
    cells: tuple[NDArray[np.uint8], Ints, Ints]
    sections: tuple["LazyArrays", "LazyArrays", "LazyArrays"]  # of points, cells and the whole


class LazyArrays(Mapping[str, NDArray[Any]]):
    """LazyArrays by their names, decoded each time they are asked for; raises SeriesError where that fails."""

    def __init__(self, file: Path, packed: dict[str, Packed]) -> None:
        self._file, self._packed = file, packed

    def __getitem__(self, name: str) -> NDArray[Any]:
        return unpacked(self._packed[name], self._file, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._packed)

    def __len__(self) -> int:
        return len(self._packed)

    @property
    def nbytes(self) -> int:
        """Return how many bytes are held."""
        return sum(len(one.text) for one in self._packed.values())


class _NotInlineError(Exception):
    """The file is written in another way, or does not add up: VTK is to judge."""


def inline_file(file: Path) -> Inline | None:
    """Return what an inline .vtu says, None for every other file."""
    try:
        return _read(file)
    except Exception:  # whatever there is to stumble on in a file of another program: who reads it next will tell
        return None


def unpacked(one: Packed, file: Path, name: str) -> NDArray[Any]:
    """Return the numbers of an array, free to be written to; raises SeriesError where they are damaged."""
    try:
        data = a2b_base64(one.text, strict_mode=True)
        if len(one.packed) == 1:
            data = _inflated(data, one.sizes[0])
        elif one.packed:
            ends = np.cumsum(one.packed).tolist()
            starts = [0, *ends[:-1]]
            data = b"".join(_inflated(data[a:b], n) for a, b, n in zip(starts, ends, one.sizes, strict=True))
        else:
            data = data[-one.nbytes :]
        if one.dtype == "S":
            return _texts(data, one.shape[0])
        plain = np.frombuffer(data, dtype=one.dtype).reshape(one.shape)
    except (ValueError, zlib.error) as error:
        raise SeriesError(f"{file}: cannot be read (the array {name}: {error})") from error
    return plain.astype(plain.dtype.newbyteorder("="))


def _texts(data: bytes, count: int) -> NDArray[Any]:
    """Return texts, each of which ends with a zero; raises ValueError where there are not so many."""
    *texts, rest = data.split(b"\0")
    if rest or len(texts) != count:
        raise ValueError(f"{len(texts)} texts, not {count}")
    if 4 * count * max(map(len, texts)) > _LEAST_BYTES:  # numpy makes each as long as the longest
        raise ValueError(f"{count} texts that differ too much in length")
    return np.array([text.decode() for text in texts])


def _inflated(block: bytes, size: int) -> bytes:
    """Return a block decompressed; raises ValueError where it has not that size."""
    inflate = zlib.decompressobj()
    plain = inflate.decompress(block, size + 1)  # one more than there should be: never much more than was said
    if len(plain) != size or not inflate.eof:
        raise ValueError(f"a block of {size} bytes is damaged")
    return plain


def _read(file: Path) -> Inline:
    with file.open("rb") as opened:
        size, head = os.fstat(opened.fileno()).st_size, opened.read(_HEAD)
        if size > _LARGEST or any(word in head for word in _ELSEWHERE):
            raise _NotInlineError
        opened.seek(0)
        content = opened.read(size)
    if claims.wide(content):
        raise _NotInlineError
    bare, texts = _without_texts(content)
    root = ElementTree.fromstring(bare)
    (grid,) = root
    pieces = grid.findall("Piece")
    if root.tag != "VTKFile" or grid.tag != "UnstructuredGrid" or len(pieces) != 1:
        raise _NotInlineError
    (piece,) = pieces
    way = _Way(
        _ORDERS[root.attrib["byte_order"]], _HEADERS[root.get("header_type", "UInt32")],
        _COMPRESSORS[root.get("compressor")], texts,
    )  # fmt: skip
    counts = {name: int(piece.attrib[name]) for name in _SECTIONS.values()}
    whole = {a.attrib["Name"]: _packed(a, int(a.attrib["NumberOfTuples"]), way) for a in _children(grid, "FieldData")}
    of_points, of_cells = (
        {array.attrib["Name"]: _packed(array, counts[count], way) for array in _children(piece, section)}
        for section, count in _SECTIONS.items()
    )
    (located,) = _children(piece, "Points")
    points = _packed(located, counts["NumberOfPoints"], way)
    found = {array.attrib["Name"]: _packed(array, None, way) for array in _children(piece, "Cells")}
    total = points.nbytes + sum(one.nbytes for a in (of_points, of_cells, whole, found) for one in a.values())
    if total > max(_LEAST_BYTES, _BYTES_PER_BYTE * size) or points.shape[1:] != (3,):
        raise _NotInlineError
    if found.keys() != {"connectivity", "offsets", "types"} or "vtkGhostType" in of_cells:
        raise _NotInlineError
    try:
        cells = _cells(found["types"], found["offsets"], found["connectivity"], *counts.values())
    except SeriesError as error:
        raise _NotInlineError from error
    return Inline(points, cells, (LazyArrays(file, of_points), LazyArrays(file, of_cells), LazyArrays(file, whole)))


def _without_texts(content: bytes) -> tuple[bytes, dict[bytes, bytes]]:
    """Return the XML with @k in the place of the k-th text that is long enough to hold numbers, and these texts by it.

    A parser looks at every character of them, which is most of the time that a file takes. Base64 has no @.
    """
    parts, texts = content.split(b"<", _MOST_MARKS), dict[bytes, bytes]()
    odd = [part for part in parts[2:] if part.startswith((b"!", b"?"))]  # the first two are <?xml and what is before
    if len(parts) > _MOST_MARKS or any(part.startswith(b"!DOCTYPE") for part in parts):
        raise _NotInlineError  # entities are for claims.py to refuse
    for i, part in enumerate([] if odd else parts):  # comments may hold what looks like an element
        tag, end, text = part.partition(b">")
        if len(text) > _LONG and b"&" not in text and len(tag) < _LONG_TAG and _TAG.fullmatch(tag):
            place = b"@%d" % len(texts)
            parts[i], texts[place] = tag + end + place, text.strip()
    bare = b"<".join(parts)
    if bare.count(b'"') + bare.count(b"'") > _MOST_MARKS:
        raise _NotInlineError
    return bare, texts


def _children(element: ElementTree.Element, tag: str) -> list[ElementTree.Element]:
    """Return the arrays of a section, which must differ in their names."""
    section = element.find(tag)
    arrays = [] if section is None else list(section)
    if len({array.get("Name") for array in arrays}) < len(arrays):
        raise _NotInlineError
    return arrays


class _Way(NamedTuple):
    """How the arrays of a file are written: in the letters of struct."""

    order: str
    header: str
    compressed: bool
    texts: dict[bytes, bytes]  # what _without_texts took out


def _packed(array: ElementTree.Element, tuples: int | None, way: _Way) -> Packed:
    """Return an array with its sizes checked; `tuples` is how many it must have, None for any number."""
    text = array.tag == "Array" and array.attrib["type"] == "String"
    if (array.tag != "DataArray" and not text) or array.attrib["format"] != "binary":
        raise _NotInlineError
    if any(child.tag != "InformationKey" for child in array):  # ranges that VTK adds behind the numbers
        raise _NotInlineError
    numbers = (array.text or "").strip().encode()
    if numbers.startswith(b"@"):
        numbers = way.texts.pop(numbers)  # KeyError: that is what the file itself says
    sizes, packed, numbers = _blocks(numbers, way)
    if text and tuples:
        return Packed("S", (tuples,), sizes, packed, numbers)
    dtype = way.order + TYPES[array.attrib["type"]]
    components = int(array.get("NumberOfComponents", 1))
    item = int(dtype[2:]) * components
    if components < 1 or (tuples or 0) < 0:
        raise _NotInlineError
    if tuples is None:
        tuples = sum(sizes) // item
    if sum(sizes) != tuples * item or not sum(sizes):
        raise _NotInlineError
    return Packed(dtype, (tuples,) if components == 1 else (tuples, components), sizes, packed, numbers)


def _blocks(text: bytes, way: _Way) -> tuple[tuple[int, ...], tuple[int, ...], bytes]:
    """Return the bytes of each block decoded and packed, and the text of the blocks."""
    word = _WORDS[way.header]
    if not way.compressed:
        (size,) = _words(text, 1, way)
        apart = _characters(word)  # some programs encode the length apart, others in one go with the numbers
        alone = text[:apart].endswith(b"=")
        expected = apart + _characters(size) if alone else _characters(word + size)
        if len(text) != expected:
            raise _NotInlineError
        return (size,), (), text[apart:] if alone else text
    count, size, last = _words(text, 3, way)
    start = _characters((3 + count) * word)
    if not count or start >= len(text):
        raise _NotInlineError
    packed = _words(text, 3 + count, way)[3:]
    if len(text) - start != _characters(sum(packed)):
        raise _NotInlineError
    return (*(size,) * (count - 1), last or size), packed, text[start:]


def _characters(size: int) -> int:
    """Return how many characters of base64 that many bytes take."""
    return -(-size // 3) * 4


def _words(text: bytes, count: int, way: _Way) -> tuple[int, ...]:
    """Return the first numbers of a header."""
    header = struct.Struct(f"{way.order}{count}{way.header}")
    return header.unpack_from(a2b_base64(text[: _characters(header.size)], strict_mode=True))


@lru_cache(maxsize=4)  # the frames of a series spell their cells alike
def _cells(
    types: Packed, offsets: Packed, connectivity: Packed, points: int, cells: int
) -> tuple[NDArray[np.uint8], Ints, Ints]:
    """Return types, offsets from 0 on and connectivity; raises _NotInlineError where VTK should say what is wrong."""
    if any(one.dtype[1] == "f" for one in (types, offsets, connectivity)):
        raise _NotInlineError
    here = Path()
    kinds = unpacked(types, here, "types").astype(np.uint8).reshape(-1)
    ends = unpacked(offsets, here, "offsets").astype(np.int64).reshape(-1)
    corners = unpacked(connectivity, here, "connectivity").astype(np.int64).reshape(-1)
    known = np.array([CORNERS.get(kind, -1) for kind in range(256)])[kinds]
    starts = np.concatenate([[0], ends])
    fits = len(kinds) == len(ends) == cells and len(corners) == starts[-1] and np.array_equal(np.diff(starts), known)
    if not fits or corners.min() < 0 or corners.max() >= points:
        raise _NotInlineError
    out = kinds, starts, corners
    for one in out:
        one.flags.writeable = False  # shared by all frames
    return out
