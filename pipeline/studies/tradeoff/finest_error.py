r"""The error of the finest mesh, from the distances of coarser ones of its order.

If errors fall by a ratio r whenever the cells' size is halved, and e is that of the finest mesh, meshes whose cells are
2 and 4 times as large lie  d_2 = e (r - 1),  d_4 = e (r^2 - 1)  from it: so  r = d_4 / d_2 - 1  is observed. A motion
that is late by half a period differs by its whole travel however coarse its mesh is: then d_4 / d_2 is about 1, and
nothing can be told.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, log2

# of log error over log size, if only two meshes show it: edges of supports limit order 2 as corners limit its stresses
ASSUMED_RATES = {1: 1.0, 2: 1.5}
_LEAST_RATE = 0.5  # slower convergence cannot be told from none
_SURPLUS = 1  # faster than the order by more than this is chance


@dataclass(frozen=True)
class FinestError:
    """The estimated error of the finest mesh, None if coarser meshes do not converge to it; then so is the rate.

    `distances` are those of meshes whose cells are 2 and 4 times as large, without those not run; `is_observed` is
    whether the rate is that of these meshes.
    """

    error: float | None
    rate: float | None
    is_observed: bool
    distances: tuple[float, ...]


def estimate_finest_error(order: int, distances: Sequence[float]) -> FinestError | None:
    """Return the error of the finest mesh, from the distances of meshes with cells 2 and 4 times as large (or NaN).

    None if the first is not known.
    """
    known = tuple(distance for distance in distances if isfinite(distance))
    if not known or not isfinite(distances[0]):
        return None
    if len(known) == 1 or known[0] == 0:
        rate = ASSUMED_RATES[order]
        return FinestError(known[0] / (2**rate - 1), rate, False, known)
    ratio = known[1] / known[0] - 1
    if ratio < 2**_LEAST_RATE:
        return FinestError(None, None, True, known)
    rate = min(log2(ratio), float(order + _SURPLUS))
    return FinestError(known[0] / (2**rate - 1), rate, True, known)
