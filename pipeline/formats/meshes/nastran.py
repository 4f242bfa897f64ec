"""Nastran bulk data (.bdf, .nas, .fem): grid points in their coordinate systems, and elements.

Fields of 8 or 16 characters, or separated by commas. Systems CORD2R, CORD2C and CORD2S are understood; everything else
that would move or add grid points is refused.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import MeshError, shorten
from pipeline.formats.meshes.plain_mesh import PlainMesh, group_by_number, make_block, number_nodes

_REFUSED = set("CORD1R CORD1C CORD1S CORD3G GRDSET SPOINT EGRID GRIDB SEBULK RINGAX CMESH".split())
_NO_CONNECTIONS = ("CORD", "COMP", "CLOAD", "CSSCHD", "CONV", "CHACAB")  # cards that begin like those of elements
_DEEPEST = 10  # files that include each other
# card: dimension, cells by number of nodes; nodes begin in field 3
_ELEMENTS = {
    "CTETRA": (3, {4: "tetra", 10: "tetra10"}),
    "CHEXA": (3, {8: "hexahedron", 20: "hexahedron20"}),
    "CPENTA": (3, {6: "wedge", 15: "wedge15"}),
    "CPYRAM": (3, {5: "pyramid", 13: "pyramid13"}),
    "CPYRA": (3, {5: "pyramid", 13: "pyramid13"}),
    **dict.fromkeys(("CTRIA3", "CTRIAR", "CPLSTN3", "CPLSTS3"), (2, {3: "triangle"})),
    **dict.fromkeys(("CTRIA6", "CPLSTN6", "CPLSTS6"), (2, {6: "triangle6"})),
    **dict.fromkeys(("CQUAD4", "CQUADR", "CSHEAR", "CPLSTN4", "CPLSTS4"), (2, {4: "quad"})),
    **dict.fromkeys(("CQUAD8", "CPLSTN8", "CPLSTS8"), (2, {8: "quad8"})),
}
_AXISYMMETRIC = {"CTRIAX", "CTRIAX6", "CTRAX3", "CTRAX6", "CQUADX", "CQUADX4", "CQUADX8", "CTORDRG", "CTRAPRG"}
_LINES = {"CBAR", "CBEAM", "CROD", "CONROD", "CTUBE", "CBUSH", "CGAP", "PLOTEL"}


class _Card(NamedTuple):
    name: str
    fields: list[str]
    where: str

    def make_error(self, text: str) -> MeshError:
        return MeshError(f"{self.where}: {self.name} {text}")

    def read_integer(self, index: int) -> int:
        """Return an integer field, 0 if it is blank."""
        text = self.fields[index] if index < len(self.fields) else ""
        try:
            return int(text or "0")
        except ValueError:
            raise self.make_error(f"has {shorten(text)}, an integer is needed") from None

    def read_numbers(self, first: int, count: int) -> Floats:
        """Return real fields; blank ones are zero, and the letter of an exponent may be missing, as in 1.5-3."""
        texts = [*self.fields[first : first + count], *[""] * count][:count]
        try:
            return np.array([_parse_real(text) for text in texts])
        except ValueError:
            raise self.make_error(f"has {shorten(' '.join(texts))}, {count} numbers are needed") from None


class _System(NamedTuple):
    """A coordinate system in that of `parent`: kind R, C or S, origin (3,) and axes (rows)."""

    parent: int
    kind: str
    origin: Floats
    axes: Floats


def read_nastran(path: Path) -> PlainMesh:
    """Return the mesh of a bulk data file; raises MeshError if it is not one, or if a part of it is not understood."""
    grids: dict[int, tuple[int, Floats]] = {}
    systems: dict[int, _System] = {}
    cells: dict[tuple[int, str], list[list[int]]] = {}
    properties: dict[tuple[int, str], list[int]] = {}  # of each cell
    lines, others = 0, Counter[str]()
    for card in _read_cards(path):
        if card.name in _REFUSED:
            raise card.make_error("is not read, and it changes the grid points; write them in the basic system")
        if card.name in _AXISYMMETRIC:
            raise card.make_error("is axisymmetric, which is no planar body")
        if card.name == "GRID":
            _add_grid(grids, card)
        elif card.name.startswith("CORD2"):
            systems[card.read_integer(1)] = _read_system(card)
        elif card.name in _ELEMENTS:
            dimension, kind, nodes = _read_element(card)
            cells.setdefault((dimension, kind), []).append(nodes)
            properties.setdefault((dimension, kind), []).append(card.read_integer(2))
        elif card.name in _LINES:
            lines += 1
        elif card.name.startswith(("C", "RB", "RROD", "MPC")) and not card.name.startswith(_NO_CONNECTIONS):
            others[card.name] += 1
    if not grids:
        raise MeshError(f"{path}: has no GRID card: it is not Nastran bulk data")
    ids, points = _place_points(grids, systems, path)
    blocks = [make_block(kind, d, number_nodes(ids, np.array(rows), f"{path}: {kind}"))
              for (d, kind), rows in cells.items()]  # fmt: skip
    blocks += [("line", 1, lines, None)] if lines else []
    top = max((d for d, _ in properties), default=0)
    counts = ", ".join(f"{count} {shorten(name)}" for name, count in sorted(others.items()))
    notes = [f"connections are not read: {counts}"] if counts else []
    numbers = [number for (d, _), of_cells in properties.items() if d == top for number in of_cells]
    regions = [f"property {number}" for number in dict.fromkeys(numbers)]
    return PlainMesh(points, blocks, notes, regions, [], group_by_number(numbers, "property") if numbers else [])


def _add_grid(grids: dict[int, tuple[int, Floats]], card: _Card) -> None:
    number, place = card.read_integer(1), (card.read_integer(2), card.read_numbers(3, 3))
    known = grids.setdefault(number, place)
    if known[0] != place[0] or (known[1] != place[1]).any():
        raise card.make_error(f"{number} is defined twice, at different places")


def _read_element(card: _Card) -> tuple[int, str, list[int]]:
    """Return the dimension, the kind of cell and the nodes of an element; trailing fields of shells are not nodes."""
    dimension, kinds = _ELEMENTS[card.name]
    most = max(kinds)
    nodes = [card.read_integer(i) for i in range(3, 3 + most)]
    given = [node for node in nodes if node]
    least = min(kinds)
    if len(given) not in kinds or (len(given) == least and not all(nodes[:least])):
        corners = nodes[:least]
        if not all(corners):
            raise card.make_error(f"{card.read_integer(1)} has {len(given)} nodes")
        return dimension, kinds[least], corners  # some nodes on sides are left out: the corners remain
    return dimension, kinds[len(given)], given


def _read_system(card: _Card) -> _System:
    a, b, c = card.read_numbers(3, 9).reshape(3, 3)
    z = b - a
    y = np.cross(z, c - a)
    if not np.linalg.norm(y) > 1e-12 * np.linalg.norm(z) * np.linalg.norm(c - a) > 0:
        raise card.make_error(f"{card.read_integer(1)} has points on one line")
    axes = np.array([np.cross(y, z), y, z])
    return _System(card.read_integer(2), card.name[5:6], a, axes / np.linalg.norm(axes, axis=1, keepdims=True))


def _place_points(
    grids: dict[int, tuple[int, Floats]], systems: dict[int, _System], path: Path
) -> tuple[np.ndarray, Floats]:
    """Return the numbers (n,) and the basic coordinates (n, 3) of all grid points."""
    ids = np.array(list(grids), dtype=np.int64)
    points = np.array([xyz for _, xyz in grids.values()])
    used = np.array([system for system, _ in grids.values()])
    for number in np.unique(used[used != 0]).tolist():
        chosen = used == number
        x, seen = points[chosen], set[int]()
        while number:
            if number in seen or number not in systems:
                raise MeshError(f"{path}: coordinate system {number} is missing, or refers to itself")
            seen.add(number)
            number, kind, origin, axes = systems[number]
            x = origin + _make_cartesian(x, kind) @ axes
        points[chosen] = x
    return ids, points


def _make_cartesian(x: Floats, kind: str) -> Floats:
    """Return Cartesian coordinates of cylindrical (r, theta, z) or spherical ones (r, theta from z, phi) [degrees]."""
    if kind == "R":
        return x
    if kind == "C":
        theta = np.radians(x[:, 1])
        return np.column_stack([x[:, 0] * np.cos(theta), x[:, 0] * np.sin(theta), x[:, 2]])
    theta, phi = np.radians(x[:, 1]), np.radians(x[:, 2])
    ring = x[:, 0] * np.sin(theta)
    return np.column_stack([ring * np.cos(phi), ring * np.sin(phi), x[:, 0] * np.cos(theta)])


def _parse_real(text: str) -> float:
    if not text:
        return 0.0
    text = text.upper().replace("D", "E")
    sign = max(text.rfind("+"), text.rfind("-"))
    if sign > 0 and "E" not in text:
        text = f"{text[:sign]}E{text[sign:]}"
    return float(text)


def _read_cards(path: Path, depth: int = 0) -> Iterator[_Card]:
    """Yield the cards of the bulk data, continuation lines joined; field 0 is the name."""
    if depth > _DEEPEST:
        raise MeshError(f"{path}: files include each other more than {_DEEPEST} deep")
    try:
        lines = path.read_text(encoding="latin-1").splitlines()
    except OSError as error:
        raise MeshError(f"{path}: cannot be read ({error.strerror})") from None
    heads = (i + 1 for i, line in enumerate(lines) if line.upper().split()[:2] == ["BEGIN", "BULK"])
    start = next(heads, 0)  # a file of bulk data alone has no such line
    card: _Card | None = None
    for i, line in enumerate(lines[start:], start + 1):
        text = line.split("$")[0].rstrip().expandtabs(8)
        if not text.strip():
            continue
        if text.strip().upper() == "ENDDATA":
            break
        where = f"{path}: line {i}"
        if text.split()[0].upper() == "INCLUDE":
            if card:
                yield card
                card = None
            yield from _read_included(path, text, where, depth)
            continue
        fields = _split_fields(text)
        if fields[0] in ("", "+", "*") or fields[0][0] in "+*":
            if card is None:
                raise MeshError(f"{where}: a continuation line continues nothing")
            card.fields.extend(fields[1:9])
            continue
        if card:
            yield card
        card = _Card(fields[0], fields, where)
    if card:
        yield card


def _read_included(path: Path, text: str, where: str, depth: int) -> Iterator[_Card]:
    name = text.strip()[7:].strip().strip("'\"")
    file = path.parent / name.replace("\\", "/")
    if not file.is_file():
        raise MeshError(f"{where}: INCLUDE needs {shorten(name)}, which is not there")
    yield from _read_cards(file, depth + 1)


def _split_fields(text: str) -> list[str]:
    """Return the name and the eight data fields of a line (four of a line with fields of 16 characters)."""
    if "," in text:
        fields = [field.strip() for field in text.split(",")]
        count = 4 if "*" in fields[0] else 8
        fields = [*fields, *[""] * count][: count + 1]
    else:
        width = 16 if "*" in text[:8] else 8
        fields = [text[:8].strip(), *(text[k : k + width].strip() for k in range(8, 72, width))]
    name = fields[0].upper()
    return [name if name[:1] in "+*" else name.rstrip("*_"), *fields[1:]]
