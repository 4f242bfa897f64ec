r"""The thesis' formulas exactly as printed, each with the one sign or factor that corrects it; `corrected` chooses.

    T 4.30         K_e block by block, from the three sums of sigma grad N_i
    T 4.31, 4.32   the same as products of 3 x 3 matrices
    T 4.47, 4.48   one step of backward Euler
    T 6.15, 6.16   one step of the corotational method

Prefactor and volume are right in all of them (correction to T 4.33), so that each shows only one fault. They are used
by the corrections table and its tests; the program has its own formulas.
"""

import numpy as np

from pipeline.arrays import Floats
from pipeline.fem.material import Material
from pipeline.mesh.simplex import Mesh


def stiffness_4_30(mesh: Mesh, material: Material, *, corrected: bool = False) -> Floats:
    """Return K_e (e, 4, 3, 4, 3) [N/m] of T 4.30; corrected: dNi/dz dNj/dy in the third sum of (*)_2."""
    nu = material.poisson_ratio
    h = (1 - 2 * nu) / 2
    x, y, z = np.moveaxis(mesh.shape_gradients[:, :, None], -1, 0)  # of N_i
    X, Y, Z = np.moveaxis(mesh.shape_gradients[:, None, :], -1, 0)  # of N_j
    third = z * Y if corrected else x * X
    rows = [
        [(1 - nu) * x * X + h * y * Y + h * z * Z, nu * x * Y + h * y * X, nu * x * Z + h * z * X],
        [h * x * Y + nu * y * X, h * x * X + (1 - nu) * y * Y + h * z * Z, nu * y * Z + h * third],
        [h * x * Z + nu * z * X, h * y * Z + nu * z * Y, h * x * X + h * y * Y + (1 - nu) * z * Z],
    ]
    prefactor = material.youngs_modulus / ((1 + nu) * (1 - 2 * nu))
    blocks = np.array(rows)  # (row, column, e, i, j)
    return np.asarray(prefactor * np.einsum("rceij,e->eirjc", blocks, mesh.rest_volumes))


def stiffness_4_32(mesh: Mesh, material: Material, *, corrected: bool = False) -> Floats:
    """Return K_e (e, 4, 3, 4, 3) [N/m] of T 4.31 + 4.32; corrected: (0, dNi/dy, dNi/dx) in row 3 of the left factor."""
    E, nu = material.youngs_modulus, material.poisson_ratio
    a, b = (E * share / ((1 + nu) * (1 - 2 * nu)) for share in (1 - nu, nu))
    c = E / (2 * (1 + nu))
    N = mesh.shape_gradients
    x, y, z = np.moveaxis(N, -1, 0)
    zero = np.zeros_like(x)
    left = np.array([[y, zero, z], [x, z, zero], [zero, y if corrected else z, x]])
    right = np.array([[y, x, zero], [zero, z, y], [z, zero, x]])
    normal = np.einsum("eir,rc,ejc->eirjc", N, np.full((3, 3), b) + (a - b) * np.eye(3), N)
    shear = c * np.einsum("rkei,kcej->eirjc", left, right)
    return np.asarray((normal + shear) * mesh.rest_volumes[:, None, None, None, None])


def step_4_48(
    M: Floats, K: Floats, f: Floats, u: Floats, v: Floats, dt: float, *, corrected: bool = False
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return u and v (k,) one step later by T 4.48 and 4.49; corrected: + dt (f - K u)."""
    sign = 1.0 if corrected else -1.0
    v_next = np.asarray(np.linalg.solve(M + dt**2 * K, M @ v + sign * dt * (f - K @ u)), np.float64)
    return u + dt * v_next, v_next


def force_6_12(K: Floats, f: Floats, x: Floats, u: Floats, f_0: Floats, *, corrected: bool = False) -> Floats:
    """Return the bracket of T 6.12 to 6.16, f - K'(u + x) - f_0 (k,) [N]; corrected: + f_0."""
    return np.asarray(f - K @ (u + x) + (f_0 if corrected else -f_0))
