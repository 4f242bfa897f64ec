"""The mesh of an XDMF grid: the points of a Geometry and the cells of a Topology, in VTK's layout.

Cells have VTK's order of nodes. Structured topologies become quadrilaterals and hexahedra; their last index is the
fastest (Dimensions are nz ny nx), as in VTK's own reader.
"""

import math
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.errors import shorten
from pipeline.formats.grid import CellArray, PolyhedronFaces
from pipeline.formats.xdmf.document import XdmfDocument
from pipeline.formats.xdmf.items import parse_numbers, read_item


class _Shape(NamedTuple):
    """One of XDMF's kinds of cells: VTK's type, its dimension and number of nodes (0: it varies)."""

    vtk_type: int
    dimension: int
    nodes: int


_CODES = {  # XDMF's numbers in a Mixed topology
    1: _Shape(2, 0, 0), 2: _Shape(4, 1, 0), 3: _Shape(7, 2, 0), 4: _Shape(5, 2, 3), 5: _Shape(9, 2, 4),
    6: _Shape(10, 3, 4), 7: _Shape(14, 3, 5), 8: _Shape(13, 3, 6), 9: _Shape(12, 3, 8), 16: _Shape(42, 3, 0),
    34: _Shape(21, 1, 3), 35: _Shape(28, 2, 9), 36: _Shape(22, 2, 6), 37: _Shape(23, 2, 8), 38: _Shape(24, 3, 10),
    39: _Shape(27, 3, 13), 40: _Shape(26, 3, 15), 41: _Shape(32, 3, 18), 48: _Shape(25, 3, 20), 49: _Shape(33, 3, 24),
    50: _Shape(29, 3, 27),
}  # fmt: skip
_NAMES = {
    "polyvertex": 1, "polyline": 2, "polygon": 3, "triangle": 4, "quadrilateral": 5, "tetrahedron": 6, "pyramid": 7,
    "wedge": 8, "hexahedron": 9, "polyhedron": 16, "edge_3": 34, "quadrilateral_9": 35, "quad_9": 35, "triangle_6": 36,
    "tri_6": 36, "quadrilateral_8": 37, "quad_8": 37, "tetrahedron_10": 38, "tet_10": 38, "pyramid_13": 39,
    "wedge_15": 40, "wedge_18": 41, "hexahedron_20": 48, "hex_20": 48, "hexahedron_24": 49, "hex_24": 49,
    "hexahedron_27": 50, "hex_27": 50,
}  # fmt: skip
_FIXED_NODES = {1: 1, 2: 2}  # of a single vertex or line, if NodesPerElement is missing
_DIMENSIONS = {shape.vtk_type: shape.dimension for shape in _CODES.values()} | {1: 0, 3: 1}
_STRUCTURED = ("2dsmesh", "2drectmesh", "2dcorectmesh", "3dsmesh", "3drectmesh", "3dcorectmesh")
_PRODUCTS = {"vxvyvz": 3, "vxvy": 2}
_LATTICES = {"origin_dxdydz": 3, "origin_dxdy": 2}


def get_dimension(cells: CellArray) -> int:
    """Return the largest dimension of the cells."""
    return max((_DIMENSIONS[kind] for kind in np.unique(cells.types).tolist()), default=0)


def read_mesh(document: XdmfDocument, topology: Element, geometry: Element) -> tuple[Floats, CellArray]:
    """Return the points (n, 3) and the cells; raises ValueError or OSError."""
    kind = topology.get("TopologyType", topology.get("Type", "")).lower()
    if kind in _STRUCTURED:
        shape = _read_node_counts(topology, int(kind[0]))
        points = _read_points(document, geometry, shape)
        if len(points) != math.prod(shape):
            raise ValueError(f"its geometry has {len(points)} points, its {shorten(kind)} {math.prod(shape)}")
        return points, make_structured_cells(shape)
    points = _read_points(document, geometry, None)
    cells = _read_cells(document, topology, kind, len(points))
    if cells.connectivity.size and not 0 <= cells.connectivity.min() <= cells.connectivity.max() < len(points):
        worst = cells.connectivity.min() if cells.connectivity.min() < 0 else cells.connectivity.max()
        raise ValueError(f"a cell refers to point {worst} of {len(points)} (counted from 0)")
    return points, cells


def _read_node_counts(topology: Element, dimension: int) -> tuple[int, ...]:
    shape = parse_numbers(topology.get("Dimensions", topology.get("NumberOfElements", "")))
    if len(shape) != dimension or min(shape) < 2:
        raise ValueError(f"a structured topology has the Dimensions {shape}, not {dimension} numbers above 1")
    return shape


