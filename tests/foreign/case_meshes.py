"""Meshes of cases as other programs write them: Abaqus, tetgen, Medit, Nastran, gmsh, and every encoding of .vtu."""

from itertools import product
from pathlib import Path

import numpy as np

from tests.foreign.writers import bar, plate, quadratic, split

POINTS, CELLS = bar((1, 1, 1), (1.0, 1.0, 1.0))
BRICK, BRICK_CELLS = bar((1, 1, 1), (1.0, 2.0, 3.0))  # of volume 6


def _write_nodes(points: np.ndarray, numbers: np.ndarray) -> str:
    return "".join(f"{i}, {x}, {y}, {z}\n" for i, (x, y, z) in zip(numbers.tolist(), points.tolist(), strict=True))


def _write_block(points: np.ndarray, cells: np.ndarray = CELLS, numbers: np.ndarray | None = None) -> str:
    numbers = np.arange(len(points)) + 1 if numbers is None else numbers
    rows = [", ".join(map(str, [i + 1, *row])) for i, row in enumerate(numbers[cells].tolist())]
    return "*Node\n" + _write_nodes(points, numbers) + "*Element, type=C3D4\n" + "\n".join(rows) + "\n"


def abaqus(folder: Path) -> None:
    """Parts and instances that are moved and turned, *SYSTEM, several *NODE blocks, variants of C3D4, *NGEN, gaps."""
    folder.mkdir(parents=True, exist_ok=True)
    a = f"*Heading\n*Part, name=A\n{_write_block(POINTS)}*End Part\n"
    b = f"*Part, name=B\n{_write_block(POINTS * [1.0, 0.5, 0.25])}*End Part\n"
    long = f"*Heading\n*Part, name=A\n{_write_block(POINTS * [1, 2, 3])}*End Part\n"
    head, tail = "*Assembly, name=Assembly\n*Instance, name=A-1, part=A\n", "*End Instance\n*End Assembly\n"
    mesh, numbers = _write_block(POINTS), np.arange(8) + 1
    texts = {
        "two_parts": f"{a}{b}{head}*End Instance\n*Instance, name=B-1, part=B\n1., 0., 0.\n{tail}",
        "two_instances": f"{a}{head}*End Instance\n*Instance, name=A-2, part=A\n5., 0., 0.\n{tail}",
        "moved_instance": f"{long}{head}10., 0., 0.\n10., 0., 0., 10., 0., 1., 90.\n{tail}",
        "two_node_blocks": "*Node\n" + _write_nodes(POINTS[:5], numbers[:5]) + "*Node, nset=rest\n"
        + _write_nodes(POINTS[5:], numbers[5:]) + mesh[mesh.index("*Element") :],
        "system": f"*System\n10., 0., 0., 10., 1., 0., 9., 0., 0.\n{_write_block(POINTS * [1, 2, 3])}",
        "c3d4h": mesh.replace("C3D4", "C3D4H"),
        "c3d4t": mesh.replace("C3D4", "C3D4T"),
        "elset": mesh.replace("type=C3D4", "type=C3D4, elset=BODY")
        + "*Solid Section, elset=BODY, material=STEEL\n"
        "*Material, name=STEEL\n*Elastic\n210000., 0.3\n*Density\n7.8e-9\n",
        "cps3": "*Node\n1, 0, 0\n2, 1, 0\n3, 1, 1\n4, 0, 1\n*Element, type=CPS3\n1, 1, 2, 3\n2, 1, 3, 4\n",
        "ngen": "*Node\n1, 0., 0., 0.\n3, 1., 0., 0.\n4, 0., 1., 0.\n5, 0., 0., 1.\n*Ngen\n1, 3, 1\n"
        "*Element, type=C3D4\n1, 1, 3, 4, 5\n",
        "mesh_part": mesh,
        "include": "*Heading\n*INCLUDE, INPUT=mesh_part.inp\n",
        "sets_and_comments": "** comment\n" + mesh.replace("type=C3D4", "type=C3D4, elset=A")
        + "** another\n*Nset, nset=all, generate\n1, 8, 1\n*Elset, elset=half, generate\n1, 3, 1\n",
        "gaps": _write_block(POINTS, numbers=1000 + 7 * np.arange(8)),
    }  # fmt: skip
    for name, text in texts.items():
        (folder / f"{name}.inp").write_text(text)


