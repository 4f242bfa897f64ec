"""Abaqus and CalculiX input files (.inp): parts, instances, local systems, generated nodes, included files.

Keywords that change the mesh are understood or refused; those that do not (sets, steps, output) are passed over. Each
instance of a part is a body of its own: coincident nodes of two instances are not joined, as in Abaqus.
https://docs.software.vt.edu/abaqusv2024/English/SIMACAEKEYRefMap/simakey-c-ov.htm
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, join_names, shorten
from pipeline.formats.meshes.abaqus_elements import ElementKind, find_element_kind
from pipeline.formats.meshes.abaqus_keywords import Keyword, join_rows, read_keywords, read_numbers
from pipeline.formats.meshes.abaqus_sets import ElementSets, join_sets, list_groups
from pipeline.formats.meshes.plain_mesh import CellBlock, CellGroup, PlainMesh, make_block, number_nodes

# they make or move nodes or elements in ways that are not implemented here
_REFUSED = set(
    "NFILL NCOPY NMAP ELGEN ELCOPY IMPERFECTION SYMMETRICMODELGENERATION SYMMETRICRESULTSTRANSFER IMPORT "
    "IMPORTNODESET IMPORTELSET SUPERELEMENT SUBSTRUCTUREGENERATION PARAMETER FRAGMENT ADAPTIVEREMESHING".split()
)
_CONNECTIONS = {
    "TIE", "MPC", "EQUATION", "COUPLING", "RIGIDBODY", "EMBEDDEDELEMENT", "CONTACTPAIR", "SHELLTOSOLIDCOUPLING",
}  # fmt: skip


@dataclass
class _AbaqusBody:
    """The nodes and elements of a part, an instance, or of the file itself, as they are read."""

    name: str
    ids: list[Ints] = field(default_factory=list)
    points: list[Floats] = field(default_factory=list)
    elements: list[tuple[ElementKind, Ints]] = field(default_factory=list)  # with their own numbers in column 0
    system: tuple[Floats, Floats] | None = None  # origin (3,) and axes (3, 3) as rows
    sets: ElementSets = field(default_factory=ElementSets)


def read_abaqus(path: Path) -> PlainMesh:
    """Return the mesh of an input file; raises MeshError if it is not one, or if a part of it is not understood."""
    model = _Model(path)
    for keyword in read_keywords(path):
        model.take(keyword)
    return model.assemble()


class _Model:
    """Collects parts and instances keyword by keyword."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.whole = _AbaqusBody("")  # everything outside parts and instances
        self.current = self.whole
        self.parts: dict[str, _AbaqusBody] = {}
        # the part, the instance's own nodes and elements, its placement
        self.instances: list[tuple[_AbaqusBody, _AbaqusBody, Keyword]] = []
        self.materials: dict[str, None] = {}
        self.connections: set[str] = set()
        self.sets: dict[tuple[int, str], None] = {}  # dimension and ELSET of elements

    def take(self, keyword: Keyword) -> None:
        """Add the content of a keyword and its data lines."""
        name = keyword.name
        if name in _REFUSED:
            raise keyword.make_error("is not read, and it changes the mesh; write the mesh without it")
        if name in _CONNECTIONS:
            self.connections.add(f"*{name}")
        if name in ("SOLIDSECTION", "SHELLSECTION") and "MATERIAL" in keyword.options:
            self.materials[keyword.options["MATERIAL"]] = None
            self.current.sets.add_section(keyword)
        if name in _ACTIONS:
            _ACTIONS[name](self, keyword)

    def start_part(self, keyword: Keyword) -> None:
        self.current = _AbaqusBody(keyword.options.get("NAME", ""))
        self.parts[self.current.name.upper()] = self.current

    def end_body(self, _keyword: Keyword) -> None:
        self.current = self.whole

    def start_instance(self, keyword: Keyword) -> None:
        part = keyword.options.get("PART", "").upper()
        if "LIBRARY" in keyword.options or "INSTANCE" in keyword.options:
            raise keyword.make_error("from another analysis is not read")
        if part not in self.parts:
            raise keyword.make_error(
                f"of part {shorten(part)}, which is not defined; there are {join_names(self.parts)}"
            )
        self.current = _AbaqusBody(keyword.options.get("NAME", part))
        self.instances.append((self.parts[part], self.current, keyword))

    def set_system(self, keyword: Keyword) -> None:
        self.current.system = _read_system(keyword)

    def add_nodes(self, keyword: Keyword) -> None:
        rows = read_numbers(keyword)
        if not len(rows):
            return
        if rows.shape[1] > 7:
            raise keyword.make_error(f"has {rows.shape[1]} numbers in a line")
        points = np.zeros((len(rows), 3))
        points[:, : min(rows.shape[1] - 1, 3)] = rows[:, 1:4]
        system = keyword.options.get("SYSTEM", "R").upper()[:1]
        if system == "C":
            angle = np.radians(points[:, 1])
            points[:, :2] = np.column_stack([points[:, 0] * np.cos(angle), points[:, 0] * np.sin(angle)])
        elif system != "R":
            raise keyword.make_error("in spherical coordinates is not read; write Cartesian ones")
        if self.current.system is not None:
            origin, axes = self.current.system
            points = origin + points @ axes
        self.current.ids.append(_read_ids(rows[:, 0], keyword))
        self.current.points.append(points)

    def add_elements(self, keyword: Keyword) -> None:
        kind = find_element_kind(keyword)
        rows = join_rows(keyword, 1 + kind.nodes)
        if rows is None:
            if kind.dimension < 2:  # between nodes of instances, such as springs
                return
            raise keyword.make_error("names nodes of instances, which is not read")
        self.current.elements.append((kind, _read_ids(rows, keyword)))
        if "ELSET" in keyword.options:
            self.sets[kind.dimension, keyword.options["ELSET"]] = None
            self.current.sets.add(keyword.options["ELSET"], self.current.elements[-1][1][:, 0])

    def add_set(self, keyword: Keyword) -> None:
        self.current.sets.add_keyword(keyword)

    def generate_nodes(self, keyword: Keyword) -> None:
        if keyword.options.keys() - {"NSET"}:
            raise keyword.make_error("along a curve is not read; write the nodes")
        ids, points = _join_nodes(self.current, keyword.where)
        for row in read_numbers(keyword):
            first, last, step = (int(value) for value in np.pad(row, (0, 3))[:3])
            step, sign = step or 1, 1 if last >= first else -1
            count = abs(last - first) // max(step, 1)
            if step < 1 or first + sign * count * step != last or row[3:].any() or count > 10**8:
                raise keyword.make_error(f"from {first} to {last} in steps of {step} is not possible")
            ends = points[number_nodes(ids, np.array([first, last]), keyword.where)]
            inner = np.arange(1, count)
            self.current.ids.append(first + sign * step * inner)
            self.current.points.append(ends[0] + (inner / max(count, 1))[:, None] * (ends[1] - ends[0]))

    def assemble(self) -> PlainMesh:
        """Return all bodies in one mesh, each instance moved to its place."""
        if self.parts and not self.instances:
            raise MeshError(f"{self.path}: {len(self.parts)} parts, but no *INSTANCE of any of them")
        points, blocks, counts, names = [np.zeros((0, 3))], list[CellBlock](), list[int](), list[str]()
        for body, place in self._list_bodies():
            name = body.name or "the file"
            ids, own_points = _join_nodes(body, f"{self.path}: {name}")
            for kind, rows in body.elements:
                cells = number_nodes(ids, rows[:, 1:], f"{self.path}: {kind.name} element of {name}")
                blocks.append(make_block(kind.cell, kind.dimension, cells + sum(counts)))
            points.append(own_points if place is None else _move(own_points, place))
            counts.append(len(own_points))
            names += [name] if body.elements else []
        bodies = counts if len(names) > 1 else []
        groups, unknown = self._list_groups(blocks)
        notes = self._list_notes(names, unknown)
        return PlainMesh(np.concatenate(points), blocks, notes, self._list_regions(blocks), bodies, groups)

    def _list_regions(self, blocks: Sequence[CellBlock]) -> list[str]:
        """Return the materials of the file, or the sets in which the elements of the highest dimension come."""
        top = max((dimension for _, dimension, *_ in blocks), default=0)
        return list(self.materials) or [name for dimension, name in self.sets if dimension == top]

    def _list_groups(self, blocks: Sequence[CellBlock]) -> tuple[list[CellGroup], list[str]]:
        """Return the sets and materials of the cells of the highest dimension, and the sets that are not understood."""
        top, bodies = max((dimension for _, dimension, *_ in blocks), default=0), []
        for body, _ in self._list_bodies():
            ids = [np.zeros(0, dtype=np.int64), *(rows[:, 0] for kind, rows in body.elements if kind.dimension == top)]
            bodies.append((body.name, np.concatenate(ids), body.sets))
        return list_groups(bodies, self.whole.sets)

    def _list_bodies(self) -> list[tuple[_AbaqusBody, Keyword | None]]:
        """Return each instance with its placement, and the nodes and elements outside of all."""
        bodies: list[tuple[_AbaqusBody, Keyword | None]] = []
        for part, own, keyword in self.instances:
            points, elements = part.points + own.points, part.elements + own.elements
            sets = join_sets(part.sets, own.sets)
            bodies.append((_AbaqusBody(own.name, part.ids + own.ids, points, elements, None, sets), keyword))
        return [*bodies, (self.whole, None)] if self.whole.ids else bodies

    def _list_notes(self, names: Sequence[str], unknown: Sequence[str]) -> list[str]:
        notes = []
        if unknown:
            notes.append(f"sets of sets that are not defined here are not read: {join_names(unknown)}")
        if len(names) > 1:
            notes.append(f"{len(names)} instances ({join_names(names)}) are bodies of their own: no nodes are joined")
        if self.connections:
            notes.append(f"connections are not read: {join_names(sorted(self.connections))}")
        if len(self.materials) == 1:
            notes.append(f"the case's material replaces {join_names(self.materials)} of the file")
        return notes


