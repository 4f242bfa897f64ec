"""The volume of a body whose cells have changed: no cell can be followed, but the whole still has a volume."""

import numpy as np

from pipeline.arrays import Floats
from pipeline.formats.grid import Grid
from pipeline.mesh.blocks import find_simplices
from pipeline.mesh.cell_mesh import measure_volumes
from pipeline.mesh.orientation import find_mirrored_cells


def measure_changed_body(grid: Grid, points: Floats, dimension: int) -> float:
    """Return the volume [m3; m2 if the dimension is 2] of the cells of that dimension at points (n, 3).

    Cells that only their numbering mirrors count as they lie. A body of another dimension has the volume NaN.
    """
    planar = dimension == 2 and float(np.ptp(points[:, 2])) <= 1e-6 * float(np.ptp(points, axis=0).max())
    x = np.ascontiguousarray(points[:, :2]) if planar else points
    volumes = measure_volumes(x, grid.cells, dimension)
    measured = volumes[np.isfinite(volumes)]
    if not measured.size:
        return float("nan")
    simplices = find_simplices(grid.cells)
    if simplices is not None and x.shape[1] == dimension:
        measured = np.where(find_mirrored_cells(x, simplices), -volumes, volumes)
    elif (measured <= 0).all():
        measured = -measured
    return float(measured.sum())
