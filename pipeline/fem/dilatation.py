"""The mean dilatation, which does not lock: one tr(eps) for each group of elements instead of one per point.

    W = sum w mu |eps|^2 + sum_groups lam V theta^2 / 2,    theta = sum w tr(eps) / V over the points of a group
    d theta = sum w R : dF / V,    whose stiffness is lam / V g (x) g,    g_a = sum w R grad N_a

The rotations contribute nothing to d theta: R^T dR is skew and R^T F symmetric, so tr(dR^T F) = 0. If the order is 2, a
group is one element; if it is 1, an element has only one strain, and a group is several of them (mesh/groups.py).
"""

from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.fem.assembly import Assembly, BlockPattern, locate_patches
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.groups import find_groups


class Groups(NamedTuple):
    """The group of every element (e,), the nodes of every group (g, m), and the places of an element's in them (e, k).

    Groups with fewer than m nodes are filled with their first one. `volumes` and `lam` (g,) are V and lam [Pa].
    """

    labels: Ints
    nodes: Ints
    places: Ints
    volumes: Floats
    lam: Floats

    def assemble(self, pattern: BlockPattern) -> Assembly:
        """Return the map from groups into a pattern that has their blocks."""
        return locate_patches(pattern, self.nodes)


def group_elements(mesh: ElementMesh, lam: float | Floats) -> Groups:
    """Return the groups of a mesh; all elements of a group have the same lam [Pa]."""
    (e, k), volumes = mesh.cells.shape, mesh.integration.weights.sum(axis=1)
    lam = np.array(np.broadcast_to(lam, e), dtype=np.float64)
    if mesh.order > 1:
        labels, places = np.arange(e, dtype=np.int64), np.zeros((e, 1), dtype=np.int64) + np.arange(k)
        return Groups(labels, mesh.cells, places, volumes, lam)
    labels = find_groups(mesh, lam)
    nodes, places = _gather_nodes(labels, mesh.cells)
    first = np.unique(labels, return_index=True)[1]
    return Groups(labels, nodes, places, np.asarray(np.bincount(labels, volumes), np.float64), lam[first])


def _gather_nodes(labels: Ints, cells: Ints) -> tuple[Ints, Ints]:
    """Return the nodes of every group (g, m), and the places of those of its cells in them (e, k)."""
    n = int(cells.max()) + 1
    numbers, inverse = np.unique(labels[:, None] * n + cells, return_inverse=True)
    group, node = numbers // n, numbers % n
    starts = np.searchsorted(group, np.arange(labels.max() + 2))
    columns, counts = np.arange(np.diff(starts).max()), np.diff(starts)[:, None]
    nodes = node[starts[:-1, None] + np.where(columns < counts, columns, 0)]
    return nodes, (inverse.reshape(cells.shape) - starts[labels][:, None]).astype(np.int64)


def average_over_groups(mesh: ElementMesh, groups: Groups, values: Floats) -> Floats:
    """Return the mean over its group, weighted by volume, of every value at the points (p,), at the points (p,)."""
    w = mesh.integration.weights
    means = np.bincount(groups.labels, (w * values.reshape(w.shape)).sum(axis=1)) / groups.volumes
    return np.repeat(means[groups.labels], w.shape[1])


def find_dilatation_blocks(mesh: ElementMesh, groups: Groups, R: Floats) -> Floats:
    """Return the stiffness lam / V g (x) g of every group (g, m, d, m, d) [N/m], with the rotations R (p, d, d)."""
    weights, gradients = mesh.integration
    (count, m), d = groups.nodes.shape, mesh.dimension
    R = R.reshape(*weights.shape, d, d)
    each = (weights[:, :, None, None] * (gradients @ np.swapaxes(R, 2, 3))).sum(axis=1)
    rows = (groups.labels[:, None] * m + groups.places)[:, :, None] * d + np.arange(d)
    g = np.bincount(rows.ravel(), each.ravel(), minlength=count * m * d).reshape(count, m, d)
    factor = groups.lam / groups.volumes
    return np.asarray(factor[:, None, None, None, None] * (g[:, :, :, None, None] * g[:, None, None]))
