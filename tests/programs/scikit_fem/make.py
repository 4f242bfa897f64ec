"""Files of scikit-fem: a neo-Hookean bar, stretched and twisted. Hexahedra in .vtu, 10-node tetrahedra in .xdmf.

pip install scikit-fem h5py;  python make.py
"""

import os
import sys
from pathlib import Path

import meshio
import numpy as np
import skfem
import skfem.io.meshio
from skfem.helpers import ddot, det, grad, identity, inv, transpose

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402

MU, LAM = 1.0, 2.0


@skfem.LinearForm
def residual(v, w):
    F = grad(w["u"]) + identity(grad(w["u"]))
    T = transpose(inv(F))
    return ddot(MU * F + (LAM * np.log(det(F)) - MU) * T, grad(v))


@skfem.BilinearForm
def stiffness(u, v, w):
    F = grad(w["u"]) + identity(grad(w["u"]))
    T, D = transpose(inv(F)), grad(u)
    turned = np.einsum("ij...,kj...,kl...->il...", T, D, T)
    tangent = MU * D - (LAM * np.log(det(F)) - MU) * turned + LAM * ddot(T, D) * T
    return ddot(tangent, grad(v))


def solve(basis):
    """Return the displacements at TIMES, solved by Newton's method with both ends held."""
    X = basis.doflocs
    ends = basis.get_dofs(lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 2)).all()
    u, states = basis.zeros(), []
    for t in TIMES:
        points = X[:, ends].T
        component = np.zeros(len(ends), dtype=int)
        for axis in range(3):
            component[np.isin(ends, basis.get_dofs(lambda x: x[0] > -1).all([f"u^{axis + 1}"]))] = axis
        u = u.copy()
        u[ends] = (move_bar(points, t) - points)[np.arange(len(ends)), component]
        for _ in range(30):
            w = basis.interpolate(u)
            r = residual.assemble(basis, u=w)
            du = skfem.solve(*skfem.condense(stiffness.assemble(basis, u=w), -r, D=ends))
            u = u + du
            if np.abs(du).max() < 1e-12:
                break
        states.append(u)
    return states


def integrate(basis, states):
    """Return rest volumes, volumes and mean F of the cells, by the program's own quadrature."""
    rest = basis.dx.sum(axis=1)
    volumes, means = [], []
    for u in states:
        gradient = np.asarray(basis.interpolate(u).grad)
        F = gradient + np.eye(3)[:, :, None, None]
        volumes.append((np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1))) * basis.dx).sum(axis=1))
        means.append(np.moveaxis((F * basis.dx).sum(axis=-1) / rest, -1, 0))
    return rest, np.array(volumes), np.array(means)


def at_points(basis, mesh, u):
    """Return the displacements (n, 3) at the points of the mesh's file."""
    X = mesh.doflocs.T
    values = np.zeros((len(X), 3))
    for axis in range(3):
        dofs = basis.get_dofs(lambda x: x[0] > -1).all([f"u^{axis + 1}"])
        where = {tuple(np.round(basis.doflocs[:, d], 6)): u[d] for d in dofs}
        values[:, axis] = [where[tuple(np.round(p, 6))] for p in X]
    return values


def main():
    os.chdir(HERE)  # the .h5 is written beside the .xdmf
    entries = []
    mesh = skfem.MeshHex.init_tensor(np.linspace(0, 2, 5), np.linspace(0, 1, 3), np.linspace(0, 1, 3))
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex1()), intorder=6)
    states = solve(basis)
    for i, u in enumerate(states):
        mesh.save(f"hexahedra_{i}.vtu", point_data={"u": at_points(basis, mesh, u)})
    rest, volumes, means = integrate(basis, states)
    centers = mesh.p[:, mesh.t].mean(axis=1).T
    program = f"scikit-fem {skfem.__version__}"
    times = range(len(TIMES))  # these files have none
    entries.append(make_expectation(program, "hexahedra_*.vtu", times, centers=centers, rest_volumes=rest,
                                    volumes=volumes, gradients=means))  # fmt: skip

    mesh = skfem.MeshTet2.from_mesh(
        skfem.MeshTet.init_tensor(np.linspace(0, 2, 3), np.linspace(0, 1, 2), np.linspace(0, 1, 2))
    )
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP2()), intorder=6)
    states = solve(basis)
    plain = skfem.io.meshio.to_meshio(mesh)
    with meshio.xdmf.TimeSeriesWriter("tetrahedra.xdmf") as writer:
        writer.write_points_cells(plain.points, plain.cells)
        for t, u in zip(TIMES, states, strict=True):
            writer.write_data(t, point_data={"displacement": at_points(basis, mesh, u)})
    rest, volumes, means = integrate(basis, states)
    centers = mesh.p[:, mesh.t[:4]].mean(axis=1).T
    entries.append(make_expectation(program, "tetrahedra.xdmf", TIMES, centers=centers, rest_volumes=rest,
                                    volumes=volumes, gradients=means))  # fmt: skip
    write_expected(HERE, *entries)


if __name__ == "__main__":
    main()
