"""Meshes in simple text files: tetgen's .node and .ele, and Medit's .mesh."""

from pathlib import Path

import numpy as np

from pipeline.errors import MeshError, join_names, shorten
from pipeline.formats.meshes.plain_mesh import PlainMesh, group_by_number, make_block

# Medit's keywords of cells: dimension, kind and number of nodes
_MEDIT_CELLS = {
    "EDGES": (1, "line", 2), "TRIANGLES": (2, "triangle", 3), "QUADRILATERALS": (2, "quad", 4),
    "TETRAHEDRA": (3, "tetra", 4), "HEXAHEDRA": (3, "hexahedron", 8), "HEXAEDRA": (3, "hexahedron", 8),
    "PRISMS": (3, "wedge", 6), "PENTAHEDRA": (3, "wedge", 6), "PYRAMIDS": (3, "pyramid", 5),
}  # fmt: skip
# of second order: programs do not agree on the order of nodes on sides, which their places tell later
_MEDIT_CURVED = {"TRIANGLESP2": (2, "triangle6", 6), "TETRAHEDRAP2": (3, "tetra10", 10)}


def read_tetgen(path: Path) -> PlainMesh:
    """Return the mesh of a pair of files NAME.node and NAME.ele; raises MeshError."""
    nodes, cells = (_read_table(path.with_suffix(suffix)) for suffix in (".node", ".ele"))
    (count, dimension), points = nodes
    (_, corners), rows = cells
    if dimension not in (2, 3) or points.shape[1] < 1 + dimension:
        raise MeshError(f"{path.with_suffix('.node')}: has {dimension} dimensions and {points.shape[1]} columns")
    if corners not in (3, 4, 6, 10) or rows.shape[1] < 1 + corners:
        raise MeshError(f"{path.with_suffix('.ele')}: has cells of {corners} nodes and {rows.shape[1]} columns")
    first = int(points[0, 0]) if count else 0
    if first not in (0, 1) or (points[:, 0] != first + np.arange(count)).any():
        raise MeshError(f"{path.with_suffix('.node')}: nodes are not counted from 0 or 1")
    kind = {3: "triangle", 4: "tetra", 6: "triangle6", 10: "tetra10"}[corners]
    simplex = 2 if corners in (3, 6) else 3
    # nodes on sides come in an order of tetgen's own, which their places tell later
    block = make_block(kind, simplex, rows[:, 1 : 1 + corners].astype(np.int64) - first)
    groups = group_by_number(rows[:, 1 + corners], "region") if len(rows) and rows.shape[1] > 1 + corners else []
    return PlainMesh(points[:, 1 : 1 + dimension], [block], [], [name for name, *_ in groups], [], groups)


def _read_table(path: Path) -> tuple[tuple[int, int], np.ndarray]:
    """Return the first two numbers of the header, and the rows (count, columns) of all numbers."""
    if not path.is_file():
        raise MeshError(f"{path}: is missing; tetgen's meshes are pairs of .node and .ele")
    lines = [line.split("#")[0] for line in path.read_text(encoding="latin-1").splitlines()]
    lines = [line for line in lines if line.strip()]
    try:
        count, second = (int(word) for word in lines[0].split()[:2])
        rows = np.loadtxt(lines[1 : count + 1], ndmin=2, comments=None) if count else np.zeros((0, 1))
    except (ValueError, IndexError) as error:
        raise MeshError(f"{path}: is not a table of tetgen ({shorten(str(error), 100)})") from None
    if len(rows) != count or len(lines) > count + 1:
        raise MeshError(f"{path}: declares {count} rows and has {len(lines) - 1}")
    return (count, second), rows


def read_medit(path: Path) -> PlainMesh:
    """Return the mesh of a text file of Medit, mmg or FreeFem; raises MeshError."""
    sections = _split_sections(path)
    dimension = int(sections.pop("DIMENSION", ["3"])[0])
    if "VERTICES" not in sections or dimension not in (2, 3):
        raise MeshError(f"{path}: has no Vertices of 2 or 3 dimensions: it is not Medit's")
    vertices = _read_section(path, "Vertices", sections.pop("VERTICES"), dimension + 1)
    blocks, references = [], dict[int, list[np.ndarray]]()
    for name in list(sections):
        if name in _MEDIT_CELLS:
            d, kind, nodes = _MEDIT_CELLS[name]
            rows = _read_section(path, name, sections.pop(name), nodes + 1).astype(np.int64)
            if len(rows):
                blocks.append(make_block(kind, d, rows[:, :-1] - 1))
                references.setdefault(d, []).append(rows[:, -1])
    for name in [name for name in _MEDIT_CURVED if name in sections]:
        d, kind, nodes = _MEDIT_CURVED[name]
        rows = _read_section(path, name, sections.pop(name), nodes + 1).astype(np.int64)
        if len(rows):
            blocks.append(make_block(kind, d, rows[:, :-1] - 1))
            references.setdefault(d, []).append(rows[:, -1])
    sections = {name: words for name, words in sections.items() if name != "EDGESP2"}
    curved = [name for name in sections if name.endswith(("P2", "P3", "P4", "Q2"))]
    if curved:
        raise MeshError(f"{path}: {join_names(curved)} are not read; write cells of first order")
    groups = group_by_number(np.concatenate(references[max(references)]), "reference") if references else []
    return PlainMesh(vertices[:, :-1], blocks, [], [name for name, *_ in groups], [], groups)


def _split_sections(path: Path) -> dict[str, list[str]]:
    """Return the words after each keyword, by the keyword in capitals."""
    text = path.read_text(encoding="latin-1")
    sections: dict[str, list[str]] = {}
    current: list[str] = []
    for line in text.splitlines():
        for word in line.split("#")[0].split():
            if word[0].isalpha():
                if word.upper() in sections and word.upper() != "END":
                    raise MeshError(f"{path}: has {shorten(word)} twice")
                current = sections.setdefault(word.upper(), [])
            else:
                current.append(word)
    if "END" not in sections:
        raise MeshError(f"{path}: does not finish with End: it is cut off")
    return sections


def _read_section(path: Path, name: str, words: list[str], columns: int) -> np.ndarray:
    """Return the rows of a section, of which the first word is their number; the last column is a reference."""
    try:
        count = int(words[0])
        numbers = np.array([word.replace("D", "E").replace("d", "e") for word in words[1:]], dtype=np.float64)
    except (ValueError, IndexError):
        raise MeshError(f"{path}: {name} are not a count and numbers") from None
    if numbers.size != count * columns:
        raise MeshError(f"{path}: {count} {name} need {count * columns} numbers; there are {numbers.size}")
    return numbers.reshape(count, columns)
