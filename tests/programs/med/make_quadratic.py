"""A MED file by medcoupling 9: one quadratic tetrahedron, pyramid, wedge and hexahedron, with straight edges.

    pip install medcoupling;  python make_quadratic.py

medcoupling puts the nodes between the corners itself, so the file has MED's order of them.
"""

from pathlib import Path

import medcoupling as mc
import numpy as np

CUBE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], dtype=float)
PYRAMID = np.concatenate([CUBE[:4], [[0.5, 0.5, 1]]])
KINDS = [
    (CUBE[[0, 1, 2, 6]], mc.NORM_TETRA4),
    (PYRAMID, mc.NORM_PYRA5),
    (CUBE[[0, 1, 3, 4, 5, 7]], mc.NORM_PENTA6),
    (CUBE, mc.NORM_HEXA8),
]


def main():
    mesh = mc.MEDCouplingUMesh("kinds", 3)
    mesh.setCoords(
        mc.DataArrayDouble(np.concatenate([x + np.array([2.0 * i, 0, 0]) for i, (x, _) in enumerate(KINDS)]))
    )
    mesh.allocateCells()
    first = 0
    for x, kind in KINDS:
        mesh.insertNextCell(kind, list(range(first, first + len(x))))
        first += len(x)
    mesh.orientCorrectly3DCells()
    mesh.convertLinearCellsToQuadratic(0)
    mc.WriteUMesh(str(Path(__file__).parent / "quadratic.med"), mesh, True)


if __name__ == "__main__":
    main()
