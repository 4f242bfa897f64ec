"""Bodies in several files or orders: parts, pieces of ranks with overlaps, permuted cells, other meshes."""

from pathlib import Path

import numpy as np

from tests.foreign.displacements import CELLS, LONG_CELLS, LONG_POINTS, POINTS
from tests.foreign.writers import STRETCHES, bar, index, plate, quadratic, split, stretch, write_pvd, write_vtu


def numbered_parts(folder: Path) -> None:
    """Parts 0 and 1 at every time, the halves of the bar."""
    rows = []
    for k, s in enumerate(STRETCHES):
        for r, cells in enumerate((CELLS[:6], CELLS[6:])):
            used, local = split(cells)
            u = (stretch(POINTS, s) - POINTS)[used]
            write_vtu(folder / f"f_{k}_{r}.vtu", POINTS[used], [(10, local)], {"u": u})
            rows.append({"timestep": 0.1 * k, "part": r, "file": f"f_{k}_{r}.vtu"})
    write_pvd(folder / "s.pvd", rows)


def unnumbered_parts(folder: Path) -> None:
    """Two files at every time, without `part` or with part="0" in both; only the first half is stretched."""
    rows, zeros = [], []
    for k, s in enumerate(STRETCHES):
        for name, cells, factor in (("a", CELLS[:6], s), ("b", CELLS[6:], 1.0)):
            used, local = split(cells)
            u = (stretch(POINTS, factor) - POINTS)[used]
            write_vtu(folder / f"{name}_{k}.vtu", POINTS[used], [(10, local)], {"displacement": u})
            rows.append({"timestep": 0.1 * k, "group": "", "file": f"{name}_{k}.vtu"})
            zeros.append({"timestep": 0.1 * k, "group": name, "part": 0, "file": f"{name}_{k}.vtu"})
    write_pvd(folder / "nopart.pvd", rows)
    write_pvd(folder / "part0.pvd", zeros)


def overlaps(folder: Path) -> None:
    """Two ranks overlap by six cells: marked by vtkGhostType (a), by ghostRank as GEOS does (b), or not at all (c)."""
    marks = {"a": '<PDataArray type="UInt8" Name="vtkGhostType"/>', "b": '<PDataArray type="Int32" Name="ghostRank"/>'}
    for k, s in enumerate(STRETCHES):
        for r, (first, last) in enumerate(((0, 12), (6, 18))):
            used, local = split(LONG_CELLS[first:last])
            ghost = np.arange(first, last) < (12 if r else 0)
            u = {"u": (stretch(LONG_POINTS, s) - LONG_POINTS)[used]}
            fields = {
                "a": {"vtkGhostType": ghost.astype(np.uint8)},
                "b": {"ghostRank": np.where(ghost, 0, -1).astype(np.int32)},
                "c": {},
            }
            for name, cell_data in fields.items():
                write_vtu(folder / f"{name}_{k}_{r}.vtu", LONG_POINTS[used], [(10, local)], u, cell_data)
        for name in "abc":
            write_pvtu(folder / f"{name}_{k}.pvtu", [f"{name}_{k}_{r}.vtu" for r in range(2)], marks.get(name, ""))
    for name in "abc":
        index(folder, name, name + "_{}.pvtu")


def missing_piece(folder: Path) -> None:
    """The pieces of one rank are missing."""
    used, local = split(CELLS[:6])
    for k, s in enumerate(STRETCHES):
        u = (stretch(POINTS, s) - POINTS)[used]
        write_vtu(folder / f"u_p0_{k}.vtu", POINTS[used], [(10, local)], {"u": u})
        write_pvtu(folder / f"u_{k}.pvtu", [f"u_p{r}_{k}.vtu" for r in range(2)])
    index(folder, "u", "u_{}.pvtu")


def write_pvtu(path: Path, pieces: list[str], cell_arrays: str = "") -> None:
    """Write the parallel file of pieces with the point field u."""
    sources = "".join(f'<Piece Source="{name}"/>\n' for name in pieces)
    path.write_text(
        '<?xml version="1.0"?>\n<VTKFile type="PUnstructuredGrid" version="1.0">\n<PUnstructuredGrid GhostLevel="0">\n'
        '<PPointData><PDataArray type="Float64" Name="u" NumberOfComponents="3"/></PPointData>\n'
        f"<PCellData>{cell_arrays}</PCellData>\n"
        f'<PPoints><PDataArray type="Float64" NumberOfComponents="3"/></PPoints>\n{sources}'
        "</PUnstructuredGrid>\n</VTKFile>\n"
    )


