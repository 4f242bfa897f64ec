"""Small inputs as other programs write them: a bar of tetrahedra, a plate of triangles, plain .vtu and .pvd files."""

from collections.abc import Iterable, Mapping
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np

STRETCHES = (1.0, 1.2, 1.5)  # of the bar along x, one a frame: the ratio of every cell
_KINDS = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}


def bar(counts=(2, 1, 1), size=(2.0, 1.0, 1.0)) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and positively oriented Kuhn tetrahedra (e, 4) of a box."""
    axes = [np.linspace(0, length, count + 1) for length, count in zip(size, counts, strict=True)]
    points = np.array(list(product(*axes)))
    strides = ((counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1)
    cells = []
    for corner in product(*map(range, counts)):
        first = int(np.dot(corner, strides))
        for order in permutations(range(3)):
            cells.append(first + np.cumsum([0, *(strides[axis] for axis in order)]))
    cells = np.array(cells)
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    mirrored = np.linalg.det(edges) < 0
    cells[mirrored] = cells[mirrored][:, [0, 1, 3, 2]]
    return points, cells


def plate(counts=(2, 1), size=(2.0, 1.0)) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) with z = 0 and positively oriented triangles (e, 3) of a rectangle."""
    axes = [np.linspace(0, length, count + 1) for length, count in zip(size, counts, strict=True)]
    points = np.array([[x, y, 0.0] for x in axes[0] for y in axes[1]])
    cells = []
    for i, j in product(*map(range, counts)):
        a, b = i * (counts[1] + 1) + j, (i + 1) * (counts[1] + 1) + j
        cells += [[a, b, b + 1], [a, b + 1, a + 1]]
    return points, np.array(cells)


def stretch(points: np.ndarray, factor: float) -> np.ndarray:
    """Points with x times the factor."""
    return points * [factor, 1.0, 1.0]


def split(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points that some cells use, and the cells counted in those."""
    used, local = np.unique(cells, return_inverse=True)
    return used, local.reshape(cells.shape)


def quadratic(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and ten-node tetrahedra with straight sides, in VTK's order, of linear tetrahedra."""
    middle: dict[tuple[int, int], int] = {}
    pairs = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
    rows = [
        [*row, *(middle.setdefault(tuple(sorted((row[a], row[b]))), len(points) + len(middle)) for a, b in pairs)]
        for row in cells.tolist()
    ]
    return np.vstack([points, [(points[a] + points[b]) / 2 for a, b in middle]]), np.array(rows)


def _write_array(name: str, values: Any, *, tuples: bool = False) -> str:
    values = np.asarray(values)
    parts = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    parts += f' NumberOfTuples="{len(values)}"' if tuples else ""
    text = "\n".join(" ".join(repr(v) for v in np.atleast_1d(row).tolist()) for row in values)
    return (
        f'<DataArray type="{_KINDS[values.dtype.str[1:]]}" Name="{name}"{parts} format="ascii">\n{text}\n</DataArray>\n'
    )


def write_vtu(
    path: Path, points: Any, blocks: Iterable[tuple[int, Any]], point_data: Mapping[str, Any] | None = None,
    cell_data: Mapping[str, Any] | None = None, field_data: Mapping[str, Any] | None = None,
) -> None:  # fmt: skip
    """Write a plain text .vtu; blocks are (VTK's cell type, points of each cell (e, k))."""
    path.parent.mkdir(parents=True, exist_ok=True)
    blocks = [(kind, np.asarray(cells)) for kind, cells in blocks]
    sizes = np.concatenate([np.full(len(cells), cells.shape[1]) for _, cells in blocks])
    arrays = [
        ("connectivity", np.concatenate([cells.ravel() for _, cells in blocks]).astype(np.int64)),
        ("offsets", np.cumsum(sizes).astype(np.int64)),
        ("types", np.concatenate([np.full(len(cells), kind) for kind, cells in blocks]).astype(np.uint8)),
    ]
    fields = "".join(_write_array(n, np.atleast_1d(v), tuples=True) for n, v in (field_data or {}).items())
    path.write_text(
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">\n'
        + "<UnstructuredGrid>\n"
        + (f"<FieldData>\n{fields}</FieldData>\n" if fields else "")
        + f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(sizes)}">\n<PointData>\n'
        + "".join(_write_array(name, values) for name, values in (point_data or {}).items())
        + "</PointData>\n<CellData>\n"
        + "".join(_write_array(name, values) for name, values in (cell_data or {}).items())
        + "</CellData>\n<Points>\n"
        + _write_array("Points", points)
        + "</Points>\n<Cells>\n"
        + "".join(_write_array(name, values) for name, values in arrays)
        + "</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n",
        encoding="utf-8",
    )


def write_pvd(path: Path, entries: Iterable[Mapping[str, Any]]) -> None:
    """Write an index; entries are the attributes of each DataSet."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = "".join("<DataSet " + " ".join(f'{k}="{v}"' for k, v in entry.items()) + "/>\n" for entry in entries)
    path.write_text(
        f'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
        f"{rows}</Collection>\n</VTKFile>\n"
    )


def index(folder: Path, name: str = "s", pattern: str = "f_{}.vtu", frames: Iterable[int] = range(3)) -> None:
    """Write an index of numbered files, 0.1 s apart."""
    write_pvd(folder / f"{name}.pvd", [{"timestep": 0.1 * k, "part": 0, "file": pattern.format(k)} for k in frames])
