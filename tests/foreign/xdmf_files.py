"""XDMF as other programs write it: a collection a function, raw binary of both byte orders, one file with Seek."""

from pathlib import Path

import numpy as np

from tests.foreign.displacements import CELLS, POINTS
from tests.foreign.writers import STRETCHES, stretch

_HEAD = '<?xml version="1.0"?>\n<Xdmf Version="3.0" xmlns:xi="http://www.w3.org/2001/XInclude"><Domain>'
_MESH = "xpointer(/Xdmf/Domain/Grid[@GridType=&apos;Uniform&apos;][1]/*[self::Topology or self::Geometry])"


def _write_item(values: np.ndarray, kind: str = "Float") -> str:
    size = " ".join(map(str, values.shape))
    text = "\n".join(" ".join(repr(v) for v in row) for row in values.tolist())
    return f'<DataItem Dimensions="{size}" NumberType="{kind}" Precision="8" Format="XML">{text}</DataItem>'


def _write_collection(name: str, center: str, steps: list[tuple[float, np.ndarray]]) -> str:
    grids = ""
    for time, values in steps:
        kind = "Vector" if values.shape[1] == 3 else "Scalar"
        grids += (
            f'<Grid Name="{name}" GridType="Uniform"><xi:include xpointer="{_MESH}"/><Time Value="{time}"/>'
            f'<Attribute Name="{name}" AttributeType="{kind}" Center="{center}">'
            f"{_write_item(values)}</Attribute></Grid>"
        )
    return f'<Grid Name="{name}" GridType="Collection" CollectionType="Temporal">{grids}</Grid>'


def two_collections(folder: Path) -> None:
    """A mesh grid, and one temporal collection a function, in both orders (dolfinx)."""
    folder.mkdir(parents=True, exist_ok=True)
    u = [(0.1 * k, stretch(POINTS, s) - POINTS) for k, s in enumerate(STRETCHES)]
    stress = [(0.1 * k, np.full((len(CELLS), 1), float(k))) for k in range(3)]
    mesh = (
        f'<Grid Name="mesh" GridType="Uniform"><Topology TopologyType="Tetrahedron" NumberOfElements="{len(CELLS)}" '
        f'NodesPerElement="4">{_write_item(CELLS, "Int")}</Topology>'
        f'<Geometry GeometryType="XYZ">{_write_item(POINTS)}</Geometry></Grid>'
    )
    parts = [_write_collection("u", "Node", u), _write_collection("stress", "Cell", stress)]
    for name, collections in (("u_then_stress", parts), ("stress_then_u", parts[::-1])):
        (folder / f"{name}.xdmf").write_text(f"{_HEAD}{mesh}{''.join(collections)}</Domain></Xdmf>\n")


class _BinaryWriter:
    """Writes arrays as raw binary beside an XDMF file: each into a file, or all into one."""

    def __init__(self, folder: Path, name: str, order: str, *, together: bool) -> None:
        self.folder, self.name, self.order, self.together = folder, name, order, together
        self.content, self.count = b"", 0

    def write_item(self, values: np.ndarray, kind: str) -> str:
        data = np.ascontiguousarray(values, dtype=self.order + ("f8" if kind == "Float" else "i8")).tobytes()
        size, endian = " ".join(map(str, values.shape)), "Big" if self.order == ">" else "Little"
        seek, file = "", self.folder / f"{self.name}_{self.count}.bin"
        if self.together:
            seek, file = f' Seek="{len(self.content)}"', self.folder / f"{self.name}.bin"
            self.content += data
            data = self.content
        file.write_bytes(data)
        self.count += 1
        head = f'<DataItem Dimensions="{size}" NumberType="{kind}" Precision="8" Format="Binary" Endian="{endian}"'
        return f"{head}{seek}>{file}</DataItem>"

    def write(self) -> None:
        mesh = (
            f'<Topology TopologyType="Tetrahedron" NumberOfElements="{len(CELLS)}">{self.write_item(CELLS, "Int")}'
            f'</Topology><Geometry GeometryType="XYZ">{self.write_item(POINTS, "Float")}</Geometry>'
        )
        steps = ""
        for k, s in enumerate(STRETCHES):
            item = self.write_item(stretch(POINTS, s) - POINTS, "Float")
            steps += (
                f'<Grid Name="g" GridType="Uniform">{mesh if k == 0 else ""}<Time Value="{0.1 * k}"/>'
                f'<Attribute Name="u" AttributeType="Vector" Center="Node">{item}</Attribute></Grid>'
            )
        collection = f'<Grid Name="t" GridType="Collection" CollectionType="Temporal">{steps}</Grid>'
        (self.folder / f"{self.name}.xdmf").write_text(f"{_HEAD}{collection}</Domain></Xdmf>\n")


def binary(folder: Path) -> None:
    """Raw binary of both byte orders, and all arrays in one file with Seek."""
    folder.mkdir(parents=True, exist_ok=True)
    _BinaryWriter(folder, "little", "<", together=False).write()
    _BinaryWriter(folder, "big", ">", together=False).write()
    _BinaryWriter(folder, "seek", "<", together=True).write()
