"""Files of OpenSees 3.8: a bar of 8-node bricks, stretched and twisted; .pvd and .vtu of its PVD recorder.

pip install openseespy;  python make.py
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import openseespy.opensees as ops

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import CUBE, integrate_cells  # noqa: E402


def main():
    numbers, cells = {}, []
    for i in range(4):
        cells.append([numbers.setdefault(tuple(p), len(numbers)) for p in (CUBE + np.array([i, 0, 0])) * [0.5, 1, 1]])
    X, cells = np.array(list(numbers)), np.array(cells)
    ends = np.flatnonzero((X[:, 0] == 0) | (X[:, 0] == 2))
    os.chdir(tempfile.mkdtemp())
    Path("bar").mkdir()  # the recorder makes no folder
    ops.model("basic", "-ndm", 3, "-ndf", 3)
    for i, p in enumerate(X):
        ops.node(i + 1, *map(float, p))
    ops.nDMaterial("ElasticIsotropic", 1, 10.0, 0.3)
    for k, cell in enumerate(cells):
        ops.element("stdBrick", k + 1, *(int(c) + 1 for c in cell), 1)
    ops.constraints("Transformation")
    ops.numberer("RCM")
    ops.system("UmfPack")
    ops.test("NormDispIncr", 1e-10, 20)
    ops.algorithm("Newton")
    ops.recorder("PVD", "bar", "-precision", 12, "disp")
    results = []
    for step, t in enumerate(TIMES[1:]):
        before = TIMES[step]
        ops.timeSeries("Linear", step + 1, "-factor", 1.0)
        ops.pattern("Plain", step + 1, step + 1)
        for i in ends:
            u = move_bar(X[i : i + 1], t)[0] - X[i]
            for axis in range(3):
                ops.sp(int(i) + 1, axis + 1, float(u[axis]), "-const")
        ops.integrator("LoadControl", t - before)
        ops.analysis("Static")
        if ops.analyze(1):
            raise SystemExit("no convergence")
        u = np.array([[ops.nodeDisp(i + 1, axis + 1) for axis in range(3)] for i in range(len(X))])
        results.append(integrate_cells("hexahedron", X, X + u, cells))
        ops.remove("loadPattern", step + 1)
        ops.remove("timeSeries", step + 1)
    ops.wipe()
    for path in Path().iterdir():
        target = HERE / path.name
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(path, target) if path.is_dir() else shutil.copy(path, target)
    write_expected(
        HERE,
        make_expectation("OpenSeesPy 3.8", "bar.pvd", TIMES[1:], centers=X[cells].mean(axis=1),
                         rest_volumes=results[0][0], volumes=[r[1] for r in results],
                         gradients=[r[2] for r in results], accuracy=1e-8),
    )  # fmt: skip


if __name__ == "__main__":
    main()
