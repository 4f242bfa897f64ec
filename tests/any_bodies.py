"""Small bodies of any kind of cells, and series of them: in memory, or as files of another program."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pipeline.formats.grid import CellArray, PolyhedronFaces
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.shape_functions import make_kind
from pipeline.mesh.shapes import box
from pipeline.mesh.simplex import Mesh
from pipeline.run.frame import Frame

TIMES = (0.0, 0.1, 0.2, 0.3)
Motion = Callable[[np.ndarray, float], np.ndarray]


# motions of points (n, 3)


def twist(points: np.ndarray, t: float) -> np.ndarray:
    """Turn cross sections about the longest axis, and swell towards its end."""
    axis = int(np.ptp(points, axis=0).argmax())
    a, b = [i for i in range(3) if i != axis]
    middle = points.mean(axis=0)
    along = (points[:, axis] - points[:, axis].min()) / np.ptp(points[:, axis])
    angle, size = 4 * t * along, 1 + t * along**2
    x, (da, db) = points.copy(), (points[:, [a, b]] - middle[[a, b]]).T
    x[:, a] = middle[a] + size * (np.cos(angle) * da - np.sin(angle) * db)
    x[:, b] = middle[b] + size * (np.sin(angle) * da + np.cos(angle) * db)
    return x


def stretch(points: np.ndarray, t: float) -> np.ndarray:
    """Stretch along x."""
    return points * [1 + t, 1.0, 1.0]


# bodies: points (n, 3) and cells


def join_cells(*blocks: tuple[int, Sequence[Sequence[int]]], faces: PolyhedronFaces | None = None) -> CellArray:
    """Cells of several VTK types: (type, nodes of each cell)."""
    types = np.concatenate([np.full(len(cells), kind, dtype=np.uint8) for kind, cells in blocks])
    sizes = [len(cell) for _, cells in blocks for cell in cells]
    nodes = np.concatenate([np.asarray(cell, dtype=np.int64) for _, cells in blocks for cell in cells])
    return CellArray(types, np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), nodes, faces)


def map_cells(number: int, kind_name: str, counts: Sequence[int], bend: Callable) -> tuple[np.ndarray, CellArray]:
    """A grid of equal cells of a square or cube kind, bent: nodes that coincide are one."""
    nodes = make_kind(kind_name).nodes
    corners = np.indices(counts).reshape(len(counts), -1).T
    everything = (corners[:, None] + nodes).reshape(-1, len(counts))
    _, first, same = np.unique(np.round(everything, 9), axis=0, return_index=True, return_inverse=True)
    points = everything[first] / np.array(counts)
    return bend(np.pad(points, [(0, 0), (0, 3 - points.shape[1])])), join_cells(
        (number, same.reshape(len(corners), -1))
    )


def _make_barrel(p: np.ndarray) -> np.ndarray:
    size = 1 + 0.5 * np.sin(np.pi * p[:, 1:2])
    return np.column_stack([(p[:, 0:1] - 0.5) * size, 3 * p[:, 1:2], (p[:, 2:3] - 0.5) * size])


def _make_arch(p: np.ndarray) -> np.ndarray:
    angle, radius = np.pi * p[:, 0], 1 + p[:, 1]
    return np.column_stack([radius * np.cos(np.pi - angle), radius * np.sin(angle), np.zeros(len(p))])


def _make_roof(p: np.ndarray) -> np.ndarray:
    angle = np.pi * p[:, 0]
    return np.column_stack([-np.cos(angle), 3 * p[:, 1], np.sin(angle)])


def _make_curved_tetrahedra() -> tuple[np.ndarray, CellArray]:
    """Ten-node tetrahedra of a bar whose sides bulge; the nodes within edges are on the curved sides."""
    mesh = box((1.0, 1.0, 1.0), (1, 2, 1))
    pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    edges = np.sort(np.stack([mesh.cells[:, pair] for pair in pairs], axis=1).reshape(-1, 2), axis=1)
    unique, which = np.unique(edges, axis=0, return_inverse=True)
    middles = mesh.points[unique].mean(axis=1)
    cells = np.column_stack([mesh.cells, len(mesh.points) + which.reshape(-1, 6)])
    return _make_barrel(np.concatenate([mesh.points, middles])), join_cells((24, cells))


def _make_mixture() -> tuple[np.ndarray, CellArray]:
    """Three unit cubes in a row: six pyramids, two wedges, and one hexahedron."""
    corners = np.array([[x, y, z] for x in range(4) for y in (0, 1) for z in (0, 1)], dtype=float)
    points = np.concatenate([corners, [[0.5, 0.5, 0.5]]])
    number = {tuple(p): i for i, p in enumerate(corners.astype(int).tolist())}

    def cube(x: int) -> list[int]:
        around = [(0, 0), (1, 0), (1, 1), (0, 1)]
        return [number[x + i, j, k] for k in (0, 1) for i, j in around]

    a, b, c = cube(0), cube(1), cube(2)
    bases = [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
    pyramids = [[*(a[i] for i in base), 16] for base in bases]
    wedges = [[b[i] for i in (0, 1, 2, 4, 5, 6)], [b[i] for i in (0, 2, 3, 4, 6, 7)]]
    return points, join_cells((14, pyramids), (13, wedges), (12, [c]))


def _make_honeycomb() -> tuple[np.ndarray, CellArray]:
    """Seven hexagonal prisms, as polyhedra with eight faces each."""
    angles = np.pi / 3 * np.arange(6)
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    middles = [np.zeros(2), *(np.sqrt(3) * np.array([np.cos(a), np.sin(a)]) for a in angles + np.pi / 6)]
    flat = np.concatenate([middle + ring for middle in middles])
    _, first, same = np.unique(np.round(flat, 6), axis=0, return_index=True, return_inverse=True)
    n, flat = len(first), flat[first]
    points = np.concatenate([np.column_stack([flat, np.full(n, z)]) for z in (0.0, 1.0)])
    faces, cells = [], []
    for low in same.reshape(7, 6).tolist():
        high = [a + n for a in low]
        faces += [low[::-1], high]
        faces += [[low[i], low[(i + 1) % 6], high[(i + 1) % 6], high[i]] for i in range(6)]
        cells.append(low + high)
    offsets = np.concatenate([[0], np.cumsum([len(face) for face in faces])]).astype(np.int64)
    described = PolyhedronFaces(np.concatenate(faces).astype(np.int64), offsets, np.arange(0, 57, 8, dtype=np.int64))
    return points, join_cells((42, cells), faces=described)


def _make_sheet(lift: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, CellArray]:
    points, cells = map_cells(9, "quad 1", (6, 2), lambda p: p * [3.0, 1.0, 0.0])
    quads = cells.connectivity.reshape(-1, 4)
    return lift(points), join_cells((5, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])))


BODIES: dict[str, Callable[[], tuple[np.ndarray, CellArray]]] = {
    "hexahedra": lambda: map_cells(12, "hexahedron 1", (2, 6, 2), lambda p: p * [1.0, 4.0, 1.0]),
    "curved tetrahedra": _make_curved_tetrahedra,
    "curved hexahedra": lambda: map_cells(25, "hexahedron serendipity", (1, 2, 1), _make_barrel),
    "Lagrange hexahedra": lambda: map_cells(72, "hexahedron 3", (1, 2, 1), _make_barrel),
    "mixture": _make_mixture,
    "polyhedra": _make_honeycomb,
    "curved quads": lambda: map_cells(23, "quad serendipity", (4, 2), _make_arch),
    "polygons": lambda: (lambda p, c: (p[: len(p) // 2], join_cells((7, c.connectivity.reshape(7, 12)[:, :6]))))(
        *_make_honeycomb()
    ),
    "triangles in xz": lambda: _make_sheet(lambda p: p[:, [0, 2, 1]]),
    "shell": lambda: map_cells(9, "quad 1", (8, 6), _make_roof),
}
PLANES = {"triangles in xz": np.array([[1.0, 0, 0], [0, 0, 1.0]])}
FLAT = ("curved quads", "polygons")


def make_mesh(name: str) -> CellMesh:
    """The rest mesh of one of BODIES."""
    points, cells = BODIES[name]()
    dimension = 2 if name in (*PLANES, *FLAT, "shell") else 3
    points = points[:, :2] if name in FLAT else points
    return CellMesh(points, cells, dimension, PLANES.get(name), name)


@dataclass(frozen=True)
class MovingBody:
    """A stand-in for Series whose frames are computed; `gaps` are frames without data, and the nodes that lack them."""

    mesh: BodyMesh
    motion: Motion = twist
    times: tuple[float, ...] = TIMES
    name: str = "body"
    gaps: dict[int, object] = field(default_factory=dict)
    whole: dict[int, float] = field(default_factory=dict)  # total volume of frames that have no cells of the mesh
    ours: bool = False
    notes: tuple[str, ...] = ()
    numbers: tuple[int, ...] | None = None

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self) -> Iterator[Frame]:
        return (self.read_frame(i) for i in range(len(self)))

    def select_frames(self, indices: Sequence[int]) -> "MovingBody":
        numbers = self.numbers or tuple(range(len(self)))
        return replace(self, times=tuple(self.times[i] for i in indices), numbers=tuple(numbers[i] for i in indices))

    def read_frame(self, index: int, grid: object = None) -> Frame:
        number = index if self.numbers is None else self.numbers[index]
        rest = self.mesh.points
        d = rest.shape[1]
        x = self.motion(np.pad(rest, [(0, 0), (0, 3 - d)]), self.times[index])[:, :d].copy()
        if number in self.gaps or number in self.whole:
            x[self.gaps.get(number, slice(None))] = np.nan
        whole = {}
        if number in self.whole:
            drift = self.whole[number] / self.mesh.rest_volumes.sum() - 1
            whole = {"total_volume": np.asarray(self.whole[number]), "volume_drift": np.asarray(drift)}
        fault = "the topology changes" if whole else "points are not finite" if number in self.gaps else ""
        return Frame(index, self.times[index], self.mesh, x, whole=whole, fault=fault)

    def read_positions(self, index: int, grid: object = None) -> np.ndarray:
        return self.read_frame(index).x


def write_files(folder: Path, mesh: Mesh | CellMesh, motion: Motion = twist, times: Sequence[float] = TIMES) -> Path:
    """Write .vtu files of deformed points by VTK, and an index; return its path."""
    import pyvista

    folder.mkdir(parents=True, exist_ok=True)
    rest, cells = np.pad(mesh.points, [(0, 0), (0, 3 - mesh.points.shape[1])]), mesh.cell_array
    lines = []
    for i, t in enumerate(times):
        grid = pyvista.UnstructuredGrid(_pack_cells(cells), cells.types, motion(rest, t))
        grid.save(folder / f"frame_{i}.vtu")
        lines.append(f'<DataSet timestep="{t!r}" file="frame_{i}.vtu"/>')
    index = folder / "series.pvd"
    index.write_text(f'<VTKFile type="Collection"><Collection>{"".join(lines)}</Collection></VTKFile>')
    return index


def _pack_cells(cells: CellArray) -> np.ndarray:
    """VTK's old layout: the number of nodes, then the nodes; for polyhedra the faces in the same way."""
    packed: list[int] = []
    for c, kind in enumerate(cells.types.tolist()):
        if kind == 42:
            assert cells.faces is not None
            numbers = range(*cells.faces.cell_offsets[c : c + 2].tolist())
            stream = [len(numbers)]
            for f in numbers:
                face = cells.faces.connectivity[slice(*cells.faces.offsets[f : f + 2].tolist())].tolist()
                stream += [len(face), *face]
        else:
            stream = cells.connectivity[slice(*cells.offsets[c : c + 2].tolist())].tolist()
        packed += [len(stream), *stream]
    return np.array(packed)
