"""One recorded instant as plain arrays, whatever file it lies in: VTK's formats, temporal VTKHDF, XDMF.

VTK's errors become a SeriesError; nothing is printed.
"""

import contextlib
import io
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Fields, Floats, Ints
from pipeline.errors import SeriesError, shorten
from pipeline.formats.cell_types import CELL_TYPES, CORNERS
from pipeline.formats.vtu_read import LazyArrays, inline_file

SUFFIXES = (".vtu", ".pvtu", ".vtk", ".vtp")  # of files that hold one instant


@dataclass(frozen=True, eq=False)
class Grid:
    """Points (n, 3), cells in VTK's way (types, offsets, connectivity) and the fields of one instant.

    `located` are the points, or LazyArrays that decode them by the name Points; `count` is their number.
    """

    located: Floats | LazyArrays
    count: int
    types: NDArray[np.uint8]
    offsets: Ints
    connectivity: Ints
    point_data: Fields
    cell_data: Fields
    field_data: Fields

    @property
    def points(self) -> Floats:
        """Return the points (n, 3)."""
        if isinstance(self.located, LazyArrays):
            return self.located["Points"].astype(np.float64, copy=False)
        return self.located

    @property
    def nbytes(self) -> int:
        """Return how many bytes its points and fields hold; its cells are not counted, see sharing."""
        fields = (self.point_data, self.cell_data, self.field_data)
        held = (f.nbytes if isinstance(f, LazyArrays) else sum(a.nbytes for a in f.values()) for f in fields)
        return self.located.nbytes + sum(held)

    def sharing(self, other: "Grid") -> "Grid":
        """Return this grid with the arrays of cells of another, which must be equal: they are held once."""
        return replace(self, types=other.types, offsets=other.offsets, connectivity=other.connectivity)

    def cells(self, kind: int, corners: int) -> Ints:
        """Return the cells of one VTK type (e, corners)."""
        starts = self.offsets[:-1][self.types == kind]
        return self.connectivity[starts[:, None] + np.arange(corners)]


def plain_grid(file: Path, step: int) -> tuple[Any, ...]:
    """Return the fields of read_grid's Grid: what a child process can send."""
    grid = read_grid(file, step)
    fields = (grid.point_data, grid.cell_data, grid.field_data)
    return grid.points, grid.count, grid.types, grid.offsets, grid.connectivity, *fields


def inline_grid(file: Path) -> Grid | None:
    """Return the instant of an inline .vtu, its arrays read when they are asked for; None for other files."""
    found = inline_file(file) if file.suffix == ".vtu" else None
    if found is None:
        return None
    return Grid(LazyArrays(file, {"Points": found.points}), found.points.shape[0], *found.cells, *found.sections)


def read_grid(file: Path, step: int = 0) -> Grid:
    """Return one instant of a file; raises SeriesError where it cannot be read or is no unstructured grid."""
    if not file.is_file():
        raise SeriesError(f"{file}: no such file")
    if file.suffix == ".xdmf":
        return _xdmf_grid(file, step)
    reader, errors = _reader(file)
    if file.suffix == ".vtkhdf":
        reader.SetStep(step)
    with _heard(errors) if file.suffix == ".vtk" else contextlib.nullcontext():
        reader.Update()
    _refuse(file, errors, reader.GetErrorCode())
    return _from_vtk(reader.GetOutputDataObject(0), file)


def file_times(file: Path) -> list[float] | None:
    """Return the times [s] that a file knows of itself, None where it says nothing."""
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

    if file.suffix == ".xdmf":
        return [float(time) for time in _xdmf(file, file.stat().st_mtime_ns)[3]]
    if file.suffix == ".vtk":  # legacy: not known before all is read
        value = read_grid(file).field_data.get("TimeValue") if b"TimeValue" in file.read_bytes() else None
        return None if value is None else [float(value.ravel()[0])]
    reader, errors = _reader(file)
    reader.UpdateInformation()
    _refuse(file, errors, reader.GetErrorCode())
    information, key = reader.GetOutputInformation(0), Pipeline.TIME_STEPS()
    return [float(time) for time in information.Get(key)] if information.Has(key) else None


def _reader(file: Path) -> tuple[Any, list[str]]:
    """Return a VTK reader of the file and the list that its errors go to."""
    from vtkmodules import vtkIOHDF, vtkIOLegacy, vtkIOXML

    kinds: dict[str, Any] = {
        ".vtu": vtkIOXML.vtkXMLUnstructuredGridReader,
        ".pvtu": vtkIOXML.vtkXMLPUnstructuredGridReader,
        ".vtp": vtkIOXML.vtkXMLPolyDataReader,
        ".vtk": vtkIOLegacy.vtkDataSetReader,
        ".vtkhdf": vtkIOHDF.vtkHDFReader,
    }
    if file.suffix not in kinds:
        raise SeriesError(
            f"{file}: {shorten(file.suffix) or 'a file without suffix'} is not read; one of {', '.join(kinds)} is"
        )
    reader, errors = kinds[file.suffix](), list[str]()

    def note(_reader: object, _event: str, text: str) -> None:
        errors.append(" ".join(text.split()))

    note.CallDataType = "string0"  # type: ignore[attr-defined]  # how VTK is told to hand over the text
    reader.AddObserver("ErrorEvent", note)
    reader.SetFileName(str(file))
    if file.suffix == ".vtk":
        # it reads the first field of each kind alone, unless told
        for kind in ("Scalars", "Vectors", "Tensors", "Fields", "Normals"):
            getattr(reader, f"ReadAll{kind}On")()
    return reader, errors


