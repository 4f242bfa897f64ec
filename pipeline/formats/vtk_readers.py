"""VTK's readers: its own formats, and those of solvers that it reads. Each instant of a file as a grid.

VTK's errors become a SeriesError; nothing is printed.
"""

import contextlib
import glob
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.grid import Grid
from pipeline.formats.vtk_data import make_grid
from pipeline.formats.vtu_steps import cut_out_step, find_step_times


class VtkReader(NamedTuple):
    """One of VTK's readers: its module and class, what is set before it reads, and how it takes a step.

    `by_number` sets a step by its number, so that equal times stay apart; otherwise the time is requested.
    `node_number` is the point field that tells the points that blocks share. `dropped` names fields that repeat
    others. `listens` takes what VTK prints as an error too. `find_fault` tells why a file with so many steps is
    damaged. `may_repeat`: a file can hold steps that the reader does not tell apart.
    """

    module: str
    name: str
    set_up: Callable[[Any, Path], None] | None = None
    by_number: str = ""
    node_number: str = ""
    dropped: tuple[str, ...] = ()
    listens: bool = False
    find_fault: Callable[[Path, int], str | None] | None = None
    may_repeat: bool = False

    def read(self, file: Path, step: int) -> Grid:
        """Return one instant of a file; raises SeriesError if it cannot be read or has no cells."""
        with self._open(file) as reader:
            if self.may_repeat and find_step_times(file):
                reader.ReadFromInputStringOn()
                reader.SetInputString(cut_out_step(file, step).decode())
                step = 0
            times = _list_times(reader)
            if step >= max(1, len(times or [])):
                raise SeriesError(f"{file}: it has {len(times or [])} steps, none with the number {step}")
            if self.find_fault is not None and (fault := self.find_fault(file, len(times or []))):
                raise SeriesError(f"{file}: cannot be read: {fault}")
            if self.by_number:
                getattr(reader, self.by_number)(step)
                reader.Update()
            elif times:
                reader.UpdateTimeStep(times[step])
            else:
                reader.Update()
        grid = make_grid(reader.GetOutputDataObject(0), file, node_number=self.node_number)
        grid = _drop_fields(grid, self.dropped) if self.dropped else grid
        return _note_restarts(grid, file) if self.node_number else grid

    def read_times(self, file: Path) -> list[float] | None:
        """Return the times [s] stored in a file, None if there are none; raises SeriesError."""
        if self.may_repeat and (steps := find_step_times(file)):
            return steps
        with self._open(file) as reader:
            return _list_times(reader)

    @contextlib.contextmanager
    def _open(self, file: Path) -> Iterator[Any]:
        """Give a reader of the file; errors that it reports until the end are raised there."""
        reader = getattr(import_module(f"vtkmodules.{self.module}"), self.name)()
        errors = list[str]()

        def append_error(_reader: object, _event: str, text: str) -> None:
            # VTK cannot read the ranges that it writes beside arrays with inf or NaN; the arrays themselves are whole
            if "InformationKey" not in text:
                errors.append(" ".join(text.split()))

        append_error.CallDataType = "string0"  # type: ignore[attr-defined]  # makes VTK pass the text
        reader.AddObserver("ErrorEvent", append_error)
        with _collect_output(errors) if self.listens else contextlib.nullcontext():
            if hasattr(reader, "SetFileName"):
                reader.SetFileName(str(file))
            if self.set_up is not None:
                self.set_up(reader, file)
            yield reader
        if errors or reader.GetErrorCode():
            reason = errors[0].rsplit("): ", 1)[-1] if errors else f"VTK's error {reader.GetErrorCode()}"
            raise SeriesError(f"{file}: cannot be read ({shorten(reason, 200)})")


def _set_up_legacy(reader: Any, _file: Path) -> None:
    # by default VTK reads only the first field of each kind
    for kind in ("Scalars", "Vectors", "Tensors", "Fields", "Normals"):
        getattr(reader, f"ReadAll{kind}On")()


XML_READERS = {
    suffix: VtkReader("vtkIOXML", f"vtkXML{kind}Reader", may_repeat=suffix in (".vtu", ".vtp"))
    for suffix, kind in {
        ".vtu": "UnstructuredGrid", ".vtp": "PolyData", ".vts": "StructuredGrid", ".vtr": "RectilinearGrid",
        ".vti": "ImageData",
    }.items()
}  # fmt: skip
LEGACY = VtkReader("vtkIOLegacy", "vtkDataSetReader", _set_up_legacy, listens=True)
VTKHDF = VtkReader("vtkIOHDF", "vtkHDFReader", by_number="SetStep")


def read_legacy_times(file: Path) -> list[float] | None:
    """Return the time [s] of a legacy file, known only after all of it has been read; None if there is none."""
    value = LEGACY.read(file, 0).field_data.get("TimeValue") if b"TimeValue" in file.read_bytes() else None
    return None if value is None else [float(value.ravel()[0])]


def _note_restarts(grid: Grid, file: Path) -> Grid:
    """Return the grid with a note if the series goes on in files that are not read with this one (out.e-s002)."""
    others = sorted(other.name for other in file.parent.glob(f"{glob.escape(file.name)}-s[0-9]*"))
    if not others:
        return grid
    return replace(grid, notes=(*grid.notes, f"the series goes on in {join_names(others)}: name one to read it"))


def _drop_fields(grid: Grid, names: tuple[str, ...]) -> Grid:
    nodal, cellular, whole = (
        {name: values for name, values in fields.items() if name not in names}
        for fields in (grid.point_data, grid.cell_data, grid.field_data)
    )
    return replace(grid, point_data=nodal, cell_data=cellular, field_data=whole)


def _list_times(reader: Any) -> list[float] | None:
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline

    reader.UpdateInformation()
    information, key = reader.GetOutputInformation(0), Pipeline.TIME_STEPS()
    return [float(time) for time in information.Get(key)] if information.Has(key) else None


@contextlib.contextmanager
def _collect_output(errors: list[str]) -> Iterator[None]:
    """Append VTK's general output to the errors: often the only sign that data end too early."""
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    before, window = vtkOutputWindow.GetInstance(), vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(window)
    try:
        yield
    finally:
        vtkOutputWindow.SetInstance(before)
        errors += [" ".join(line.split()) for line in window.GetOutput().splitlines() if line.strip()]
