"""Files of OpenGeoSys 6.5: a bar of linear elasticity, its ends held and moved; .pvd with .vtu, and .xdmf with .h5.

pip install ogs meshio;  python make.py
"""

import os
import shutil
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import h5py
import meshio
import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import CUBE, CUBE_EDGES, integrate_cells, with_midpoints  # noqa: E402

TETRAHEDRA = [CUBE[[0, a, b, 6]] for a, b in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))]
# The ends are moved in a straight line to their places at t = 1, so the motion is proportional to t.
PROJECT = """<?xml version="1.0" encoding="ISO-8859-1"?>
<OpenGeoSysProject>
  <meshes><mesh>bar.vtu</mesh><mesh>left.vtu</mesh><mesh>right.vtu</mesh></meshes>
  <processes><process>
    <name>solid</name><type>SMALL_DEFORMATION</type><integration_order>3</integration_order>
    <constitutive_relation><type>LinearElasticIsotropic</type><youngs_modulus>E</youngs_modulus>
      <poissons_ratio>nu</poissons_ratio></constitutive_relation>
    <process_variables><process_variable>displacement</process_variable></process_variables>
    <secondary_variables><secondary_variable name="sigma"/></secondary_variables>
    <specific_body_force>0 0 0</specific_body_force>
  </process></processes>
  <media><medium><phases><phase><type>Solid</type><properties><property><name>density</name><type>Constant</type>
    <value>1</value></property></properties></phase></phases></medium></media>
  <time_loop><processes><process ref="solid"><nonlinear_solver>newton</nonlinear_solver>
    <convergence_criterion><type>DeltaX</type><norm_type>NORM2</norm_type><abstol>1e-12</abstol></convergence_criterion>
    <time_discretization><type>BackwardEuler</type></time_discretization>
    <time_stepping><type>FixedTimeStepping</type><t_initial>0</t_initial><t_end>1</t_end>
      <timesteps><pair><repeat>3</repeat><delta_t>0.3333333333333333</delta_t></pair></timesteps></time_stepping>
    </process></processes>
    <output><type>{type}</type><prefix>{name}</prefix><timesteps><pair><repeat>1</repeat><each_steps>1</each_steps></pair>
      </timesteps><variables><variable>displacement</variable></variables><suffix>_{{:timestep}}</suffix></output>
  </time_loop>
  <parameters>
    <parameter><name>E</name><type>Constant</type><value>10</value></parameter>
    <parameter><name>nu</name><type>Constant</type><value>0.3</value></parameter>
    <parameter><name>zero</name><type>Constant</type><values>0 0 0</values></parameter>
    <parameter><name>fixed</name><type>Constant</type><value>0</value></parameter>
    {end}
  </parameters>
  <curves><curve><name>ramp</name><coords>0 1</coords><values>0 1</values></curve></curves>
  <process_variables><process_variable><name>displacement</name><components>3</components><order>{order}</order>
    <initial_condition>zero</initial_condition><boundary_conditions>{conditions}</boundary_conditions>
  </process_variable></process_variables>
  <nonlinear_solvers><nonlinear_solver><name>newton</name><type>Newton</type><max_iter>20</max_iter>
    <linear_solver>direct</linear_solver></nonlinear_solver></nonlinear_solvers>
  <linear_solvers><linear_solver><name>direct</name><eigen><solver_type>SparseLU</solver_type></eigen></linear_solver>
  </linear_solvers>
</OpenGeoSysProject>
"""


def make_mesh(pieces):
    """Return points (n, 3) and cells of two unit cubes side by side, cut into the pieces."""
    numbers, cells = {}, []
    for shift in (0.0, 1.0):
        for piece in pieces:
            cells.append([numbers.setdefault(tuple(p), len(numbers)) for p in piece + np.array([shift, 0, 0])])
    return np.array(list(numbers)), np.array(cells)


def write_meshes(folder, kind, points, cells):
    """Write the bar and its two ends as OpenGeoSys reads them."""
    material = {"MaterialIDs": [np.zeros(len(cells), dtype=np.int32)]}
    meshio.write(folder / "bar.vtu", meshio.Mesh(points, [(kind, cells)], cell_data=material))
    for name, x in (("left", 0.0), ("right", 2.0)):
        numbers = np.flatnonzero(points[:, 0] == x)
        u = move_bar(points[numbers], 1.0) - points[numbers]
        data = {"bulk_node_ids": numbers.astype(np.uint64), **{f"u{a}": u[:, a] for a in range(3)}}
        vertices = [("vertex", np.arange(len(numbers))[:, None])]
        bulk = {"bulk_element_ids": [np.zeros(len(numbers), dtype=np.uint64)]}
        meshio.write(folder / f"{name}.vtu", meshio.Mesh(points[numbers], vertices, point_data=data, cell_data=bulk))


def write_project(folder, name, order, output):
    end = "".join(
        f"<parameter><name>end{a}</name><type>MeshNode</type><mesh>right</mesh><field_name>u{a}</field_name></parameter>"
        f"<parameter><name>now{a}</name><type>CurveScaled</type><curve>ramp</curve><parameter>end{a}</parameter>"
        "</parameter>"
        for a in range(3)
    )
    conditions = "".join(
        f"<boundary_condition><mesh>{mesh}</mesh><type>Dirichlet</type><component>{a}</component>"
        f"<parameter>{parameter}</parameter></boundary_condition>"
        for a in range(3)
        for mesh, parameter in (("left", "fixed"), ("right", f"now{a}"))
    )
    text = PROJECT.format(type=output, name=name, order=order, end=end, conditions=conditions)
    (folder / "bar.prj").write_text(text)


def read_last(folder, name, output):
    """Return the displacements (n, 3) at t = 1 from OpenGeoSys' files, read by meshio or h5py."""
    if output == "VTK":
        last = sorted(folder.glob(f"{name}_*.vtu"), key=lambda path: path.stat().st_mtime)[-1]
        return meshio.read(last).point_data["displacement"]
    with h5py.File(next(folder.glob(f"{name}*.h5"))) as file:
        mesh = next(iter(file["meshes"].values()))
        return mesh["displacement"][-1]


def main():
    entries = []
    for name, kind, shape, pieces, output in (
        ("hexahedra", "hexahedron20", "hexahedron_20", [with_midpoints(CUBE, CUBE_EDGES)], "VTK"),
        ("tetrahedra", "tetra", "tetrahedron", TETRAHEDRA, "XDMF"),
    ):
        points, cells = make_mesh(pieces)
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            write_meshes(folder, kind, points, cells)
            write_project(folder, name, 2 if "20" in kind else 1, output)
            command = [str(Path(sys.executable).parent / "ogs"), "bar.prj"]
            run = subprocess.run(command, cwd=folder, capture_output=True, text=True, env={**os.environ})
            if run.returncode:
                raise SystemExit(run.stdout[-3000:] + run.stderr[-3000:])
            for file in folder.glob(f"{name}*"):
                shutil.copy(file, HERE)
            last = read_last(folder, name, output)
        times = np.arange(4) / 3
        results = [integrate_cells(shape, points, points + t * last, cells) for t in times]
        entries.append(
            make_expectation(
                f"OpenGeoSys {version('ogs')}",
                next(f.name for f in HERE.glob(f"{name}*") if f.suffix in (".pvd", ".xdmf")),
                times,
                centers=points[cells[:, : 8 if "hex" in kind else 4]].mean(axis=1),
                rest_volumes=results[0][0],
                volumes=[r[1] for r in results],
                gradients=[r[2] for r in results],
            )
        )
    write_expected(HERE, *entries)


if __name__ == "__main__":
    main()
