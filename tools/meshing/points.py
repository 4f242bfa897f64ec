"""The exact number of nodes on and in a shape, and the tetrahedra of their Delaunay triangulation that lie inside.

Nodes are generators of centroidal Voronoi tessellations by Lloyd's iteration over samples: first on the surface, then
inside with the surface fixed.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, cKDTree

from tools.meshing.shapes import Floats, Ints, Shape, project

OUTWARD = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # faces of a positive tetrahedron
_SURFACE_SAMPLES, _VOLUME_SAMPLES = 40_000, 60_000


def make_points(shape: Shape) -> Floats:
    """Return the nodes (n, 3): features, then the rest of the surface, then the interior."""
    rng, sampler = np.random.default_rng(shape.seed), np.random.default_rng(0)
    surface_samples, volume_samples = _sample_surface(shape, sampler), _sample_volume(shape, sampler)
    # a density of h^-(dimension + 2) gives cells of size h
    surface_weight, volume_weight = shape.spacing(surface_samples) ** -4, shape.spacing(volume_samples) ** -5
    features = shape.features
    count = shape.surface_nodes - len(features)
    surface = _run_lloyd(surface_samples, surface_weight, count, rng, fixed=features, iterations=60, shape=shape)
    surface = np.vstack([features, project(shape.distance, surface, 6)])
    interior = _run_lloyd(
        volume_samples, volume_weight, shape.nodes - shape.surface_nodes, rng, fixed=surface, iterations=40
    )
    return np.vstack([surface, interior])


def _sample_surface(shape: Shape, rng: np.random.Generator) -> Floats:
    """Return points of a thin shell about the surface, projected onto it."""
    batches: list[Floats] = []
    while sum(map(len, batches)) < _SURFACE_SAMPLES:
        p = shape.low + (shape.high - shape.low) * rng.random((_SURFACE_SAMPLES * 8, 3))
        batches.append(p[np.abs(shape.distance(p)) < 0.35])
    p = project(shape.distance, np.concatenate(batches)[:_SURFACE_SAMPLES])
    return p[np.abs(shape.distance(p)) < 1e-2]


def _sample_volume(shape: Shape, rng: np.random.Generator) -> Floats:
    batches: list[Floats] = []
    while sum(map(len, batches)) < _VOLUME_SAMPLES:
        p = shape.low + (shape.high - shape.low) * rng.random((_VOLUME_SAMPLES * 4, 3))
        batches.append(p[shape.distance(p) < 0])
    return np.concatenate(batches)[:_VOLUME_SAMPLES]


def _run_lloyd(
    samples: Floats,
    weight: Floats,
    count: int,
    rng: np.random.Generator,
    *,
    fixed: Floats,
    iterations: int,
    shape: Shape | None = None,
) -> Floats:
    """Return `count` generators beside the fixed ones, moved to their centroids; with a shape, on its surface."""
    moving = samples[rng.choice(len(samples), count, replace=False, p=weight / weight.sum())].copy()
    for _ in range(iterations):
        both = np.vstack([moving, fixed])
        _, owner = cKDTree(both).query(samples)
        total = np.bincount(owner, weight, len(both))
        moment = np.stack([np.bincount(owner, weight * samples[:, i], len(both)) for i in range(3)], 1)
        for j in range(count):
            moving[j] = moment[j] / total[j] if total[j] > 0 else samples[rng.integers(len(samples))]
        if shape is not None:
            moving = project(shape.distance, moving, 3)
    return moving


def carve(shape: Shape, points: Floats) -> Ints:
    """Return the Delaunay tetrahedra inside the shape, with a few toggled until their surface is a closed manifold."""
    cells = Delaunay(points).simplices.astype(np.int64)
    corners = points[cells]
    edges = [corners[:, i] - corners[:, 0] for i in (1, 2, 3)]
    negative = np.einsum("ij,ij->i", np.cross(edges[0], edges[1]), edges[2]) / 6 < 0
    cells[negative] = cells[negative][:, [0, 2, 1, 3]]
    corners = points[cells]
    longest = np.sqrt(((corners[:, :, None] - corners[:, None]) ** 2).sum(-1).max((1, 2)))
    at_center = shape.distance(corners.mean(1))
    # the midpoints of the edges find long cells that bridge a gap
    middles = (corners[:, [0, 0, 0, 1, 1, 2]] + corners[:, [1, 2, 3, 2, 3, 3]]) / 2
    at_edges = shape.distance(middles.reshape(-1, 3)).reshape(-1, 6).max(1)
    score = np.maximum(at_center / longest + 0.02, at_edges / longest - 0.22)
    return _repair(cells, score, len(points))


def _repair(cells: Ints, score: Floats, nodes: int) -> Ints:
    """Return the cells of negative score; borderline ones are toggled while that leaves fewer defects."""
    keep = score < 0
    count, where = find_defects(cells[keep], nodes)
    for _ in range(60):
        if count == 0:
            break
        near = np.where(np.isin(cells, list(where)).sum(1) >= 1)[0]
        best = None
        for c in near[np.abs(score[near]) < 0.4]:
            keep[c] ^= True
            fewer, places = find_defects(cells[keep], nodes)
            keep[c] ^= True
            rank = fewer + abs(score[c])
            if fewer < count and (best is None or rank < best[0]):
                best = (rank, c, fewer, places)
        if best is None:
            break
        keep[best[1]] ^= True
        count, where = best[2], best[3]
    return cells[keep]


def find_defects(cells: Ints, nodes: int) -> tuple[int, set[int]]:
    """Return the number of places where the surface is not a closed manifold or a node is unused, and their nodes."""
    faces = np.sort(cells[:, OUTWARD].reshape(-1, 3), 1)
    _, first, count = np.unique(faces, axis=0, return_index=True, return_counts=True)
    surface = faces[first[count == 1]]
    edges, shared = np.unique(surface[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=0, return_counts=True)
    open_edges = edges[shared != 2]
    fans = _count_fans(surface, nodes)
    pinched = np.flatnonzero(fans > 1)
    unused = np.flatnonzero(np.bincount(cells.ravel(), minlength=nodes) == 0)
    total = len(open_edges) + int((fans[pinched] - 1).sum()) + 2 * len(unused)
    return total, {int(node) for node in (*open_edges.ravel(), *pinched, *unused)}


def _count_fans(surface: Ints, nodes: int) -> Ints:
    """Return the number of fans of triangles that meet at every node (n,): 1 on a manifold, 0 off the surface."""
    half_edges, corners = [], []
    for a, b in ((0, 1), (1, 2), (0, 2)):
        key = (surface[:, a] * nodes + surface[:, b]) * 2
        half_edges += [key, key + 1]  # an edge as seen from either end
        corners += [np.arange(len(surface)) * 3 + a, np.arange(len(surface)) * 3 + b]
    edge, corner = np.concatenate(half_edges), np.concatenate(corners)
    order = np.argsort(edge, kind="stable")
    edge, corner = edge[order], corner[order]
    same = np.flatnonzero(edge[1:] == edge[:-1])
    size = surface.size
    graph = coo_matrix((np.ones(len(same)), (corner[same], corner[same + 1])), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    fans = np.unique(np.stack([surface.ravel(), label], 1), axis=0)
    return np.bincount(fans[:, 0], minlength=nodes).astype(np.int64)
