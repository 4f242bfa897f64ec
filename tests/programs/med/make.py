"""A MED file by medcoupling 9: three kinds of cells; the field resu____DEPL (DX, DY, DZ), as Code_Aster names it.

    pip install medcoupling;  python make.py

Cells are oriented as MED has them, so their nodes are in another order than VTK's.
"""

import sys
from pathlib import Path

import medcoupling as mc
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import CUBE, integrate_cells  # noqa: E402

WEDGES = [CUBE[[0, 1, 3, 4, 5, 7]], CUBE[[1, 2, 3, 5, 6, 7]]]
TETRAHEDRA = [CUBE[[0, a, b, 6]] for a, b in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))]
KINDS = [
    ("tetrahedron", TETRAHEDRA, mc.NORM_TETRA4),
    ("wedge", WEDGES, mc.NORM_PENTA6),
    ("hexahedron", [CUBE], mc.NORM_HEXA8),
]


def main():
    numbers, cells, kinds, centers = {}, [], [], []
    for block, (_, pieces, kind) in enumerate(KINDS):
        for piece in pieces:
            points = (piece + np.array([block, 0, 0])) * np.array([2 / 3, 1, 1])
            cells.append([numbers.setdefault(tuple(np.round(p, 9)), len(numbers)) for p in points])
            kinds.append(kind)
            centers.append(points.mean(axis=0))
    X = np.array(list(numbers))
    mesh = mc.MEDCouplingUMesh("bar", 3)
    mesh.setCoords(mc.DataArrayDouble(X))
    mesh.allocateCells()
    for kind, cell in zip(kinds, cells, strict=True):
        mesh.insertNextCell(kind, cell)
    mesh.orientCorrectly3DCells()
    path = str(HERE / "bar.rmed")
    mc.WriteUMesh(path, mesh, True)
    results = []
    for step, t in enumerate(TIMES):
        x = move_bar(X, t)
        field = mc.MEDCouplingFieldDouble(mc.ON_NODES, mc.ONE_TIME)
        field.setName("resu____DEPL")
        field.setMesh(mesh)
        values = mc.DataArrayDouble(x - X)
        values.setInfoOnComponents(["DX", "DY", "DZ"])
        field.setArray(values)
        field.setTime(t, step, step)
        mc.WriteFieldUsingAlreadyWrittenMesh(path, field)
        parts = []
        for shape, _, kind in KINDS:
            rows = np.array([c for c, k in zip(cells, kinds, strict=True) if k == kind])
            parts.append(integrate_cells(shape, X, x, rows))
        results.append([np.concatenate(arrays) for arrays in zip(*parts, strict=True)])
    write_expected(
        HERE,
        make_expectation(f"medcoupling {mc.MEDCouplingVersionStr()}", "bar.rmed", TIMES, centers=centers,
                         rest_volumes=results[0][0], volumes=[r[1] for r in results],
                         gradients=[r[2] for r in results]),
    )  # fmt: skip


if __name__ == "__main__":
    main()
