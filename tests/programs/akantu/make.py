"""Files of Akantu 5: a bar in finite deformation, stretched and twisted; tetrahedra, by its ParaView dumper: .pvtu.

pip install akantu gmsh;  python make.py
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path

import akantu as aka
import gmsh
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import integrate_cells  # noqa: E402

MATERIAL = """material elastic [
  name = soft
  rho = 1
  E = 10
  nu = 0.3
  finite_deformation = true
]
"""


def write_mesh(path):
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 1.0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0)
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
    gmsh.model.occ.addBox(0, 0, 0, 2, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [1])
    gmsh.model.mesh.generate(3)
    gmsh.write(path)
    gmsh.finalize()


def main():
    os.chdir(tempfile.mkdtemp())
    write_mesh("bar.msh")
    Path("material.dat").write_text(MATERIAL)
    aka.parseInput("material.dat")
    mesh = aka.Mesh(3)
    mesh.read("bar.msh")
    model = aka.SolidMechanicsModel(mesh)
    model.initFull(_analysis_method=aka._static)
    X = mesh.getNodes().copy()
    u, blocked = model.getDisplacement(), model.getBlockedDOFs()
    ends = np.flatnonzero(np.isclose(X[:, 0], 0) | np.isclose(X[:, 0], 2))
    blocked[ends] = True
    solver = model.getNonLinearSolver()
    solver.set("max_iterations", 50)
    solver.set("threshold", 1e-10)
    solver.set("convergence_type", aka.SolveConvergenceCriteria.residual)
    model.setBaseName("bar")
    model.addDumpFieldVector("displacement")
    cells = mesh.getConnectivity(aka._tetrahedron_4).copy()
    results = []
    for step, t in enumerate(TIMES):
        u[ends] = move_bar(X[ends], t) - X[ends]
        if t > 0:
            model.solveStep()
        model.dump(t, step)
        results.append(integrate_cells("tetrahedron", X, X + u, cells))
    for name in os.listdir("paraview"):
        source = Path("paraview", name)
        target = HERE / name
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
    write_expected(
        HERE,
        make_expectation(f"Akantu {aka.__version__}", "bar_*.pvtu", range(len(TIMES)), centers=X[cells].mean(axis=1),
                         rest_volumes=results[0][0], volumes=[r[1] for r in results],
                         gradients=[r[2] for r in results], accuracy=1e-6),
    )  # fmt: skip


if __name__ == "__main__":
    main()
