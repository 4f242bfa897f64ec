"""Names, units and attributes of the fields in a dataset of a moving body."""

from typing import Any

import numpy as np

from pipeline.formats.grid import Grid
from pipeline.run.measures import STEPS, VARIABLES, make_attributes

ATTRIBUTES = "dataset_attributes"  # field data of exported frames: the attributes as JSON in the first
LOCATIONS = {2: "face", 3: "volume"}  # UGRID's word for the cells of each dimension
# dimension, unit and long_name of fields that are not in VARIABLES
_FIELDS = {
    "displacement": ("node", "m", "position minus rest position"),
    "velocity": ("node", "m s-1", "velocity"),
    "volume": ("cell", "m3", "signed volume"),
    "inverted": ("cell", "1", "det F is zero or less somewhere in the cell"),
}


def is_exported(grid: Grid) -> bool:
    """Return whether a frame is as write_pvd_series wrote it, and no other program has moved its points since."""
    fields = grid.point_data
    if ATTRIBUTES not in grid.field_data or not {"rest_position", "displacement"}.issubset(fields):
        return False
    rest, displacement = fields["rest_position"], fields["displacement"]
    return rest.shape == displacement.shape and np.array_equal(grid.points, rest + displacement, equal_nan=True)


def describe_field(name: str, dims: tuple[str, ...], dimension: int) -> dict[str, Any]:
    """Return the CF attributes of a field, and the place on the mesh that it belongs to.

    `dims` are its dimensions after time. A field of another program has no units because they are unknown.
    """
    place = {"node": "node", "cell": LOCATIONS[dimension]}.get(dims[0] if dims else "")
    where = {"mesh": "mesh", "location": place} if place else {}
    if name in STEPS and dims == ("step_of_frame",):
        return make_attributes(name, dimension)
    if name in VARIABLES and dims == VARIABLES[name].dims:
        return make_attributes(name, dimension) | where
    if name in _FIELDS and _FIELDS[name][0] in dims:
        _, unit, text = _FIELDS[name]
        return {"units": "m2" if (unit, dimension) == ("m3", 2) else unit, "long_name": text, **where}
    return {"long_name": name, **where}
