"""The groups and fields of cells that a mesh file has: they choose the cells of materials."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import Ints
from pipeline.errors import MeshError, join_names, quote_value

_SHOWN = 12  # values of a field in an error


@dataclass(frozen=True, eq=False)
class Regions:
    """Sets of the cells that a file lists, by name and number, and whole numbers of these cells by the field's name.

    `places` (listed,) are the cells of the mesh that are those of the file: a file may list a cell several times, in
    several groups. Each of them has been cut into `children` cells. `note` is that of the mesh about its regions.
    """

    groups: Sequence[tuple[str, str, Ints]]
    fields: Mapping[str, Ints]
    places: Ints
    children: int = 1
    note: str = ""

    def refine(self, children: int) -> "Regions":
        """Return the regions of the mesh in which each cell has become that many, one after the other."""
        return replace(self, children=self.children * children)

    def find_group(self, name: str) -> Ints:
        """Return the cells of a group, by its name or its number; raises MeshError if there is none, or several."""
        by_name = [cells for own, _, cells in self.groups if own == name]
        by_number = [cells for _, number, cells in self.groups if number == name]
        in_other_case = [cells for own, _, cells in self.groups if own.casefold() == name.casefold()]
        found = by_name or by_number or in_other_case
        if not found:
            raise MeshError(f"{quote_value(name)} is not a group; {_list_choices('groups', self._list_groups())}")
        if len(found) > 1:
            raise MeshError(f"{len(found)} groups are called {quote_value(name)}: {join_names(self._list_groups())}")
        return self._find_cells(found[0])

    def find_values(self, name: str, value: int) -> Ints:
        """Return the cells in which a field is exactly the value; raises MeshError if there are none."""
        if name not in self.fields:
            have = _list_choices("fields of whole numbers on cells", self.fields)
            raise MeshError(f"{quote_value(name)} is not a field of whole numbers on cells; {have}")
        values = self.fields[name]
        cells = np.flatnonzero(values == value)
        if not cells.size:
            known = np.unique(values).tolist()
            shown = ", ".join(str(number) for number in known[:_SHOWN]) + (", …" if len(known) > _SHOWN else "")
            raise MeshError(f"no cell has {value} in {quote_value(name)}; its values are {shown}")
        return self._find_cells(cells)

    def _find_cells(self, listed: Ints) -> Ints:
        if listed.min() < 0 or listed.max() >= len(self.places):
            raise MeshError(f"the file has {len(self.places)} cells, and none with the number {listed.max()}")
        cells = np.unique(self.places[listed])
        return np.asarray((self.children * cells[:, None] + np.arange(self.children)).ravel())

    def _list_groups(self) -> list[str]:
        return [
            name if not number or name.endswith(number) else f"{name} ({number})" for name, number, _ in self.groups
        ]


def _list_choices(kind: str, names: Iterable[str]) -> str:
    names = list(names)
    return f"the {kind} are {join_names(names)}" if names else f"the file has no {kind}"