def _read_points(document: XdmfDocument, geometry: Element, shape: tuple[int, ...] | None) -> Floats:
    """Return points (n, 3); `shape` has the numbers of points of a structured grid, slowest first."""
    kind = geometry.get("GeometryType", geometry.get("Type", "XYZ")).lower()
    items = [np.asarray(read_item(document, item), np.float64) for item in document.get_children(geometry, "DataItem")]
    widths = {"xyz": 3, "xy": 2}
    if kind in widths and len(items) == 1:
        if items[0].size % widths[kind] or (items[0].ndim > 1 and items[0].shape[-1] not in (widths[kind], 1)):
            raise ValueError(f"a geometry {kind.upper()} has an array of shape {items[0].shape}")
        return _pad(items[0].reshape(-1, widths[kind]))
    if kind in ("x_y_z", "x_y") and len(items) == len(kind.split("_")):
        if len({item.size for item in items}) > 1:
            raise ValueError(f"a geometry {kind.upper()} has arrays of different lengths")
        return _pad(np.stack([item.ravel() for item in items], axis=1))
    if kind in _PRODUCTS and shape is not None and len(items) >= len(shape):
        return _multiply_axes([item.ravel() for item in items[: len(shape)]], shape)
    if kind in _LATTICES and shape is not None and len(items) == 2:
        origin, spacing = (item.ravel()[::-1][: len(shape)] for item in items)  # the file has z first
        if min(len(origin), len(spacing)) == len(shape):
            axes = (o + s * np.arange(n) for o, s, n in zip(origin, spacing, reversed(shape), strict=True))
            return _multiply_axes(list(axes), shape)
    raise ValueError(f"a geometry {shorten(kind)} with {len(items)} arrays is not read")


def _multiply_axes(axes: list[Floats], shape: tuple[int, ...]) -> Floats:
    """Return the points of a rectilinear grid (n, 3), the first axis (x) running fastest."""
    if [len(axis) for axis in axes] != list(reversed(shape)):
        raise ValueError(f"its axes have {[len(a) for a in axes]} coordinates, its topology {list(reversed(shape))}")
    parts = np.meshgrid(*reversed(axes), indexing="ij")
    return _pad(np.stack([part.ravel() for part in reversed(parts)], axis=1))


def _pad(points: Floats) -> Floats:
    return np.ascontiguousarray(np.pad(points, [(0, 0), (0, 3 - points.shape[1])]))


def make_structured_cells(shape: tuple[int, ...]) -> CellArray:
    """Return the quadrilaterals or hexahedra between points in rows; `shape` counts the points, slowest first."""
    numbers = np.arange(math.prod(shape), dtype=np.int64).reshape(shape)
    if len(shape) == 2:
        corners = [numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]]
    else:
        layer = [(slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None)),
                 (slice(1, None), slice(1, None)), (slice(1, None), slice(None, -1))]  # fmt: skip
        corners = [numbers[k][:, j][:, :, i] for k in (slice(None, -1), slice(1, None)) for j, i in layer]
    nodes = np.stack([corner.ravel() for corner in corners], axis=1)
    return _make_cells(nodes, 9 if len(shape) == 2 else 12)


def _make_cells(nodes: Ints, vtk_type: int) -> CellArray:
    """Return cells of one type, given their nodes (e, k)."""
    count, width = nodes.shape
    types = np.full(count, vtk_type, dtype=np.uint8)
    return CellArray(types, np.arange(count + 1, dtype=np.int64) * width, np.ascontiguousarray(nodes).reshape(-1))


def _read_cells(document: XdmfDocument, topology: Element, kind: str, points: int) -> CellArray:
    item = document.get_child(topology, "DataItem")
    count = math.prod(parse_numbers(topology.get("NumberOfElements", topology.get("Dimensions", ""))) or (-1,))
    if "Order" in topology.attrib:
        raise ValueError("its topology has an Order of its own for the nodes; write VTK's order without it")
    base = int(topology.get("BaseOffset", "0"))
    values = None if item is None else np.asarray(read_item(document, item)).astype(np.int64)
    if kind == "mixed" and values is not None:
        cells = decode_mixed(values.ravel(), base)
    elif kind not in _NAMES or kind == "polyhedron":
        raise ValueError(f"a topology has the type {shorten(kind)}; it may be one of {', '.join(_NAMES)}, mixed")
    else:
        shape = _CODES[_NAMES[kind]]
        width = shape.nodes or int(topology.get("NodesPerElement", _FIXED_NODES.get(_NAMES[kind], 0)))
        if values is None and width == 1:  # a vertex at each point needs no numbers
            values = np.arange(points, dtype=np.int64) + base
            count = points
        if values is None or not width or values.size % width:
            size = "no" if values is None else values.size
            raise ValueError(f"a topology {kind} has {size} nodes, {width or 'an unknown number'} of them a cell")
        cells = _make_cells(values.reshape(-1, width) - base, shape.vtk_type)
    if count not in (-1, len(cells.types)):
        raise ValueError(f"a topology declares {count} cells and has {len(cells.types)}")
    return cells