_ACTIONS = {
    "PART": _Model.start_part,
    "ENDPART": _Model.end_body,
    "INSTANCE": _Model.start_instance,
    "ENDINSTANCE": _Model.end_body,
    "SYSTEM": _Model.set_system,
    "NODE": _Model.add_nodes,
    "NGEN": _Model.generate_nodes,
    "ELEMENT": _Model.add_elements,
    "ELSET": _Model.add_set,
}


def _read_ids(values: Any, keyword: Keyword) -> Ints:
    ids = np.asarray(values).astype(np.int64)
    if (ids != values).any() or (ids < 1).any():
        raise keyword.make_error("has a number of a node or element that is no positive integer")
    return ids


def _join_nodes(body: _AbaqusBody, where: str) -> tuple[Ints, Floats]:
    """Return the numbers (n,) and points (n, 3) of a body; raises MeshError if a node is defined in two places."""
    ids = np.concatenate([np.zeros(0, dtype=np.int64), *body.ids])
    points = np.concatenate([np.zeros((0, 3)), *body.points])
    unique, first, inverse = np.unique(ids, return_index=True, return_inverse=True)
    if len(unique) == len(ids):
        return ids, points
    moved = np.flatnonzero((points != points[first[inverse]]).any(axis=1))
    if moved.size:
        raise MeshError(f"{where}: node {ids[moved[0]]} is defined twice, at different places")
    keep = np.sort(first)
    return ids[keep], points[keep]


