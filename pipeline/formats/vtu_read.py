"""Inline .vtu files, as most programs write them: numbers within the XML, in base64, plain or compressed with zlib.

VTK reads these too, but always every array of a file, and it has to be loaded first. Here an array is decoded on
access, and cells encoded like those of the previous frame are not decoded at all. Every other kind of file (appended,
ASCII, several pieces, ghost cells, polyhedra), and every inconsistent one, is left to VTK. Only Python and numpy handle
the bytes, so a damaged file cannot crash the process. The writer is vtu_write.
https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

import os
import re
import struct
import zlib
from binascii import a2b_base64
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Ints
from pipeline.errors import SeriesError
from pipeline.formats.cell_types import CORNERS
from pipeline.formats.grid import Grid, LazyArrays
from pipeline.formats.preflight import is_wide

# numpy's type for each type name in a .vtu
NUMPY_TYPES = {f"{word}Int{8 * n}": f"{kind}{n}" for word, kind in (("", "i"), ("U", "u")) for n in (1, 2, 4, 8)} | {
    "Float32": "f4",
    "Float64": "f8",
}
_COMPRESSORS = {None: False, "vtkZLibDataCompressor": True}
_BYTE_ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
_HEADERS = {"UInt32": "I", "UInt64": "Q"}  # as struct names them
_WORD_BYTES = {"I": 4, "Q": 8}
_HEADER_BYTES = (0, 4, 8)  # before numbers that are not compressed; 0 if the header was encoded by itself
_SECTIONS = {"PointData": "NumberOfPoints", "CellData": "NumberOfCells"}
_HEAD, _NOT_INLINE = 4096, (b'format="appended"', b'format="ascii"')  # marks a file whose rest need not be read
# a file that decodes to more than the first, and to more than the second times its size, is left to the sandbox
_LEAST_BYTES, _BYTES_PER_BYTE = 2 * 10**9, 40
# parsing takes up to four times the file; each mark (element or attribute) takes some 100 bytes
_LARGEST, _MOST_MARKS = _LEAST_BYTES // 4, 10**6
_LONG, _LONG_TAG = 200, 10_000  # bytes of a text worth keeping from the parser, and of a tag that cannot precede one
_TAG = re.compile(rb"""/?[\w:.-]+(?:\s+[\w:.-]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*/?""")


class Packed(NamedTuple):
    """An array as encoded in the file: its type and shape once decoded, and the text of its blocks."""

    dtype: str
    shape: tuple[int, ...]
    sizes: tuple[int, ...]  # bytes of each block when decoded
    packed_sizes: tuple[int, ...]  # bytes of each block in the file; empty if nothing is compressed
    text: bytes

    @property
    def nbytes(self) -> int:
        """Return the number of bytes when decoded."""
        return sum(self.sizes)


class _NotInlineError(Exception):
    """The file has another encoding or is inconsistent: VTK must judge it."""


def read_inline(file: Path) -> Grid | None:
    """Return the instant of an inline .vtu, its arrays decoded on access; None for every other file."""
    if file.suffix != ".vtu" and file.suffix.lower() != ".vtu":
        return None
    try:
        return _parse_file(file)
    except Exception:  # any fault of a foreign file: the next reader reports it
        return None


def decode_array(array: ElementTree.Element, root: ElementTree.Element) -> NDArray[Any]:
    """Return the numbers of one small array (ASCII or base64) of a document; raises ValueError if they are damaged."""
    if array.get("format") == "ascii":
        dtype = NUMPY_TYPES.get(array.get("type", ""), "f8")
        return np.array([float(word) for word in (array.text or "").split()]).astype(dtype)
    try:
        encoding = _find_encoding(root, {})
        tuples = array.get("NumberOfTuples")
        return unpack(_pack(array, None if tuples is None else int(tuples), encoding), Path(), array.get("Name", ""))
    except (_NotInlineError, SeriesError, KeyError, struct.error) as error:
        raise ValueError(f"the array {array.get('Name')} is damaged") from error


def unpack(array: Packed, file: Path, name: str) -> NDArray[Any]:
    """Return the numbers of an array, writable; raises SeriesError if they are damaged."""
    try:
        data = a2b_base64(array.text, strict_mode=True)
        # damaged padding at the end changes the length, and would shift every number
        if len(data) - (sum(array.packed_sizes) or array.nbytes) not in ((0,) if array.packed_sizes else _HEADER_BYTES):
            raise ValueError(f"{len(data)} bytes instead of {array.nbytes}")
        if len(array.packed_sizes) == 1:
            data = _inflate(data, array.sizes[0])
        elif array.packed_sizes:
            ends = np.cumsum(array.packed_sizes).tolist()
            starts = [0, *ends[:-1]]
            data = b"".join(_inflate(data[a:b], n) for a, b, n in zip(starts, ends, array.sizes, strict=True))
        else:
            data = data[-array.nbytes :]
        if array.dtype == "S":
            return _split_texts(data, array.shape[0])
        numbers = np.frombuffer(data, dtype=array.dtype).reshape(array.shape)
    except (ValueError, zlib.error) as error:
        raise SeriesError(f"{file}: cannot be read (the array {name}: {error})") from error
    return numbers.astype(numbers.dtype.newbyteorder("="))


def _split_texts(data: bytes, count: int) -> NDArray[Any]:
    """Return texts, each of which ends with a zero; raises ValueError unless there are `count`."""
    *texts, rest = data.split(b"\0")
    if rest or len(texts) != count:
        raise ValueError(f"{len(texts)} texts, not {count}")
    if 4 * count * max(map(len, texts)) > _LEAST_BYTES:  # numpy makes each as long as the longest
        raise ValueError(f"{count} texts that differ too much in length")
    return np.array([text.decode() for text in texts])


def _inflate(block: bytes, size: int) -> bytes:
    """Return a block decompressed; raises ValueError if it does not have that size."""
    decompressor = zlib.decompressobj()
    content = decompressor.decompress(block, size + 1)  # one byte more reveals an excess
    if len(content) != size or not decompressor.eof:
        raise ValueError(f"a block of {size} bytes is damaged")
    return content


def _parse_file(file: Path) -> Grid:
    with file.open("rb") as stream:
        size, head = os.fstat(stream.fileno()).st_size, stream.read(_HEAD)
        if size > _LARGEST or any(word in head for word in _NOT_INLINE):
            raise _NotInlineError
        stream.seek(0)
        content = stream.read(size)
    if is_wide(content):
        raise _NotInlineError
    xml, texts = _take_out_texts(content)
    root = ElementTree.fromstring(xml)
    (grid,) = root
    pieces = grid.findall("Piece")
    if root.tag != "VTKFile" or grid.tag != "UnstructuredGrid" or len(pieces) != 1:
        raise _NotInlineError
    (piece,) = pieces
    if "TimeValues" in grid.attrib:  # several steps
        raise _NotInlineError
    encoding = _find_encoding(root, texts)
    counts = {name: int(piece.attrib[name]) for name in _SECTIONS.values()}
    field_data = {
        array.attrib["Name"]: _pack(array, int(array.attrib["NumberOfTuples"]), encoding)
        for array in _find_arrays(grid, "FieldData")
    }
    point_data, cell_data = (
        {array.attrib["Name"]: _pack(array, counts[count], encoding) for array in _find_arrays(piece, section)}
        for section, count in _SECTIONS.items()
    )
    (point_array,) = _find_arrays(piece, "Points")
    points = _pack(point_array, counts["NumberOfPoints"], encoding)
    cells = {array.attrib["Name"]: _pack(array, None, encoding) for array in _find_arrays(piece, "Cells")}
    groups = ({"Points": points}, point_data, cell_data, field_data, cells)
    total = sum(array.nbytes for group in groups for array in group.values())
    if total > max(_LEAST_BYTES, _BYTES_PER_BYTE * size) or points.shape[1:] != (3,):
        raise _NotInlineError
    if cells.keys() != {"connectivity", "offsets", "types"} or "vtkGhostType" in cell_data:
        raise _NotInlineError
    cell_arrays = _decode_cells(cells["types"], cells["offsets"], cells["connectivity"], *counts.values())
    located, nodal, cellular, numbers = (_make_lazy(group, file) for group in groups[:4])
    return Grid(located, points.shape[0], *cell_arrays, nodal, cellular, numbers)


def _make_lazy(group: dict[str, Packed], file: Path) -> LazyArrays:
    nbytes = sum(len(array.text) for array in group.values())
    return LazyArrays(group, lambda array, name: unpack(array, file, name), nbytes)


def _take_out_texts(content: bytes) -> tuple[bytes, dict[bytes, bytes]]:
    """Return the XML with @k in place of the k-th text long enough to hold numbers, and those texts by their @k.

    A parser would look at every character of them, which would take most of the reading time. Base64 has no @.
    """
    parts, texts = content.split(b"<", _MOST_MARKS), dict[bytes, bytes]()
    odd = [part for part in parts[2:] if part.startswith((b"!", b"?"))]  # the first two: <?xml and the text before it
    if len(parts) > _MOST_MARKS or any(part.startswith(b"!DOCTYPE") for part in parts):
        raise _NotInlineError  # preflight refuses entities
    for i, part in enumerate([] if odd else parts):  # comments may contain text that looks like an element
        tag, end, text = part.partition(b">")
        if len(text) > _LONG and b"&" not in text and len(tag) < _LONG_TAG and _TAG.fullmatch(tag):
            mark = b"@%d" % len(texts)
            parts[i], texts[mark] = tag + end + mark, text.strip()
    xml = b"<".join(parts)
    if xml.count(b'"') + xml.count(b"'") > _MOST_MARKS:
        raise _NotInlineError
    return xml, texts


def _find_arrays(element: ElementTree.Element, tag: str) -> list[ElementTree.Element]:
    """Return the arrays of a section, whose names must differ."""
    section = element.find(tag)
    arrays = [] if section is None else list(section)
    if len({array.get("Name") for array in arrays}) < len(arrays):
        raise _NotInlineError
    return arrays


class _Encoding(NamedTuple):
    """How the arrays of a file are written: byte order and header word in struct's letters."""

    order: str
    header: str
    compressed: bool
    texts: dict[bytes, bytes]  # from _take_out_texts


def _find_encoding(root: ElementTree.Element, texts: dict[bytes, bytes]) -> _Encoding:
    return _Encoding(
        _BYTE_ORDERS[root.attrib["byte_order"]], _HEADERS[root.get("header_type", "UInt32")],
        _COMPRESSORS[root.get("compressor")], texts,
    )  # fmt: skip


def _pack(array: ElementTree.Element, tuples: int | None, encoding: _Encoding) -> Packed:
    """Return an array with its sizes checked; `tuples` is its required number of tuples, None for any."""
    is_text = array.tag == "Array" and array.attrib["type"] == "String"
    if (array.tag != "DataArray" and not is_text) or array.attrib["format"] != "binary":
        raise _NotInlineError
    if any(child.tag != "InformationKey" for child in array):  # ranges that VTK adds after the numbers
        raise _NotInlineError
    numbers = (array.text or "").strip().encode()
    if numbers.startswith(b"@"):
        numbers = encoding.texts.pop(numbers)  # KeyError if the file itself contains the @
    sizes, packed_sizes, numbers = _split_header(numbers, encoding)
    if is_text and tuples:
        return Packed("S", (tuples,), sizes, packed_sizes, numbers)
    dtype = encoding.order + NUMPY_TYPES[array.attrib["type"]]
    components = int(array.get("NumberOfComponents", 1))
    item = int(dtype[2:]) * components
    if components < 1 or (tuples or 0) < 0:
        raise _NotInlineError
    if tuples is None:
        tuples = sum(sizes) // item
    if sum(sizes) != tuples * item or not sum(sizes):
        raise _NotInlineError
    return Packed(dtype, (tuples,) if components == 1 else (tuples, components), sizes, packed_sizes, numbers)


def _split_header(text: bytes, encoding: _Encoding) -> tuple[tuple[int, ...], tuple[int, ...], bytes]:
    """Return the bytes of each block, decoded and packed, and the text of the blocks."""
    word = _WORD_BYTES[encoding.header]
    if not encoding.compressed:
        (size,) = _read_words(text, 1, encoding)
        end = _count_characters(word)  # some programs encode the length by itself, others together with the numbers
        is_separate = text[:end].endswith(b"=")
        expected = end + _count_characters(size) if is_separate else _count_characters(word + size)
        if len(text) != expected:
            raise _NotInlineError
        return (size,), (), text[end:] if is_separate else text
    count, size, last = _read_words(text, 3, encoding)
    start = _count_characters((3 + count) * word)
    if not count or start >= len(text):
        raise _NotInlineError
    packed_sizes = _read_words(text, 3 + count, encoding)[3:]
    if len(text) - start != _count_characters(sum(packed_sizes)):
        raise _NotInlineError
    return (*(size,) * (count - 1), last or size), packed_sizes, text[start:]


def _count_characters(size: int) -> int:
    """Return the number of base64 characters for this many bytes."""
    return -(-size // 3) * 4


def _read_words(text: bytes, count: int, encoding: _Encoding) -> tuple[int, ...]:
    """Return the first numbers of a header."""
    header = struct.Struct(f"{encoding.order}{count}{encoding.header}")
    return header.unpack_from(a2b_base64(text[: _count_characters(header.size)], strict_mode=True))


@lru_cache(maxsize=4)  # the frames of a series encode their cells alike
def _decode_cells(
    types: Packed, offsets: Packed, connectivity: Packed, points: int, cells: int
) -> tuple[NDArray[np.uint8], Ints, Ints]:
    """Return types, offsets from 0 on and connectivity; raises _NotInlineError if VTK should report a fault."""
    if any(array.dtype[1] == "f" or len(array.shape) > 1 for array in (types, offsets, connectivity)):
        raise _NotInlineError
    nowhere = Path()  # the caller discards the message
    cell_types = unpack(types, nowhere, "types").astype(np.uint8).reshape(-1)
    ends = unpack(offsets, nowhere, "offsets").astype(np.int64).reshape(-1)
    corners = unpack(connectivity, nowhere, "connectivity").astype(np.int64).reshape(-1)
    expected = np.array([CORNERS.get(cell_type, -1) for cell_type in range(256)])[cell_types]
    starts = np.concatenate([[0], ends])
    counts_fit = len(cell_types) == len(ends) == cells and len(corners) == starts[-1]
    if not counts_fit or not np.array_equal(np.diff(starts), expected):
        raise _NotInlineError
    if corners.min() < 0 or corners.max() >= points:
        raise _NotInlineError
    for array in (cell_types, starts, corners):
        array.flags.writeable = False  # shared by all frames
    return cell_types, starts, corners
