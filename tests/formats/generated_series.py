"""Writers of files of whole series with random contents: XDMF by hand, VTKHDF by h5py, indices of numbered files."""

from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from tests.formats.generated_content import PLAIN_NAMES, Content, make_content, make_fields, make_tetrahedra
from tests.formats.generated_vtk import VtuWriter

_XDMF_KINDS = {5: "Triangle", 9: "Quadrilateral", 10: "Tetrahedron", 12: "Hexahedron", 13: "Wedge", 14: "Pyramid",
               22: "Tri_6", 24: "Tet_10", 25: "Hex_20"}  # fmt: skip
_XDMF_CODES = {5: 4, 9: 5, 10: 6, 12: 9, 13: 8, 14: 7, 22: 36, 24: 38, 25: 48}
_FIRST_MESH = "xpointer(//Grid[@Name=&quot;g0&quot;]/*[self::Topology or self::Geometry])"
_XDMF_TYPES = ["f4", "f8", "i1", "i2", "i4", "i8", "u1", "u4"]


class Steps(NamedTuple):
    """The times of a series (None if the file has none) and what each instant must give."""

    times: list[float] | None
    contents: list[Content]


class _XdmfWriter:
    """Writes arrays as items of an XDMF file: text, HDF5, or raw binary of either byte order, at random."""

    def __init__(self, random: np.random.Generator, path: Path) -> None:
        self.random, self.path = random, path
        self.formats = list(random.choice(["XML", "HDF", "Binary"], size=2))
        self.order = str(random.choice(["<", ">"]))
        self.together = bool(random.random() < 0.5)
        self.blob = b""
        self.count = 0
        self.hdf = h5py.File(path.with_suffix(".h5"), "w") if "HDF" in self.formats else None

    def item(self, values: np.ndarray) -> str:
        """An item, sometimes a hyperslab of a larger one."""
        if values.ndim == 2 and self.random.random() < 0.15:
            return self._slab(values)
        return self._plain(values)

    def _plain(self, values: np.ndarray) -> str:
        form = str(self.random.choice(self.formats))
        if form == "Binary" and values.dtype.kind == "u":
            form = "XML"
        kind = {"f": "Float", "i": "Int", "u": "UInt"}[values.dtype.kind]
        size = " ".join(map(str, values.shape))
        head = f'Dimensions="{size}" NumberType="{kind}" Precision="{values.dtype.itemsize}" Format="{form}"'
        self.count += 1
        if form == "XML":
            text = str(self.random.choice([" ", "\n"])).join(map(str, values.ravel().tolist()))
            return f"<DataItem {head}>{text}</DataItem>"
        if form == "HDF":
            name = f"/group/a{self.count}"
            self.hdf.create_dataset(name, data=values)
            return f"<DataItem {head}>{self.path.stem}.h5:{name}</DataItem>"
        data = values.astype(values.dtype.newbyteorder(self.order)).tobytes()
        name, seek = f"{self.path.stem}_{self.count}.bin", ""
        if self.together:
            name, seek = f"{self.path.stem}.bin", f' Seek="{len(self.blob)}"'
            self.blob += data
        else:
            (self.path.parent / name).write_bytes(data)
        endian = {"<": "Little", ">": "Big"}[self.order]
        return f'<DataItem {head} Endian="{endian}"{seek}>{name}</DataItem>'

    def _slab(self, values: np.ndarray) -> str:
        rows, columns = values.shape
        wide = np.zeros((2 * rows + 1, columns), dtype=values.dtype)
        wide[1::2] = values
        selection = np.array([[1, 0], [2, 1], [rows, columns]])
        return (
            f'<DataItem ItemType="HyperSlab" Dimensions="{rows} {columns}"><DataItem Dimensions="3 2" Format="XML">'
            f"{' '.join(map(str, selection.ravel()))}</DataItem>{self._plain(wide)}</DataItem>"
        )

    def mesh(self, content: Content) -> str:
        """The Topology and the Geometry of a content."""
        kinds = set(content.types.tolist())
        if len(kinds) == 1 and self.random.random() < 0.7:
            kind = kinds.pop()
            cells = content.connectivity.reshape(len(content.types), -1)
            topology = f'TopologyType="{_XDMF_KINDS[kind]}" NumberOfElements="{len(cells)}"'
        else:
            parts = [[_XDMF_CODES[int(k)], *c] for k, c in zip(content.types, content.cells, strict=True)]
            cells = np.concatenate(parts)
            topology = f'TopologyType="Mixed" NumberOfElements="{len(parts)}"'
        points = self.item(content.points)
        geometry = f'<Geometry GeometryType="XYZ">{points}</Geometry>'
        if self.random.random() < 0.15:
            items = "".join(self._plain(column.copy()) for column in content.points.T)
            geometry = f'<Geometry GeometryType="X_Y_Z">{items}</Geometry>'
        items = self.item(cells.astype(str(self.random.choice(["i4", "i8"]))))
        return f"<Topology {topology}>{items}</Topology>{geometry}"

    def fields(self, content: Content) -> str:
        """The attributes of a content."""
        rows = []
        for center, data in (("Node", content.point_data), ("Cell", content.cell_data)):
            for name, values in data.items():
                components = 1 if values.ndim == 1 else values.shape[1]
                kind = {1: "Scalar", 2: "Matrix", 3: "Vector", 6: "Tensor6", 9: "Tensor"}[components]
                rows.append(
                    f'<Attribute Name="{name}" AttributeType="{kind}" Center="{center}">{self.item(values)}</Attribute>'
                )
        return "".join(rows)

    def finish(self, grids: str) -> None:
        if self.blob:
            (self.path.parent / f"{self.path.stem}.bin").write_bytes(self.blob)
        if self.hdf is not None:
            self.hdf.close()
        head = '<?xml version="1.0"?>\n<Xdmf Version="3.0" xmlns:xi="http://www.w3.org/2001/XInclude"><Domain>'
        self.path.write_text(f"{head}{grids}</Domain></Xdmf>\n")


