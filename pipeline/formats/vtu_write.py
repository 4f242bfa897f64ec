"""Writes .vtu files: inline base64 with zlib; the reader is vtu_read.

Appended data is never written, because ParaView in several distributions cannot read it. The parts that frames
share (cells, rest positions) are compressed once and well, the rest quickly: low digits hardly compress.
https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

import zlib
from base64 import b64encode
from collections.abc import Iterable
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Fields
from pipeline.formats.grid import CellArray, PolyhedronFaces
from pipeline.formats.vtu_read import NUMPY_TYPES

_TYPE_NAMES = {dtype: name for name, dtype in NUMPY_TYPES.items()}
_HEAD = (
    '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="{}" byte_order="LittleEndian" '
    'header_type="UInt64" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n'
)
# readers turn Lagrange hexahedra of older versions into today's order of nodes, which is ours already
_VERSION, _VERSION_OF_HEXAHEDRA, _LAGRANGE_HEXAHEDRON = "1.0", "2.2", 72
_TAIL = b"</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"


class StaticParts(NamedTuple):
    """The parts that all frames share, encoded: counts of points and cells, the cells, the rest positions, the head."""

    counts: tuple[int, int]
    cells: bytes
    rest: bytes
    head: bytes = _HEAD.format(_VERSION).encode()


def encode_static_parts(cells: CellArray, rest: NDArray[np.floating]) -> StaticParts:
    """Return the parts that frames with these cells and rest positions (n, 3) share."""
    arrays: dict[str, NDArray[Any]] = {
        "connectivity": cells.connectivity.astype(np.int64, copy=False),
        "offsets": cells.offsets[1:].astype(np.int64, copy=False),
        "types": cells.types,
    }
    if cells.faces is not None:
        arrays |= _list_faces(cells.faces)
    encoded = _encode_element("Cells", (_encode_array(*item, static=True) for item in arrays.items()))
    version = _VERSION_OF_HEXAHEDRA if (cells.types == _LAGRANGE_HEXAHEDRON).any() else _VERSION
    head = _HEAD.format(version).encode()
    return StaticParts((len(rest), len(cells.types)), encoded, _encode_array("rest_position", rest, static=True), head)


def _list_faces(faces: PolyhedronFaces) -> dict[str, NDArray[Any]]:
    """Return the faces as all versions of ParaView read them: their number, then for each its size and points.

    `faceoffsets` are the ends of the polyhedra in that list, -1 for other cells.
    """
    lengths = np.diff(faces.offsets)
    # each face takes one place more than its points, and each polyhedron another one for the number of its faces
    per_cell = np.diff(faces.cell_offsets)
    places = np.concatenate([[0], np.cumsum(lengths + 1)])
    ends = places[faces.cell_offsets[1:]] + np.cumsum(per_cell > 0)
    stream = np.empty(int(places[-1]) + int((per_cell > 0).sum()), dtype=np.int64)
    owner = np.repeat(np.cumsum(per_cell > 0), per_cell)  # the polyhedra up to that of each face, itself included
    sizes_at = places[:-1] + owner
    stream[sizes_at] = lengths
    firsts = np.repeat(sizes_at + 1 - faces.offsets[:-1], lengths)
    stream[np.arange(len(faces.connectivity)) + firsts] = faces.connectivity
    whole = per_cell > 0
    stream[sizes_at[faces.cell_offsets[:-1][whole]] - 1] = per_cell[whole]
    return {"faces": stream, "faceoffsets": np.where(whole, ends, -1).astype(np.int64)}


def encode_vtu(
    points: NDArray[np.floating], point_data: Fields, cell_data: Fields, field_data: Fields, static: StaticParts
) -> bytes:
    """Return one frame as a .vtu: points (n, 3), fields of nodes and cells, numbers of the body as rows (1, k).

    Field data of bytes (dtype S) become strings.
    """
    numbers = (_encode_array(name, value, tuples=len(value)) for name, value in field_data.items())
    return b"".join(
        (
            static.head,
            _encode_element("FieldData", numbers),
            '<Piece NumberOfPoints="{}" NumberOfCells="{}">'.format(*static.counts).encode(),
            _encode_element("PointData", [*(_encode_array(*item) for item in point_data.items()), static.rest]),
            _encode_element("CellData", (_encode_array(*item) for item in cell_data.items())),
            _encode_element("Points", [_encode_array("Points", points)]),
            static.cells,
            _TAIL,
        )
    )


def _encode_element(name: str, arrays: Iterable[bytes]) -> bytes:
    return b"".join((f"<{name}>\n".encode(), *arrays, f"</{name}>\n".encode()))


def _encode_array(name: str, values: NDArray[Any], *, tuples: int | None = None, static: bool = False) -> bytes:
    """Return a DataArray: one zlib block after a header of four numbers, each part in base64.

    Bytes (dtype S) become strings, each ending with a zero.
    """
    kind = values.dtype.str[1:]
    if values.dtype.kind == "S":
        tag, type_name, data = "Array", "String", memoryview(b"".join(text + b"\0" for text in values.tolist()))
    else:
        tag, type_name = "DataArray", _TYPE_NAMES[kind]
        data = np.ascontiguousarray(values, dtype=f"<{kind}").data.cast("B")
    # only run lengths and entropy coding: three times as fast on floats as level 1, files 3 % larger
    compressor = zlib.compressobj(6) if static else zlib.compressobj(1, strategy=zlib.Z_RLE)
    packed = compressor.compress(data) + compressor.flush()
    header = np.array([1, len(data), 0, len(packed)], dtype="<u8").tobytes()
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    count = "" if tuples is None else f' NumberOfTuples="{tuples}"'
    start = f'<{tag} type="{type_name}" Name={quoteattr(name)}{components}{count} format="binary">'
    return b"".join((start.encode(), b64encode(header), b64encode(packed), f"</{tag}>\n".encode()))
