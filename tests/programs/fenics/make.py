"""Files of legacy FEniCS 2019.2 (Debian's python3-dolfin): .pvd, .xdmf by write and by write_checkpoint.

apt install python3-dolfin;  /usr/bin/python3 make.py
"""

import os
import sys
from pathlib import Path

import dolfin as df
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, make_refusal, move_bar, move_plate, write_expected  # noqa: E402


class BarMotion(df.UserExpression):
    """Displacement of a point of the bar."""

    t = 0.0

    def eval(self, values, x):
        values[:] = (move_bar(np.array([x]), self.t) - x)[0]

    def value_shape(self):
        return (3,)


class PlateMotion(df.UserExpression):
    """Displacement of a point of the plate."""

    t = 0.0

    def eval(self, values, x):
        values[:] = (move_plate(np.array([x]), self.t) - x)[0]

    def value_shape(self):
        return (2,)


def solve_problem(u, motion):
    """Solve for u with the motion on both ends: neo-Hookean, in the plane or in space."""
    space = u.function_space()
    d = space.mesh().geometry().dim()
    ends = df.DirichletBC(space, motion, lambda x, on_boundary: df.near(x[0], 0) or df.near(x[0], 2))
    F = df.Identity(d) + df.grad(u)
    J = df.det(F)
    energy = ((df.tr(F.T * F) - d) / 2 - df.ln(J) + df.ln(J) ** 2) * df.dx
    test = df.TestFunction(space)
    R = df.derivative(energy, u, test)
    df.solve(R == 0, u, ends, J=df.derivative(R, u), solver_parameters={"newton_solver": {"relative_tolerance": 1e-12}})


def integrate(u):
    """Return rest volumes, volumes and mean F of the cells, assembled by the program."""
    mesh = u.function_space().mesh()
    d = mesh.geometry().dim()
    constants = df.FunctionSpace(mesh, "DG", 0)
    q = df.TestFunction(constants)
    F = df.Identity(d) + df.grad(u)
    order = [constants.dofmap().cell_dofs(k)[0] for k in range(mesh.num_cells())]
    dx = df.dx(metadata={"quadrature_degree": 6})

    def assemble(value):
        own = df.assemble(value * q * dx).get_local()[order]
        return np.concatenate(df.MPI.comm_world.allgather(own))

    rest = assemble(df.Constant(1.0))
    mean = np.stack([assemble(F[i, j]) / rest for i in range(d) for j in range(d)], axis=1).reshape(-1, d, d)
    return rest, assemble(df.det(F)), mean


def run(mesh, degree, name, write):
    space = df.VectorFunctionSpace(mesh, "CG", degree)
    u = df.Function(space, name="Displacement")
    motion = (BarMotion if mesh.geometry().dim() == 3 else PlateMotion)(degree=degree)
    volumes, means = [], []
    for t in TIMES:
        motion.t = t
        solve_problem(u, motion)
        write(u, t)
        rest, volume, mean = integrate(u)
        volumes.append(volume)
        means.append(mean)
    centers = np.concatenate(df.MPI.comm_world.allgather(mesh.coordinates()[mesh.cells()].mean(axis=1)))
    return make_expectation(f"FEniCS (DOLFIN {df.__version__})", name, TIMES, centers=centers, rest_volumes=rest,
                            volumes=volumes, gradients=means, accuracy=1e-8 if "xdmf" in name else 1e-5)  # fmt: skip


def main():
    df.set_log_level(df.LogLevel.WARNING)
    if df.MPI.comm_world.size > 1:
        (HERE / "parallel").mkdir(exist_ok=True)
        os.chdir(HERE / "parallel")
        pvd = df.File("two_parts.pvd")
        mesh = df.BoxMesh(df.Point(0, 0, 0), df.Point(2, 1, 1), 3, 1, 1)
        entry = run(mesh, 1, "two_parts.pvd", lambda u, t: pvd.__lshift__((u, t)))
        if df.MPI.comm_world.rank == 0:
            write_expected(HERE / "parallel", entry)
        return
    os.chdir(HERE)
    bar = df.BoxMesh(df.Point(0, 0, 0), df.Point(2, 1, 1), 3, 1, 1)
    plate = df.RectangleMesh(df.Point(0, 0), df.Point(2, 1), 4, 2)
    entries = []
    pvd = df.File("bar.pvd")
    entries.append(run(bar, 1, "bar.pvd", lambda u, t: pvd.__lshift__((u, t))))
    xdmf = df.XDMFFile("plate.xdmf")
    entries.append(run(plate, 1, "plate.xdmf", lambda u, t: xdmf.write(u, t)))
    xdmf.close()
    for name, degree in (("checkpoint.xdmf", 1), ("quadratic.xdmf", 2)):
        with df.XDMFFile(name) as checkpoint:

            def write(u, t, checkpoint=checkpoint):
                checkpoint.write_checkpoint(u, "u", t, df.XDMFFile.Encoding.HDF5, t > 0)

            entry = run(df.BoxMesh(df.Point(0, 0, 0), df.Point(2, 1, 1), 2, 1, 1), degree, name, write)
        # Functions of order 2 on a linear mesh: no reader of XDMF but FEniCS' own knows them.
        refusal = make_refusal(entry["program"], name, "write\\(\\) in place of write_checkpoint")
        entries.append(entry if degree == 1 else refusal)
    plate_pvd = df.File("plate.pvd")
    entries.append(run(plate, 1, "plate.pvd", lambda u, t: plate_pvd.__lshift__((u, t))))
    write_expected(HERE, *entries)


if __name__ == "__main__":
    main()
