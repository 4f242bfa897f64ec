"""The element sets of an Abaqus input file, and the sections that give their elements a material."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.arrays import Ints
from pipeline.errors import MeshError
from pipeline.formats.meshes.abaqus_keywords import Keyword, read_numbers
from pipeline.formats.meshes.plain_mesh import CellGroup

_MOST_ELEMENTS = 10**9  # of a generated set


class ElementSets:
    """Sets of the elements of one part, instance or file: numbers of elements, or names of other sets, by name."""

    def __init__(self) -> None:
        self.members: dict[str, list[Ints | str]] = {}  # by the name in capitals
        self.names: dict[str, str] = {}  # as the file writes them first
        self.materials: dict[str, list[str]] = {}  # the sets of their sections
        self.assembled: list[tuple[str, str, Ints | str]] = []  # name of a set, name of an instance, content

    def add(self, name: str, content: Ints | str) -> None:
        """Add numbers of elements, or all elements of another set."""
        self.names.setdefault(name.upper(), name)
        self.members.setdefault(name.upper(), []).append(content)

    def add_keyword(self, keyword: Keyword) -> None:
        """Add the content of *ELSET; raises MeshError."""
        name, instance = keyword.options.get("ELSET", ""), keyword.options.get("INSTANCE", "")
        for content in _read_set(keyword):
            place = instance
            if isinstance(content, str) and not instance and "." in content:
                place, _, entry = content.rpartition(".")
                content = np.array([int(entry)]) if entry.isdecimal() else entry
            if place:
                self.assembled.append((name, place.upper(), content))
            else:
                self.add(name, content)

    def add_section(self, keyword: Keyword) -> None:
        """Add the set of a section with a material."""
        if "ELSET" in keyword.options:
            self.materials.setdefault(keyword.options["MATERIAL"], []).append(keyword.options["ELSET"].upper())

    def find_elements(self, name: str, seen: tuple[str, ...] = ()) -> Ints:
        """Return the numbers of the elements of a set; raises MeshError if it is not defined, or in itself."""
        if name.upper() not in self.members or name.upper() in seen:
            raise MeshError(name)
        parts = [
            self.find_elements(content, (*seen, name.upper())) if isinstance(content, str) else content
            for content in self.members[name.upper()]
        ]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *parts]))


def join_sets(part: ElementSets, own: ElementSets) -> ElementSets:
    """Return the sets of an instance: those of its part, and its own."""
    joined = ElementSets()
    for sets in (part, own):
        for name, contents in sets.members.items():
            for content in contents:
                joined.add(sets.names[name], content)
        for material, names in sets.materials.items():
            joined.materials.setdefault(material, []).extend(names)
    return joined


def list_groups(
    bodies: Sequence[tuple[str, Ints, ElementSets]], whole: ElementSets
) -> tuple[list[CellGroup], list[str]]:
    """Return the sets and materials of the elements of all bodies, and the names of sets that are not understood.

    Each body has its name, the numbers (e,) of its elements of the highest dimension, and its sets. A set is that of
    all bodies that have one of the name; sets outside of parts may take elements from instances.
    """
    sets, materials, unknown = dict[str, list[Any]](), dict[str, list[Any]](), _find_mixed(whole)
    names: dict[str, str] = {}
    start = 0
    for body_name, ids, own in bodies:
        for name in own.members:
            names.setdefault(name, own.names[name])
            _add_cells(sets, name, own, name, ids, start, unknown)
        for material, section_sets in own.materials.items():
            for name in section_sets:
                _add_cells(materials, material, own, name, ids, start, unknown)
        for name, instance, content in whole.assembled:
            if instance == body_name.upper():
                names.setdefault(name.upper(), name)
                if isinstance(content, str):
                    _add_cells(sets, name.upper(), own, content, ids, start, unknown)
                else:
                    sets.setdefault(name.upper(), []).append(start + np.flatnonzero(np.isin(ids, content)))
        start += len(ids)
    groups = [
        (names[name], "", np.unique(np.concatenate(parts))) for name, parts in sets.items() if name not in unknown
    ]
    taken = {name.upper(): cells for name, _, cells in groups}
    for material, parts in materials.items():
        if material in unknown:
            continue
        cells = np.unique(np.concatenate(parts))
        same = taken.get(material.upper())
        if same is None or not np.array_equal(cells, same):
            groups.append((material if same is None else f"material {material}", "", cells))
    names = {name: names.get(name, whole.names.get(name, name)) for name in unknown}
    return [group for group in groups if len(group[2])], list(names.values())


def _find_mixed(whole: ElementSets) -> dict[str, None]:
    """Return the sets outside of parts that are made of other sets that take elements from instances."""
    assembled = {name.upper() for name, *_ in whole.assembled}
    mixed = dict[str, None]()
    while True:
        more = [
            name for name, contents in whole.members.items()
            if name not in mixed and any(isinstance(c, str) and c.upper() in {*assembled, *mixed} for c in contents)
        ]  # fmt: skip
        if not more:
            return mixed
        mixed |= dict.fromkeys(more)


def _add_cells(
    found: dict[str, list[Any]], key: str, own: ElementSets, name: str, ids: Ints, start: int, unknown: dict[str, None]
) -> None:
    """Add the cells of a set of one body to what has been found under a key."""
    try:
        found.setdefault(key, []).append(start + np.flatnonzero(np.isin(ids, own.find_elements(name))))
    except MeshError:
        found[key].append(np.zeros(0, dtype=np.int64))
        unknown[key] = None


def _read_set(keyword: Keyword) -> list[Ints | str]:
    """Return the numbers and names in *ELSET; raises MeshError."""
    if "GENERATE" in keyword.options:
        ranges: list[Ints | str] = []
        for row in read_numbers(keyword):
            first, last, step = (int(value) for value in np.pad(row, (0, 3))[:3])
            if last < first or step < 0 or last - first > _MOST_ELEMENTS:
                raise keyword.make_error(f"from {first} to {last} in steps of {step} is not possible")
            ranges.append(np.arange(first, last + 1, step or 1))
        return ranges
    try:
        numbers = read_numbers(keyword)
        return [numbers[numbers > 0].astype(np.int64)]
    except MeshError:  # names of sets among the numbers
        entries = [entry.strip().strip('"') for line in keyword.lines for entry in line.split(",")]
    plain = [int(entry) for entry in entries if entry.isdecimal()]
    return [np.array(plain, dtype=np.int64), *(entry for entry in entries if entry and not entry.isdecimal())]
