"""Files of felupe: a neo-Hookean bar, stretched and twisted at its end; 20-node hexahedra, written by its Job as .xdmf.

pip install felupe meshio h5py;  python make.py
"""

import os
import sys
from pathlib import Path

import felupe
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402


def run_job(region, name):
    """Solve, write the file and return the mean of F and the volumes of the cells at the job's steps."""
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    points = region.mesh.points
    ends = {side: felupe.Boundary(field[0], fx=x) for side, x in (("left", 0.0), ("right", 2.0))}
    solid = felupe.SolidBody(felupe.NeoHooke(mu=1, bulk=2), field)
    right = ends["right"].points
    values = [(move_bar(points, t) - points)[right].ravel() for t in TIMES]
    step = felupe.Step(items=[solid], ramp={ends["right"]: values}, boundaries=ends)
    rest = region.dV.sum(axis=0)
    volumes, means = [], []

    def record(i, j, substep):
        F = substep.x.extract()[0]
        volumes.append((np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1))) * region.dV).sum(axis=0))
        means.append(np.moveaxis((F * region.dV).sum(axis=-2) / rest, -1, 0))

    job = felupe.Job(steps=[step], callback=record)
    job.evaluate(filename=name, verbose=False, point_data={}, cell_data={}, cell_data_default=False)
    return rest, np.array(volumes), np.array(means)


def main():
    os.chdir(HERE)  # the .h5 is written beside the .xdmf
    box = felupe.Cube(a=(0, 0, 0), b=(2, 1, 1), n=(3, 2, 2))
    program = f"felupe {felupe.__version__}"
    entries = []
    quadratic = box.add_midpoints_edges()
    for mesh, region, name in (
        (quadratic, felupe.RegionQuadraticHexahedron, "hexahedra_20.xdmf"),
        (box.add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes(), felupe.RegionTriQuadraticHexahedron,
         "hexahedra_27.xdmf"),
    ):  # fmt: skip
        region = region(mesh, quadrature=felupe.GaussLegendre(order=5, dim=3))
        rest, volumes, means = run_job(region, name)
        centers = mesh.points[mesh.cells[:, :8]].mean(axis=1)
        times = list(range(len(volumes)))
        entries.append(make_expectation(program, name, times, centers=centers, rest_volumes=rest, volumes=volumes,
                                        gradients=means))  # fmt: skip
    write_expected(HERE, *entries)


if __name__ == "__main__":
    main()
