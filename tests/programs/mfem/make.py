"""Files of MFEM: bars of second order, stretched and twisted; high-order Lagrange cells by ParaViewDataCollection.

pip install mfem;  python make.py
"""

import os
import shutil
import sys
from importlib.metadata import version
from pathlib import Path

import mfem.ser as mfem
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402

ORDER = 2
KINDS = {"hexahedra": mfem.Element.HEXAHEDRON, "tetrahedra": mfem.Element.TETRAHEDRON, "wedges": mfem.Element.WEDGE,
         "moving": mfem.Element.HEXAHEDRON}  # fmt: skip


class Motion(mfem.VectorPyCoefficient):
    """Displacement of the bar."""

    def __init__(self):
        super().__init__(3)
        self.t = 0.0

    def EvalValue(self, x):
        return (move_bar(np.array([x]), self.t) - x)[0]


def integrate(mesh, u):
    """Return the volumes and the means of F of the cells, by the program's own quadrature."""
    volumes, means = [], []
    gradient = mfem.DenseMatrix(3, 3)
    for k in range(mesh.GetNE()):
        transformation = mesh.GetElementTransformation(k)
        rule = mfem.IntRules.Get(mesh.GetElementBaseGeometry(k), 10)
        rest = volume = 0.0
        mean = np.zeros((3, 3))
        for i in range(rule.GetNPoints()):
            point = rule.IntPoint(i)
            transformation.SetIntPoint(point)
            weight = point.weight * transformation.Weight()
            u.GetVectorGradient(transformation, gradient)
            F = np.eye(3) + gradient.GetDataArray()
            rest += weight
            volume += weight * np.linalg.det(F)
            mean += weight * F
        volumes.append((rest, volume))
        means.append(mean / rest)
    rest, volumes = np.array(volumes).T
    return rest, volumes, np.array(means)


def main():
    os.chdir(HERE)
    entries = []
    for name, kind in KINDS.items():
        n = (2, 1, 1)
        mesh = mfem.Mesh.MakeCartesian3D(*n, kind, 2.0, 1.0, 1.0)
        mesh.SetCurvature(ORDER, False, 3, mfem.Ordering.byNODES)
        space = mfem.FiniteElementSpace(mesh, mfem.H1_FECollection(ORDER, 3), 3, mfem.Ordering.byNODES)
        u = mfem.GridFunction(space)
        motion = Motion()
        shutil.rmtree(name, ignore_errors=True)
        rest_nodes = mesh.GetNodes().GetDataArray().copy()
        moving = name == "moving"
        output = mfem.ParaViewDataCollection(name, mesh)
        output.SetPrefixPath(".")
        output.RegisterField("displacement", u)
        output.SetLevelsOfDetail(ORDER)
        output.SetHighOrderOutput(True)
        volumes, means = [], []
        for cycle, t in enumerate(TIMES):
            motion.t = t
            u.ProjectCoefficient(motion)
            output.SetCycle(cycle)
            output.SetTime(t)
            rest, volume, mean = integrate(mesh, u)
            if moving:  # the mesh's own nodes move, and the field is there too
                mesh.GetNodes().GetDataArray()[:] = rest_nodes + u.GetDataArray()
            output.Save()
            mesh.GetNodes().GetDataArray()[:] = rest_nodes
            volumes.append(volume)
            means.append(mean)
        centers = [np.mean([mesh.GetVertexArray(v) for v in mesh.GetElementVertices(k)], axis=0)
                   for k in range(mesh.GetNE())]  # fmt: skip
        entries.append(
            make_expectation(
                f"MFEM, PyMFEM {version('mfem')}",
                f"{name}/{name}.pvd",
                TIMES,
                centers=centers,
                rest_volumes=rest,
                volumes=volumes,
                gradients=means,
            )
        )
    write_expected(HERE, *entries)


if __name__ == "__main__":
    main()
