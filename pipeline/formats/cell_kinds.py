"""The table of VTK's cell types: dimension, and the shape functions that belong to each number of nodes.

A type's number alone does not decide: a Lagrange tetrahedron (71) with 4 nodes is the linear tetrahedron (10).
https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html; the numbers are those of vtkCellType.h.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

POLYGON, POLYHEDRON, PENTAGONAL_PRISM, HEXAGONAL_PRISM = 7, 42, 15, 16


@dataclass(frozen=True)
class CellType:
    """A row: VTK's number and name, dimension, and the name of the shape functions for each number of nodes.

    `faceted` cells have no shape functions: their volume follows from their faces. `remedy` says why a type that is
    neither is refused, and how to convert it.
    """

    number: int
    name: str
    dimension: int
    kinds: Mapping[int, str] = field(default_factory=dict)
    faceted: bool = False
    remedy: str = ""


_BEZIER = "the weights of Bezier cells are not read; write Lagrange cells (68 to 73) instead"
_TRIANGLES = {3: "triangle 1", 6: "triangle 2", 7: "triangle 2 with center", 10: "triangle 3", 15: "triangle 4"}
_QUADS = {(n + 1) ** 2: f"quad {n}" for n in range(1, 5)}
_HEXAHEDRA = {(n + 1) ** 3: f"hexahedron {n}" for n in range(1, 5)}
_WEDGES = {(n + 1) ** 2 * (n + 2) // 2: f"wedge {n}" for n in range(1, 5)} | {21: "wedge 2 with centers"}
_TETRAHEDRA = {(n + 1) * (n + 2) * (n + 3) // 6: f"tetrahedron {n}" for n in range(1, 5)}
_TETRAHEDRA |= {15: "tetrahedron 2 with centers"}

ROWS = (
    CellType(0, "empty cell", 0),
    CellType(1, "vertex", 0),
    CellType(2, "poly-vertex", 0),
    CellType(3, "line", 1),
    CellType(4, "poly-line", 1),
    CellType(5, "triangle", 2, {3: "triangle 1"}),
    CellType(6, "triangle strip", 2, remedy="split strips into triangles (vtkTriangleFilter)"),
    CellType(POLYGON, "polygon", 2, faceted=True),
    CellType(8, "pixel", 2, {4: "pixel"}),
    CellType(9, "quad", 2, {4: "quad 1"}),
    CellType(10, "tetrahedron", 3, {4: "tetrahedron 1"}),
    CellType(11, "voxel", 3, {8: "voxel"}),
    CellType(12, "hexahedron", 3, {8: "hexahedron 1"}),
    CellType(13, "wedge", 3, {6: "wedge 1"}),
    CellType(14, "pyramid", 3, {5: "pyramid 1"}),
    CellType(PENTAGONAL_PRISM, "pentagonal prism", 3, faceted=True),
    CellType(HEXAGONAL_PRISM, "hexagonal prism", 3, faceted=True),
    CellType(21, "quadratic edge", 1),
    CellType(22, "quadratic triangle", 2, {6: "triangle 2"}),
    CellType(23, "quadratic quad", 2, {8: "quad serendipity"}),
    CellType(24, "quadratic tetrahedron", 3, {10: "tetrahedron 2"}),
    CellType(25, "quadratic hexahedron", 3, {20: "hexahedron serendipity"}),
    CellType(26, "quadratic wedge", 3, {15: "wedge serendipity"}),
    CellType(27, "quadratic pyramid", 3, {13: "pyramid 2"}),
    CellType(28, "biquadratic quad", 2, {9: "quad 2"}),
    CellType(29, "triquadratic hexahedron", 3, {27: "hexahedron 2"}),
    CellType(30, "quadratic-linear quad", 2, {6: "quad 2 by 1"}),
    CellType(31, "quadratic-linear wedge", 3, {12: "wedge 2 by 1"}),
    CellType(32, "biquadratic-quadratic wedge", 3, {18: "wedge 2"}),
    CellType(33, "biquadratic-quadratic hexahedron", 3, {24: "hexahedron 2 by serendipity"}),
    CellType(34, "biquadratic triangle", 2, {7: "triangle 2 with center"}),
    CellType(35, "cubic line", 1),
    CellType(36, "quadratic polygon", 2, remedy="write quadratic triangles (22) or quads (23) instead"),
    CellType(37, "triquadratic pyramid", 3, {19: "pyramid 2 with centers"}),
    CellType(41, "convex point set", 3, remedy="write polyhedra (42) or split it into tetrahedra instead"),
    CellType(POLYHEDRON, "polyhedron", 3, faceted=True),
    CellType(51, "parametric curve", 1),
    CellType(52, "parametric surface", 2, remedy="write Lagrange cells (68 to 73) instead"),
    CellType(53, "parametric triangle surface", 2, remedy="write Lagrange cells (68 to 73) instead"),
    CellType(54, "parametric quad surface", 2, remedy="write Lagrange cells (68 to 73) instead"),
    CellType(55, "parametric tetrahedral region", 3, remedy="write Lagrange cells (68 to 73) instead"),
    CellType(56, "parametric hexahedral region", 3, remedy="write Lagrange cells (68 to 73) instead"),
    CellType(60, "higher-order edge", 1),
    CellType(61, "higher-order triangle", 2, remedy="write Lagrange triangles (69) instead"),
    CellType(62, "higher-order quad", 2, remedy="write Lagrange quads (70) instead"),
    CellType(63, "higher-order polygon", 2, remedy="write Lagrange triangles (69) or quads (70) instead"),
    CellType(64, "higher-order tetrahedron", 3, remedy="write Lagrange tetrahedra (71) instead"),
    CellType(65, "higher-order wedge", 3, remedy="write Lagrange wedges (73) instead"),
    CellType(66, "higher-order pyramid", 3, remedy="write quadratic pyramids (27) instead"),
    CellType(67, "higher-order hexahedron", 3, remedy="write Lagrange hexahedra (72) instead"),
    CellType(68, "Lagrange curve", 1),
    CellType(69, "Lagrange triangle", 2, _TRIANGLES),
    CellType(70, "Lagrange quad", 2, _QUADS),
    CellType(71, "Lagrange tetrahedron", 3, _TETRAHEDRA),
    CellType(72, "Lagrange hexahedron", 3, _HEXAHEDRA),
    CellType(73, "Lagrange wedge", 3, _WEDGES),
    CellType(74, "Lagrange pyramid", 3, {5: "pyramid 1"}),
    CellType(75, "Bezier curve", 1),
    CellType(76, "Bezier triangle", 2, remedy=_BEZIER),
    CellType(77, "Bezier quad", 2, remedy=_BEZIER),
    CellType(78, "Bezier tetrahedron", 3, remedy=_BEZIER),
    CellType(79, "Bezier hexahedron", 3, remedy=_BEZIER),
    CellType(80, "Bezier wedge", 3, remedy=_BEZIER),
    CellType(81, "Bezier pyramid", 3, remedy=_BEZIER),
)
TYPES: Mapping[int, CellType] = {row.number: row for row in ROWS}


def explain_refusal(number: int, count: int) -> str:
    """Return why cells of this type with `count` nodes cannot be measured, and the remedy; empty if they can be."""
    row = TYPES.get(number)
    if row is None:
        return f"cell type {number} is not one of VTK's; write a type from the list in docs/cells.md"
    if row.faceted or count in row.kinds:
        return ""
    if row.remedy:
        return f"{row.name} (type {number}) cannot be measured: {row.remedy}"
    if row.dimension < 2:
        return f"{row.name} (type {number}) has no volume or area"
    counts = ", ".join(str(k) for k in sorted(row.kinds))
    return (
        f"{row.name} (type {number}) with {count} nodes cannot be measured, only with {counts}: "
        "write one order along all axes, at most 4"
    )
