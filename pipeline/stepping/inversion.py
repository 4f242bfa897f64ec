r"""The rotation of a cell with det F <= 0; if det F > 0, all treatments are the polar rotation.

    flip      the smallest singular value is negative (Irving, Teran, Fedkiw 2004): the nearest rotation. A cell
              pushed far through a face may find another axis shorter, and stay inverted. No history; has a potential
    last      the rotation before the inversion is kept. Recovers, but a cell that turns meanwhile is held back
    crossing  the singular value whose direction collapsed when the cell inverted is taken as negative, as long as it
              stays inverted (after Schmedding, Teschner 2008 and Civit-Flores, Susin 2014)

The last two need the previous step, which they keep in the state's memory; they are for one solve per step. A cell that
is inverted at the start counts as having been at rest before.
"""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.body import Body
from pipeline.fem.rotation import polar
from pipeline.stepping.state import NO_ARRAYS, State

Record = Mapping[str, Floats]


class Treatment(Protocol):
    """Rotations that depend on the previous step."""

    def rotations(self, F: Floats, record: Record) -> tuple[Floats, Record]:
        """Return the rotations R (s, d, d) of F (s, d, d) at their sites, and the record for the next step."""
        ...


def track_rotations(treatment: Treatment | None, body: Body, x: Floats, state: State) -> tuple[Floats | None, Record]:
    """Return the treatment's rotations at x (n, d) and its next record; without a treatment, None and an empty one."""
    if treatment is None:
        return None, NO_ARRAYS
    return treatment.rotations(body.site_gradients(x), state.memory.inversion)


class Last:
    """Keeps the rotation from before the inversion."""

    def rotations(self, F: Floats, record: Record) -> tuple[Floats, Record]:
        """Return polar(F), or the recorded rotation of cells with det F <= 0."""
        R = polar(F)
        inverted = np.linalg.det(F) <= 0
        if inverted.any():
            before = record.get("rotation_before", np.broadcast_to(np.eye(F.shape[-1]), F.shape))
            R[inverted] = before[inverted]
        return R, {"rotation_before": R}


class Crossing:
    """Keeps the direction that collapsed: a unit vector of the rest shape, zero for a cell that is not inverted."""

    def rotations(self, F: Floats, record: Record) -> tuple[Floats, Record]:
        """Return polar(F), with the collapsed direction reflected for cells with det F <= 0."""
        e, d = F.shape[:2]
        before = record.get("gradient_before", np.broadcast_to(np.eye(d), F.shape))
        collapsed = record.get("collapsed", np.zeros((e, d))).copy()
        R = polar(F)
        inverted = np.linalg.det(F) <= 0
        collapsed[~inverted] = 0.0
        fresh = np.flatnonzero(inverted & ~collapsed.any(axis=1))
        if fresh.size:
            collapsed[fresh] = _collapsed_directions(before[fresh], F[fresh])
        if inverted.any():
            R[inverted] = _reflect(F[inverted], collapsed[inverted])
        return R, {"gradient_before": F, "collapsed": collapsed}


def _collapsed_directions(A: Floats, B: Floats) -> Floats:
    """Return for each pair the unit n (k, d) with ((1 - s) A + s B) n = 0 at the smallest such s in [0, 1]."""
    out = np.empty(A.shape[:2])
    for i, (a, b) in enumerate(zip(A, B, strict=True)):
        # det(a + s (b - a)) = 0; s = 1 / (1 - eigenvalue) of a^-1 b
        values = np.linalg.eigvals(np.linalg.lstsq(a, b, rcond=None)[0])
        real = values.real[(np.abs(values.imag) <= 1e-9 * np.abs(values).max()) & (values.real <= 0)]
        s = 1 / (1 - real.min()) if real.size else 1.0
        out[i] = np.linalg.svd((1 - s) * a + s * b)[2][-1]
    return out


def _reflect(F: Floats, direction: Floats) -> Floats:
    """Return U D V^T (k, d, d); D is -1 for the singular direction nearest to `direction`, 1 for the others."""
    largest = np.abs(F).max(axis=(1, 2), keepdims=True)
    U, _, Vt = np.linalg.svd(F / np.where(largest == 0, 1.0, largest))
    nearest = np.abs((Vt @ direction[:, :, None])[:, :, 0]).argmax(axis=1)
    wrong = np.linalg.det(U) * np.linalg.det(Vt) < 0
    rows = np.arange(len(F))
    U[rows, :, nearest] *= np.where(wrong, -1.0, 1.0)[:, None]
    return np.asarray(U @ Vt)
