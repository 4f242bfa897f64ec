r"""Constitutive laws of one cell: energy density W, first Piola-Kirchhoff stress P = dW/dF, tangent dP/dF.

    law             strain                     P                                  W = mu |eps|^2 + lam tr(eps)^2 / 2
    linear          eps = sym(F) - I           2 mu eps + lam tr(eps) I           (T 4.29)
    corotational    eps = sym(R^T F) - I       R (2 mu eps + lam tr(eps) I)       (T 6.12; web page, equation 3)

Linear is for small rotations only: a cell rotated by t grows by a factor 1/cos^2 t. Corotational is for large rotations
and small strains. Neither resists inversion (W is finite at det F = 0), so neither is for large stretches, and linear
simplices lock near poisson_ratio = 0.5.

With the polar R, R^T F is symmetric and P = 2 mu (F - R) + lam tr(R^T F - I) R. With the Gram-Schmidt R, T's second
method, P is not a derivative: there is no potential, and Newton's method on an energy must not be used.

Exact tangent for the polar R, with S = R^T F, A = tr(S) I - S, (A_i, q_i) its eigenpairs, c = lam (tr S - d) - 2 mu,
a = axial(R^T dF - dF^T R):

    dF : dP = 2 mu |sym(R^T dF)|^2 + lam tr(R^T dF)^2 + sum_i (mu + c / A_i) (q_i . a)^2

`frozen` keeps the first two terms, T's R K_e R^T. `projected` clamps every mu + c/A_i at zero: the nearest positive
semidefinite tangent, because the three terms act on orthogonal spaces. `exact` is indefinite in compression.

With a mean dilatation (dilatation.py) the trace tr(eps) in W, P and c is that mean, given as `dilatation` (e,); the
second term of the tangent then couples the cells of a group, and dilatation.py adds it.

Laws know nothing of meshes: element.py makes nodal forces and stiffness matrices from P and dP/dF.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.material import Material, align_values
from pipeline.fem.rotation import POLAR_ROTATION, Rotation

Tangent = Literal["frozen", "projected", "exact"]
# [mu] replaces the unbounded curvature of W on its convex crease, A_i -> 0 with c > 0
CREASE = 1e3


class Law(Protocol):
    """A constitutive law; R (e, d, d) is an argument, so that a solve can use rotations computed earlier."""

    constant_tangent: bool

    @property
    def material(self) -> Material:
        """Return the material."""
        ...

    def rotations(self, F: Floats) -> Floats:
        """Return the rotations R (e, d, d) of the frames in which this law measures strain."""
        ...

    def measure_dilatation(self, F: Floats, R: Floats) -> Floats:
        """Return tr(eps) (e,) [1]."""
        ...

    def energy_density(self, F: Floats, R: Floats, dilatation: Floats | None = None) -> Floats:
        """Return W (e,) [J/m3]."""
        ...

    def stress(self, F: Floats, R: Floats, dilatation: Floats | None = None) -> Floats:
        """Return the first Piola-Kirchhoff stress P (e, d, d) [Pa]."""
        ...

    def tangent(self, F: Floats, R: Floats, kind: Tangent = "frozen", dilatation: Floats | None = None) -> Floats:
        """Return the tangents dP_iJ/dF_kL (e, d, d, d, d) [Pa]; without the second term if dilatations are given."""
        ...


@dataclass(frozen=True)
class Linear:
    """Linear elasticity: the strain of small displacements; a cell rotated by t grows by a factor 1/cos^2 t."""

    material: Material
    constant_tangent = True

    def rotations(self, F: Floats) -> Floats:
        """Return identities; no rotation is extracted."""
        return np.broadcast_to(np.eye(F.shape[-1]), F.shape)

    def measure_dilatation(self, F: Floats, R: Floats) -> Floats:
        """Return tr(F) - d (e,) [1]; R is not used."""
        return _compute_trace(_compute_strain(F))

    def energy_density(self, F: Floats, R: Floats, dilatation: Floats | None = None) -> Floats:
        """Return W (e,) [J/m3]; R is not used."""
        return _compute_energy(_compute_strain(F), self.material, dilatation)

    def stress(self, F: Floats, R: Floats, dilatation: Floats | None = None) -> Floats:
        """Return P = 2 mu eps + lam tr(eps) I (e, d, d) [Pa]; R is not used."""
        return _compute_stress(_compute_strain(F), self.material, dilatation)

    def tangent(self, F: Floats, R: Floats, kind: Tangent = "frozen", dilatation: Floats | None = None) -> Floats:
        """Return the elasticity tensor (e, d, d, d, d) [Pa], the same for every F and R."""
        C = make_elasticity_tensor(F.shape[-1], self.material.spread(len(F)), has_trace=dilatation is None)
        return np.broadcast_to(C, F.shape + F.shape[-2:])


@dataclass(frozen=True)
class Corotational:
    """Linear elasticity in the frame R of every cell."""

    material: Material
    rotation: Rotation = POLAR_ROTATION
    constant_tangent = False

    def rotations(self, F: Floats) -> Floats:
        """Return the rotation extracted from each F."""
        return self.rotation.extract(F)

    def measure_dilatation(self, F: Floats, R: Floats) -> Floats:
        """Return tr(R^T F) - d (e,) [1]."""
        return _compute_trace(_compute_strain(_transpose(R) @ F))

    def energy_density(self, F: Floats, R: Floats, dilatation: Floats | None = None) -> Floats:
        """Return W (e,) [J/m3] of the strain in the frame R."""
        return _compute_energy(_compute_strain(_transpose(R) @ F), self.material, dilatation)

    def stress(self, F: Floats, R: Floats, dilatation: Floats | None = None) -> Floats:
        """Return P = R (2 mu eps + lam tr(eps) I) (e, d, d) [Pa]."""
        return R @ _compute_stress(_compute_strain(_transpose(R) @ F), self.material, dilatation)

    def tangent(self, F: Floats, R: Floats, kind: Tangent = "frozen", dilatation: Floats | None = None) -> Floats:
        """Return dP/dF (e, d, d, d, d) [Pa]; `exact` and `projected` are for the polar R only."""
        d = F.shape[-1]
        C = make_elasticity_tensor(d, self.material.spread(len(F)), has_trace=dilatation is None)
        half = (R @ C.reshape(*C.shape[:-4], d, d**3)).reshape(-1, d, d, d, d)  # R_iI C_IJKL
        frozen = R[:, None, None] @ half  # R_kK R_iI C_IJKL
        if kind == "frozen":
            return frozen
        weight, mode = self._find_rotation_modes(F, R, dilatation)
        if kind == "projected":
            weight = np.maximum(weight, 0.0)
        mode = mode.reshape(len(F), -1, d * d)
        return frozen + (np.swapaxes(mode, 1, 2) @ (weight[:, :, None] * mode)).reshape(frozen.shape)

    def _find_rotation_modes(self, F: Floats, R: Floats, dilatation: Floats | None) -> tuple[Floats, Floats]:
        """Return mu + c/A_i (e, m) and the T_i (e, m, d, d) with T_i : dF = q_i . axial(R^T dF - dF^T R)."""
        d, m = F.shape[-1], self.material.spread(len(F))
        mu, lam = (align_values(values, 1) for values in (m.mu, m.lam))
        S = _compute_strain(_transpose(R) @ F) + np.eye(d)
        trace = _compute_trace(S)[:, None]
        c = lam * (trace - d if dilatation is None else dilatation[:, None]) - 2 * mu
        if d == 2:
            A, mode = trace, (R @ _GENERATOR_2D)[:, None]
        else:
            A, q = np.linalg.eigh(trace[:, :, None] * np.eye(3) - S)
            mode = R[:, None] @ np.tensordot(np.swapaxes(q, 1, 2), _GENERATORS_3D, axes=1)
        return mu + c / np.maximum(A, np.maximum(np.abs(c) / (CREASE * mu), np.finfo(float).tiny)), mode


def make_elasticity_tensor(d: int, material: Material, *, has_trace: bool = True) -> Floats:
    """Return the isotropic C_IJKL = mu (d_IK d_JL + d_IL d_JK) + lam d_IJ d_KL (d, d, d, d) [Pa].

    Without the trace it has only the first term. It has an axis of cells (e,) in front if the material has.
    """
    delta = np.eye(d)
    shear = np.einsum("ik,jl->ijkl", delta, delta) + np.einsum("il,jk->ijkl", delta, delta)
    mu, lam = (align_values(values, 4) for values in (material.mu, material.lam if has_trace else 0.0))
    return np.asarray(mu * shear + lam * np.einsum("ij,kl->ijkl", delta, delta))


# component m of axial(R^T dF - dF^T R) is (R L_m) : dF with these generators L_m of rotations
_GENERATOR_2D = np.array([[0.0, -1.0], [1.0, 0.0]])
_GENERATORS_3D = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)


def _compute_strain(F: Floats) -> Floats:
    return (F + _transpose(F)) / 2 - np.eye(F.shape[-1])


def _compute_trace(strain: Floats) -> Floats:
    return np.asarray(np.trace(strain, axis1=1, axis2=2))


def _compute_stress(strain: Floats, material: Material, dilatation: Floats | None) -> Floats:
    trace, m = _compute_trace(strain) if dilatation is None else dilatation, material.spread(len(strain))
    mu, lam = (align_values(values, 2) for values in (m.mu, m.lam))
    return np.asarray(2 * mu * strain + lam * trace[:, None, None] * np.eye(strain.shape[-1]))


def _compute_energy(strain: Floats, material: Material, dilatation: Floats | None) -> Floats:
    trace, m = _compute_trace(strain) if dilatation is None else dilatation, material.spread(len(strain))
    return np.asarray(m.mu * (strain**2).sum(axis=(1, 2)) + m.lam / 2 * trace**2)


def _transpose(F: Floats) -> Floats:
    return np.swapaxes(F, -1, -2)
