"""Whether bodies are in different places."""

import numpy as np

from pipeline.formats.grid import Grid

_APART = 0.5  # share of the common box


def are_apart(a: Grid, b: Grid) -> bool:
    """Return whether two bodies share less than half of the box of both: parts may touch, frames of one overlap."""
    lows, highs = zip(*((grid.points.min(axis=0), grid.points.max(axis=0)) for grid in (a, b)), strict=True)
    shared = np.minimum(*highs) - np.maximum(*lows)
    extents = [high - low for low, high in zip(lows, highs, strict=True)]
    extended = np.maximum(*extents) > 1e-9 * max(float(e.max()) for e in extents)  # a planar body has no third extent
    if (shared[~extended] < -1e-9 * max(float(e.max()) for e in extents)).any():
        return True
    common = float(np.prod(np.maximum(shared[extended], 0.0)))
    both = sum(float(np.prod(extent[extended])) for extent in extents) - common
    return common < _APART * both
