"""Files of EasyFEA 7: a plate of 8-node quadrilaterals, stretched and turned by 60 degrees; .pvd and .vtu by Save_simu.

pip install EasyFEA;  python make.py
"""

import shutil
import sys
import tempfile
from pathlib import Path

import EasyFEA
import numpy as np
from EasyFEA import ElemType, Geoms, Models, Simulations
from EasyFEA.IO import Paraview

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_plate, write_expected  # noqa: E402
from quadrature import integrate_cells  # noqa: E402


def main():
    plate = Geoms.Domain((0, 0), (2, 1), 0.5)
    mesh = plate.Mesh_2D([], ElemType.QUAD8, isOrganised=True)
    X = np.array(mesh.coord)[:, :2]
    simulation = Simulations.Elastic(mesh, Models.Elastic.Isotropic(2, E=10.0, v=0.3))
    ends = np.flatnonzero(np.isclose(X[:, 0], 0) | np.isclose(X[:, 0], 2))
    results = []
    cells = np.array(mesh.connect)
    for t in TIMES:
        u = move_plate(X[ends], t) - X[ends]
        simulation.Bc_Init()
        simulation.add_dirichlet(ends, [u[:, 0], u[:, 1]], ["x", "y"])
        simulation.Solve()
        simulation.Save_Iter()
        results.append(
            integrate_cells("quadrilateral_8", X, X + np.array(simulation.displacement).reshape(-1, 2), cells)
        )
    with tempfile.TemporaryDirectory() as folder:
        Paraview.Save_simu(simulation, folder)
        shutil.rmtree(HERE / "Paraview", ignore_errors=True)
        shutil.copytree(Path(folder) / "Paraview", HERE / "Paraview")
    write_expected(
        HERE,
        make_expectation(f"EasyFEA {EasyFEA.__version__}", "Paraview/simulation.pvd", range(len(TIMES)),
                         centers=X[cells[:, :4]].mean(axis=1), rest_volumes=results[0][0],
                         volumes=[r[1] for r in results], gradients=[r[2] for r in results], accuracy=1e-6),
    )  # fmt: skip


if __name__ == "__main__":
    main()
