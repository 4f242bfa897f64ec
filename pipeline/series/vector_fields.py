"""Point fields that may be a displacement: vectors, and scalars that together are the components of one."""

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.grid import Grid

# parts of names that say "displacement", in lower case, and whole names that say it
_CLEAR_PARTS, _CLEAR_NAMES = ("displ", "depl", "verschieb"), ("disp", "deformation")
# names of displacements that other programs give to velocities
_SHORT_NAMES = ("u", "uh", "u_h", "d", "dh", "d_h")
# parts of the names of other vectors; those of stresses end with letters of axes, like components
_OTHERS = (
    "veloc", "acceler", "force", "normal", "reaction", "load", "momentum", "traction", "rest_", "stress", "strain",
    "sigma", "epsilon", "grad", "flux", "rotation", "angular", "old", "prev", "incr", "delta", "rate", "error",
    "residual",
)  # fmt: skip
_COMPONENT = re.compile(r"^(.+?)[ _.:\-\[(]*(?:comp(?:onent)?[_ ]*)?([xyz0-3])[\])]?$", re.IGNORECASE)
_AXES = (("x", "y", "z"), ("0", "1", "2"), ("1", "2", "3"))


class VectorField(NamedTuple):
    """A vector at points: one point field, or the scalar fields of its components."""

    names: tuple[str, ...]
    stem: str  # the name, without that of the axis

    @property
    def label(self) -> str:
        """Return the name for messages, which the option `displacement` accepts too."""
        return ",".join(self.names)

    @property
    def _bare_name(self) -> str:
        """Return the stem in lower case; readers of Exodus join disp_x, disp_y and disp_z to the vector disp_."""
        return self.stem.lower().rstrip("_.:- ")

    @property
    def is_clear(self) -> bool:
        """Return whether the name can only mean a displacement."""
        name = self._bare_name
        return not self.is_other and (name in _CLEAR_NAMES or any(part in name for part in _CLEAR_PARTS))

    @property
    def is_short(self) -> bool:
        """Return whether the name is one that some programs give to displacements and others to velocities."""
        return self._bare_name in _SHORT_NAMES

    @property
    def is_other(self) -> bool:
        """Return whether the name says that the vector is not a displacement."""
        name = self.stem.lower()
        return any(part in name for part in _OTHERS)

    def is_in(self, grid: Grid) -> bool:
        """Return whether a grid has the field."""
        return all(name in grid.point_data for name in self.names)

    def read(self, grid: Grid) -> Floats:
        """Return the vectors (n, 3) at the points of a grid; zero if the grid does not have the field."""
        out = np.zeros((grid.count, 3))
        if not self.is_in(grid):
            return out
        if len(self.names) > 1:
            for axis, name in enumerate(self.names):
                out[:, axis] = np.asarray(grid.point_data[name], dtype=np.float64).reshape(-1)
            return out
        values = np.asarray(grid.point_data[self.names[0]], dtype=np.float64)
        columns = min(values.shape[1], 3)  # six components: translations, then rotations
        out[:, :columns] = values[:, :columns]
        return out


def list_vector_fields(grids: Iterable[Grid]) -> dict[str, VectorField]:
    """Return the vectors that may be a displacement in any of the grids, by their labels."""
    fields: dict[str, VectorField] = {}
    for grid in grids:
        for field in _iterate_vector_fields(grid):
            fields.setdefault(field.label, field)
    return fields


def find_vector_field(label: str, grids: Iterable[Grid], where: str) -> VectorField:
    """Return the field that a caller names: "u", or "ux,uy,uz"; raises SeriesError if no grid has it."""
    grids = list(grids)
    names = tuple(name.strip() for name in label.split(",")) if "," in label else (label,)
    if not any(all(name in grid.point_data for name in names) for grid in grids):
        known = sorted({name for grid in grids for name in grid.point_data})
        raise SeriesError(f"{where}: no point field {shorten(label)}; it has {join_names(known) or 'none'}")
    for grid in grids:
        shapes = [np.shape(grid.point_data[name]) for name in names if name in grid.point_data]
        for name, shape in zip(names, shapes, strict=False):
            if len(names) == 1 and (len(shape) != 2 or shape[1] not in (2, 3, 4, 6)):
                raise SeriesError(f"{where}: the point field {shorten(name)} {shape} is not a vector field")
            if len(names) > 1 and int(np.prod(shape)) != grid.count:
                raise SeriesError(f"{where}: the point field {shorten(name)} {shape} is not a component of a vector")
    if len(names) > 3:
        raise SeriesError(f"{where}: displacement = {shorten(label)} names {len(names)} components, not 2 or 3")
    return VectorField(names, names[0])


def _iterate_vector_fields(grid: Grid) -> Iterator[VectorField]:
    stems: dict[str, dict[str, str]] = {}
    for name in grid.point_data:
        try:
            values = grid.point_data[name]
        except SeriesError:  # a damaged field leaves the others readable
            continue
        if values.dtype.kind not in "fiu":
            continue
        field = VectorField((name,), name)
        if values.ndim == 2 and (values.shape[1] in (2, 3) or (values.shape[1] in (4, 6) and field.is_clear)):
            yield field
        elif values.size == grid.count and (match := _COMPONENT.match(name)):
            stems.setdefault(match[1], {})[match[2].lower()] = name
    for stem, components in stems.items():
        names = next((tuple(components[a] for a in axes if a in components) for axes in _AXES
                      if set(components) in (set(axes), set(axes[:2]))), None)  # fmt: skip
        field = VectorField(names or (), stem)
        if names and (field.is_clear or field.is_short):
            yield field
