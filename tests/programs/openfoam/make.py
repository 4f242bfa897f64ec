"""Files of OpenFOAM 1912 (Debian): a box, twisted by moveDynamicMesh; the case, and by foamToVTK and foamToEnsight.

    apt install openfoam openmpi-bin;  python3 make.py

And solidDisplacementFoam, whose only displacement is the field D, small and at cells.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import make_expectation, make_note, write_expected  # noqa: E402
from quadrature import integrate_cells  # noqa: E402

N = (4, 2, 2)
TIMES = (0.0, 0.25, 0.5, 1.0)
HEADER = "FoamFile {{ version 2.0; format ascii; class {kind}; object {name}; }}\n"
SCHEMES = """ddtSchemes {{ default {ddt}; }} d2dt2Schemes {{ default steadyState; }}
gradSchemes {{ default leastSquares; }}
divSchemes {{ default none; div(sigmaD) Gauss linear; }} interpolationSchemes {{ default linear; }}
laplacianSchemes {{ default Gauss linear corrected; }} snGradSchemes {{ default corrected; }}
"""
CONTROL = """application {program}; startFrom startTime; startTime 0; stopAt endTime; endTime 1; deltaT {step};
writeControl {control}; writeInterval {step}; writeFormat ascii; writePrecision 12; timeFormat general; timePrecision 6;
writeCompression off; runTimeModifiable no;
"""
BOX = f"""scale 1; vertices ((0 0 0) (2 0 0) (2 1 0) (0 1 0) (0 0 1) (2 0 1) (2 1 1) (0 1 1));
blocks (hex (0 1 2 3 4 5 6 7) ({N[0]} {N[1]} {N[2]}) simpleGrading (1 1 1)); edges ();
boundary (left {{ type patch; faces ((0 4 7 3)); }} right {{ type patch; faces ((1 2 6 5)); }}
sides {{ type patch; faces ((0 1 5 4) (3 7 6 2) (0 3 2 1) (4 5 6 7)); }}); mergePatchPairs ();
"""
MOTION = {
    "system/controlDict": CONTROL.format(program="moveDynamicMesh", step=0.25, control="runTime"),
    "system/fvSchemes": SCHEMES.format(ddt="Euler"),
    "system/fvSolution": 'solvers { "cellDisplacement.*" '
    "{ solver PCG; preconditioner DIC; tolerance 1e-12; relTol 0; } }\n",
    "system/blockMeshDict": BOX,
    "constant/dynamicMeshDict": "dynamicFvMesh dynamicMotionSolverFvMesh; motionSolverLibs (fvMotionSolvers);\n"
    "motionSolver displacementLaplacian; displacementLaplacianCoeffs { diffusivity uniform; }\n",
    "0/pointDisplacement": "dimensions [0 1 0 0 0 0 0]; internalField uniform (0 0 0);\n"
    "boundaryField { left { type fixedValue; value uniform (0 0 0); } sides { type zeroGradient; }\n"
    "right { type angularOscillatingDisplacement; axis (1 0 0); origin (2 0.5 0.5); angle0 0; amplitude 1;\n"
    "omega 1.5707963267948966; value uniform (0 0 0); } }\n",
}
SOLID = {
    "system/controlDict": CONTROL.format(program="solidDisplacementFoam", step=0.5, control="runTime"),
    "system/fvSchemes": SCHEMES.format(ddt="steadyState"),
    "system/fvSolution": 'solvers { "(D|T)" { solver PCG; preconditioner DIC; tolerance 1e-10; relTol 0.1; } }\n'
    "stressAnalysis { compactNormalStress yes; nCorrectors 50; D 1e-9; }\n",
    "system/blockMeshDict": BOX,
    "constant/mechanicalProperties": "rho { type uniform; value 1000; } nu { type uniform; value 0.3; }\n"
    "E { type uniform; value 1e6; } planeStress no;\n",
    "constant/thermalProperties": "thermalStress no;\n",
    "0/D": "dimensions [0 1 0 0 0 0 0]; internalField uniform (0 0 0);\n"
    "boundaryField { left { type fixedValue; value uniform (0 0 0); }\n"
    "right { type fixedValue; value uniform (0.2 0 0); }\n"
    "sides { type tractionDisplacement; traction uniform (0 0 0); pressure uniform 0; value uniform (0 0 0); } }\n",
}
CLASSES = {"pointDisplacement": "pointVectorField", "D": "volVectorField"}


def write_case(folder, files):
    for path, text in files.items():
        name = Path(path).name
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(HEADER.format(kind=CLASSES.get(name, "dictionary"), name=name) + text)


def run(folder, *commands):
    for command in commands:
        result = subprocess.run(["bash", "-c", f". /usr/share/openfoam/etc/bashrc; {command}"], cwd=folder,
                                capture_output=True, text=True, env={**os.environ})  # fmt: skip
        if result.returncode:
            raise SystemExit(command + result.stdout[-3000:] + result.stderr[-3000:])


def copy_case(case):
    """Copy mesh, motion and fields beside this script, and make the empty file .foam that names the case."""
    unneeded = shutil.ignore_patterns("uniform", "*.obj", "meshPhi", "VTK", "system", "sigma*", "*Properties", "*Zones",
                                      "*ProcAddressing")  # fmt: skip
    shutil.copytree(case, HERE / case.name, ignore=unneeded)
    shutil.copytree(case / "system", HERE / case.name / "system", ignore=shutil.ignore_patterns("fv*", "blockMeshDict"))
    (HERE / case.name / f"{case.name}.foam").touch()


def read_points(path):
    """Return the points (n, 3) of a file polyMesh/points."""
    rows = re.findall(r"^\(([^()]+)\)$", path.read_text(), re.MULTILINE)
    return np.array([row.split() for row in rows], dtype=float)


def read_lists(path):
    """Return the lists of numbers of a file polyMesh/faces, or the numbers of owner and neighbour."""
    text = path.read_text().split("// * *", 1)[1]
    if path.name == "faces":
        return [np.array(row.split(), dtype=int) for row in re.findall(r"^\d+\(([^()]+)\)$", text, re.MULTILINE)]
    return np.array(text[text.index("(") + 1 : text.index(")")].split(), dtype=int)


def read_volumes(path):
    """Return OpenFOAM's own volumes of the cells, from its field V."""
    text = path.read_text()
    return np.array(re.search(r"List<scalar>\s+\d+\s+\(([^()]+)\)", text)[1].split(), dtype=float)


