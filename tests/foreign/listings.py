"""Indices, names and times of frames: rounded, equal or missing times, odd paths, and broken indices."""

import json
from pathlib import Path

import numpy as np

from tests.foreign.displacements import CELLS, POINTS, TETRAHEDRA
from tests.foreign.writers import STRETCHES, index, stretch, write_pvd, write_vtu


def equal_times(folder: Path) -> None:
    """Numbered files that all say TimeValue = 0."""
    for k, s in enumerate(STRETCHES):
        write_vtu(folder / f"f_{k}.vtu", stretch(POINTS, s), TETRAHEDRA, field_data={"TimeValue": [0.0]})


def many_digits(folder: Path) -> None:
    """Numbers of files with different counts of digits."""
    for k in (0, 999999, 1000000, 10000000):
        write_vtu(folder / f"timestep_{k:06d}.vtu", stretch(POINTS, 1 + 1e-8 * k), TETRAHEDRA)


def names_with_decimals(folder: Path) -> None:
    """The names of the files hold times, whose text does not sort like the numbers."""
    for time in ("0.0005", "0.001", "0.0015", "0.002"):
        write_vtu(folder / f"result-{time}.vtu", stretch(POINTS, 1 + 100 * (float(time) - 0.0005)), TETRAHEDRA)


def rounded_times(folder: Path) -> None:
    """Times written with few digits: three different frames at 8e+06."""
    times = ["0", "4e+06", "8e+06", "8e+06", "8e+06"]
    for k, s in enumerate((1.0, 1.1, 1.2, 1.8, 1.3)):
        write_vtu(folder / f"f_{k}.vtu", stretch(POINTS, s), TETRAHEDRA)
    write_pvd(
        folder / "s.pvd",
        [{"timestep": t, "group": "", "part": 0, "file": f"f_{k}.vtu"} for k, t in enumerate(times)],
    )


def paths(folder: Path) -> None:
    """Paths of an index: Windows separators, absolute, upwards; no timestep; a decimal comma."""
    for k, s in enumerate(STRETCHES):
        write_vtu(folder / f"vtu/f_{k}.vtu", stretch(POINTS, s), TETRAHEDRA)
    index(folder, "backslash", "vtu\\f_{}.vtu")
    index(folder, "dotback", ".\\vtu\\f_{}.vtu")
    index(folder, "absolute", f"{folder.resolve().as_posix()}/vtu/f_{{}}.vtu")
    index(folder / "pvd", "up", "../vtu/f_{}.vtu")
    write_pvd(folder / "nostep.pvd", [{"part": 0, "file": "vtu/f_2.vtu"}])
    write_pvd(folder / "comma.pvd", [{"timestep": f"{k},5", "part": 0, "file": f"vtu/f_{k}.vtu"} for k in range(3)])


def broken_index(folder: Path) -> None:
    """An index whose writer was killed, and one with times such as 2.0D-1 and paths that begin with a dot."""
    for k, s in enumerate(STRETCHES):
        u = stretch(POINTS, s) - POINTS
        write_vtu(folder / f"f_{k}.vtu", POINTS, TETRAHEDRA, {"d": u, "v": 3 * u, "p": np.zeros(len(POINTS))})
    index(folder, "full")
    (folder / "killed.pvd").write_text((folder / "full.pvd").read_text().split("</Collection>")[0])
    rows = [{"timestep": t, "part": 0, "file": f"./f_{k}.vtu"} for k, t in enumerate(["0", "1e-1", "2.0D-1"])]
    write_pvd(folder / "dots.pvd", rows)


def legacy_and_multiblock(folder: Path) -> None:
    """A .vtk.series as NAME.dt0.vtk, frames of several blocks (.vtm), and suffixes in capitals."""
    import pyvista

    folder.mkdir(parents=True, exist_ok=True)
    for k, s in enumerate(STRETCHES):
        moved = pyvista.UnstructuredGrid({10: CELLS}, stretch(POINTS, s))
        still = pyvista.UnstructuredGrid({10: CELLS}, POINTS)
        for grid in (moved, still):
            grid["Displacement"] = stretch(POINTS, s) - POINTS
        still.save(folder / f"Solid-Mesh.dt{k}.vtk")
        pyvista.MultiBlock({"internal": moved}).save(folder / f"case_{k}.vtm")
        moved.save(folder / f"U_{k}.vtu")
        (folder / f"U_{k}.vtu").rename(folder / f"U_{k}.VTU")
        pyvista.MultiBlock({"a": moved}).save(folder / f"m_{k}.vtm")
    names = [{"name": f"Solid-Mesh.dt{k}.vtk", "time": 0.1 * k} for k in range(3)]
    (folder / "Solid-Mesh.vtk.series").write_text(json.dumps({"file-series-version": "1.0", "files": names}))
    still.save(folder / "Solid-Mesh.init.vtk")
    index(folder, "vtm", "m_{}.vtm")
    index(folder, "capitals", "U_{}.VTU")
    (folder / "capitals.pvd").rename(folder / "S.PVD")


def steps_in_one_vtu(folder: Path) -> None:
    """One .vtu that holds several time steps, as VTK's writer writes with NumberOfTimeSteps."""
    import pyvista
    import vtk

    folder.mkdir(parents=True, exist_ok=True)
    grid = pyvista.UnstructuredGrid({10: CELLS}, POINTS)
    grid["displacement"] = 0 * POINTS
    writer = vtk.vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(str(folder / "all.vtu"))
    writer.SetNumberOfTimeSteps(3)
    writer.SetDataModeToAscii()
    writer.Start()
    for k, s in enumerate(STRETCHES):
        grid["displacement"][:] = stretch(POINTS, s) - POINTS
        grid.GetPointData().GetArray("displacement").Modified()
        grid.Modified()
        writer.WriteNextTime(0.1 * k)
    writer.Stop()
