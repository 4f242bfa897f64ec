"""Files of GetFEM 5.4 (Debian's python3-getfem): a St. Venant-Kirchhoff bar, stretched and twisted.

20-node hexahedra in legacy .vtk, 10-node tetrahedra and linear wedges in .vtu; GetFEM writes no times.

    apt install python3-getfem;  /usr/bin/python3 make.py
"""

import os
import sys
from itertools import pairwise
from pathlib import Path

import getfem
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402

SPLITS = (np.arange(3.0), np.arange(2.0), np.arange(2.0))


def run(name, mesh, element, constant, rule):
    suffix = "vtk" if name == "hexahedra" else "vtu"
    mfu = getfem.MeshFem(mesh, 3)
    mfu.set_fem(getfem.Fem(element))
    mim = getfem.MeshIm(mesh, getfem.Integ(rule))
    faces = mesh.outer_faces()
    normals = mesh.normal_of_faces(faces)
    mesh.set_region(1, faces[:, np.abs(normals[0]) > 0.9])
    model = getfem.Model("real")
    model.add_fem_variable("u", mfu)
    model.add_initialized_data("parameters", [1.0, 1.0])
    model.add_finite_strain_elasticity_brick(mim, "SaintVenant Kirchhoff", "u", "parameters")
    nodes = mfu.basic_dof_nodes()[:, ::3].T
    model.add_initialized_fem_data("target", mfu, np.zeros(mfu.nbdof()))
    model.add_Dirichlet_condition_with_multipliers(mim, "u", mfu, 1, "target")

    constants = getfem.MeshFem(mesh, 1)
    constants.set_fem(getfem.Fem(constant))

    def assemble(expression, u):
        vector = getfem.asm_generic(mim, 1, f"({expression})*Test_q", -1, "u", False, mfu, u, "q", True, constants,
                                    np.zeros(constants.nbdof()))  # fmt: skip
        return np.asarray(vector).ravel()[-constants.nbdof() :]

    volumes, means = [], []
    for i, t in enumerate(TIMES):
        model.set_variable("target", (move_bar(nodes, t) - nodes).ravel())
        model.solve("max_iter", 50, "max_res", 1e-10)
        u = model.variable("u")
        arguments = [f"{name}_{i}.{suffix}", "ascii", mfu, u, "displacement"]
        if suffix == "vtu":
            mfu.export_to_vtu(*arguments)
        else:
            mfu.export_to_vtk(*arguments)
        rest = assemble("1", u)
        volumes.append(assemble("Det(Id(3)+Grad_u)", u))
        F = [assemble(f"(Id(3)+Grad_u)({i + 1},{j + 1})", u) / rest for i in range(3) for j in range(3)]
        means.append(np.stack(F, axis=1).reshape(-1, 3, 3))
    points = mesh.pts().T
    numbers, starts = mesh.pid_from_cvid()
    corners = [numbers[a:b] for a, b in pairwise(starts)]
    centers = [points[c].mean(axis=0) for c in corners]
    return make_expectation("GetFEM 5.4.2", f"{name}_*.{suffix}", range(len(TIMES)), centers=centers, rest_volumes=rest,
                            volumes=volumes, gradients=means, accuracy=1e-5)  # fmt: skip


def main():
    os.chdir(HERE)
    hexahedra = getfem.Mesh("cartesian", *SPLITS)
    tetrahedra = getfem.Mesh("regular simplices", *SPLITS)
    wedges = getfem.Mesh("prismatic", getfem.Mesh("regular simplices", *SPLITS[:2]), 1)
    write_expected(
        HERE,
        run("hexahedra", hexahedra, "FEM_Q2_INCOMPLETE(3)", "FEM_QK(3,0)", "IM_GAUSS_PARALLELEPIPED(3,8)"),
        run("tetrahedra", tetrahedra, "FEM_PK(3,2)", "FEM_PK(3,0)", "IM_TETRAHEDRON(8)"),
        run(
            "wedges", wedges, "FEM_PRISM_INCOMPLETE_P2", "FEM_PRISM_PK(3,0)", "IM_PRODUCT(IM_TRIANGLE(8),IM_GAUSS1D(8))"
        ),
    )


if __name__ == "__main__":
    main()
