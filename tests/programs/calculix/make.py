"""Files of CalculiX ccx 2.20: bars of four kinds of cells with large displacements (NLGEOM); .frd, ASCII and binary.

    apt install calculix-ccx;  python3 make.py

The displacements for the expected values are those of the .dat file (*NODE PRINT), not of the .frd.
"""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))
from expected import TIMES, make_expectation, move_bar, write_expected  # noqa: E402
from quadrature import CUBE, CUBE_EDGES, PRISM, SIMPLEX, SIMPLEX_EDGES, integrate_cells, with_midpoints  # noqa: E402

# One unit cube cut into cells, by corners in (x, y, z); Abaqus' order of nodes.
WEDGES = [CUBE[[0, 1, 3, 4, 5, 7]], CUBE[[1, 2, 3, 5, 6, 7]]]
TETRAHEDRA = [CUBE[[0, a, b, 6]] for a, b in ((1, 2), (2, 3), (3, 7), (7, 4), (4, 5), (5, 1))]
PRISM_ORDER = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)]
KINDS = {
    "C3D8": ("hexahedron", [CUBE]),
    "C3D20": ("hexahedron_20", [with_midpoints(CUBE, CUBE_EDGES)]),
    "C3D10": ("tetrahedron_10", [with_midpoints(c, SIMPLEX_EDGES) for c in TETRAHEDRA]),
    "C3D15": ("wedge_15", [with_midpoints(c, PRISM_ORDER) for c in WEDGES]),
    "C3D6": ("wedge", WEDGES),
    "C3D4": ("tetrahedron", TETRAHEDRA),
}
assert len(PRISM) == 6 and len(SIMPLEX) == 4


def make_mesh(pieces):
    """Return points (n, 3) and cells of two unit cubes side by side, cut into the pieces."""
    numbers, cells = {}, []
    for shift in (0.0, 1.0):
        for piece in pieces:
            cells.append([numbers.setdefault(tuple(p), len(numbers)) for p in piece + np.array([shift, 0, 0])])
    return np.array(list(numbers)), np.array(cells)


def write_deck(path, kind, points, cells, binary):
    """Write a deck with one static step for each time but 0, both ends held at the places of the motion."""
    ends = np.flatnonzero((points[:, 0] == 0) | (points[:, 0] == 2))
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{i + 1}, {p[0]:.9g}, {p[1]:.9g}, {p[2]:.9g}" for i, p in enumerate(points)]
    lines.append(f"*ELEMENT, TYPE={kind}, ELSET=BAR")
    for k, cell in enumerate(cells):
        row = [str(n) for n in (k + 1, *(cell + 1))]
        lines.append(", ".join(row[:11]) + ("," if len(row) > 11 else ""))
        lines += [", ".join(row[11:])] if len(row) > 11 else []
    lines += ["*MATERIAL, NAME=SOFT", "*ELASTIC", "10.0, 0.3", "*SOLID SECTION, ELSET=BAR, MATERIAL=SOFT"]
    for t in TIMES[1:]:
        u = move_bar(points, t) - points
        length = t - TIMES[TIMES.index(t) - 1]
        lines += ["*STEP, NLGEOM, INC=100", "*STATIC", f"{length:g}, {length:g}", "*BOUNDARY"]
        lines += [f"{i + 1}, {a + 1}, {a + 1}, {u[i, a]:.12g}" for i in ends for a in range(3)]
        words = ("*NODE OUTPUT", "*ELEMENT OUTPUT") if binary else ("*NODE FILE", "*EL FILE")
        lines += [words[0], "U, RF", words[1], "S"] if kind == "C3D20" else [words[0], "U"]
        lines += ["*NODE PRINT, NSET=ALL", "U", "*END STEP"]
    path.write_text("\n".join(lines) + "\n")


def read_displacements(path, count):
    """Return the displacements (step, n, 3) that the .dat file prints."""
    rows = [line.split() for line in path.read_text().splitlines() if re.match(r"\s+\d+\s+-?\d\.", line)]
    values = np.array([[float(v) for v in row[1:4]] for row in rows])
    return values.reshape(-1, count, 3)


def main():
    entries = []
    for kind, (shape, pieces) in KINDS.items():
        points, cells = make_mesh(pieces)
        for binary in (False, True) if kind == "C3D20" else (False,):
            name = kind.lower() + ("_binary" if binary else "")
            with tempfile.TemporaryDirectory() as folder:
                write_deck(Path(folder) / f"{name}.inp", kind, points, cells, binary)
                run = subprocess.run(["ccx", name], cwd=folder, capture_output=True, text=True, env={**os.environ})
                if not (Path(folder) / f"{name}.frd").exists() or "*ERROR" in run.stdout:
                    raise SystemExit(run.stdout[-3000:])
                (HERE / f"{name}.frd").write_bytes((Path(folder) / f"{name}.frd").read_bytes())
                moved = read_displacements(Path(folder) / f"{name}.dat", len(points))
            results = [integrate_cells(shape, points, points + u, cells) for u in moved]
            corners = {"h": 8, "w": 6, "t": 4}[shape[0]]
            entries.append(
                make_expectation(
                    "CalculiX 2.20",
                    f"{name}.frd",
                    TIMES[1:],
                    centers=points[cells[:, :corners]].mean(axis=1),
                    rest_volumes=results[0][0],
                    volumes=[r[1] for r in results],
                    gradients=[r[2] for r in results],
                    accuracy=5e-5,
                )
            )
    write_expected(HERE, *entries)


if __name__ == "__main__":
    main()
