"""Files of SfePy 2026: a hyperelastic bar of hexahedra (total Lagrangian), stretched and twisted; .vtk.

    pip install sfepy;  python make.py

The loop over times writes a numbered .vtk a step; SfePy writes no times into them.
"""

import os
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
from sfepy.applications import solve_pde
from sfepy.base.base import output
from sfepy.base.conf import ProblemConf
from sfepy.mesh.mesh_generators import gen_block_mesh

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import integrate_cells  # noqa: E402

STATES = []


def hold_end(ts, coordinates, **kwargs):
    return move_bar(coordinates, ts.time) - coordinates


def record(out, problem, state, extend=False):
    STATES.append(np.array(out["u"].data))
    return out


def make_problem(mesh, folder):
    return ProblemConf.from_dict(
        {
            "filename_mesh": mesh,
            "options": {"nls": "newton", "ls": "ls", "ts": "ts", "save_times": "all", "output_dir": folder,
                        "post_process_hook": record, "output_format": "vtk"},
            "fields": {"displacement": ("real", 3, "Omega", 1)},
            "materials": {"solid": ({"K": 10.0, "mu": 5.0},)},
            "variables": {"u": ("unknown field", "displacement", 0), "v": ("test field", "displacement", "u")},
            "regions": {"Omega": "all", "Left": ("vertices in (x < 0.001)", "facet"),
                        "Right": ("vertices in (x > 1.999)", "facet")},
            "ebcs": {"l": ("Left", {"u.all": 0.0}), "r": ("Right", {"u.all": "hold_end"})},
            "functions": {"hold_end": (hold_end,)},
            "integrals": {"i": 3},
            "equations": {"balance": "dw_tl_he_neohook.i.Omega(solid.mu, v, u) "
                          "+ dw_tl_bulk_penalty.i.Omega(solid.K, v, u) = 0"},
            "solvers": {"ls": ("ls.scipy_direct", {}),
                        "newton": ("nls.newton", {"i_max": 25, "eps_a": 1e-10, "eps_r": 1e-12}),
                        "ts": ("ts.simple", {"t0": 0.0, "t1": 1.0, "n_step": 4})},
        },
        sys.modules[__name__],
    )  # fmt: skip


def main():
    output.set_output(quiet=True)
    mesh = gen_block_mesh([2.0, 1.0, 1.0], [4, 3, 3], [1.0, 0.5, 0.5], name="bar", verbose=False)
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "bar.vtk")
        mesh.write(path, io="auto")
        results = os.path.join(folder, "results")
        solve_pde(make_problem(path, results))
        for file in sorted(Path(results).glob("*.vtk")):
            (HERE / file.name).write_bytes(file.read_bytes())
    X, cells = mesh.coors, mesh.get_conn("3_8")
    parts = [integrate_cells("hexahedron", X, X + u, cells) for u in STATES]
    write_expected(
        HERE,
        make_expectation(f"SfePy {version('sfepy')}", "bar.*.vtk", range(len(STATES)), centers=X[cells].mean(axis=1),
                         rest_volumes=parts[0][0], volumes=[p[1] for p in parts], gradients=[p[2] for p in parts],
                         accuracy=1e-6),
    )  # fmt: skip


if __name__ == "__main__":
    main()