def permuted_cells(folder: Path) -> None:
    """Every cell has points of its own, and the middle frame has the cells in another order (GEOS)."""
    points, cells = bar((4, 1, 1), (4.0, 1.0, 1.0))
    points[:, 0] **= 1.5  # cells of different size
    own = np.arange(4 * len(cells)).reshape(-1, 4)
    for k, s in enumerate(STRETCHES):
        order = np.roll(np.arange(len(cells)), len(cells) // 2 if k == 1 else 0)
        x = stretch(points, s)[cells[order]].reshape(-1, 3)
        write_vtu(folder / f"f_{k}.vtu", x, [(10, own)], {}, {"localToGlobalMap": order.astype(np.int64)})
    index(folder)


def different_bodies(folder: Path) -> None:
    """Three series with equal connectivity: a bar in m, the same in mm, and another body."""
    other = bar((1, 2, 1), (1.0, 2.0, 1.0))
    for name, factor, (points, cells) in (("m", 1.0, bar()), ("mm", 1000.0, bar()), ("other", 1.0, other)):
        X, own = factor * points[cells].reshape(-1, 3), np.arange(4 * len(cells)).reshape(-1, 4)
        for k, s in enumerate(STRETCHES):
            write_vtu(folder / name / f"f_{k}.vtu", X, [(10, own)], {"displacement": stretch(X, s) - X})
        index(folder / name)


def remeshed(folder: Path) -> None:
    """The last frame has more cells."""
    for k, counts in enumerate([(2, 1, 1), (2, 1, 1), (3, 1, 1)]):
        points, cells = bar(counts)
        write_vtu(folder / f"f_{k}.vtu", stretch(points, 1 + 0.1 * k), [(10, cells)])
    index(folder)


# Kinds of cells


def lagrange_of_order_1(folder: Path) -> None:
    """Kind 71 with four nodes, as dolfinx and Firedrake write linear tetrahedra; kind 69 with three."""
    points, triangles = plate()
    for k, s in enumerate(STRETCHES):
        write_vtu(folder / f"u_{k:06d}.vtu", POINTS, [(71, CELLS)], {"u": stretch(POINTS, s) - POINTS})
        write_vtu(folder / f"t_{k:06d}.vtu", points, [(69, triangles)], {"u": stretch(points, s) - points})
    index(folder, "u", "u_{:06d}.vtu")
    index(folder, "t", "t_{:06d}.vtu")


def mixed_orientation(folder: Path) -> None:
    """Corners sorted by number (legacy FEniCS, scikit-fem): half of the cells are mirrored, the body is valid."""
    points, triangles = plate()
    for k, s in enumerate(STRETCHES):
        u, v = stretch(POINTS, s) - POINTS, stretch(points, s) - points
        write_vtu(folder / f"f_{k}.vtu", POINTS, [(10, np.sort(CELLS, axis=1))], {"displacement": u})
        write_vtu(folder / f"g_{k}.vtu", points, [(5, np.sort(triangles, axis=1))], {"u": v})
    index(folder, "f")
    index(folder, "g", "g_{}.vtu")


def tetrahedra_and_hexahedra(folder: Path) -> None:
    """One hexahedron beside six tetrahedra."""
    hexahedron = np.array([[0, 4, 6, 2, 1, 5, 7, 3]])
    for k, s in enumerate(STRETCHES):
        blocks = [(12, hexahedron), (10, CELLS[6:])]
        write_vtu(folder / f"f_{k}.vtu", POINTS, blocks, {"u": stretch(POINTS, s) - POINTS})
    index(folder)


def quadratic_tetrahedra(folder: Path) -> None:
    """Tetrahedra with ten nodes."""
    points, cells = quadratic(POINTS, CELLS)
    for k, s in enumerate(STRETCHES):
        write_vtu(folder / f"q_{k}.vtu", points, [(24, cells)], {"u": stretch(points, s) - points})
    index(folder, pattern="q_{}.vtu")


def vertical_plane(folder: Path) -> None:
    """Triangles in the plane y = 0."""
    points, triangles = plate()
    X = points[:, [0, 2, 1]]
    for k, s in enumerate(STRETCHES):
        write_vtu(folder / f"f_{k}.vtu", X, [(5, triangles)], {"displacement": stretch(X, s) - X})
    index(folder)
