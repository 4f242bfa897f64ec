"""Files of fedoo 1.1: a bar of 20-node hexahedra with large displacements, stretched and twisted; numbered .vtk.

pip install fedoo pyvista;  python make.py
"""

import shutil
import sys
import tempfile
from pathlib import Path

import fedoo as fd
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import integrate_cells  # noqa: E402


def main():
    fd.ModelingSpace("3D")
    mesh = fd.mesh.box_mesh(3, 2, 2, 0, 2, 0, 1, 0, 1, elm_type="hex20")
    law = fd.constitutivelaw.ElasticIsotrop(10.0, 0.3)
    weak = fd.weakform.StressEquilibrium(law, nlgeom=True)
    assembly = fd.Assembly.create(weak, mesh)
    problem = fd.problem.NonLinear(assembly)
    X = np.array(mesh.nodes)
    target = move_bar(X, 1.0) - X
    left, right = np.flatnonzero(X[:, 0] < 1e-9), np.flatnonzero(X[:, 0] > 2 - 1e-9)
    problem.bc.add("Dirichlet", left, "Disp", 0)
    for axis, name in enumerate(("DispX", "DispY", "DispZ")):
        for node in right:
            problem.bc.add("Dirichlet", [node], name, float(target[node, axis]))
    times, states = [], []

    def record(problem):
        times.append(problem.time)
        states.append(np.array(problem.get_disp()).reshape(3, -1).T.copy())

    with tempfile.TemporaryDirectory() as folder:
        problem.add_output(f"{folder}/bar", assembly, ["Disp"], file_format="vtk")
        problem.nlsolve(dt=0.25, tmax=1, update_dt=False, print_info=0, interval_output=0.25,
                        callback=record)  # fmt: skip
        for file in sorted(Path(folder).rglob("*.vtk")):
            shutil.copy(file, HERE)
    cells = np.array(mesh.elements)
    parts = [integrate_cells("hexahedron_20", X, X + u, cells) for u in states]
    write_expected(
        HERE,
        make_expectation(f"fedoo {fd.__version__}", "bar_*.vtk", times, centers=X[cells[:, :8]].mean(axis=1),
                         rest_volumes=parts[0][0], volumes=[p[1] for p in parts], gradients=[p[2] for p in parts],
                         accuracy=1e-6),
    )  # fmt: skip


if __name__ == "__main__":
    main()