@contextlib.contextmanager
def _heard(errors: list[str]) -> Iterator[None]:
    """Add what VTK says to nobody in particular: all that it does of legacy data that end too early."""
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    before, window = vtkOutputWindow.GetInstance(), vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(window)
    try:
        yield
    finally:
        vtkOutputWindow.SetInstance(before)
        errors += [" ".join(line.split()) for line in window.GetOutput().splitlines() if line.strip()]


def _refuse(file: Path, errors: list[str], code: int) -> None:
    if errors or code:
        said = errors[0].rsplit("): ", 1)[-1] if errors else f"error {code} of VTK"
        raise SeriesError(f"{file}: cannot be read ({shorten(said, 200)})")


def _from_vtk(data: Any, file: Path) -> Grid:
    """Return the arrays of what VTK read, ghost cells left out."""
    import pyvista
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if data is None:
        raise SeriesError(f"{file}: cannot be read (VTK finds nothing in it)")
    grid = pyvista.wrap(data)
    if isinstance(grid, pyvista.PartitionedDataSet) and len(grid) == 1:
        grid = grid[0]
    if isinstance(grid, pyvista.PolyData):
        grid = grid.cast_to_unstructured_grid()
    if not isinstance(grid, pyvista.UnstructuredGrid):
        raise SeriesError(f"{file}: holds a {type(grid).__name__}, not an unstructured grid")
    if "vtkGhostType" in grid.cell_data:  # pieces of a .pvtu overlap there
        grid = grid.extract_cells(np.asarray(grid.cell_data["vtkGhostType"]) == 0)
    points = np.asarray(grid.points, dtype=np.float64)
    if not grid.n_cells or grid.GetCells() is None:
        raise SeriesError(f"{file}: has no cells")
    connectivity = np.asarray(grid.cell_connectivity, dtype=np.int64)
    offsets = vtk_to_numpy(grid.GetCells().GetOffsetsArray()).astype(np.int64)
    types = np.asarray(grid.celltypes)
    if (why := _wrong_cells(types, offsets, len(connectivity))) is not None:
        raise SeriesError(f"{file}: {why}")
    if connectivity.min() < 0 or connectivity.max() >= len(points):
        raise SeriesError(f"{file}: a cell names point {connectivity.max()} of {len(points)} (counted from 0)")
    fields = [{name: np.asarray(data[name]) for name in data.keys()} for data in  # noqa: SIM118  (pyvista's fields iterate over values)
              (grid.point_data, grid.cell_data, grid.field_data)]  # fmt: skip
    return Grid(points, len(points), types, offsets, connectivity, *fields)


def _wrong_cells(types: NDArray[np.uint8], offsets: Ints, length: int) -> str | None:
    """Return what is wrong with kinds of cells, or with their places in a connectivity of that length."""
    import pyvista

    unknown = set(np.unique(types).tolist()) - {int(kind) for kind in pyvista.CellType}
    if unknown:
        return f"a cell is of the unknown kind {min(unknown)}"
    sizes = np.diff(offsets)
    if len(sizes) != len(types) or offsets[0] != 0 or offsets[-1] != length or (sizes < 0).any():
        return f"the places of its {len(types)} cells do not fit their {length} corners"
    for kind in CELL_TYPES.values():
        bad = np.flatnonzero((types == kind) & (sizes != CORNERS[kind]))
        if bad.size:
            return f"cell {bad[0]} has {sizes[bad[0]]} corners, not {CORNERS[kind]}"
    return None


def _xdmf_grid(file: Path, step: int) -> Grid:
    """Return one step of a temporal collection, as meshio reads it."""
    import meshio
    import pyvista

    reader, points, cells, _ = _xdmf(file, file.stat().st_mtime_ns)
    try:
        _, point_data, cell_data = reader.read_data(step)
    except Exception as error:  # meshio lets through whatever its parsers raise
        raise SeriesError(
            f"{file}: step {step} cannot be read ({type(error).__name__}: {shorten(str(error), 200)})"
        ) from error
    grid = pyvista.from_meshio(meshio.Mesh(points, cells, point_data, cell_data))
    return _from_vtk(grid, file)


@lru_cache(maxsize=4)
def _xdmf(file: Path, _modified: int) -> tuple[Any, Any, Any, tuple[float, ...]]:
    """Return meshio's reader of a time series, its points, its cells and its times [s]."""
    import meshio

    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            reader = meshio.xdmf.TimeSeriesReader(file)
            points, cells = reader.read_points_cells()
        moving = [grid for grid in reader.collection[1:] if grid.find("Geometry") is not None]
        times = tuple(float(grid.find("Time").get("Value")) for grid in reader.collection)
    except ModuleNotFoundError as error:
        raise SeriesError(f"{file}: its arrays lie in an HDF5 file; pip install {error.name}") from error
    except (Exception, SystemExit) as error:
        words = " ".join(f"{error} {said.getvalue()}".split()) or "not a temporal collection of XDMF 3"
        raise SeriesError(f"{file}: meshio cannot read it ({type(error).__name__}: {shorten(words, 200)})") from error
    if moving:
        raise SeriesError(f"{file}: {len(moving)} steps carry a geometry of their own, which meshio cannot read")
    if points.shape[1] == 2:
        points = np.pad(points, [(0, 0), (0, 1)])
    return reader, points, cells, times
