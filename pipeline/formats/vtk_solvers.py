"""Settings of VTK's readers of solvers' files, so that they return all numbers as they are in the file."""

from pathlib import Path
from typing import Any

from pipeline.formats.solver_checks import find_dyna_fault, find_ensight_fault, find_exodus_fault
from pipeline.formats.vtk_readers import VtkReader


def _set_up_exodus(reader: Any, _file: Path) -> None:
    """The points stay at rest and are those of the file, all blocks and fields are read, numbers are kept."""
    reader.ApplyDisplacementsOff()
    reader.GenerateGlobalElementIdArrayOn()
    reader.GenerateGlobalNodeIdArrayOn()
    reader.GenerateImplicitNodeIdArrayOn()  # its blocks share points, and positions do not identify them
    reader.GenerateObjectIdCellArrayOn()
    reader.UpdateInformation()
    for kind in (reader.ELEM_BLOCK, reader.NODAL, reader.GLOBAL):
        reader.SetAllArrayStatus(kind, 1)
    for block in range(reader.GetNumberOfObjects(reader.ELEM_BLOCK)):
        reader.SetObjectStatus(reader.ELEM_BLOCK, block, 1)


def _set_up_ensight(reader: Any, file: Path) -> None:
    reader.SetCaseFileName(str(file.absolute()))
    reader.ReadAllVariablesOn()


def _set_up_openfoam(reader: Any, file: Path) -> None:
    """Fields are read where OpenFOAM has them, the first time too, and no boundaries."""
    reader.SetCreateCellToPoint(0)
    reader.SetSkipZeroTime(False)
    reader.SetListTimeStepsByControlDict(0)
    if not (file.parent / "constant" / "polyMesh").is_dir() and (file.parent / "processor0").is_dir():
        reader.SetCaseType(0)  # decomposed
    else:
        reader.SetCaseType(1)
    reader.UpdateInformation()
    reader.EnableAllCellArrays()
    reader.EnableAllPointArrays()
    for i in range(reader.GetNumberOfPatchArrays()):
        name = reader.GetPatchArrayName(i)
        reader.SetPatchArrayStatus(name, name.rsplit("/", 1)[-1] == "internalMesh")


def _set_up_dyna(reader: Any, _file: Path) -> None:
    reader.SetDeformedMesh(1)  # the file has deformed coordinates
    reader.SetRemoveDeletedCells(0)  # the cells must be those of all instants


def _set_up_cgns(reader: Any, _file: Path) -> None:
    reader.SetLoadBndPatch(0)
    reader.UpdateInformation()
    reader.EnableAllBases()
    reader.EnableAllFamilies()
    reader.EnableAllPointArrays()
    reader.EnableAllCellArrays()


EXODUS = VtkReader(
    "vtkIOExodus",
    "vtkExodusIIReader",
    _set_up_exodus,
    by_number="SetTimeStep",
    node_number="ImplicitNodeId",
    dropped=("PedigreeNodeId", "PedigreeElementId", "ElementBlockIds", "Title"),
    listens=True,
    find_fault=find_exodus_fault,
)
ENSIGHT = VtkReader(
    "vtkIOEnSight", "vtkGenericEnSightReader", _set_up_ensight, listens=True, find_fault=find_ensight_fault
)
OPENFOAM = VtkReader("vtkIOParallel", "vtkPOpenFOAMReader", _set_up_openfoam, listens=True)
# its node numbers are wrong in single precision: VTK takes pairs of them for one number
DYNA = VtkReader(
    "vtkIOLSDyna",
    "vtkLSDynaReader",
    _set_up_dyna,
    by_number="SetTimeStep",
    dropped=("UserID",),
    listens=True,
    find_fault=find_dyna_fault,
)
CGNS = VtkReader("vtkIOCGNSReader", "vtkCGNSReader", _set_up_cgns, listens=True)