def write_xdmf(random: np.random.Generator, path: Path) -> Steps:
    """One static grid, or a temporal collection with a fixed or moving mesh."""
    writer = _XdmfWriter(random, path)
    pool = tuple(_XDMF_KINDS) if random.random() < 0.5 else (int(random.choice([10, 12, 24])),)
    content = make_content(random, kinds=pool, names=PLAIN_NAMES, types=_XDMF_TYPES)
    content.wider = True
    if random.random() < 0.3:
        writer.finish(f'<Grid Name="g" GridType="Uniform">{writer.mesh(content)}{writer.fields(content)}</Grid>')
        return Steps(None, [content])
    count = int(random.integers(2, 4))
    times = np.sort(random.choice(1000, size=count, replace=False) / 64).tolist()
    moves = random.random() < 0.5
    listed = random.random() < 0.3
    contents, grids = [], ""
    for k, time in enumerate(times):
        one = Content(
            content.points + (k if moves else 0), content.types, content.offsets, content.connectivity,
            make_fields(random, len(content.points), PLAIN_NAMES, _XDMF_TYPES),
            make_fields(random, len(content.types), PLAIN_NAMES, _XDMF_TYPES),
        )  # fmt: skip
        contents.append(one)
        mesh = writer.mesh(one)
        if k and not moves:
            mesh = str(random.choice([f'<xi:include xpointer="{_FIRST_MESH}"/>', mesh]))
        when = "" if listed else f'<Time Value="{time!r}"/>'
        grids += f'<Grid Name="g{k}" GridType="Uniform">{when}{mesh}{writer.fields(one)}</Grid>'
    listing = ""
    if listed:
        text = " ".join(map(repr, times))
        listing = f'<Time TimeType="List"><DataItem Dimensions="{count}" Format="XML">{text}</DataItem></Time>'
    for content in contents:
        content.wider = True
    writer.finish(f'<Grid Name="c" GridType="Collection" CollectionType="Temporal">{listing}{grids}</Grid>')
    return Steps(times, contents)