def describe_polyhedra(case, times):
    """Return the entry for the case of polyhedra. Volumes are OpenFOAM's own; there is no F in it."""
    mesh = case / "constant" / "polyMesh"
    X, faces = read_points(mesh / "points"), read_lists(mesh / "faces")
    nodes = {}
    for name in ("owner", "neighbour"):
        for face, cell in zip(faces, read_lists(mesh / name), strict=False):
            nodes.setdefault(int(cell), set()).update(face.tolist())
    volumes = [read_volumes(case / f"{t:g}" / "V") for t in times]
    entry = make_expectation(
        "OpenFOAM 1912",
        "polyhedra/polyhedra.foam",
        times,
        centers=[X[sorted(nodes[cell])].mean(axis=0) for cell in range(len(volumes[0]))],
        rest_volumes=volumes[0],
        volumes=volumes,
        gradients=np.tile(np.eye(3), (len(times), len(volumes[0]), 1, 1)),
        accuracy=1e-4,  # OpenFOAM divides a face that is not plane about another point
    )
    return entry | {"rotation_angle": None}


def make_cells():
    """Return the corners (cell, 8) in the order of blockMesh."""
    nx, ny, nz = N
    number = lambda i, j, k: i + (nx + 1) * (j + (ny + 1) * k)  # noqa: E731
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    return np.array([[number(i + a, j + b, k + c) for a, b, c in corners]
                     for k in range(nz) for j in range(ny) for i in range(nx)])  # fmt: skip


def main():
    for name in ("twist", "vtk", "ensight", "solid", "polyhedra", "decomposed"):
        shutil.rmtree(HERE / name, ignore_errors=True)
    with tempfile.TemporaryDirectory() as temporary:
        case = Path(temporary) / "twist"
        write_case(case, MOTION)
        run(case, "blockMesh", "moveDynamicMesh", "foamToVTK -ascii -no-boundary", "foamToEnsight -ascii -noPatches")
        shutil.move(case / "VTK", HERE / "vtk")
        shutil.move(case / "EnSight", HERE / "ensight")
        copy_case(case)
        case = Path(temporary) / "decomposed"
        write_case(case, MOTION | {"system/decomposeParDict": "numberOfSubdomains 2; method simple;\n"
                                   "simpleCoeffs { n (2 1 1); delta 0.001; }\n"})  # fmt: skip
        run(case, "blockMesh", "decomposePar", "mpirun --allow-run-as-root -n 2 moveDynamicMesh -parallel")
        shutil.rmtree(case / "constant" / "polyMesh")
        copy_case(case)
        case = Path(temporary) / "polyhedra"
        write_case(case, MOTION)
        run(case, "blockMesh", "polyDualMesh 60 -overwrite", "moveDynamicMesh", "postProcess -func writeCellVolumes")
        copy_case(case)
        case = Path(temporary) / "solid"
        write_case(case, SOLID)
        run(case, "blockMesh", "solidDisplacementFoam", "foamToVTK -no-boundary")
        copy_case(case)
    folders = sorted((HERE / "twist").glob("[0-9]*"), key=lambda path: float(path.name))
    times = [float(path.name) for path in folders]
    rest = read_points(HERE / "twist" / "constant" / "polyMesh" / "points")
    cells = make_cells()
    moved = [read_points(f / "polyMesh" / "points") if (f / "polyMesh" / "points").exists() else rest for f in folders]
    results = [integrate_cells("hexahedron", rest, x, cells) for x in moved]
    solid = make_note("OpenFOAM 1912", "solid/solid.foam", r"cell field D\b.*points")
    write_expected(
        HERE,
        solid,
        describe_polyhedra(HERE / "polyhedra", times),
        *(
            make_expectation(
                "OpenFOAM 1912",
                series,
                times,
                centers=rest[cells].mean(axis=1),
                rest_volumes=results[0][0],
                volumes=[r[1] for r in results],
                gradients=[r[2] for r in results],
                accuracy=2e-6 if "foam" in series else 2e-5,  # their other writers give six digits
            )
            for series in (
                "twist/twist.foam",
                "decomposed/decomposed.foam",
                "vtk/twist.vtm.series",
                "ensight/twist.case",
            )
        ),
    )


if __name__ == "__main__":
    main()
