"""The element types of Abaqus and CalculiX: nodes, dimension, and the kind of cell.

https://docs.software.vt.edu/abaqusv2024/English/SIMACAEELMRefMap/simaelm-c-elindex.htm
"""

import re
from typing import NamedTuple

from pipeline.errors import shorten
from pipeline.formats.meshes.abaqus_keywords import Keyword

_SOLIDS = {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 13: "pyramid13", 15: "wedge15",
           18: "wedge18", 20: "hexahedron20", 27: "hexahedron27"}  # fmt: skip
_FACES = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
_LINES = {2: "line", 3: "line3"}
# prefix, dimension, cells by number of nodes; the number follows the prefix
_FAMILIES: tuple[tuple[re.Pattern[str], int, dict[int, str]], ...] = (
    (re.compile(r"(?:C|DC|DCC|AC|Q|EC|EMC|FC)3D(\d+)"), 3, _SOLIDS),
    (re.compile(r"SC(\d)"), 3, _SOLIDS),  # continuum shells
    (re.compile(r"COH3D(\d)"), 3, {}),
    (re.compile(r"(?:CPS|CPE|CPEG|(?:DC|DCC|AC|EMC)2D)(\d)"), 2, _FACES),
    (re.compile(r"(?:S|DS|M3D|SFM3D|R3D|F3D)(\d)"), 2, _FACES),
    (re.compile(r"(?:[TR]2D|T3D|RB[23]D|CONN[23]D|DC1D)([23])"), 1, _LINES),
)
_OTHERS = {
    "STRI3": (3, 2, "triangle"), "STRI65": (6, 2, "triangle6"), "SPRINGA": (2, 1, "line"), "SPRING2": (2, 1, "line"),
    "DASHPOTA": (2, 1, "line"), "DASHPOT2": (2, 1, "line"), "GAPUNI": (2, 1, "line"), "JOINTC": (2, 1, "line"),
    "MASS": (1, 0, "vertex"), "ROTARYI": (1, 0, "vertex"), "SPRING1": (1, 0, "vertex"), "HEATCAP": (1, 0, "vertex"),
    "DASHPOT1": (1, 0, "vertex"), "DCOUP3D": (1, 0, "vertex"),
}  # fmt: skip
_BEAM = re.compile(r"(?:B|PIPE|ELBOW)[23]([123])")  # of two nodes, or three if this number is 2
_AXISYMMETRIC = re.compile(r"(?:D|DC|A|G|F)?C?G?AX|SAX|MAX|RAX|CAX")


class ElementKind(NamedTuple):
    """An element type: its name, its number of nodes, its dimension and the kind of cell (meshio's name)."""

    name: str
    nodes: int
    dimension: int
    cell: str


def find_element_kind(keyword: Keyword) -> ElementKind:
    """Return the kind of the elements of *ELEMENT; raises MeshError if it is not known."""
    name = keyword.options.get("TYPE", "").upper()
    if name in _OTHERS:
        return ElementKind(name, *_OTHERS[name])
    if beam := _BEAM.match(name):
        return ElementKind(name, 3 if beam[1] == "2" else 2, 1, "line3" if beam[1] == "2" else "line")
    for pattern, dimension, cells in _FAMILIES:
        if match := pattern.match(name):
            count = int(match[1])
            return ElementKind(name, count, dimension, cells.get(count, name))
    if _AXISYMMETRIC.match(name):
        raise keyword.make_error(f"has axisymmetric elements ({shorten(name)}), which are no planar body")
    raise keyword.make_error(f"has elements of type {shorten(name) or 'none'}, which is not known")
