"""Writers of VTK's file formats for random contents: by hand with every layout, and through VTK's own writers."""

import base64
import lzma
import struct
import zlib
from dataclasses import replace
from itertools import chain
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from tests.formats.generated_content import (
    NO_MARKUP,
    PLAIN_NAMES,
    SOLIDS,
    Content,
    add_polyhedra,
    join_contents,
    make_content,
    make_values,
)

_NAMES = {"f4": "Float32", "f8": "Float64"} | {
    f"{s}{n}": f"{'U' * (s == 'u')}Int{8 * n}" for s in "iu" for n in (1, 2, 4, 8)
}


class VtuWriter:
    """Writes one .vtu by hand; every choice of layout is random."""

    def __init__(self, random: np.random.Generator, *, inline: bool = False) -> None:
        self.random = random
        self.order = str(random.choice(["<", ">"]))
        self.header = str(random.choice(["UInt32", "UInt64", ""]))
        self.compressor = str(
            random.choice(
                ["", "vtkZLibDataCompressor"] if inline else ["", "vtkZLibDataCompressor", "vtkLZMADataCompressor"]
            )
        )
        self.formats = ["binary"] if inline else list(random.choice(["ascii", "binary", "appended"], size=2))
        self.raw = bool(random.random() < 0.5)
        self.appended = b""
        self.quote = str(random.choice(['"', "'"]))
        self.gap = str(random.choice(["\n", "\n  ", "", "\n<!-- comment -->\n"]))

    def write(self, path: Path, contents: list[Content]) -> None:
        first = contents[0]
        self.points = "f4" if all(np.array_equal(c.points, c.points.astype("f4")) for c in contents) else "f8"
        version = str(self.random.choice(["0.1", "1.0", "2.0"]))
        root = {
            "type": "UnstructuredGrid",
            "version": version,
            "byte_order": {"<": "LittleEndian", ">": "BigEndian"}[self.order],
        }
        if self.header:
            root["header_type"] = self.header
        if self.compressor:
            root["compressor"] = self.compressor
        fields = "".join(self._array(name, np.atleast_1d(v), tuples=True) for name, v in first.field_data.items())
        body = f"<FieldData>{self.gap}{fields}</FieldData>{self.gap}" if fields else ""
        body += "".join(self._piece(content) for content in contents)
        text = f"<VTKFile {self._join(root)}>{self.gap}<UnstructuredGrid>{self.gap}{body}</UnstructuredGrid>{self.gap}"
        if self.random.random() < 0.8:
            text = '<?xml version="1.0"?>\n' + text
        data = text.encode()
        if self.appended:
            encoding = "raw" if self.raw else "base64"
            data += f'<AppendedData encoding="{encoding}">\n_'.encode() + self.appended + b"\n</AppendedData>\n"
        path.write_bytes(data + b"</VTKFile>\n")

    def _join(self, attributes: dict[str, object]) -> str:
        items = list(attributes.items())
        items = [items[i] for i in self.random.permutation(len(items))]
        quoted = ((key, escape(str(value), {'"': "&quot;", "'": "&apos;"})) for key, value in items)
        return " ".join(f"{key}={self.quote}{value}{self.quote}" for key, value in quoted)

    def _piece(self, content: Content) -> str:
        def section(name: str, arrays: dict[str, np.ndarray]) -> str:
            return f"<{name}>{self.gap}{''.join(self._array(n, v) for n, v in arrays.items())}</{name}>{self.gap}"

        kind = str(self.random.choice(["i4", "i8"]))
        points = content.points.astype(self.points)
        cells = {
            "connectivity": content.connectivity.astype(kind),
            "offsets": content.offsets[1:].astype(kind),
            "types": content.types.astype("u1"),
        }
        if content.faces:
            solid = np.flatnonzero(content.types == 42)
            streams = [[len(f), *chain.from_iterable([len(face), *face] for face in f)] for f in content.faces]
            ends = np.full(len(content.types), -1, dtype=kind)
            ends[solid] = np.cumsum([len(stream) for stream in streams])
            cells |= {"faces": np.concatenate(streams).astype(kind), "faceoffsets": ends}
        sections = [
            section("PointData", content.point_data),
            section("CellData", content.cell_data),
            section("Points", {"Points": points}),
            section("Cells", cells),
        ]
        head = self._join({"NumberOfPoints": len(content.points), "NumberOfCells": len(content.types)})
        return f"<Piece {head}>{self.gap}{''.join(sections)}</Piece>{self.gap}"

    def _array(self, name: str, values: np.ndarray, *, tuples: bool = False) -> str:
        form = str(self.random.choice(self.formats))
        attributes: dict[str, object] = {"type": _NAMES[values.dtype.str[1:]], "Name": name, "format": form}
        if values.ndim == 2 or self.random.random() < 0.3:
            attributes["NumberOfComponents"] = 1 if values.ndim == 1 else values.shape[1]
        if tuples:
            attributes["NumberOfTuples"] = len(values)
        if form == "ascii":
            content = str(self.random.choice(["\n", " ", "\n   "])).join(map(str, values.ravel().tolist()))
        else:
            data = values.astype(values.dtype.newbyteorder(self.order)).tobytes()
            if form == "appended":
                attributes["offset"] = len(self.appended)
                self.appended += self._encode(data, raw=self.raw)
                return f"<DataArray {self._join(attributes)}/>{self.gap}"
            content = self._encode(data, raw=False).decode()
        space = str(self.random.choice(["", "\n", "\n    "]))
        return f"<DataArray {self._join(attributes)}>{space}{content}{space}</DataArray>{self.gap}"

    def _encode(self, data: bytes, *, raw: bool) -> bytes:
        word = "Q" if self.header == "UInt64" else "I"
        as_text = (lambda b: b) if raw else base64.b64encode
        if not self.compressor:
            return as_text(struct.pack(f"{self.order}{word}", len(data)) + data)
        size = int(self.random.choice([32, 64, 1 << 15]))
        blocks = [data[k : k + size] for k in range(0, len(data), size)]
        pack = zlib.compress if "ZLib" in self.compressor else lzma.compress
        packed = [pack(block) for block in blocks]
        last = len(blocks[-1]) if blocks and len(blocks[-1]) < size else 0
        head = struct.pack(f"{self.order}{3 + len(packed)}{word}", len(packed), size, last, *map(len, packed))
        return as_text(head) + as_text(b"".join(packed))


