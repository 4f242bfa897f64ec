"""One recorded instant as plain arrays, whatever kind of file it was read from."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Fields, Floats, Ints
from pipeline.formats.cell_types import CORNERS


class LazyArrays(Mapping[str, NDArray[Any]]):
    """Arrays by name, each decoded anew on every access; raises SeriesError if decoding fails.

    `decode(array, name)` decodes one; `nbytes` is the memory that the encoded arrays take. One function serves
    all arrays, because a thousand cached frames hold many objects for the garbage collector to visit.
    """

    def __init__(self, encoded: Mapping[str, Any], decode: Callable[[Any, str], NDArray[Any]], nbytes: int) -> None:
        self._encoded, self._decode, self.nbytes = encoded, decode, nbytes

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._decode(self._encoded[name], name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._encoded)

    def __len__(self) -> int:
        return len(self._encoded)

    def __repr__(self) -> str:
        return f"LazyArrays({', '.join(self._encoded)})"

    def list_encoded(self) -> Mapping[str, Any]:
        """Return the arrays as encoded, by name; each knows the `dtype` and `shape` that it has once decoded."""
        return self._encoded


def describe_arrays(fields: Fields) -> dict[str, tuple[np.dtype[Any], tuple[int, ...]]]:
    """Return the type and shape of each array, without decoding it."""
    arrays = fields.list_encoded() if isinstance(fields, LazyArrays) else fields
    return {name: (np.dtype(array.dtype), tuple(array.shape)) for name, array in arrays.items()}


class PolyhedronFaces(NamedTuple):
    """The faces of polyhedra: face f has the points connectivity[offsets[f]:offsets[f + 1]].

    Cell c has the faces cell_offsets[c] to cell_offsets[c + 1] (exclusive); cells that are no polyhedra have none.
    """

    connectivity: Ints
    offsets: Ints
    cell_offsets: Ints


class CellArray(NamedTuple):
    """Cells of any kind in VTK's layout: cell c has the points connectivity[offsets[c]:offsets[c + 1]]."""

    types: NDArray[np.uint8]
    offsets: Ints
    connectivity: Ints
    faces: PolyhedronFaces | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Grid:
    """Points (n, 3), cells in VTK's layout (types, offsets, connectivity) and the fields of one instant.

    `stored_points` are the points, or LazyArrays with the entry Points; `count` is the number of points. A grid that
    was joined from several parts (files, pieces, blocks) has the number of its points in each of them in `parts`, and
    the name of each in `part_names`: points of different parts that coincide at rest are one node of the body.
    `notes` tell what the reader decided or left out.
    """

    stored_points: Floats | LazyArrays
    count: int
    types: NDArray[np.uint8]
    offsets: Ints
    connectivity: Ints
    point_data: Fields
    cell_data: Fields
    field_data: Fields
    faces: PolyhedronFaces | None = None
    parts: tuple[int, ...] = ()
    part_names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def cells(self) -> CellArray:
        """The cells in VTK's layout."""
        return CellArray(self.types, self.offsets, self.connectivity, self.faces)

    @property
    def points(self) -> Floats:
        """The points (n, 3)."""
        if isinstance(self.stored_points, LazyArrays):
            return self.stored_points["Points"].astype(np.float64, copy=False)
        return self.stored_points

    @property
    def nbytes(self) -> int:
        """Memory of the points and fields; cells are not counted, because share_cells lets frames share them."""
        fields = (self.point_data, self.cell_data, self.field_data)
        sizes = (f.nbytes if isinstance(f, LazyArrays) else sum(a.nbytes for a in f.values()) for f in fields)
        return self.stored_points.nbytes + sum(sizes)

    def share_cells(self, other: "Grid") -> "Grid":
        """Return this grid with the cell arrays of another, which must be equal, so that memory holds them once."""
        return replace(
            self, types=other.types, offsets=other.offsets, connectivity=other.connectivity, faces=other.faces
        )

    def select_cells(self, cell_type: int) -> Ints:
        """Return the cells of one VTK type with a fixed number of corners (e, corners)."""
        starts = self.offsets[:-1][self.types == cell_type]
        return self.connectivity[starts[:, None] + np.arange(CORNERS[cell_type])]

    def __repr__(self) -> str:
        names = ", ".join([*self.point_data, *self.cell_data, *self.field_data])
        return f"Grid({self.count} points, {len(self.types)} cells: {names})"


def have_same_cells(a: Grid, b: Grid) -> bool:
    """Return whether two grids have equal cells and the same number of points."""
    if all(one is other for one, other in zip(a.cells, b.cells, strict=True)):  # equal text is decoded only once
        return a.count == b.count
    return a.count == b.count and _have_equal_arrays(a.cells, b.cells)


def _have_equal_arrays(a: CellArray, b: CellArray) -> bool:
    """Return whether two lists of cells are equal: polygons of other lengths, or other faces of polyhedra, are not."""
    arrays: list[tuple[NDArray[Any], NDArray[Any]]] = [
        (a.types, b.types), (a.offsets, b.offsets), (a.connectivity, b.connectivity)
    ]  # fmt: skip
    if (a.faces is None) != (b.faces is None):
        return False
    arrays += [] if a.faces is None or b.faces is None else [*zip(a.faces, b.faces, strict=True)]
    return all(np.array_equal(one, other) for one, other in arrays)
