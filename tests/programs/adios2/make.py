"""A folder .bp by adios2 2.12, in the layout of dolfinx's VTXWriter: 10-node tetrahedra, the displacement u.

    pip install adios2;  python make.py

Debian's dolfinx is built without ADIOS2, so this script writes the variables that its VTXWriter writes.
"""

import shutil
import sys
from pathlib import Path

import adios2
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import CUBE, SIMPLEX_EDGES, integrate_cells, with_midpoints  # noqa: E402

TETRAHEDRA = [CUBE[[0, a, b, 6]] for a, b in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))]
LAGRANGE_TETRAHEDRON = 71
SCHEMA = """
<VTKFile type="UnstructuredGrid" version="0.1">
  <UnstructuredGrid>
    <Piece NumberOfPoints="NumberOfNodes" NumberOfCells="NumberOfCells">
      <Points>
        <DataArray Name="geometry" />
      </Points>
      <Cells>
        <DataArray Name="connectivity" />
        <DataArray Name="types" />
      </Cells>
      <PointData>
        <DataArray Name="TIME">step</DataArray>
        <DataArray Name="vtkOriginalPointIds" />
        <DataArray Name="vtkGhostType" />
        <DataArray Name="u" />
      </PointData>
    </Piece>
  </UnstructuredGrid>
</VTKFile>
"""


def main():
    numbers, cells = {}, []
    for shift in (0.0, 1.0):
        for corners in TETRAHEDRA:
            points = with_midpoints(corners, SIMPLEX_EDGES) + np.array([shift, 0, 0])
            cells.append([numbers.setdefault(tuple(p), len(numbers)) for p in points])
    X, cells = np.array(list(numbers)), np.array(cells)
    shutil.rmtree(HERE / "bar.bp", ignore_errors=True)
    results = []
    with adios2.Stream(str(HERE / "bar.bp"), "w") as stream:
        for t in TIMES:
            x = move_bar(X, t)
            results.append(integrate_cells("tetrahedron_10", X, x, cells))
            stream.begin_step()
            if t == TIMES[0]:
                stream.write_attribute("vtk.xml", SCHEMA)
                write_mesh(stream, X, cells)
            stream.write("step", np.array(t))
            u = x - X
            stream.write("u", u, [], [], list(u.shape))
            stream.end_step()
    write_expected(
        HERE,
        make_expectation("adios2 2.12, as dolfinx's VTXWriter", "bar.bp", TIMES, centers=X[cells[:, :4]].mean(axis=1),
                         rest_volumes=results[0][0], volumes=[r[1] for r in results],
                         gradients=[r[2] for r in results]),
    )  # fmt: skip


def write_mesh(stream, X, cells):
    rows = np.concatenate([np.full((len(cells), 1), cells.shape[1]), cells], axis=1).astype(np.int64)
    stream.write("geometry", X, [], [], list(X.shape))
    stream.write("connectivity", rows, [], [], list(rows.shape))
    stream.write("types", np.array(LAGRANGE_TETRAHEDRON, dtype=np.uint32))
    stream.write("NumberOfNodes", np.array([len(X)], dtype=np.uint32))
    stream.write("NumberOfCells", np.array([len(cells)], dtype=np.uint32))
    ids = np.arange(len(X), dtype=np.int64)
    stream.write("vtkOriginalPointIds", ids, [], [], [len(X)])
    stream.write("vtkGhostType", np.zeros(len(X), dtype=np.uint8), [], [], [len(X)])


if __name__ == "__main__":
    main()
