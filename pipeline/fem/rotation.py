r"""Rotations of a deformation gradient F = R S: the two that the seeds use, and the angle of one.

    polar          the rotation closest to F, det R = +1 always (the reflection is removed, correction to T 6.6)
    gram_schmidt   T 6.11: r0 = a0/|a0|, r1 = orthonormalised a1, r2 = r0 x r1; a QR factor, biased by the axes

Both return a finite rotation for every finite F. Where F does not determine one (rank below d - 1, zero)
a rotation is still chosen: polar completes the singular vectors, gram_schmidt takes the coordinate axis
that is least parallel to what it has; F = 0 gives the identity.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats

# A column is taken for null, or for parallel to the one before, when less than this part of it is left:
# below it the direction is rounding error.
_NULL = 1e-14
POLAR, GRAM_SCHMIDT, IDENTITY = 0, 1, 2  # the numbers by which compiled kernels know rotations


@dataclass(frozen=True)
class Rotation:
    """Extracts the rotations (e, d, d) of gradients F (e, d, d); `number` is that of its compiled kernel, if any."""

    extract: Callable[[Floats], Floats]
    number: int | None = None


def _scale_entries(F: Floats) -> Floats:
    """Return F over its largest entry so that no square overflows; a zero matrix becomes the identity."""
    largest = np.abs(F).max(axis=(-2, -1), keepdims=True)
    zero = largest == 0
    return np.where(zero, np.eye(F.shape[-1]), F / np.where(zero, 1.0, largest))


def polar(F: Floats) -> Floats:
    """Return the closest rotation to each F (e, d, d); where det F < 0 the smallest singular value is flipped."""
    if F.shape[-1] == 2:
        A = _scale_entries(F)
        return _make_plane_rotations(A[..., 0, 0] + A[..., 1, 1], A[..., 1, 0] - A[..., 0, 1])
    from pipeline.fem.kernels.rotation import polar_rotations

    R = np.empty(F.shape)
    polar_rotations(np.ascontiguousarray(F), R)
    return R


def polar_by_svd(F: Floats) -> Floats:
    """Return what `polar` does, by the textbook's route: the plain reference of the compiled one."""
    U, _, Vt = np.linalg.svd(_scale_entries(F))
    U[..., :, -1] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[..., None]
    return np.asarray(U @ Vt)


def gram_schmidt(F: Floats) -> Floats:
    """Return the Gram-Schmidt rotation of the columns of each F (e, d, d), T 6.11."""
    A = _scale_entries(F)
    r0 = _orthonormal(A[..., :, 0], [])
    if F.shape[-1] == 2:
        return _make_plane_rotations(r0[..., 0], r0[..., 1])
    r1 = _orthonormal(A[..., :, 1], [r0])
    return np.stack([r0, r1, np.cross(r0, r1)], axis=-1)


def angle(R: Floats) -> Floats:
    """Return the angle of each rotation (e,) in [0, pi] [rad]."""
    if R.shape[-1] == 2:
        return np.abs(np.arctan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1]))
    twice_sine = np.linalg.norm(axial(R - np.swapaxes(R, -1, -2)), axis=-1)
    return np.arctan2(twice_sine / 2, (np.trace(R, axis1=-2, axis2=-1) - 1) / 2)


def axial(W: Floats) -> Floats:
    """Return the vector (W32, W13, W21) of each skew W (e, 3, 3)."""
    return np.stack([W[..., 2, 1], W[..., 0, 2], W[..., 1, 0]], axis=-1)


def _make_plane_rotations(cosine: Floats, sine: Floats) -> Floats:
    """Return the plane rotations (e, 2, 2) along (cosine, sine), the identity where both vanish."""
    length = np.hypot(cosine, sine)
    null = length <= _NULL
    c = np.where(null, 1.0, cosine / np.where(null, 1.0, length))
    s = np.where(null, 0.0, sine / np.where(null, 1.0, length))
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def _orthonormal(a: Floats, basis: list[Floats]) -> Floats:
    """Return the unit part of a (e, d) across the unit vectors of basis, or an axis across them where a has none."""
    across = _across(a, basis)
    left = np.linalg.norm(across, axis=-1)
    lost = left <= _NULL * np.maximum(np.linalg.norm(a, axis=-1), _NULL)
    if lost.any():
        across[lost] = _least_parallel_axis([r[lost] for r in basis], int(lost.sum()), a.shape[-1])
        left = np.linalg.norm(across, axis=-1)
    # once more: one pass leaves an error of eps |a| / |across|
    across = _across(across / left[..., None], basis)
    return np.asarray(across / np.linalg.norm(across, axis=-1, keepdims=True))


def _across(a: Floats, basis: list[Floats]) -> Floats:
    out = a.copy()
    for r in basis:
        out -= (r * out).sum(axis=-1, keepdims=True) * r
    return out


def _least_parallel_axis(basis: list[Floats], count: int, d: int) -> Floats:
    """Return, for each element, the part across the basis of the coordinate axis least parallel to it."""
    parallel = np.zeros((count, d))
    for r in basis:
        parallel += r**2
    return _across(np.eye(d)[np.argmin(parallel, axis=-1)], basis)


POLAR_ROTATION = Rotation(polar, POLAR)
GRAM_SCHMIDT_ROTATION = Rotation(gram_schmidt, GRAM_SCHMIDT)
