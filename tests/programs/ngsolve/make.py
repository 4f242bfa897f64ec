"""Files of NGSolve: a neo-Hookean bar, stretched and twisted at its end, in .pvd and .vtu by VTKOutput.

Of first order, and of second order in quadratic cells. Each cell has points of its own.

    pip install ngsolve;  python make.py
"""

import os
import sys
from pathlib import Path

import ngsolve
import numpy as np
from netgen.occ import Box, OCCGeometry
from netgen.occ import X as AXIS
from ngsolve import CF, Det, Grad, Id, Integrate, Trace, VectorH1, VTKOutput, cos, dx, log, sin, x, y, z

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import STRETCH, TIMES, TWIST, make_expectation, write_expected  # noqa: E402


def move_ends(u, t):
    """Put the displacement of the two ends at time t into u; the rest of u remains the last solution."""
    angle = TWIST * t * x / 2
    c, s, b, d = cos(angle), sin(angle), y - 0.5, z - 0.5
    ends = ngsolve.GridFunction(u.space)
    target = CF((STRETCH * t * x, 0.5 + c * b - s * d - y, 0.5 + s * b + c * d - z))
    ends.Set(target, definedon=u.space.mesh.Boundaries("left|right"))
    free = u.space.FreeDofs()
    for dof in range(u.space.ndof):
        if not free[dof]:
            u.vec[dof] = ends.vec[dof]


def run(mesh, order, name, moves=False):
    space = VectorH1(mesh, order=order, dirichlet="left|right")
    u = ngsolve.GridFunction(space, name="displacement")
    form = ngsolve.BilinearForm(space)
    F = Id(3) + Grad(space.TrialFunction())
    form += ngsolve.Variation((0.5 * (Trace(F.trans * F) - 3) - log(Det(F)) + log(Det(F)) ** 2) * dx)
    output = VTKOutput(mesh, coefs=[u], names=["displacement"], filename=name, order=order)
    rest = np.array(Integrate(CF(1), mesh, element_wise=True))
    gradient = Id(3) + Grad(u)
    volumes, means = [], []
    for t in TIMES:
        move_ends(u, t)
        ngsolve.solvers.NewtonMinimization(form, u, printing=False, maxerr=1e-12)
        if moves:
            mesh.SetDeformation(u)  # VTKOutput then writes the deformed points, and the field too
        output.Do(time=t)
        mesh.UnsetDeformation()
        volumes.append(np.array(Integrate(Det(gradient), mesh, element_wise=True, order=4)))
        entries = [np.array(Integrate(gradient[i, j], mesh, element_wise=True)) for i in range(3) for j in range(3)]
        means.append((np.stack(entries, axis=1) / rest[:, None]).reshape(-1, 3, 3))
    centers = [np.mean([mesh[v].point for v in element.vertices], axis=0) for element in mesh.Elements()]
    return make_expectation(f"NGSolve {ngsolve.__version__}", f"{name}.pvd", TIMES, centers=centers,
                            rest_volumes=rest, volumes=volumes, gradients=means)  # fmt: skip


def main():
    os.chdir(HERE)
    box = Box((0, 0, 0), (2, 1, 1))
    box.faces.Min(AXIS).name = "left"
    box.faces.Max(AXIS).name = "right"
    mesh = ngsolve.Mesh(OCCGeometry(box).GenerateMesh(maxh=0.8))
    write_expected(HERE, run(mesh, 1, "linear"), run(mesh, 2, "quadratic"),
                   run(mesh, 1, "deformed", moves=True))  # fmt: skip


if __name__ == "__main__":
    main()