# encodings of .vtu: mode, compressor, byte order, raw appended data
ENCODINGS = [
    (mode, compressor, order, raw)
    for mode, compressor, order in product(
        ("Ascii", "Binary", "Appended"), ("None", "ZLib", "LZ4", "LZMA"), ("Little", "Big")
    )
    for raw in ((0, 1) if mode == "Appended" else (0,))
]


def encodings(folder: Path) -> None:
    """The brick as .vtu in every encoding of VTK's writer, and as legacy .vtk of two versions."""
    import pyvista
    import vtk

    folder.mkdir(parents=True, exist_ok=True)
    grid = pyvista.UnstructuredGrid({10: BRICK_CELLS}, BRICK)
    for mode, compressor, order, raw in ENCODINGS:
        writer = vtk.vtkXMLUnstructuredGridWriter()
        writer.SetInputData(grid)
        getattr(writer, f"SetDataModeTo{mode}")()
        getattr(writer, f"SetCompressorTypeTo{compressor}")()
        getattr(writer, f"SetByteOrderTo{order}Endian")()
        if mode == "Appended":
            writer.SetEncodeAppendedData(1 - raw)
        writer.SetHeaderTypeToUInt32() if raw else writer.SetHeaderTypeToUInt64()
        writer.SetFileName(str(folder / f"{mode}_{compressor}_{order}_{raw}.vtu"))
        writer.Write()
    for binary, version in product((0, 1), (42, 51)):
        writer = vtk.vtkUnstructuredGridWriter()
        writer.SetInputData(grid)
        writer.SetFileType(vtk.VTK_BINARY if binary else vtk.VTK_ASCII)
        writer.SetFileVersion(version)
        writer.SetFileName(str(folder / f"legacy_{version}_{binary}.vtk"))
        writer.Write()


def formats(folder: Path) -> None:
    """The brick as tetgen writes it (with attributes, counted from 0 or 1), Medit, Nastran (ten nodes) and gmsh 1."""
    folder.mkdir(parents=True, exist_ok=True)
    p, c = BRICK.tolist(), (BRICK_CELLS + 1).tolist()
    plain = "".join(f"{x} {y} {z} 0\n" for x, y, z in p)
    cells = "".join(" ".join(map(str, [*row, 7])) + "\n" for row in c)
    medit = "MeshVersionFormatted 2\n"
    texts = {
        "one.node": "# c\n8 3 1 1\n" + "".join(f"{i + 1} {x} {y} {z} 0.5 {i % 2}\n" for i, (x, y, z) in enumerate(p)),
        "one.ele": "6 4 1\n" + "".join(" ".join(map(str, [i + 1, *row, 2.5])) + "\n" for i, row in enumerate(c)),
        "zero.node": "8 3 0 0\n" + "".join(f"{i} {x} {y} {z}\n" for i, (x, y, z) in enumerate(p)),
        "zero.ele": "6 4 0\n"
        + "".join(" ".join(map(str, [i, *row])) + "\n" for i, row in enumerate(BRICK_CELLS.tolist())),
        "medit.mesh": f"{medit}Dimension 3\nVertices\n8\n{plain}RequiredVertices\n2\n1\n2\nTetrahedra\n6\n{cells}End\n",
        "medit2.mesh": f"{medit}\nDimension\n3\n\nVertices\n8\n{plain}\nTriangles 1\n1 2 3 1\n\nTetrahedra 6\n{cells}"
        "\nEnd\n",
        "version_1.msh": "$NOD\n8\n" + "".join(f"{i + 1} {x} {y} {z}\n" for i, (x, y, z) in enumerate(p))
        + "$ENDNOD\n$ELM\n6\n"
        + "".join(" ".join(map(str, [i + 1, 4, 1, 1, 4, *row])) + "\n" for i, row in enumerate(c)) + "$ENDELM\n",
        "ten_marked.bdf": _write_nastran("+\n+       "),
        "ten_unmarked.bdf": _write_nastran("\n        "),
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text)


