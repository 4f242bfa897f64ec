"""Numbers of the whole body in a frame whose cells are not those of the mesh: after remeshing or a loss of cells."""

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError
from pipeline.formats.grid import Grid
from pipeline.mesh.blocks import mirror_cells, split_blocks
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_mesh import measure_volumes
from pipeline.mesh.rest_cells import share_among_nodes
from pipeline.run.frame import Values
from pipeline.run.measures import pad_to_space
from pipeline.series.body.cell_arrays import select_array
from pipeline.series.body.cell_selection import choose_cells, extract_cells, find_doubled_cells
from pipeline.series.body.cell_sides import compare_sides


def measure_whole_body(grid: Grid, points: Floats, mesh: BodyMesh, plane: Floats | None) -> Values:
    """Return total volume, volume drift and center of mass of a grid's own cells at positions (n, 3).

    The drift is relative to the mesh. Returns nothing if the cells have another dimension or points are not finite.
    """
    try:
        choice = choose_cells(grid, "")
    except SeriesError:
        return {}
    cells = extract_cells(grid, choice.cells)
    if choice.dimension != mesh.dimension or not np.isfinite(points[cells.connectivity]).all():
        return {}
    doubled = find_doubled_cells(points, cells)
    cells = select_array(cells, np.delete(np.arange(len(cells.types)), doubled))
    local = _find_local(points, mesh, plane)
    volumes = measure_volumes(local, cells, mesh.dimension)
    if local.shape[1] == mesh.dimension and (volumes < 0).any():
        cells = mirror_cells(cells, np.flatnonzero(compare_sides(local, cells, volumes).mirrored))
        volumes = measure_volumes(local, cells, mesh.dimension)
    total = float(volumes.sum())
    if not np.isfinite(total) or total == 0:
        return {}
    moment = np.zeros(points.shape[1])
    for block in split_blocks(cells):
        shares = share_among_nodes(local, block)
        moment += np.einsum("mk,mkc->c", shares, points[block.connectivity])
    measured = {
        "total_volume": np.asarray(total),
        "volume_drift": np.asarray(total / float(mesh.rest_volumes.sum()) - 1),
    }
    if len(choice.cells) and sum(len(b.cells) for b in split_blocks(cells)) == len(cells.types):
        measured["center_of_mass"] = pad_to_space(moment / total)
    return measured


def _find_local(points: Floats, mesh: BodyMesh, plane: Floats | None) -> Floats:
    """Return points in the coordinates in which the mesh measures its cells."""
    if plane is not None:
        return np.ascontiguousarray(points @ plane.T)
    return np.ascontiguousarray(points[:, : mesh.points.shape[1]])
