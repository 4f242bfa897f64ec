r"""The law of spurious volume. A cell without strain in the frame of its solve ends at J = sec^2 of the angle between
the rotation used and the one reached: F = R (I + W), det F = 1 + |axial W|^2 = 1 + tan^2.

    linear      used I         J against the angle of the polar rotation
    one solve   used R(x_n)    J against the angle between the polar rotations before and after the step

A homogeneous rotation obeys it exactly. In a scene, strain adds to it, so the median and the band of J / sec^2 are
reported.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.element import deformation_gradient
from pipeline.fem.rotation import angle, polar
from pipeline.mesh.simplex import require_simplices
from pipeline.series import Series


@dataclass(frozen=True, eq=False)
class Growth:
    """Volume ratio J (k,) of cells and the angle (k,) [rad] between the rotation used and the one reached."""

    angle: Floats
    ratio: Floats

    @property
    def over_law(self) -> Floats:
        """Return J / sec^2 (k,)."""
        return np.asarray(self.ratio * np.cos(self.angle) ** 2)

    @property
    def largest_degrees(self) -> float:
        """Return the largest angle [degrees]."""
        return float(np.degrees(self.angle.max(initial=0.0)))


@dataclass(frozen=True)
class RatioBand:
    """J / sec^2 of the cells that turned by more than `above` [degrees]: count, 5 %, median, 95 %, largest angle."""

    above: float
    count: int
    low: float
    median: float
    high: float
    largest_angle: float
    largest_growth: float  # sec^2 of the largest angle


def read_linear_growth(series: Series) -> Growth:
    """Return the growth of all cells and frames of a run of the linear law."""
    pairs = [(angle(polar(F)), np.linalg.det(F)) for F in _list_gradients(series)]
    return Growth(*(np.concatenate(column) for column in zip(*pairs, strict=True)))


def read_step_growth(series: Series) -> Growth:
    """Return the growth of all cells and steps of a run with one solve per step and a frame for every step."""
    angles, ratios, before = [], [], None
    for F in _list_gradients(series):
        R = polar(F)
        if before is not None:
            angles.append(angle(np.swapaxes(before, 1, 2) @ R))
            ratios.append(np.linalg.det(F))
        before = R
    return Growth(np.concatenate(angles), np.concatenate(ratios)) if angles else Growth(np.zeros(0), np.zeros(0))


def _list_gradients(series: Series) -> list[Floats]:
    return [deformation_gradient(require_simplices(series.mesh), frame.x) for frame in series]


def make_band(growth: Growth, above: float) -> RatioBand | None:
    """Return the band of the cells that turned by more than `above` degrees; None if there are none."""
    turned = growth.angle > np.radians(above)
    if not turned.any():
        return None
    low, median, high = np.quantile(growth.over_law[turned], [0.05, 0.5, 0.95])
    largest = float(growth.angle.max())
    return RatioBand(
        above, int(turned.sum()), float(low), float(median), float(high),
        float(np.degrees(largest)), float(1 / np.cos(largest) ** 2),
    )  # fmt: skip
