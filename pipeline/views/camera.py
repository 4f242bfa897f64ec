"""One parallel camera for all panels, fixed on the bounds of the whole motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.views.track import Track, list_drawn_points

# The camera looks at the longer side, turned toward one end and raised a little, so that side, end and top show:
# 23 degrees to the side and 17 degrees up. The movie, the page and ParaView's script share these numbers.
ASIDE, RAISED = -0.42, 0.34  # components along the length and along z; the one along the view is 1
LONG = 1.5  # only bodies long in x are seen from -y; nearly square ones, like those long in y, from +x
MARGIN = 0.03  # of a panel, on each side
PARALLEL = 0.999  # cosine of 2.6 degrees


@dataclass(frozen=True, eq=False)
class Camera:
    """The directions of the camera, and the bounds of all drawn points along them [m]."""

    toward: Floats  # unit vectors: toward the viewer, to the right, up
    right: Floats
    up: Floats
    low: Floats  # bounds along right, up, toward (3,)
    high: Floats

    @property
    def center(self) -> Floats:
        """Return the middle of the bounds, in space."""
        middle = (self.low + self.high) / 2
        return np.asarray(middle @ np.stack([self.right, self.up, self.toward]))

    def fit_pixel(self, width: float, height: float) -> float:
        """Return the size of a pixel [m] at which everything fits into a panel with a margin all around."""
        across, upward = np.maximum(self.high - self.low, 1e-12)[:2]
        return float(max(across / width, upward / height) / (1 - 2 * MARGIN))


def fit_camera(tracks: Sequence[Track]) -> Camera:
    """Return the camera for bodies: z up, the longer of x and y across; planar bodies are seen along their normal."""
    points = np.concatenate([list_drawn_points(track) for track in tracks])
    flat = _find_common_normal(tracks)
    if flat is not None:
        toward, upward = _face_plane(flat)
    else:
        extent = np.ptp(tracks[0].rest, axis=0)
        toward = np.array([ASIDE, -1.0, RAISED]) if extent[0] > LONG * extent[1] else np.array([1.0, ASIDE, RAISED])
        upward = np.array([0.0, 0.0, 1.0])
    toward = toward / np.linalg.norm(toward)
    right = np.cross(upward, toward)
    right /= np.linalg.norm(right)
    up = np.cross(toward, right)
    projected = points @ np.stack([right, up, toward]).T
    return Camera(toward, right, up, projected.min(axis=0), projected.max(axis=0))


def _find_common_normal(tracks: Sequence[Track]) -> Floats | None:
    """Return the normal of the plane of all bodies, or None if there is none."""
    normals = [track.normal for track in tracks]
    first = normals[0]
    if first is None or any(other is None or abs(first @ other) < PARALLEL for other in normals[1:]):
        return None
    return first


def _face_plane(normal: Floats) -> tuple[Floats, Floats]:
    """Return the directions toward the viewer and upward: z up, or y in a plane of constant z.

    The plane is seen from the side from which the axis that runs across points to the right.
    """
    upward = np.array([0.0, 1.0, 0.0] if abs(normal[2]) > PARALLEL else [0.0, 0.0, 1.0])
    right = np.cross(upward, normal)
    return normal if right[np.abs(right).argmax()] > 0 else -normal, upward
