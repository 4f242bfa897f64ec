"""Files of MuJoCo 4: a soft block (a flex of tetrahedra) that falls on the floor; moving points, by pyvista.

    pip install mujoco pyvista;  python make.py

MuJoCo writes no result files: its arrays are written by the five lines of `write_frame`.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pyvista as pv

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import make_expectation, write_expected  # noqa: E402

SCENE = """<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <geom type="plane" size="5 5 1" euler="0 20 0"/>
    <flexcomp name="block" type="grid" count="3 3 3" spacing=".1 .1 .1" pos="0 0 .4" dim="3" mass="1" radius=".001">
      <elasticity young="2e3" poisson=".3" damping=".005"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""
FRAMES, STEPS = 5, 100


def write_frame(path, points, cells, t):
    rows = np.hstack([np.full((len(cells), 1), 4), cells])
    grid = pv.UnstructuredGrid(rows.ravel(), np.full(len(cells), pv.CellType.TETRA), points)
    grid.field_data["TimeValue"] = [t]
    grid.save(path)


def main():
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    cells = model.flex_elem.reshape(-1, 4)
    X = data.flexvert_xpos.copy()
    edges = X[cells[:, 1:]] - X[cells[:, :1]]
    if np.linalg.det(edges[0]) < 0:
        cells = cells[:, [0, 2, 1, 3]]
        edges = X[cells[:, 1:]] - X[cells[:, :1]]
    rest = np.linalg.det(edges) / 6
    times, volumes, gradients = [], [], []
    for frame in range(FRAMES):
        x = data.flexvert_xpos.copy()
        write_frame(HERE / f"block_{frame}.vtu", x, cells, data.time)
        now = x[cells[:, 1:]] - x[cells[:, :1]]
        times.append(data.time)
        volumes.append(np.linalg.det(now) / 6)
        gradients.append(np.swapaxes(np.linalg.solve(edges, now), 1, 2))
        mujoco.mj_step(model, data, STEPS)
    write_expected(
        HERE,
        make_expectation(f"MuJoCo {mujoco.__version__}", "block_*.vtu", times, centers=X[cells].mean(axis=1),
                         rest_volumes=rest, volumes=volumes, gradients=gradients),
    )  # fmt: skip


if __name__ == "__main__":
    main()
