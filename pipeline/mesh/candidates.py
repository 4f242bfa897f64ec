"""Candidates for the cell around a point: cells whose bounding boxes contain it, found by trees of their centers."""

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from pipeline.arrays import Floats, Ints

_AT_A_TIME = 20_000  # points: a point has some 20 candidates, and each of these takes a few hundred bytes


def iterate_candidates(low: Floats, high: Floats, points: Floats) -> Iterator[tuple[Ints, Ints]]:
    """Yield pairs of a point and a cell whose box from `low` to `high` (e, d) contains it, as two arrays of indices.

    All pairs of one point come together. Points that are not finite have none.
    """
    finite = np.flatnonzero(np.isfinite(points).all(axis=1))
    trees = _plant_trees(low, high)
    for start in range(0, len(finite), _AT_A_TIME):
        chosen = finite[start : start + _AT_A_TIME]
        pairs = [_query_tree(tree, members, scale, radius, points[chosen]) for tree, members, scale, radius in trees]
        where, cells = (np.concatenate(column) for column in zip(*pairs, strict=True))
        where = chosen[where]
        inside = ((low[cells] <= points[where]) & (points[where] <= high[cells])).all(axis=1)
        yield where[inside], cells[inside]


def _plant_trees(low: Floats, high: Floats) -> list[tuple[cKDTree, Ints, Floats, float]]:
    """Return a tree of centers for the boxes of each size, their indices, and the scale and radius to search with.

    Sizes are powers of two, because one radius for all would find too many small boxes beside a large one.
    """
    half = (high - low) / 2
    scale = np.where((typical := np.median(half, axis=0)) > 0, typical, 1.0)
    radii = (half / scale).max(axis=1)
    levels = np.ceil(np.log2(np.maximum(radii, np.finfo(float).tiny)))
    centers = (low + half) / scale
    trees = list[tuple[cKDTree, Ints, Floats, float]]()
    for level in np.unique(levels).tolist():
        members = np.flatnonzero(levels == level)
        radius = float(radii[members].max()) * (1 + 1e-9)  # rounding of the scaled coordinates
        trees.append((cKDTree(centers[members]), members, scale, radius))
    return trees


def _query_tree(tree: cKDTree, members: Ints, scale: Floats, radius: float, points: Floats) -> tuple[Ints, Ints]:
    """Return the points and the boxes whose centers are near them, as two arrays of indices."""
    lists: list[list[int]] = tree.query_ball_point(points / scale, radius, p=np.inf, return_sorted=False)  # type: ignore[assignment]  # an object array of lists
    counts = np.fromiter((len(some) for some in lists), dtype=np.int64, count=len(points))
    found = np.concatenate([np.asarray(some, dtype=np.int64) for some in lists]) if counts.any() else np.empty(0, int)
    return np.repeat(np.arange(len(points)), counts), members[found.astype(np.int64, copy=False)]
