"""Files of Kratos: bars of hexahedra, wedges and tetrahedra in one file, stretched and twisted; .vtk by VtkOutput.

    pip install KratosMultiphysics KratosStructuralMechanicsApplication;  python make.py

VtkOutput writes a folder of numbered files. With `write_deformed_configuration = false`, the default, the
points rest; with true the points move, and the field DISPLACEMENT is there too.
"""

import os
import shutil
import sys
from pathlib import Path

import KratosMultiphysics as Kratos
import KratosMultiphysics.StructuralMechanicsApplication as Structural
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import integrate_cells  # noqa: E402

# One hexahedron, two wedges and six tetrahedra of a unit cube, with corners by number 4 x + 2 y + z.
SPLITS = {
    "hexahedron": [[0, 4, 6, 2, 1, 5, 7, 3]],
    "wedge": [[0, 4, 2, 1, 5, 3], [4, 6, 2, 5, 7, 3]],
    "tetrahedron": [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]],
}
ELEMENTS = {8: "TotalLagrangianElement3D8N", 6: "TotalLagrangianElement3D6N", 4: "TotalLagrangianElement3D4N"}


def make_cells():
    """Return the points of three bars, their shifts, and the cells of each kind."""
    grid = np.array([(x, y, z) for x in range(3) for y in range(2) for z in range(2)], dtype=float)
    cells = {}
    for bar, (kind, split) in enumerate(SPLITS.items()):
        corners = [[12 * bar + 4 * i + c for c in range(8)] for i in range(2)]
        cells[kind] = [[cube[c] for c in cell] for cube in corners for cell in split]
    shifts = np.repeat([[0.0, 0, 0], [0, 0, 3], [0, 0, 6]], len(grid), axis=0)
    return np.tile(grid, (3, 1)), shifts, cells


def make_solver(points, shifts, cells):
    """Return the model, its part and a strategy of Newton's method."""
    model = Kratos.Model()
    part = model.CreateModelPart("Structure", 2)
    part.ProcessInfo[Kratos.DOMAIN_SIZE] = 3
    for variable in (Kratos.DISPLACEMENT, Kratos.REACTION, Kratos.VOLUME_ACCELERATION):
        part.AddNodalSolutionStepVariable(variable)
    properties = part.CreateNewProperties(1)
    properties[Kratos.YOUNG_MODULUS], properties[Kratos.POISSON_RATIO] = 10.0, 0.3
    properties[Kratos.DENSITY] = 1.0
    properties[Kratos.CONSTITUTIVE_LAW] = Structural.LinearElastic3DLaw()
    for i, (x, y, z) in enumerate(points + shifts):
        part.CreateNewNode(i + 1, x, y, z)
    rows = [cell for kind in cells.values() for cell in kind]
    for k, cell in enumerate(rows):
        part.CreateNewElement(ELEMENTS[len(cell)], k + 1, [c + 1 for c in cell], properties)
    for axis in "XYZ":
        dof, reaction = (Kratos.KratosGlobals.GetVariable(f"{name}_{axis}") for name in ("DISPLACEMENT", "REACTION"))
        Kratos.VariableUtils().AddDof(dof, reaction, part)
    scheme = Kratos.ResidualBasedIncrementalUpdateStaticScheme()
    criterion = Kratos.ResidualCriteria(1e-10, 1e-12)
    builder = Kratos.ResidualBasedBlockBuilderAndSolver(Kratos.SkylineLUFactorizationSolver())
    strategy = Kratos.ResidualBasedNewtonRaphsonStrategy(part, scheme, criterion, builder, 30, True, False, True)
    strategy.SetEchoLevel(0)
    return model, part, strategy


def hold_ends(part, points, t):
    """Move the two ends of the bars to where they are at time t."""
    u = move_bar(points, t) - points
    for i in np.flatnonzero((points[:, 0] == 0) | (points[:, 0] == 2)):
        node = part.GetNode(int(i) + 1)
        for axis, value in zip("XYZ", u[i], strict=True):
            variable = Kratos.KratosGlobals.GetVariable(f"DISPLACEMENT_{axis}")
            node.Fix(variable)
            node.SetSolutionStepValue(variable, value)


def main():
    Kratos.Logger.GetDefaultOutput().SetSeverity(Kratos.Logger.Severity.WARNING)
    os.chdir(HERE)
    points, shifts, cells = make_cells()
    _model, part, strategy = make_solver(points, shifts, cells)
    outputs = []
    for name, deformed in (("rest_points", False), ("moving_points", True)):
        shutil.rmtree(name, ignore_errors=True)
        settings = Kratos.Parameters("{}")
        settings.AddString("model_part_name", "Structure")
        settings.AddString("file_format", "ascii" if deformed else "binary")
        settings.AddString("output_path", name)
        settings.AddBool("write_deformed_configuration", deformed)
        settings.AddBool("output_sub_model_parts", False)
        settings.AddInt("output_precision", 12)
        settings.AddStringArray("nodal_solution_step_data_variables", ["DISPLACEMENT"])
        outputs.append(Kratos.VtkOutput(part, settings))
    volumes, means = [], []
    for step, t in enumerate(TIMES):
        part.CloneTimeStep(t)
        part.ProcessInfo[Kratos.STEP] = step
        hold_ends(part, points, t)
        strategy.Solve()
        for output in outputs:
            output.PrintOutput()
        X = np.array([[node.X0, node.Y0, node.Z0] for node in part.Nodes])
        u = np.array([list(node.GetSolutionStepValue(Kratos.DISPLACEMENT)) for node in part.Nodes])
        parts = [integrate_cells(kind, X, X + u, np.array(rows)) for kind, rows in cells.items()]
        rest, volume, mean = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        volumes.append(volume)
        means.append(mean)
    centers = [(points + shifts)[cell].mean(axis=0) for kind in cells.values() for cell in kind]
    program = f"Kratos {Kratos.Kernel.Version()}"
    write_expected(
        HERE,
        *(make_expectation(program, name, range(len(TIMES)), centers=centers, rest_volumes=rest, volumes=volumes,
                           gradients=means, accuracy=2e-6) for name in ("rest_points", "moving_points")),
    )  # fmt: skip


if __name__ == "__main__":
    main()