def decode_mixed(stream: Ints, base: int = 0) -> CellArray:
    """Return the cells of a Mixed topology: for each its code, for some kinds its number of nodes, and its nodes."""
    kinds, sizes, chunks = list[NDArray[np.uint8]](), list[Ints](), list[Ints]()
    faces = _FaceLists()
    place, cell = 0, 0
    while place < len(stream):
        code = int(stream[place])
        if code not in _CODES:
            raise ValueError(f"a mixed topology has the unknown code {code} at number {place}")
        shape = _CODES[code]
        if code == 16:
            nodes, place = faces.add(stream, place + 1, cell, base)
            run, width = 1, len(nodes)
        elif shape.nodes:
            width = shape.nodes
            run = _count_run(stream, place, code, width + 1)
            rows = stream[place : place + run * (width + 1)]
            place += run * (width + 1)
            nodes = rows.reshape(run, width + 1)[:, 1:].ravel() - base if place <= len(stream) else rows[:0]
        else:
            run, width = 1, int(stream[place + 1]) if place + 1 < len(stream) else -1
            nodes = stream[place + 2 : place + 2 + max(width, 0)] - base
            place += 2 + width
        if width < 1 or len(nodes) != run * width:
            raise ValueError("a mixed topology ends within a cell")
        kinds.append(np.full(run, shape.vtk_type, dtype=np.uint8))
        sizes.append(np.full(run, width, dtype=np.int64))
        chunks.append(nodes)
        cell += run
    if not cell:
        raise ValueError("a mixed topology has no cells")
    offsets = np.concatenate([[0], np.cumsum(np.concatenate(sizes))]).astype(np.int64)
    return CellArray(np.concatenate(kinds), offsets, np.concatenate(chunks), faces.finish(cell))


def _count_run(stream: Ints, place: int, code: int, stride: int) -> int:
    """Return how many cells of one kind follow each other: their codes are `stride` numbers apart."""
    total, length = 0, 64
    while True:
        codes = stream[place : place + length * stride : stride]
        others = np.flatnonzero(codes != code)
        if others.size:
            total += int(others[0])
            break
        total += len(codes)
        if len(codes) < length:
            break
        place, length = place + length * stride, length * 8
    return total


class _FaceLists:
    """The faces of polyhedra, collected cell by cell."""

    def __init__(self) -> None:
        self._faces = list[Ints]()
        self._ends = list[tuple[int, int]]()  # a cell and the number of faces up to its end

    def add(self, stream: Ints, place: int, cell: int, base: int) -> tuple[Ints, int]:
        """Return the points of a polyhedron and the place behind it: its number of faces, then each face's points."""
        count = int(stream[place]) if place < len(stream) else 0
        place += 1
        first = len(self._faces)
        for _ in range(count):
            length = int(stream[place]) if place < len(stream) else 0
            face = stream[place + 1 : place + 1 + length] - base
            if length < 3 or len(face) != length:
                raise ValueError("a mixed topology ends within a polyhedron")
            self._faces.append(face)
            place += 1 + length
        if not count:
            raise ValueError("a mixed topology has a polyhedron without faces")
        self._ends.append((cell, len(self._faces)))
        return np.array(list(dict.fromkeys(np.concatenate(self._faces[first:]).tolist())), dtype=np.int64), place

    def finish(self, cells: int) -> PolyhedronFaces | None:
        """Return the faces of all cells, None if there are no polyhedra."""
        if not self._faces:
            return None
        counts = np.zeros(cells, dtype=np.int64)
        before = 0
        for cell, end in self._ends:
            counts[cell], before = end - before, end
        lengths = [len(face) for face in self._faces]
        offsets: Any = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        cell_offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        return PolyhedronFaces(np.concatenate(self._faces), offsets, cell_offsets)