def write_vtkhdf(random: np.random.Generator, path: Path) -> Steps:
    """A VTKHDF file of unstructured grids: one instant, or several on one mesh that stays or moves."""
    content = make_content(random, kinds=(10, 12, 13, 14), names=PLAIN_NAMES)
    steps = int(random.integers(1, 4))
    moves = random.random() < 0.5
    point_data = [make_fields(random, len(content.points), PLAIN_NAMES[:1], ["f8"]) for _ in range(steps)]
    if any(
        point_data[0].keys() != fields.keys()
        or {n: v.shape for n, v in fields.items()} != {n: v.shape for n, v in point_data[0].items()}
        for fields in point_data
    ):
        point_data = [{} for _ in range(steps)]
    contents = [
        Content(
            content.points + (k if moves else 0), content.types, content.offsets, content.connectivity, point_data[k]
        )
        for k in range(steps)
    ]
    times = (np.arange(steps) / 8).tolist() if steps > 1 else None
    for time, one in zip(times or [], contents, strict=False):
        one.field_data["Time"] = np.array([time])  # VTK's reader adds it
    with h5py.File(path, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0])
        root.attrs.create("Type", b"UnstructuredGrid", dtype=h5py.string_dtype("ascii", 16))
        pieces = steps if moves else 1
        n, e, c = len(content.points), len(content.types), len(content.connectivity)
        for name, size in (("Points", n), ("Cells", e), ("ConnectivityIds", c)):
            root[f"NumberOf{name}"] = np.array([size])
        root["Points"] = np.concatenate([one.points for one in contents[:pieces]])
        root["Types"], root["Offsets"], root["Connectivity"] = content.types, content.offsets, content.connectivity
        for name in point_data[0]:
            root[f"PointData/{name}"] = np.concatenate([fields[name] for fields in point_data])
        if times:
            _write_steps(root, times, n if moves else 0, dict.fromkeys(point_data[0], n))
    return Steps(times, contents)


def _write_steps(root, times: list[float], points: int, fields: dict[str, int]) -> None:
    count = len(times)
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = count
    steps["Values"] = np.array(times)
    steps["NumberOfParts"] = np.ones(count, dtype=np.int64)
    steps["PartOffsets"] = np.zeros(count, dtype=np.int64)  # one part, used by all steps
    steps["PointOffsets"] = points * np.arange(count)
    steps["CellOffsets"] = np.zeros((count, 1), dtype=np.int64)
    steps["ConnectivityIdOffsets"] = np.zeros((count, 1), dtype=np.int64)
    for name, size in fields.items():
        steps[f"PointDataOffsets/{name}"] = size * np.arange(count)


def write_index(random: np.random.Generator, path: Path) -> Steps:
    """A .pvd of numbered files in any order, with times, paths and attributes as many programs write them."""
    count = int(random.integers(1, 6))
    times = np.sort(random.choice(1000, size=count, replace=False) / 64).tolist()
    folder = str(random.choice(["", "vtu/", "./", "vtu\\"]))
    rows, contents, extra = [], [], int(random.integers(3))
    for k, time in enumerate(times):
        content = make_tetrahedra(random)
        contents.append(content)
        name = f"{folder}f_{k}.vtu"
        file = path.parent / name.replace("\\", "/")
        file.parent.mkdir(exist_ok=True)
        VtuWriter(random).write(file, [content])
        text = str(
            random.choice([repr(time), f"{time:.10e}", f"{time:.10E}".replace("E", "D"), repr(time).replace(".", ",")])
        )
        attributes = [("timestep", text), ("file", name)]
        attributes += [("group", ""), ("part", "0")][:extra]
        attributes = [attributes[i] for i in random.permutation(len(attributes))]
        rows.append("<DataSet " + " ".join(f'{key}="{value}"' for key, value in attributes) + "/>")
    shuffled = [rows[i] for i in random.permutation(count)]
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n<Collection>\n'
    path.write_text(head + "\n".join(shuffled) + "\n</Collection>\n</VTKFile>\n")
    return Steps(times, contents)
