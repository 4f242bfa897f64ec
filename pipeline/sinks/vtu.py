"""ParaView files: a .vtu a frame, inline base64 with zlib, and a .pvd index with the true times.

Appended data is never written: the ParaView of several distributions cannot read it. What the frames share (cells,
rest positions) is compressed once and well, the rest quickly: the low digits of a number do not compress.
"""

import time
import zlib
from base64 import b64encode
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Ints
from pipeline.formats.atomic import write_whole
from pipeline.formats.cell_types import CELL_TYPES
from pipeline.formats.vtu_read import TYPES
from pipeline.mesh.simplex import Mesh
from pipeline.run.frame import Frame, Values
from pipeline.sinks.fields import FrameFields, Precision, frame_fields, rest_positions

_TYPES = {kind: name for name, kind in TYPES.items()}
_INDEX_SECONDS = 1.0  # the index grows with the run; written every frame it would cost the square of it


class VtuSink:
    """Writes frames/frame_000000.vtu … and series.pvd into a folder, after frames of `earlier` times [s] there.

    With `precision` "float32" the fields of nodes and cells take half the room; the dataset cannot be made from them.
    """

    def __init__(self, folder: Path, *, earlier: Sequence[float] = (), precision: Precision = "float64") -> None:
        self.folder = Path(folder)
        self.index = self.folder / "series.pvd"
        self.precision = precision
        self._rows = bytearray(pvd_rows((t, frame_file(index)) for index, t in enumerate(earlier)))
        self._indexed = -np.inf
        self._mesh: Mesh | None = None
        self._static: StaticParts

    def write(self, frame: Frame, measured: Values) -> None:
        """Write one frame whole; the index follows within a second."""
        name = frame_file(frame.index)
        write_whole(self.folder / name, self._encoded(frame, measured))
        self._rows += pvd_rows([(frame.time, name)])
        if time.monotonic() - self._indexed >= _INDEX_SECONDS:
            self._write_index()

    def close(self) -> None:
        """Write the index of all frames."""
        if self._rows:
            self._write_index()

    def _write_index(self) -> None:
        write_whole(self.index, b"".join((_PVD_HEAD, self._rows, _PVD_TAIL)))
        self._indexed = time.monotonic()

    def _encoded(self, frame: Frame, measured: Values) -> bytes:
        """Return the frame's .vtu."""
        mesh = frame.mesh
        if self._mesh is not mesh:
            self._mesh = mesh
            self._static = static_parts(mesh.cells, rest_positions(mesh, self.precision))
        return vtu_text(frame_fields(frame, measured, self.precision), self._static)


class StaticParts(NamedTuple):
    """What all frames share, encoded: counts of points and cells, the cells, the rest positions."""

    counts: tuple[int, int]
    cells: bytes
    rest: bytes


def static_parts(cells: Ints, rest: NDArray[np.floating]) -> StaticParts:
    """Return what the frames of cells (e, d + 1) at rest positions (n, 3) share."""
    e, corners = cells.shape
    offsets = np.arange(corners, corners * e + 1, corners, dtype=np.int64)
    types = np.full(e, CELL_TYPES[corners - 1], dtype=np.uint8)
    named = {"connectivity": cells.astype(np.int64, copy=False).ravel(), "offsets": offsets, "types": types}
    encoded = _element("Cells", (_array(*one, static=True) for one in named.items()))
    return StaticParts((len(rest), e), encoded, _array("rest_position", rest, static=True))


def vtu_text(fields: FrameFields, static: StaticParts) -> bytes:
    """Return one frame as a .vtu."""
    numbers = (_array(name, value, tuples=len(value)) for name, value in fields.numbers.items())
    return b"".join(
        (
            _HEAD,
            _element("FieldData", numbers),
            '<Piece NumberOfPoints="{}" NumberOfCells="{}">'.format(*static.counts).encode(),
            _element("PointData", [*(_array(*one) for one in fields.nodal.items()), static.rest]),
            _element("CellData", (_array(*one) for one in fields.cellular.items())),
            _element("Points", [_array("Points", fields.points)]),
            static.cells,
            _TAIL,
        )
    )


_HEAD = (
    b'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
    b'header_type="UInt64" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n'
)
_TAIL = b"</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"


def _element(name: str, arrays: Iterable[bytes]) -> bytes:
    return b"".join((f"<{name}>\n".encode(), *arrays, f"</{name}>\n".encode()))


def _array(name: str, values: NDArray[Any], *, tuples: int | None = None, static: bool = False) -> bytes:
    """Return a DataArray: one block of zlib behind a header of four numbers, each part in base64.

    Bytes (dtype S) become texts, which end with a zero.
    """
    kind = values.dtype.str[1:]
    if values.dtype.kind == "S":
        tag, type_name, plain = "Array", "String", memoryview(b"".join(text + b"\0" for text in values.tolist()))
    else:
        tag, type_name, plain = "DataArray", _TYPES[kind], np.ascontiguousarray(values, dtype=f"<{kind}").data.cast("B")
    # runs and entropy alone: three times as fast on floats as level 1, files 3 % larger
    compressor = zlib.compressobj(6) if static else zlib.compressobj(1, strategy=zlib.Z_RLE)
    packed = compressor.compress(plain) + compressor.flush()
    header = np.array([1, len(plain), 0, len(packed)], dtype="<u8").tobytes()
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    count = "" if tuples is None else f' NumberOfTuples="{tuples}"'
    start = f'<{tag} type="{type_name}" Name={quoteattr(name)}{components}{count} format="binary">'
    return b"".join((start.encode(), b64encode(header), b64encode(packed), f"</{tag}>\n".encode()))


def frame_file(index: int) -> str:
    """Return the name of a frame's file, within the folder of the run."""
    return f"frames/frame_{index:06d}.vtu"


_PVD_HEAD = b"""<?xml version="1.0"?>
<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">
  <Collection>
"""
_PVD_TAIL = b"  </Collection>\n</VTKFile>\n"


def pvd_rows(listed: Iterable[tuple[float, str]]) -> bytes:
    """Return the lines of a ParaView index for (time [s], file) pairs."""
    rows = (f"    <DataSet timestep={quoteattr(repr(t))} file={quoteattr(name)}/>\n" for t, name in listed)
    return "".join(rows).encode()


def pvd_text(listed: Iterable[tuple[float, str]]) -> bytes:
    """Return a whole ParaView index of (time [s], file) pairs."""
    return b"".join((_PVD_HEAD, pvd_rows(listed), _PVD_TAIL))