def write_vtu_by_hand(random: np.random.Generator, path: Path) -> Content:
    content = make_content(random)
    if random.random() < 0.4:
        content.field_data["TimeValue"] = np.array([random.random()])
    if random.random() < 0.2:
        add_polyhedra(random, content)
    contents = [content]
    if random.random() < 0.25 and not content.faces:
        contents += [_make_alike(random, content) for _ in range(int(random.integers(1, 3)))]
    VtuWriter(random).write(path, contents)
    return join_contents(contents) if len(contents) > 1 else content


def _make_alike(random: np.random.Generator, content: Content) -> Content:
    """Another content with fields of the same names and types.

    It has solid cells: pieces with surfaces alone beside those with solids are left out, with a note.
    """
    other = make_content(random, kinds=SOLIDS)
    for kind, count in (("point_data", len(other.points)), ("cell_data", len(other.types))):
        fields = {
            name: make_values(random, count, v.dtype.str[1:], 1 if v.ndim == 1 else v.shape[1])
            for name, v in getattr(content, kind).items()
        }
        other = replace(other, **{kind: fields})
    return other


def write_inline_vtu(random: np.random.Generator, path: Path) -> Content:
    """A file that our own reader reads: one piece, binary, plain or compressed with zlib."""
    content = make_content(random, kinds=(10, 12, 13, 14, 24))
    if random.random() < 0.5:
        content.field_data["TimeValue"] = np.array([random.random()])
    VtuWriter(random, inline=True).write(path, [content])
    return content


def make_vtk_grid(content: Content):
    """The content as a vtkUnstructuredGrid."""
    import vtk
    from vtkmodules.util.numpy_support import numpy_to_vtk

    grid, points = vtk.vtkUnstructuredGrid(), vtk.vtkPoints()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(content.points, deep=True))
    grid.SetPoints(points)
    solids = iter(content.faces)
    for kind, nodes in zip(content.types.tolist(), content.cells, strict=True):
        if kind == 42:
            faces = next(solids)
            stream = vtk.vtkIdList()
            for value in [len(faces), *chain.from_iterable([len(f), *f] for f in faces)]:
                stream.InsertNextId(value)
            grid.InsertNextCell(42, stream)
        else:
            grid.InsertNextCell(kind, len(nodes), nodes)
    fill_vtk_fields(grid, content)
    return grid


def fill_vtk_fields(data, content: Content) -> None:
    """Add the fields of a content to a VTK dataset."""
    from vtkmodules.util.numpy_support import numpy_to_vtk

    groups = (
        (data.GetPointData(), content.point_data),
        (data.GetCellData(), content.cell_data),
        (data.GetFieldData(), content.field_data),
    )
    for target, fields in groups:
        for name, values in fields.items():
            array = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
            array.SetName(name)
            target.AddArray(array)


def write_vtu_by_vtk(random: np.random.Generator, path: Path) -> Content:
    import vtk

    content = make_content(random, names=NO_MARKUP)  # VTK's writer does not escape < and & in names
    if random.random() < 0.2:
        add_polyhedra(random, content)
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetInputData(make_vtk_grid(content))
    set_layout(writer, random)
    writer.SetFileName(str(path))
    writer.Write()
    return content


