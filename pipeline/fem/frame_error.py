r"""The error of a solve that used the rotations U and reached R: one number from spurious volume and stray stress.

    spurious volume   tan^2 of the angle between U and R: the error of the frozen frame in an unstrained cell
    stray stress      w |P(F, R) - P(F, U)| / (2 mu + lam): the strain that the solve balanced but the cell lacks

In an unstrained cell the two are about equal; in a strained cell that rotates the second is larger, strain times angle.
The indicator is the larger of the two in the worst cell. The weight w is 4/3 in space and 8/3 in the plane.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.laws import Law
from pipeline.fem.material import Material, MaterialValues

# measured: whole runs of the scenes here stay within twice the tolerance. A cantilever of triangles that swings for 180
# steps of backward Euler exceeded it by a factor of 3.4 with 4/3, 2.3 with 2 and 1.8 with 8/3
_WEIGHT = {2: 8 / 3, 3: 4 / 3}


class FrameError(NamedTuple):
    """The indicator of (used, reached), and the spurious volume of (I, reached), which is that of the linear law."""

    indicator: float
    from_rest: float


def spurious_volume(trace: float, d: int) -> float:
    """Return tan^2 of the angle of a rotation with this trace; infinite from 90 degrees on."""
    cosine = (trace - 1) / 2 if d == 3 else trace / 2
    return float(max(1 / cosine**2 - 1, 0.0)) if cosine > 0 else np.inf


def indicator(trace: float, d: int, stress: float, modulus: float) -> float:
    """Return the larger of spurious volume, from the smallest tr(U^T R), and stray stress: w `stress` / `modulus`."""
    return max(spurious_volume(trace, d), _WEIGHT[d] * stress / modulus)


def scale_moduli(material: Material) -> tuple[MaterialValues, MaterialValues, float]:
    """Return mu, lam and the modulus 2 mu + lam that stray stresses are divided by.

    If cells differ, their mu and lam are divided by their own modulus beforehand, and the last number is 1.
    """
    modulus = 2 * material.mu + material.lam
    if isinstance(modulus, np.ndarray):
        return material.mu / modulus, material.lam / modulus, 1.0
    return material.mu, material.lam, modulus


def measure_frame_error(
    law: Law,
    F: Floats,
    used: Floats | None,
    reached: Floats,
    find_dilatation: Callable[[Floats, Floats], Floats | None] = lambda F, R: None,
) -> FrameError:
    """Write the rotations of the gradients F (e, d, d) into reached; return their error against those used.

    `used` = None means identities. find_dilatation(F, R) returns the law's mean dilatations (e,), None for its own.
    """
    d = F.shape[-1]
    U = np.broadcast_to(np.eye(d) if used is None else used, F.shape)
    reached[:] = law.rotations(F)
    trace = float(np.einsum("eij,eij->e", U, reached).min())
    stray = law.stress(F, reached, find_dilatation(F, reached)) - law.stress(F, U, find_dilatation(F, U))
    m, strays = law.material.spread(len(F)), np.sqrt((stray**2).sum(axis=(1, 2)))
    modulus = 2 * m.mu + m.lam
    if isinstance(modulus, np.ndarray):
        strays, modulus = strays / modulus, 1.0
    own = float(np.trace(reached, axis1=1, axis2=2).min())
    return FrameError(indicator(trace, d, float(strays.max()), modulus), spurious_volume(own, d))
