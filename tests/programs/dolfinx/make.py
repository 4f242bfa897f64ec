"""Files of dolfinx 0.5 (Debian's python3-dolfinx): a stretched and twisted bar by VTKFile and XDMFFile.

    apt install python3-dolfinx openmpi-bin;  /usr/bin/python3 make.py;  mpirun -n 2 /usr/bin/python3 make.py

Two processes write a series in two parts, with ghost cells. Debian's build has no ADIOS2, so no VTXWriter.
"""

import os
import sys
from pathlib import Path

import dolfinx
import numpy as np
import ufl
from dolfinx import fem, io, mesh
from mpi4py import MPI
from petsc4py import PETSc

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, make_refusal, move_bar, write_expected  # noqa: E402
from quadrature import integrate_cells  # noqa: E402


def solve_problem(space, t, u):
    """Solve linear elasticity for u with the ends of the bar where they are at time t."""
    domain = space.mesh
    ends = fem.locate_dofs_geometrical(space, lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 2))
    target = fem.Function(space)
    target.interpolate(lambda x: (move_bar(x.T, t) - x.T).T)
    v, w = ufl.TestFunction(space), ufl.TrialFunction(space)
    strain = ufl.sym(ufl.grad(w))
    stress = 2 * strain + ufl.tr(strain) * ufl.Identity(3)
    zero = fem.Constant(domain, PETSc.ScalarType((0, 0, 0)))
    problem = fem.petsc.LinearProblem(ufl.inner(stress, ufl.grad(v)) * ufl.dx, ufl.inner(zero, v) * ufl.dx,
                                      bcs=[fem.dirichletbc(target, ends)], u=u)  # fmt: skip
    problem.solve()


def integrate(u):
    """Return rest volumes, volumes and mean F of the cells, assembled by the program."""
    domain = u.function_space.mesh
    constants = fem.FunctionSpace(domain, ("DG", 0))
    owned = [constants.dofmap.cell_dofs(k)[0] for k in range(domain.topology.index_map(3).size_local)]
    q = ufl.TestFunction(constants)
    F = ufl.Identity(3) + ufl.grad(u)
    dx = ufl.Measure("dx", metadata={"quadrature_degree": 8})
    one = fem.Constant(domain, PETSc.ScalarType(1))

    def assemble(value):
        vector = fem.petsc.assemble_vector(fem.form(value * q * dx(domain)))
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.concatenate(domain.comm.allgather(vector.array[owned]))

    rest = assemble(one)
    mean = np.stack([assemble(F[i, j]) / rest for i in range(3) for j in range(3)], axis=1).reshape(-1, 3, 3)
    return rest, assemble(ufl.det(F)), mean


def run(name, cell, degree, vtk, xdmf):
    domain = mesh.create_box(MPI.COMM_WORLD, [(0, 0, 0), (2, 1, 1)], (2, 1, 1) if degree == 2 else (3, 1, 1), cell)
    space = fem.VectorFunctionSpace(domain, ("CG", degree))
    u = fem.Function(space, name="u" if vtk else "displacement")
    volumes, means = [], []
    file = io.VTKFile(domain.comm, f"{name}.pvd", "w") if vtk else io.XDMFFile(domain.comm, f"{name}.xdmf", "w")
    if xdmf:
        file.write_mesh(domain)
    for t in TIMES:
        solve_problem(space, t, u)
        file.write_function([u], t) if vtk else file.write_function(u, t)
        rest, volume, mean = integrate(u)
        volumes.append(volume)
        means.append(mean)
    file.close()
    x = domain.geometry.x
    owned = range(domain.topology.index_map(3).size_local)
    centers = np.array([x[domain.geometry.dofmap.links(k)].mean(axis=0) for k in owned])
    centers = np.concatenate(domain.comm.allgather(centers))
    series = f"{name}.{'pvd' if vtk else 'xdmf'}"
    return make_expectation(f"dolfinx {dolfinx.__version__}", series, TIMES, centers=centers,
                            rest_volumes=rest, volumes=volumes, gradients=means)  # fmt: skip


def run_moving(name, suffix):
    """Write the mesh itself at each time, its geometry moved, as for fluid and structure: there is no field."""
    domain = mesh.create_box(MPI.COMM_WORLD, [(0, 0, 0), (2, 1, 1)], (3, 1, 1), mesh.CellType.tetrahedron)
    X = domain.geometry.x.copy()
    cells = np.array([domain.geometry.dofmap.links(k) for k in range(domain.topology.index_map(3).size_local)])
    flipped = np.linalg.det(X[cells[:, 1:]] - X[cells[:, :1]]) < 0
    cells[flipped] = cells[flipped][:, [0, 2, 1, 3]]
    kind = io.VTKFile if suffix == "pvd" else io.XDMFFile
    results = []
    with kind(domain.comm, f"{name}.{suffix}", "w") as file:
        for t in TIMES:
            domain.geometry.x[:] = move_bar(X, t)
            if suffix == "pvd":
                file.write_mesh(domain, t)
            else:
                domain.name = f"mesh_{t:g}"
                file.write_mesh(domain)
            results.append(integrate_cells("tetrahedron", X, domain.geometry.x, cells))
    return make_expectation(f"dolfinx {dolfinx.__version__}", f"{name}.{suffix}", TIMES, centers=X[cells].mean(axis=1),
                            rest_volumes=results[0][0], volumes=[r[1] for r in results],
                            gradients=[r[2] for r in results])  # fmt: skip


def main():
    if MPI.COMM_WORLD.size > 1:
        (HERE / "parallel").mkdir(exist_ok=True)
        os.chdir(HERE / "parallel")
        entry = run("two_parts", mesh.CellType.tetrahedron, 1, True, False)
        if MPI.COMM_WORLD.rank == 0:
            write_expected(HERE / "parallel", entry)
        return
    os.chdir(HERE)
    run_moving("meshes", "xdmf")  # grids without times, which ParaView too shows all at once
    write_expected(
        HERE,
        run("tetrahedra_2", mesh.CellType.tetrahedron, 2, True, False),
        run("hexahedra_2", mesh.CellType.hexahedron, 2, True, False),
        run("hexahedra_1", mesh.CellType.hexahedron, 1, True, False),
        run("tetrahedra_1", mesh.CellType.tetrahedron, 1, False, True),
        run_moving("moving", "pvd"),
        make_refusal(f"dolfinx {dolfinx.__version__}", "meshes.xdmf", "temporal collection"),
    )


if __name__ == "__main__":
    main()
