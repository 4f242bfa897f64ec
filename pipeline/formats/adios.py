"""ADIOS2 folders (.bp) as dolfinx's VTXWriter writes them: the attribute vtk.xml names the variables of a VTK grid."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SeriesError, shorten
from pipeline.formats.blocks import join_blocks
from pipeline.formats.cell_types import find_cell_fault
from pipeline.formats.grid import Grid

_TIME = "TIME"  # the field of the layout that names the variable of the time
_GHOSTS = "vtkGhostType"
_COLORS = re.compile(r"\x1b\[\d*m")  # of adios2's messages


class _Layout:
    """The variables of a grid, by the layout in vtk.xml."""

    def __init__(self, text: str) -> None:
        if "<!ENTITY" in text:
            raise ValueError("vtk.xml declares entities")
        piece = ET.fromstring(text.strip()).find("./UnstructuredGrid/Piece")
        if piece is None:
            raise ValueError("vtk.xml describes no unstructured grid")
        self.points = _list_names(piece, "Points")
        self.cells = _list_names(piece, "Cells")
        self.nodal, self.cellular = _list_names(piece, "PointData"), _list_names(piece, "CellData")
        self.time = self.nodal.pop(_TIME, None) or self.cellular.pop(_TIME, None)
        if not self.points or not {"connectivity", "types"} <= self.cells.keys():
            raise ValueError("vtk.xml names no points, connectivity and types")


def _list_names(piece: ET.Element, section: str) -> dict[str, str]:
    """Return the variable of each array of a section: its text, or its name."""
    arrays = piece.findall(f"./{section}/DataArray")
    return {array.get("Name", ""): (array.text or "").strip() or array.get("Name", "") for array in arrays}


def read_bp(folder: Path, step: int) -> Grid:
    """Return one instant; blocks of several processes are parts. Raises SeriesError."""
    with _open(folder) as (file, layout, steps):
        if step >= steps:
            raise ValueError(f"it has {steps} steps, none with the number {step}")
        geometry = next(iter(layout.points.values()))
        blocks = len(file.all_blocks_info(geometry)[0])
        grids = [_read_block(file, layout, step, block) for block in range(blocks)]
        return join_blocks(grids, [f"block {block}" for block in range(blocks)])


def read_bp_times(folder: Path) -> list[float] | None:
    """Return the times [s] of the steps; raises SeriesError."""
    with _open(folder) as (file, layout, steps):
        if layout.time is None:
            return None
        return [float(np.ravel(file.read(layout.time, step_selection=[k, 1]))[0]) for k in range(steps)]


@contextmanager
def _open(folder: Path) -> Iterator[tuple[Any, _Layout, int]]:
    try:
        import adios2
    except ModuleNotFoundError as error:
        raise SeriesError(f"{folder}: ADIOS2 wrote it; pip install adios2") from error
    try:
        with adios2.FileReader(str(folder)) as file:
            if "vtk.xml" not in file.available_attributes():
                raise ValueError("it has no attribute vtk.xml (dolfinx: write it with VTXWriter)")
            yield file, _Layout(str(file.read_attribute("vtk.xml"))), int(file.num_steps())
    except (ValueError, KeyError, IndexError, RuntimeError, OSError, TypeError, ET.ParseError) as error:
        raise SeriesError(
            f"{folder}: cannot be read: {shorten(' '.join(_COLORS.sub('', str(error)).split()), 300)}"
        ) from error


def _read_block(file: Any, layout: _Layout, step: int, block: int) -> Grid:
    """Return the grid of one block."""
    points = np.asarray(_read(file, next(iter(layout.points.values())), step, block), dtype=np.float64)
    rows = np.asarray(_read(file, layout.cells["connectivity"], step, block), dtype=np.int64)
    kind = np.ravel(_read(file, layout.cells["types"], step, 0)).astype(np.uint8)
    width = rows.shape[1] - 1  # each row begins with the number of its nodes
    if (rows[:, 0] != width).any() or len(kind) not in (1, len(rows)):
        raise ValueError("its cells have different numbers of nodes, which is not read")
    types = np.full(len(rows), kind[0]) if len(kind) == 1 else kind
    offsets, connectivity = np.arange(len(rows) + 1, dtype=np.int64) * width, rows[:, 1:].ravel()
    if fault := find_cell_fault(types, offsets, len(connectivity)):
        raise ValueError(fault)
    if connectivity.size and (connectivity.min() < 0 or connectivity.max() >= len(points)):
        raise ValueError(f"a cell refers to point {connectivity.max()} of {len(points)} (counted from 0)")
    points = np.pad(points, [(0, 0), (0, 3 - points.shape[1])])
    nodal = {name: _squeeze(_read(file, variable, step, block)) for name, variable in layout.nodal.items()}
    cellular = {name: _squeeze(_read(file, variable, step, block)) for name, variable in layout.cellular.items()}
    nodal.pop(_GHOSTS, None)  # of points; each cell is in one block only
    for values, count, name in [
        *((values, len(points), name) for name, values in nodal.items()),
        *((values, len(rows), name) for name, values in cellular.items()),
    ]:
        if len(values) != count:
            raise ValueError(f"the field {shorten(name)} has {len(values)} values, {count} are needed")
    return Grid(points, len(points), types, offsets, connectivity, nodal, cellular, {})


def _read(file: Any, name: str, step: int, block: int) -> NDArray[Any]:
    """Return a variable of a block at a step; what is written once belongs to all steps."""
    variable = file.available_variables().get(name)
    if variable is None:
        raise ValueError(f"it has no variable {shorten(name)}")
    count = int(variable["AvailableStepsCount"])
    selection = [step if count > 1 else 0, 1]
    if count > 1 and step >= count:
        raise ValueError(f"its variable {shorten(name)} has {count} steps")
    if variable["Shape"] or variable["SingleValue"] == "true":
        return np.asarray(file.read(name, step_selection=selection))
    return np.asarray(file.read(name, block_id=block, step_selection=selection))


def _squeeze(values: NDArray[Any]) -> NDArray[Any]:
    return values[:, 0] if values.ndim == 2 and values.shape[1] == 1 else values
