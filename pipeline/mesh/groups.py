"""Groups of neighboring simplices that are large enough to share one dilatation without locking.

Each simplex joins the others around its longest side: the tetrahedra of a block of a box make one group, as do the
triangles of a block of a rectangle, since their longest side is its diagonal. In other meshes groups differ in size;
those with fewer than d! simplices, the number in a block, join a neighbor. Groups of one block each leave about one
dilatation per node, which leaves nodes enough freedom (as in hexahedra with one pressure each).
"""

from collections.abc import Iterator
from heapq import heapify, heappop, heappush
from math import factorial

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.node_order import SIMPLEX_EDGES

_EQUAL = 1e-9  # relative: sides whose lengths differ by less are equally long


def find_groups(mesh: ElementMesh, kinds: Floats | Ints) -> Ints:
    """Return the group of every simplex (e,), numbered from 0; simplices of different `kinds` (e,) share none."""
    sides = _find_longest_sides(mesh)
    _, kinds = np.unique(kinds, return_inverse=True)
    _, labels = np.unique(sides * (int(kinds.max()) + 1) + kinds, return_inverse=True)
    return _join_small_groups(labels, _find_neighbors(mesh, kinds), factorial(mesh.dimension))


def _find_longest_sides(mesh: ElementMesh) -> Ints:
    """Return a number (e,) for the longest side of every simplex; of equal ones, that of the lowest nodes."""
    ends = np.sort(mesh.cells[:, SIMPLEX_EDGES[mesh.dimension]], axis=2)
    lengths = np.linalg.norm(mesh.points[ends[:, :, 1]] - mesh.points[ends[:, :, 0]], axis=2)
    numbers = ends[:, :, 0] * len(mesh.points) + ends[:, :, 1]
    is_longest = lengths >= (1 - _EQUAL) * lengths.max(axis=1, keepdims=True)
    return np.asarray(np.where(is_longest, numbers, np.iinfo(np.int64).max).min(axis=1), dtype=np.int64)


def _find_neighbors(mesh: ElementMesh, kinds: Ints) -> Ints:
    """Return the pairs (f, 2) of simplices of one kind that share a facet."""
    d = mesh.dimension
    facets = np.stack([np.delete(mesh.cells, a, axis=1) for a in range(d + 1)], axis=1).reshape(-1, d)
    facets = np.sort(facets, axis=1)
    order = np.lexsort(facets.T)
    shared = np.flatnonzero((facets[order[1:]] == facets[order[:-1]]).all(axis=1))
    pairs = np.stack([order[shared], order[shared + 1]], axis=1) // (d + 1)
    return pairs[kinds[pairs[:, 0]] == kinds[pairs[:, 1]]]


def _join_small_groups(labels: Ints, neighbors: Ints, least: int) -> Ints:
    """Return the labels (e,) after every group with fewer than `least` members, smallest first, joined a neighbor.

    The neighbor is the smallest; of equal ones that with the most facets in common, then that of the lowest number.
    """
    sizes = np.bincount(labels).tolist()
    shared: list[dict[int, int]] = [{} for _ in sizes]
    for a, b in _iterate_pairs(labels[neighbors]):
        shared[a][b] = shared[a].get(b, 0) + 1
        shared[b][a] = shared[b].get(a, 0) + 1
    target = list(range(len(sizes)))
    queue = [(size, group) for group, size in enumerate(sizes) if size < least]
    heapify(queue)
    while queue:
        size, group = heappop(queue)
        if target[group] != group or sizes[group] != size or not shared[group]:
            continue
        other = min(shared[group], key=lambda g: (sizes[g], -shared[group][g], g))
        target[group], sizes[other] = other, sizes[other] + size
        for third, count in shared[group].items():
            del shared[third][group]
            if third != other:
                shared[other][third] = shared[third][other] = shared[other].get(third, 0) + count
        if sizes[other] < least:
            heappush(queue, (sizes[other], other))
    return _follow(np.array(target, dtype=np.int64))[labels]


def _iterate_pairs(pairs: Ints) -> Iterator[tuple[int, int]]:
    """Yield the pairs of different numbers."""
    for a, b in pairs.tolist():
        if a != b:
            yield a, b


def _follow(target: Ints) -> Ints:
    """Return for every group the number, from 0 without gaps, of the group at the end of its chain of targets."""
    while not (target[target] == target).all():
        target = target[target]
    return np.unique(target, return_inverse=True)[1].astype(np.int64)
