"""Exodus files by exovista 1.3: blocks of several kinds of cells; displacements as disp_x, disp_y, disp_z.

    pip install exovista;  python make.py

MOOSE and SIERRA name their displacements like this. The motion is imposed.
"""

import sys
from importlib.metadata import version
from pathlib import Path

import exovista
import numpy as np
import pyvista as pv

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import CUBE, CUBE_EDGES, SIMPLEX_EDGES, integrate_cells, with_midpoints  # noqa: E402

WEDGES = [CUBE[[0, 1, 3, 4, 5, 7]], CUBE[[1, 2, 3, 5, 6, 7]]]
TETRAHEDRA = [CUBE[[0, a, b, 6]] for a, b in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))]
LINEAR = [("hexahedron", [CUBE], 12, 8), ("wedge", WEDGES, 13, 6), ("tetrahedron", TETRAHEDRA, 10, 4)]
QUADRATIC = [
    ("hexahedron_20", [with_midpoints(CUBE, CUBE_EDGES)], 25, 8),
    ("tetrahedron_10", [with_midpoints(c, SIMPLEX_EDGES) for c in TETRAHEDRA], 24, 4),
]


def write_linear(path, X, cells, types, blocks, fields):
    grid = pv.UnstructuredGrid(np.concatenate([[len(c), *c] for c in cells]), types, X)
    grid.cell_data["region"] = np.array(blocks)
    exovista.write_exo(str(path), grid, times=np.array(TIMES), node_fields=fields, save_node_arrays=False)


def write_quadratic(path, X, cells, blocks, fields):
    """Write quadratic cells by exovista's lower calls; in Exodus' order vertical edges come before the top's."""
    order = [*range(12), 16, 17, 18, 19, 12, 13, 14, 15]
    with exovista.ExodusIIFile(str(path), mode="w") as file:
        file.put_init(title="bar", num_dim=3, num_nodes=len(X), num_elem=len(cells), num_elem_blk=max(blocks) + 1,
                      num_side_sets=0, num_node_sets=0)  # fmt: skip
        file.put_coords(X)
        for block in range(max(blocks) + 1):
            rows = np.array([c for c, b in zip(cells, blocks, strict=True) if b == block]) + 1
            kind = "HEX20" if rows.shape[1] == 20 else "TETRA10"
            rows = rows[:, order] if kind == "HEX20" else rows
            file.put_element_block(
                block + 1, elem_type=kind, num_block_elems=len(rows), num_nodes_per_elem=rows.shape[1]
            )
            file.put_element_conn(block + 1, rows)
        for step, t in enumerate(TIMES):
            file.put_time(step + 1, t)
        file.put_node_variable_params(3)
        file.put_node_variable_names(list(fields))
        for name, values in fields.items():
            for step in range(len(TIMES)):
                file.put_node_variable_values(step + 1, name, values[step])


def run(name, kinds):
    """Write one file: each kind of cell fills one unit cube of a bar."""
    numbers, cells, types, blocks, centers = {}, [], [], [], []
    for block, (_, pieces, vtk, corners) in enumerate(kinds):
        for piece in pieces:
            # The motion is for x up to 2, so the cubes of three kinds are 2/3 long.
            points = (piece + np.array([block, 0, 0])) * np.array([2 / len(kinds), 1, 1])
            cells.append([numbers.setdefault(tuple(np.round(p, 9)), len(numbers)) for p in points])
            centers.append(points[:corners].mean(axis=0))
            types.append(vtk)
            blocks.append(block)
    X = np.array(list(numbers))
    moved = [move_bar(X, t) for t in TIMES]
    fields = {f"disp_{axis}": np.array([x[:, a] - X[:, a] for x in moved]) for a, axis in enumerate("xyz")}
    if kinds is QUADRATIC:
        write_quadratic(HERE / name, X, cells, blocks, fields)
    else:
        write_linear(HERE / name, X, cells, types, blocks, fields)
    results = []
    for x in moved:
        parts = []
        for block, (shape, *_) in enumerate(kinds):
            rows = np.array([c for c, b in zip(cells, blocks, strict=True) if b == block])
            parts.append(integrate_cells(shape, X, x, rows))
        results.append([np.concatenate(arrays) for arrays in zip(*parts, strict=True)])
    return make_expectation(f"exovista {version('exovista')}", name, TIMES, centers=centers, rest_volumes=results[0][0],
                            volumes=[r[1] for r in results], gradients=[r[2] for r in results],
                            accuracy=1e-6)  # fmt: skip


if __name__ == "__main__":
    write_expected(HERE, run("linear.e", LINEAR), run("quadratic.exo", QUADRATIC))
