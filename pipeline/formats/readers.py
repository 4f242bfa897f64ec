"""Every format that frames are read from: one row per format.

These readers run in the calling process, which a damaged file can crash, so foreign files are read through the sandbox.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.errors import SeriesError, shorten
from pipeline.formats.adios import read_bp, read_bp_times
from pipeline.formats.frd import read_frd, read_frd_times
from pipeline.formats.grid import Grid, PolyhedronFaces
from pipeline.formats.med import read_med, read_med_times
from pipeline.formats.multiblock import find_first_piece, read_own_times, read_pieces
from pipeline.formats.vtk_readers import LEGACY, VTKHDF, XML_READERS, VtkReader, read_legacy_times
from pipeline.formats.vtk_solvers import CGNS, DYNA, ENSIGHT, EXODUS, OPENFOAM
from pipeline.formats.xdmf.reader import read_xdmf, read_xdmf_times


class FrameReader(NamedTuple):
    """Reads one instant of a file, and the times [s] stored in it (None if there are none).

    `names` are suffixes, or whole names of files without one. `has_steps`: one file holds a whole series. `package`
    must be installed for it. `spread`: its numbers are in other files beside it. `tested` names the programs that
    wrote the files of the tests.
    """

    names: tuple[str, ...]
    description: str
    read: Callable[[Path, int], Grid]
    read_times: Callable[[Path], list[float] | None]
    has_steps: bool = False
    programs: str = ""
    package: str = ""
    spread: bool = False
    tested: str = ""


def _use_vtk(names: str, description: str, reader: VtkReader, programs: str = "", **more: Any) -> FrameReader:
    return FrameReader(tuple(names.split()), description, reader.read, reader.read_times, programs=programs, **more)


def _use_pieces(names: str, description: str, programs: str, tested: str) -> FrameReader:
    """Return the row of files that name others, each of which has a row of its own."""

    def read(file: Path, _step: int) -> Grid:
        return read_pieces(file, read_grid, SUFFIXES)

    def read_own_or_first(file: Path) -> list[float] | None:
        first = find_first_piece(file)
        return list(read_own_times(file)) or (None if first is None else read_times(first))

    return FrameReader(
        tuple(names.split()), description, read, read_own_or_first, False, programs, spread=True, tested=tested
    )


_XML_NAMES = {
    ".vtu": "VTK unstructured grid", ".vtp": "VTK surface", ".vts": "VTK structured grid",
    ".vtr": "VTK rectilinear grid", ".vti": "VTK image",
}  # fmt: skip
_XML_TESTS = {".vtu": "scikit-fem, deal.II, NGSolve, GetFEM, FreeFEM, FEniCS"}
FORMATS = (
    *(
        _use_vtk(suffix, _XML_NAMES[suffix], reader, "most solvers", tested=_XML_TESTS.get(suffix, "PyVista"))
        for suffix, reader in XML_READERS.items()
    ),
    _use_pieces(".pvtu .pvtp", "VTK grid or surface in pieces", "parallel solvers", tested="dolfinx, MFEM"),
    _use_pieces(".vtm .vtmb", "VTK blocks", "OpenFOAM, ParaView, PyVista", tested="OpenFOAM"),
    _use_pieces(".vtpd .vtpc", "VTK partitions", "VTK, ParaView", tested="VTK"),
    FrameReader(
        (".vtk",), "VTK legacy", LEGACY.read, read_legacy_times, programs="Kratos, SfePy, SOFA",
        tested="Kratos, GetFEM",
    ),
    _use_vtk(".vtkhdf .hdf", "VTKHDF", VTKHDF, "VTK, ParaView, this program", has_steps=True, tested="VTK"),
    FrameReader(
        (".xdmf", ".xmf"), "XDMF 2 and 3", read_xdmf, read_xdmf_times, has_steps=True,
        programs="FEniCS, felupe, scikit-fem, OpenGeoSys", package="h5py", spread=True,
        tested="dolfinx, FEniCS, felupe, scikit-fem, OpenGeoSys, meshio",
    ),
    _use_vtk(".e .ex2 .exo .exodus", "Exodus II", EXODUS, "MOOSE, Sierra, Cubit", has_steps=True, tested="exovista"),
    _use_vtk(
        ".case .encas", "EnSight", ENSIGHT, "Ansys, STAR-CCM+, Code_Saturne", has_steps=True, spread=True,
        tested="OpenFOAM",
    ),
    _use_vtk("d3plot", "LS-DYNA d3plot", DYNA, "LS-DYNA", has_steps=True, spread=True),
    _use_vtk(
        ".foam", "OpenFOAM case", OPENFOAM, "OpenFOAM, solids4foam", has_steps=True, spread=True, tested="OpenFOAM"
    ),
    _use_vtk(".cgns", "CGNS", CGNS, "CFD programs", has_steps=True),
    FrameReader(
        (".med", ".rmed"), "MED", read_med, read_med_times, has_steps=True, programs="Code_Aster, Salome",
        package="h5py", tested="medcoupling",
    ),
    FrameReader(
        (".bp",), "ADIOS2, as VTX", read_bp, read_bp_times, has_steps=True, programs="dolfinx (VTXWriter)",
        package="adios2", spread=True, tested="adios2",
    ),
    FrameReader(
        (".frd",), "CalculiX results", read_frd, read_frd_times, has_steps=True, programs="CalculiX", tested="CalculiX"
    ),
)  # fmt: skip
READERS = {name: row for row in FORMATS for name in row.names}
SUFFIXES = tuple(name for name, row in READERS.items() if not row.has_steps)
TEMPORAL_SUFFIXES = tuple(name for name, row in READERS.items() if row.has_steps and name.startswith("."))
TEMPORAL_NAMES = tuple(name for name, row in READERS.items() if row.has_steps and not name.startswith("."))


# MOOSE goes on in another file when the mesh has changed: out.e, out.e-s002
_RESTART = re.compile(r"\.(e|ex2|exo|exodus)-s\d+")


def find_format(file: Path) -> FrameReader | None:
    """Return the row of a file's name or suffix, None if there is none."""
    if _RESTART.fullmatch(file.suffix):
        return READERS[".e"]
    return READERS.get(file.name) or READERS.get(file.suffix.lower())


