r"""Constitutive laws of one cell: energy density W(F), stress P(F), tangent dP/dF. No volumes, no sums, no mesh.

    linear          e = sym(F) - I        W = mu |e|^2 + lam tr(e)^2 / 2     P = 2 mu e + lam tr(e) I        (T 4.29)
    corotational    e = sym(R^T F) - I    the same W                          P = R (2 mu e + lam tr(e) I)  (T 6.12, W)

With the polar R, R^T F is symmetric and P is W's 2 mu (F - R) + lam tr(R^T F - I) R. With the Gram-Schmidt R it is
T's second method: its force comes from the same stiffness, but it has no potential.

Exact tangent for the polar R, with S = R^T F, A = tr(S) I - S, (A_i, q_i) its eigenpairs, c = lam (tr S - d) - 2 mu,
a = axial(R^T dF - dF^T R):

    dF : dP = 2 mu |sym(R^T dF)|^2 + lam tr(R^T dF)^2 + sum_i (mu + c / A_i) (q_i . a)^2

`frozen` keeps the first two terms (R K_e R^T of T); `projected` clamps every mu + c/A_i at zero, which is the nearest
positive semidefinite tangent because the three terms act on orthogonal spaces; `exact` is indefinite in compression.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.material import Material
from pipeline.fem.rotation import POLAR_ROTATION, Rotation

Tangent = Literal["frozen", "projected", "exact"]
# A_i -> 0 with c > 0 is a convex crease of W, whose curvature has no bound: this many shear moduli stand for it.
CREASE = 1e3


class Law(Protocol):
    """A constitutive law; R (e, d, d) is an argument, so that a solve can use the rotations that it has."""

    constant_tangent: bool

    @property
    def material(self) -> Material:
        """Return the material that W is of."""
        ...

    def rotations(self, F: Floats) -> Floats:
        """Return the frame R (e, d, d) in which this law takes the strain."""
        ...

    def energy_density(self, F: Floats, R: Floats) -> Floats:
        """Return W (e,) [J/m3]."""
        ...

    def stress(self, F: Floats, R: Floats) -> Floats:
        """Return the first Piola-Kirchhoff stress P (e, d, d) [Pa]."""
        ...

    def tangent(self, F: Floats, R: Floats, kind: Tangent = "frozen") -> Floats:
        """Return dP_iJ/dF_kL (e, d, d, d, d) [Pa]."""
        ...


@dataclass(frozen=True)
class Linear:
    """Linear elasticity: the infinitesimal strain, which takes a rotation by t for a stretch of 1/cos^2 t."""

    material: Material
    constant_tangent = True

    def rotations(self, F: Floats) -> Floats:
        """Return identities; none is extracted."""
        return np.broadcast_to(np.eye(F.shape[-1]), F.shape)

    def energy_density(self, F: Floats, R: Floats) -> Floats:
        """Return W (e,) [J/m3]; R is not used."""
        return _energy(_strain(F), self.material)

    def stress(self, F: Floats, R: Floats) -> Floats:
        """Return P = 2 mu e + lam tr(e) I [Pa]; R is not used."""
        return _stress(_strain(F), self.material)

    def tangent(self, F: Floats, R: Floats, kind: Tangent = "frozen") -> Floats:
        """Return the elasticity tensor [Pa], the same for every F and R."""
        return np.broadcast_to(isotropic(F.shape[-1], self.material), F.shape + F.shape[-2:])


@dataclass(frozen=True)
class Corotational:
    """Linear elasticity in the frame R of every cell."""

    material: Material
    rotation: Rotation = POLAR_ROTATION
    constant_tangent = False

    def rotations(self, F: Floats) -> Floats:
        """Return the rotation extracted from each F."""
        return self.rotation.extract(F)

    def energy_density(self, F: Floats, R: Floats) -> Floats:
        """Return W (e,) [J/m3] of the strain in the frame R."""
        return _energy(_strain(_transpose(R) @ F), self.material)

    def stress(self, F: Floats, R: Floats) -> Floats:
        """Return P = R (2 mu e + lam tr(e) I) [Pa]."""
        return R @ _stress(_strain(_transpose(R) @ F), self.material)

    def tangent(self, F: Floats, R: Floats, kind: Tangent = "frozen") -> Floats:
        """Return dP/dF [Pa]; `exact` and `projected` hold for the polar R only."""
        d = F.shape[-1]
        C = isotropic(d, self.material)
        half = (R @ C.reshape(d, d**3)).reshape(-1, d, d, d, d)  # R_iI C_IJKL
        frozen = R[:, None, None] @ half  # R_kK R_iI C_IJKL
        if kind == "frozen":
            return frozen
        weight, t = self._find_rotation_modes(F, R)
        if kind == "projected":
            weight = np.maximum(weight, 0.0)
        t = t.reshape(len(F), -1, d * d)
        return frozen + (np.swapaxes(t, 1, 2) @ (weight[:, :, None] * t)).reshape(frozen.shape)

    def _find_rotation_modes(self, F: Floats, R: Floats) -> tuple[Floats, Floats]:
        """Return mu + c/A_i (e, m) and the t_i (e, m, d, d) for which t_i : dF = q_i . axial(R^T dF - dF^T R)."""
        mu, lam = self.material.mu, self.material.lam
        d = F.shape[-1]
        S = _strain(_transpose(R) @ F) + np.eye(d)
        trace = np.trace(S, axis1=1, axis2=2)
        c = (lam * (trace - d) - 2 * mu)[:, None]
        if d == 2:
            A, t = trace[:, None], (R @ _SKEW_2D)[:, None]
        else:
            A, q = np.linalg.eigh(trace[:, None, None] * np.eye(3) - S)
            t = R[:, None] @ np.tensordot(np.swapaxes(q, 1, 2), _SKEW_3D, axes=1)
        return mu + c / np.maximum(A, np.maximum(np.abs(c) / (CREASE * mu), np.finfo(float).tiny)), t


def isotropic(d: int, material: Material) -> Floats:
    """Return C_IJKL = mu (d_IK d_JL + d_IL d_JK) + lam d_IJ d_KL (d, d, d, d) [Pa]."""
    one = np.eye(d)
    shear = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
    return material.mu * shear + material.lam * np.einsum("ij,kl->ijkl", one, one)


# component m of axial(R^T dF - dF^T R) is (R W_m) : dF, with these W_m
_SKEW_2D = np.array([[0.0, -1.0], [1.0, 0.0]])
_SKEW_3D = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)


def _strain(F: Floats) -> Floats:
    return (F + _transpose(F)) / 2 - np.eye(F.shape[-1])


def _stress(e: Floats, material: Material) -> Floats:
    trace = np.trace(e, axis1=1, axis2=2)
    return 2 * material.mu * e + material.lam * trace[:, None, None] * np.eye(e.shape[-1])


def _energy(e: Floats, material: Material) -> Floats:
    return material.mu * (e**2).sum(axis=(1, 2)) + material.lam / 2 * np.trace(e, axis1=1, axis2=2) ** 2


def _transpose(F: Floats) -> Floats:
    return np.swapaxes(F, -1, -2)
