"""Names, units and attributes of the fields in a dataset of a moving body."""

from typing import Any

from pipeline.run.measures import STEPS, VARIABLES, make_attributes

ATTRIBUTES = "dataset_attributes"  # field data of the first frame: the dataset's and its variables' attributes as JSON
LOCATIONS = {2: "face", 3: "volume"}  # UGRID's word for the cells of each dimension
# dimension, unit and long_name of fields that are not in VARIABLES
_FIELDS = {
    "displacement": ("node", "m", "position minus rest position"),
    "velocity": ("node", "m s-1", "velocity"),
    "volume": ("cell", "m3", "signed volume"),
    "inverted": ("cell", "1", "det F is zero or less somewhere in the cell"),
}


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