def is_temporal(file: Path) -> bool:
    """Return whether a file of this name holds a whole series."""
    row = find_format(file)
    return row is not None and row.has_steps


def is_folder(file: Path) -> bool:
    """Return whether this is a folder that one program reads as a file."""
    return file.suffix.lower() == ".bp" and file.is_dir()


def read_grid(file: Path, step: int = 0) -> Grid:
    """Return one instant of a file; raises SeriesError if it cannot be read or has no cells."""
    if not (file.is_file() or is_folder(file)):
        raise SeriesError(f"{file}: no such file")
    return _require_format(file).read(file, step)


def read_plain_grid(file: Path, step: int) -> tuple[Any, ...]:
    """Return the fields of read_grid's Grid as plain arrays, numbers and texts, which a child process can send."""
    grid = read_grid(file, step)
    fields = (grid.point_data, grid.cell_data, grid.field_data)
    cells = (grid.types, grid.offsets, grid.connectivity)
    faces = None if grid.faces is None else tuple(grid.faces)
    return grid.points, grid.count, *cells, *fields, faces, grid.parts, grid.part_names, grid.notes


def make_plain_grid(fields: tuple[Any, ...]) -> Grid:
    """Return the Grid whose fields read_plain_grid returned."""
    points, count, types, offsets, connectivity, nodal, cellular, whole, faces, *parts = fields
    own_faces = None if faces is None else PolyhedronFaces(*faces)
    return Grid(points, count, types, offsets, connectivity, nodal, cellular, whole, own_faces, *parts)


def read_times(file: Path) -> list[float] | None:
    """Return the times [s] stored in a file, None if there are none; raises SeriesError."""
    return _require_format(file).read_times(file)


def _require_format(file: Path) -> FrameReader:
    row = find_format(file)
    if row is None:
        suffix = shorten(file.suffix) or "a file without suffix"
        raise SeriesError(f"{file}: there is no reader for {suffix}; choose from {', '.join(READERS)}")
    return row
