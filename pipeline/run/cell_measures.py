"""The measures of cells of any kind, block by block through the compiled kernels."""

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.element import deformation_gradient
from pipeline.fem.kernels import cells as cell_kernels
from pipeline.fem.kernels import volumes_and_angles as simplex_kernels
from pipeline.fem.rotation import angle, polar
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.rest_cells import RestBlock
from pipeline.mesh.rest_facets import RestFacets
from pipeline.mesh.simplex import Mesh, signed_volumes

_AT_A_TIME = 8192  # tetrahedra
Measures = tuple[Floats, Floats, Floats, Floats]


def measure_any_cells(mesh: CellMesh, x: Floats) -> Measures:
    """Return signed volumes, extremes of det F, and angles of rotation [rad] of every cell (e,) at positions x (n, c).

    Cells with a node that is NaN have NaN.
    """
    x = np.ascontiguousarray(x, dtype=np.float64)
    volumes, ratio_min, ratio_max, angles = np.full((4, len(mesh.cell_array.types)), np.nan)
    outputs = (volumes, ratio_min, ratio_max, angles)
    local = mesh.find_local(x)
    for rest in mesh.rest_blocks:
        _measure_block(mesh, rest, local, outputs)
    if mesh.rest_facets is not None:
        _measure_facets(mesh.rest_facets, local, outputs)
    # the ratio is a mean of det F: rounding must not put it outside
    ratio = volumes / mesh.rest_volumes
    np.minimum(ratio_min, ratio, out=ratio_min)
    np.maximum(ratio_max, ratio, out=ratio_max)
    return outputs


def _measure_block(mesh: CellMesh, rest: RestBlock, x: Floats, outputs: Measures) -> None:
    """Write the measures of a block's cells into the outputs."""
    if rest.block.kind.is_linear_simplex and mesh.dimension == 3:
        _measure_tetrahedra(mesh, rest, x, outputs)
        return
    if rest.block.kind.is_linear_simplex and mesh.triangles is not None:
        _measure_triangles(mesh.triangles, rest, x, outputs)
        return
    place = (rest.block.cells, rest.connectivity, rest.derivatives, rest.samples.weights, rest.inverse, rest.gradients)
    if mesh.is_surface:
        cell_kernels.measure_surfaces(x, *place, rest.normals, *outputs)
    elif mesh.dimension == 2:
        cell_kernels.measure_planar(x, *place, *outputs)
    else:
        cell_kernels.measure_solids(x, *place, *outputs)


def _measure_facets(rest: RestFacets, x: Floats, outputs: Measures) -> None:
    """Write the measures of polyhedra or polygons into the outputs."""
    from pipeline.fem.kernels import facets as facet_kernels

    cells = rest.faceted
    place = (cells.cells, cells.starts, cells.nodes)
    if cells.dimension == 3:
        faces = (cells.face_starts, cells.corner_starts, cells.corners)
        facet_kernels.measure_polyhedra(x, *place, *faces, rest.inverse, rest.gradients, *outputs)
    elif len(rest.normals):
        facet_kernels.measure_polygons_in_space(x, *place, rest.inverse, rest.gradients, rest.normals, *outputs)
    else:
        facet_kernels.measure_planar_polygons(x, *place, rest.inverse, rest.gradients, *outputs)


def _measure_tetrahedra(mesh: CellMesh, rest: RestBlock, x: Floats, outputs: Measures) -> None:
    """Write the measures of linear tetrahedra by the kernel of simplices, so that they have the same bits."""
    volumes, angles = np.empty((2, min(_AT_A_TIME, len(rest.volumes))))
    for first in range(0, len(rest.volumes), _AT_A_TIME):
        cells = rest.block.cells[first : first + _AT_A_TIME]
        part, count = slice(first, first + len(cells)), len(cells)
        simplex_kernels.measure_cells(x, rest.connectivity[part], rest.gradients[part], volumes[:count], angles[:count])
        outputs[0][cells], outputs[3][cells] = volumes[:count], angles[:count]
        outputs[1][cells] = outputs[2][cells] = volumes[:count] / mesh.rest_volumes[cells]


def _measure_triangles(triangles: Mesh, rest: RestBlock, x: Floats, outputs: Measures) -> None:
    """Write the measures of linear triangles in the plane by the code of simplices, so that they have the same bits."""
    cells, volumes = rest.block.cells, signed_volumes(x, triangles.cells)
    outputs[0][cells] = volumes
    outputs[1][cells] = outputs[2][cells] = volumes / triangles.rest_volumes
    with np.errstate(invalid="ignore", over="ignore"):  # positions that are not finite
        angles = angle(polar(deformation_gradient(triangles, x)))
    outputs[3][cells] = np.where(np.isnan(volumes), np.nan, angles)
