"""A series on another mesh, sampled at the nodes and cells of a first one: at their rest positions.

Nodes get the displacement at their place in the other body at rest, cells the numbers of the cell around their center.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, SeriesError
from pipeline.mesh.locate import locate_points
from pipeline.series import Series

# ratios of sizes that units give, and these units
_UNITS = {1e3: "m and mm", 1e2: "m and cm", 1e6: "m and µm", 25.4: "inches and mm", 39.37: "m and inches"}
_ALIKE = 1e-3  # of the size: bodies that are this close after scaling are one body
_TOO_FEW = 1e-3  # share of the volume


@dataclass(frozen=True, eq=False, repr=False)
class Sampling:
    """The other body's partner of each node and cell of the first: -1 for a cell without one, NaN for a node.

    `weights` (n, m) times the other's nodes are its values at the first's nodes; `without_partner` is the share of the
    first's rest volume whose cells have none.
    """

    cells: Ints
    weights: csr_array
    without_partner: float

    def __repr__(self) -> str:
        return f"<Sampling of {len(self.cells)} cells, {self.without_partner:.3g} without a partner>"

    def take_cells(self, values: Floats) -> Floats:
        """Return the values (…, e) at the first's cells, given those of the other's (…, k); NaN without a partner."""
        taken = values[..., self.cells]
        taken[..., self.cells < 0] = np.nan
        return np.asarray(taken)

    def take_nodes(self, values: Floats) -> Floats:
        """Return the values (n, d) at the first's nodes, given those of the other's (m, d); NaN without a partner."""
        return np.asarray(self.weights @ values)


def sample_series(first: Series, other: Series) -> Sampling:
    """Return where the nodes and cells of a first body lie in another at rest; raises SeriesError if nowhere."""
    mine, theirs = first.mesh, other.mesh
    if mine.points.shape[1] != theirs.points.shape[1]:
        raise SeriesError(f"{first.name} and {other.name} do not lie in one plane: their nodes cannot be compared")
    try:
        cells, weights = locate_points(theirs, mine.centers)
        around, shares = locate_points(theirs, mine.points)
    except MeshError as error:
        raise SeriesError(f"{other.name}: {error}") from error
    lost = np.isnan(weights[:, 0])
    without = float(mine.rest_volumes[lost].sum() / mine.rest_volumes.sum())
    if without > 1 - _TOO_FEW:
        raise SeriesError(
            f"no cell of {first.name} has its center in {other.name} at rest ({_describe_place(first)}; "
            f"{_describe_place(other)}): they are different bodies, or are placed differently; compare them without "
            "--difference, or move one"
        )
    return Sampling(np.where(lost, -1, cells), _make_weights(other, around, shares), without)


def _make_weights(other: Series, around: Ints, shares: Floats) -> csr_array:
    """Return the matrix (n, m) of the weights of the other's nodes; rows of NaN for points outside."""
    cells = other.mesh.cell_array
    counts = np.diff(cells.offsets)[around]
    row = np.repeat(np.arange(len(around)), counts)
    column = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    nodes = cells.connectivity[np.repeat(cells.offsets[around], counts) + column]
    matrix = csr_array((shares[row, column], (row, nodes)), shape=(len(around), len(other.mesh.points)))
    matrix.eliminate_zeros()  # nodes without data must not matter if they have no weight; NaN stays
    return matrix


def check_units(first: Series, other: Series) -> None:
    """Raise SeriesError if one body is the other in another unit of length."""
    mine, theirs = (np.stack([s.mesh.points.min(axis=0), s.mesh.points.max(axis=0)]) for s in (first, other))
    if mine.shape != theirs.shape:
        return
    large, small = (first, other) if first.mesh.size > other.mesh.size else (other, first)
    for factor, units in _UNITS.items():
        for a, b in ((mine, theirs), (theirs, mine)):
            if (np.abs(a - factor * b) <= _ALIKE * np.ptp(a, axis=0).max()).all():
                raise SeriesError(
                    f"{large.name} is {factor:g} times as large as {small.name} ({_describe_place(large)}; "
                    f"{_describe_place(small)}), and has the same shape: their units of length seem to be {units}; "
                    f"multiply points and displacements of one of them, such as {large.name} by {1 / factor:.6g}"
                )


def _describe_place(series: Series) -> str:
    """Return the bounding box of a body at rest as text."""
    low, high = series.mesh.points.min(axis=0), series.mesh.points.max(axis=0)
    spans = ", ".join(f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=False))
    return f"{series.name}: {spans} m"
