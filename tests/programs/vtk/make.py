"""Files of VTK 9.7's vtkHDFWriter with time steps: .vtkhdf with resting and with moving points.

    pip install vtk;  python make.py

The motion is imposed; the mesh has 20-node hexahedra, quadratic wedges and 10-node tetrahedra side by side.
"""

import sys
from pathlib import Path

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk
from vtk.util.vtkAlgorithm import VTKPythonAlgorithmBase

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import CUBE, CUBE_EDGES, PRISM_EDGES, SIMPLEX_EDGES, integrate_cells, with_midpoints  # noqa: E402

WEDGES = [CUBE[[0, 1, 3, 4, 5, 7]], CUBE[[1, 2, 3, 5, 6, 7]]]
TETRAHEDRA = [CUBE[[0, a, b, 6]] for a, b in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))]
KINDS = [
    ("hexahedron_20", [with_midpoints(CUBE, CUBE_EDGES)], vtk.VTK_QUADRATIC_HEXAHEDRON, 8),
    ("wedge_15", [with_midpoints(c, PRISM_EDGES) for c in WEDGES], vtk.VTK_QUADRATIC_WEDGE, 6),
    ("tetrahedron_10", [with_midpoints(c, SIMPLEX_EDGES) for c in TETRAHEDRA], vtk.VTK_QUADRATIC_TETRA, 4),
]


def make_mesh():
    """Return the points, the cells and their kinds: each kind fills a third of the bar, apart from the others."""
    points, cells, kinds = [], [], []
    for block, (_, pieces, _, _) in enumerate(KINDS):
        numbers, first = {}, len(points)
        for piece in pieces:
            X = (piece + np.array([block, 0, 0])) * np.array([2 / 3, 1, 1])
            cells.append([first + numbers.setdefault(tuple(np.round(p, 9)), len(numbers)) for p in X])
            kinds.append(block)
        points += list(numbers)
    return np.array(points), cells, kinds


class Source(VTKPythonAlgorithmBase):
    """Source of the bar at TIMES, with the field displacement; its points move if `moves`."""

    def __init__(self, moves):
        super().__init__(nInputPorts=0, nOutputPorts=1, outputType="vtkUnstructuredGrid")
        self.moves = moves
        self.mesh = make_mesh()
        X, cells, kinds = self.mesh
        self.rest = vtk.vtkUnstructuredGrid()  # one object for all times: the writer stores resting points once
        points = vtk.vtkPoints()
        points.SetData(numpy_to_vtk(X, deep=True))
        self.rest.SetPoints(points)
        for cell, kind in zip(cells, kinds, strict=True):
            self.rest.InsertNextCell(KINDS[kind][2], len(cell), cell)

    def RequestInformation(self, request, inputs, outputs):
        information = outputs.GetInformationObject(0)
        information.Set(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS(), TIMES, len(TIMES))
        information.Set(vtk.vtkStreamingDemandDrivenPipeline.TIME_RANGE(), (TIMES[0], TIMES[-1]), 2)
        return 1

    def RequestData(self, request, inputs, outputs):
        information = outputs.GetInformationObject(0)
        key = vtk.vtkStreamingDemandDrivenPipeline.UPDATE_TIME_STEP()
        t = information.Get(key) if information.Has(key) else TIMES[0]
        X = self.mesh[0]
        x = move_bar(X, t)
        grid = vtk.vtkUnstructuredGrid()
        grid.ShallowCopy(self.rest)
        if self.moves:
            points = vtk.vtkPoints()
            points.SetData(numpy_to_vtk(x, deep=True))
            grid.SetPoints(points)
        field = numpy_to_vtk(x - X, deep=True)
        field.SetName("displacement")
        grid.GetPointData().AddArray(field)
        grid.GetInformation().Set(vtk.vtkDataObject.DATA_TIME_STEP(), t)
        outputs.GetInformationObject(0).Get(vtk.vtkDataObject.DATA_OBJECT()).ShallowCopy(grid)
        return 1


def main():
    for name, moves in (("rest_points.vtkhdf", False), ("moving_points.vtkhdf", True)):
        source = Source(moves)
        writer = vtk.vtkHDFWriter()
        writer.SetInputConnection(source.GetOutputPort())
        writer.SetFileName(str(HERE / name))
        writer.SetWriteAllTimeSteps(True)
        writer.SetChunkSize(50)  # the default of 25 000 fills small files with zeros
        writer.Write()
    X, cells, kinds = make_mesh()
    results = []
    for t in TIMES:
        parts = []
        for block, (shape, *_) in enumerate(KINDS):
            rows = np.array([c for c, k in zip(cells, kinds, strict=True) if k == block])
            parts.append(integrate_cells(shape, X, move_bar(X, t), rows))
        results.append([np.concatenate(arrays) for arrays in zip(*parts, strict=True)])
    centers = [X[cell[: KINDS[kind][3]]].mean(axis=0) for cell, kind in zip(cells, kinds, strict=True)]
    write_expected(
        HERE,
        *(
            make_expectation(
                f"VTK {vtk.vtkVersion.GetVTKVersion()}",
                name,
                TIMES,
                centers=centers,
                rest_volumes=results[0][0],
                volumes=[r[1] for r in results],
                gradients=[r[2] for r in results],
            )
            for name in ("rest_points.vtkhdf", "moving_points.vtkhdf")
        ),
    )


if __name__ == "__main__":
    main()