def set_layout(writer, random: np.random.Generator) -> None:
    """Choose encoding, compressor, byte order and header of one of VTK's XML writers."""
    mode = str(random.choice(["Ascii", "Binary", "Appended"]))
    getattr(writer, f"SetDataModeTo{mode}")()
    getattr(writer, f"SetCompressorTypeTo{random.choice(['None', 'ZLib', 'LZ4', 'LZMA'])}")()
    getattr(writer, f"SetByteOrderTo{random.choice(['Little', 'Big'])}Endian")()
    getattr(writer, f"SetHeaderTypeTo{random.choice(['UInt32', 'UInt64'])}")()
    writer.SetEncodeAppendedData(int(random.integers(2)))
    writer.SetBlockSize(int(random.choice([64, 1 << 15])))


def write_vtp(random: np.random.Generator, path: Path) -> Content:
    """Polygons, lines and vertices; they come in VTK's order: vertices, lines, polygons."""
    import vtk
    from vtkmodules.util.numpy_support import numpy_to_vtk

    content = make_content(random, kinds=(1, 3, 5, 9), names=NO_MARKUP)
    order = np.argsort([{1: 0, 3: 1}.get(int(kind), 2) for kind in content.types], kind="stable")
    cells = [content.cells[i] for i in order]
    content.types = content.types[order]
    content.offsets = np.cumsum([0, *map(len, cells)]).astype(np.int64)
    content.connectivity = np.concatenate([np.array(c, dtype=np.int64) for c in cells])
    data, points = vtk.vtkPolyData(), vtk.vtkPoints()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(content.points, deep=True))
    data.SetPoints(points)
    arrays = {group: vtk.vtkCellArray() for group in ("Verts", "Lines", "Polys")}
    for kind, nodes in zip(content.types.tolist(), cells, strict=True):
        arrays[{1: "Verts", 3: "Lines"}.get(kind, "Polys")].InsertNextCell(len(nodes), nodes)
    for group, cell_array in arrays.items():
        getattr(data, f"Set{group}")(cell_array)
    fill_vtk_fields(data, content)
    writer = vtk.vtkXMLPolyDataWriter()
    writer.SetInputData(data)
    set_layout(writer, random)
    writer.SetFileName(str(path))
    writer.Write()
    return content


def write_legacy(random: np.random.Generator, path: Path) -> Content:
    import vtk

    content = make_content(random, names=PLAIN_NAMES)
    writer = vtk.vtkUnstructuredGridWriter()
    writer.SetInputData(make_vtk_grid(content))
    content.digits = int(random.choice([0, 11]))  # VTK writes 11 digits as text
    writer.SetFileType(vtk.VTK_ASCII if content.digits else vtk.VTK_BINARY)
    writer.SetFileVersion(int(random.choice([42, 51])))
    writer.SetFileName(str(path))
    writer.Write()
    return content


def write_pvtu(random: np.random.Generator, path: Path) -> Content:
    """A parallel file of one to three pieces beside it or in a folder."""
    first = make_content(random, kinds=SOLIDS, names=PLAIN_NAMES)
    contents = [first, *(_make_alike(random, first) for _ in range(int(random.integers(0, 3))))]
    folder = str(random.choice(["", "pieces/"]))
    (path.parent / folder).mkdir(exist_ok=True)
    sources = ""
    for content in contents:  # VTK takes the type of the first piece for all
        content.points = content.points.astype("f4").astype("f8")
    for k, content in enumerate(contents):
        name = f"{folder}{path.stem}_{k}.vtu"
        VtuWriter(random).write(path.parent / name, [content])
        sources += f'<Piece Source="{name}"/>\n'

    def declare(tag: str, fields: dict[str, np.ndarray]) -> str:
        rows = (
            f'<PDataArray type="{_NAMES[v.dtype.str[1:]]}" Name="{name}" '
            f'NumberOfComponents="{1 if v.ndim == 1 else v.shape[1]}"/>\n'
            for name, v in fields.items()
        )
        return f"<{tag}>{''.join(rows)}</{tag}>\n"

    path.write_text(
        '<?xml version="1.0"?>\n<VTKFile type="PUnstructuredGrid" version="0.1" byte_order="LittleEndian">\n'
        '<PUnstructuredGrid GhostLevel="0">\n'
        + declare("PPointData", first.point_data)
        + declare("PCellData", first.cell_data)
        + '<PPoints><PDataArray type="Float64" NumberOfComponents="3"/></PPoints>\n'
        + f"{sources}</PUnstructuredGrid>\n</VTKFile>\n"
    )
    return join_contents(contents)


def write_vtm(random: np.random.Generator, path: Path) -> Content:
    """A file of one to three blocks."""
    import vtk

    first = make_content(random, kinds=SOLIDS, names=NO_MARKUP)
    contents = [first, *(_make_alike(random, first) for _ in range(int(random.integers(0, 3))))]
    blocks = vtk.vtkMultiBlockDataSet()
    for k, content in enumerate(contents):
        blocks.SetBlock(k, make_vtk_grid(content))
        blocks.GetMetaData(k).Set(vtk.vtkCompositeDataSet.NAME(), f"block {k}")
    writer = vtk.vtkXMLMultiBlockDataWriter()
    writer.SetInputData(blocks)
    set_layout(writer, random)
    writer.SetFileName(str(path))
    writer.Write()
    return join_contents(contents)
