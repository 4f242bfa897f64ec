r"""Rotations R of deformation gradients F = R S, by two methods, and their angles.

    polar          the rotation closest to F, det R = +1 always (the reflection is removed, correction to T 6.6)
    gram_schmidt   T 6.11: r0 = a0/|a0|, r1 = a1 orthonormalized, r2 = r0 x r1; the Q of QR, biased by the axes

Both return a finite rotation for every finite F, even if F does not determine one (rank below d - 1): polar then
completes the singular vectors, gram_schmidt takes the coordinate axis least parallel to the earlier columns;
F = 0 gives the identity. Gram-Schmidt rotations have no potential: not for iterations = "converged".
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.kernels import GRAM_SCHMIDT, POLAR

# a column with less than this fraction left counts as zero, or parallel to the one before: its direction is noise
_NULL = 1e-14


@dataclass(frozen=True, repr=False)
class Rotation:
    """A method: `extract` returns rotations of F (e, d, d); `number` is that of its compiled kernel, if any."""

    extract: Callable[[Floats], Floats]
    number: int | None = None

    def __repr__(self) -> str:
        return f"<Rotation {self.extract.__name__}>"


def _scale_entries(F: Floats) -> Floats:
    """Return F divided by its largest entry, so that no square overflows; a zero matrix becomes the identity."""
    largest = np.abs(F).max(axis=(-2, -1), keepdims=True)
    zero = largest == 0
    return np.where(zero, np.eye(F.shape[-1]), F / np.where(zero, 1.0, largest))


def polar(F: Floats) -> Floats:
    """Return the rotation closest to each F (e, d, d); if det F < 0, the smallest singular value becomes negative."""
    if F.shape[-1] == 2:
        A = _scale_entries(F)
        return _make_plane_rotations(A[..., 0, 0] + A[..., 1, 1], A[..., 1, 0] - A[..., 0, 1])
    from pipeline.fem.kernels.rotation import polar_rotations

    R = np.empty(F.shape)
    polar_rotations(np.ascontiguousarray(F), R)
    return R


def polar_by_svd(F: Floats) -> Floats:
    """Return the same as `polar` by the textbook method: the plain reference for the compiled kernel."""
    U, _, Vt = np.linalg.svd(_scale_entries(F))
    U[..., :, -1] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[..., None]
    return np.asarray(U @ Vt)


def gram_schmidt(F: Floats) -> Floats:
    """Return the Gram-Schmidt rotation of the columns of each F (e, d, d), T 6.11."""
    A = _scale_entries(F)
    r0 = _orthonormalize(A[..., :, 0], [])
    if F.shape[-1] == 2:
        return _make_plane_rotations(r0[..., 0], r0[..., 1])
    r1 = _orthonormalize(A[..., :, 1], [r0])
    return np.stack([r0, r1, np.cross(r0, r1)], axis=-1)


def angle(R: Floats) -> Floats:
    """Return the angle of each rotation (e,) in [0, pi] [rad]."""
    if R.shape[-1] == 2:
        return np.abs(np.arctan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1]))
    twice_sine = np.linalg.norm(axial(R - np.swapaxes(R, -1, -2)), axis=-1)
    return np.arctan2(twice_sine / 2, (np.trace(R, axis1=-2, axis2=-1) - 1) / 2)


def axial(skew: Floats) -> Floats:
    """Return the axial vectors (w32, w13, w21) of skew matrices w (e, 3, 3)."""
    return np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)


def _make_plane_rotations(cosine: Floats, sine: Floats) -> Floats:
    """Return the plane rotations (e, 2, 2) along (cosine, sine), the identity if both vanish."""
    length = np.hypot(cosine, sine)
    null = length <= _NULL
    c = np.where(null, 1.0, cosine / np.where(null, 1.0, length))
    s = np.where(null, 0.0, sine / np.where(null, 1.0, length))
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def _orthonormalize(a: Floats, basis: list[Floats]) -> Floats:
    """Return the normalized parts of a (e, d) orthogonal to basis, or of a coordinate axis if nothing is left of a."""
    rest = _remove_components(a, basis)
    left = np.linalg.norm(rest, axis=-1)
    lost = left <= _NULL * np.maximum(np.linalg.norm(a, axis=-1), _NULL)
    if lost.any():
        rest[lost] = _find_least_parallel_axes([r[lost] for r in basis], int(lost.sum()), a.shape[-1])
        left = np.linalg.norm(rest, axis=-1)
    # again, because one pass leaves an error of eps |a| / |rest|
    rest = _remove_components(rest / left[..., None], basis)
    return np.asarray(rest / np.linalg.norm(rest, axis=-1, keepdims=True))


def _remove_components(a: Floats, basis: list[Floats]) -> Floats:
    """Return the parts of a (e, d) orthogonal to the unit vectors of basis."""
    rest = a.copy()
    for r in basis:
        rest -= (r * rest).sum(axis=-1, keepdims=True) * r
    return rest


def _find_least_parallel_axes(basis: list[Floats], count: int, d: int) -> Floats:
    """Return per cell the coordinate axis least parallel to the basis, without its components along it (count, d)."""
    parallel = np.zeros((count, d))
    for r in basis:
        parallel += r**2
    return _remove_components(np.eye(d)[np.argmin(parallel, axis=-1)], basis)


POLAR_ROTATION = Rotation(polar, POLAR)
GRAM_SCHMIDT_ROTATION = Rotation(gram_schmidt, GRAM_SCHMIDT)