def _read_system(keyword: Keyword) -> tuple[Floats, Floats] | None:
    """Return the origin and the axes (rows) of *SYSTEM; None if it ends a local system."""
    numbers = np.array([v for line in keyword.lines for v in keyword.split_numbers(line)], dtype=np.float64)
    if not numbers.size:
        return None
    if numbers.size not in (3, 6, 9):
        raise keyword.make_error(f"has {numbers.size} numbers; 3, 6 or 9 are needed")
    origin, x = numbers[:3], np.array([1.0, 0.0, 0.0])
    y = np.array([0.0, 1.0, 0.0])
    if numbers.size > 3:
        x = numbers[3:6] - origin
        y = numbers[6:9] - origin if numbers.size == 9 else np.array([-x[1], x[0], 0.0])
        if numbers.size == 6 and x[2]:
            raise keyword.make_error("needs a third point: its axis does not lie in the plane of x and y")
    z = np.cross(x, y)
    if not np.linalg.norm(z) > 1e-12 * np.linalg.norm(x) * np.linalg.norm(y) > 0:
        raise keyword.make_error("has points on one line")
    axes = np.array([x, np.cross(z, x), z])
    return origin, axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _move(points: Floats, keyword: Keyword) -> Floats:
    """Return the points of an instance in place: moved by its first line, then turned about the axis of its second."""
    lines = [keyword.split_numbers(line) for line in keyword.lines if line.strip(" ,")]
    if len(lines) > 2 or any(len(numbers) != size for numbers, size in zip(lines, (3, 7), strict=False)):
        raise keyword.make_error("has a placement that is not 3 numbers, then 7")
    if lines:
        points = points + np.array(lines[0])
    if len(lines) < 2:
        return points
    start, axis, angle = np.array(lines[1][:3]), np.array(lines[1][3:6]), np.radians(lines[1][6])
    axis = axis - start
    if not np.linalg.norm(axis):
        raise keyword.make_error("turns about an axis of length zero")
    axis /= np.linalg.norm(axis)
    arm = points - start
    along = np.outer(arm @ axis, axis)
    return np.asarray(start + along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm))
