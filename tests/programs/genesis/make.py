"""Files of Genesis 1: a soft box of tetrahedra that falls on the floor (FEM); moving points, by meshio.

    pip install genesis-world torch meshio;  python make.py

Genesis writes no result files: its arrays are written by the two lines in the loop.
"""

import sys
from importlib.metadata import version
from pathlib import Path

import genesis as gs
import meshio
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import make_expectation, write_expected  # noqa: E402
from quadrature import integrate_cells  # noqa: E402

FRAMES, STEPS, DT = 5, 15, 0.004


def main():
    gs.init(backend=gs.cpu, precision="64", logging_level="warning")
    scene = gs.Scene(sim_options=gs.options.SimOptions(dt=DT, substeps=4), show_viewer=False,
                     fem_options=gs.options.FEMOptions(use_implicit_solver=False))  # fmt: skip
    scene.add_entity(gs.morphs.Plane())
    box = scene.add_entity(gs.morphs.Box(size=(0.4, 0.2, 0.2), pos=(0, 0, 0.2), euler=(20, 30, 0)),
                           material=gs.materials.FEM.Elastic(E=2e4, nu=0.3, rho=1000.0))  # fmt: skip
    scene.build()
    cells = np.array(box.elems)
    positions = []
    for frame in range(FRAMES):
        x = np.array(box.get_state().pos.cpu()).reshape(-1, 3)
        positions.append(x)
        meshio.Mesh(x, [("tetra", cells)]).write(HERE / f"box_{frame}.vtu")
        for _ in range(STEPS):
            scene.step()
    X = positions[0]
    edges = X[cells[:, 1:]] - X[cells[:, :1]]
    ordered = np.where((np.linalg.det(edges) < 0)[:, None], cells[:, [0, 2, 1, 3]], cells)
    results = [integrate_cells("tetrahedron", X, x, ordered) for x in positions]
    write_expected(
        HERE,
        make_expectation(f"Genesis {version('genesis-world')}", "box_*.vtu", range(FRAMES),
                         centers=X[cells].mean(axis=1),
                         rest_volumes=results[0][0], volumes=[r[1] for r in results],
                         gradients=[r[2] for r in results]),
    )  # fmt: skip


if __name__ == "__main__":
    main()