def _write_nastran(continuation: str) -> str:
    points, cells = quadratic(BRICK, BRICK_CELLS)
    nodes = [f"GRID    {i + 1:<8}{'':<8}{x:<8.4f}{y:<8.4f}{z:<8.4f}\n" for i, (x, y, z) in enumerate(points.tolist())]
    rows = [[f"{v + 1:<8}" for v in row] for row in cells.tolist()]
    tetrahedra = [
        f"CTETRA  {i + 1:<8}{1:<8}{''.join(row[:6])}{continuation}{''.join(row[6:])}\n" for i, row in enumerate(rows)
    ]
    return "SOL 101\nCEND\nBEGIN BULK\n" + "".join(nodes + tetrahedra) + "ENDDATA\n"


def regions_and_noise(folder: Path) -> None:
    """Two physical volumes, doubled interface nodes, noise of 1e-9 and 1e-7, and ten-node tetrahedra."""
    import meshio

    folder.mkdir(parents=True, exist_ok=True)
    p, c = bar()
    groups = [np.full(6, 1), np.full(6, 2)]
    meshio.Mesh(
        p, [("tetra", c[:6]), ("tetra", c[6:])],
        cell_data={"gmsh:physical": groups, "gmsh:geometrical": groups},
        field_data={"steel": np.array([1, 3]), "rubber": np.array([2, 3])},
    ).write(folder / "regions.msh", file_format="gmsh22", binary=False)  # fmt: skip
    used, local = split(c[6:])
    doubled = [("tetra", np.vstack([c[:6], len(p) + local]))]
    meshio.Mesh(np.vstack([p, p[used] + 1e-9]), doubled).write(folder / "nearly.vtu")
    meshio.Mesh(np.vstack([p, p[used]]), doubled).write(folder / "exactly.vtu")
    flat, triangles = plate((4, 2), (4.0, 2.0))
    flat[:, 2] = np.random.default_rng(0).uniform(-1, 1, len(flat)) * 1e-9
    meshio.Mesh(flat, [("triangle", triangles)]).write(folder / "flat_noise.vtu")
    points, ten = quadratic(p, c)
    meshio.Mesh(points, [("tetra10", ten)]).write(folder / "quadratic.vtu")
    rounded = p.copy()
    rounded[:, 0] += np.random.default_rng(1).uniform(-1, 1, len(p)) * 1e-7
    meshio.Mesh(rounded * 1000, [("tetra", c)]).write(folder / "rounded.vtu")


_BEAM = """mesh = {{file = "{name}.vtu", scale = {scale}}}
material = {{youngs_modulus = 2e5, poisson_ratio = 0.4, density = 1000.0}}
supports = [{{plane = "x", at = 0.0}}]
loads = {{gravity = [0.0, 0.0, -9.81]}}
schedule = {{dt = 0.02, frames = 10}}
[variants]
one = {{}}
converged = {{"method.iterations" = "converged"}}
linear = {{"method.law" = "linear"}}
[variants.explicit]
"method.stepper" = "symplectic_euler"
"method.mass" = "lumped"
"schedule.dt" = 0.001
"schedule.steps_per_frame" = 20
"""


def renumbered(folder: Path) -> None:
    """One beam five ways: as is, nodes and cells in another order, corners turned, in mm, all cells mirrored."""
    import meshio

    folder.mkdir(parents=True, exist_ok=True)
    p, c = bar((8, 2, 2), (4.0, 1.0, 1.0))
    random = np.random.default_rng(3)
    new = random.permutation(len(p))
    even = np.array([[0, 1, 2, 3], [1, 2, 0, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 0, 2, 1]])
    turned = np.array([row[even[random.integers(len(even))]] for row in c])
    meshes = {
        "plain": (p, c), "reordered": (p[np.argsort(new)], new[c][random.permutation(len(c))]),
        "turned": (p, turned), "millimeters": (1000 * p, c), "mirrored": (p, c[:, [1, 0, 2, 3]]),
    }  # fmt: skip
    for name, (points, cells) in meshes.items():
        meshio.Mesh(points, [("tetra", cells)]).write(folder / f"{name}.vtu")
        scale = "0.001" if name == "millimeters" else "1.0"
        (folder / f"{name}.toml").write_text(f'name = "{name}"\n' + _BEAM.format(name=name, scale=scale))
