"""The variables that make a dataset a series of a body: names, units, and the rest mesh that they describe."""

from typing import TYPE_CHECKING

from pipeline.errors import MeshError, SeriesError
from pipeline.mesh.simplex import Mesh
from pipeline.run.measures import STEPS, VARIABLES, make_attributes

if TYPE_CHECKING:
    import xarray

ATTRIBUTES = "dataset_attributes"  # field data of the first frame: the dataset's and its variables' attributes as JSON
STATIC = ("rest_position", "connectivity")
_REQUIRED = (*STATIC, "displacement")
# unit and long_name of fields that are not in VARIABLES
_FIELDS = {
    "rest_position": ("m", "position at rest"),
    "displacement": ("m", "position minus rest position"),
    "velocity": ("m s-1", "velocity"),
    "volume": ("m3", "signed volume"),
    "connectivity": ("1", "nodes of the cell, counted from 0"),
}


def describe_field(name: str, dimension: int) -> dict[str, str]:
    """Return the CF attributes of a field; a foreign field has no units because they are unknown."""
    if name in VARIABLES or name in STEPS:
        return make_attributes(name, dimension)
    if name in _FIELDS:
        unit, text = _FIELDS[name]
        return {"units": "m2" if (unit, dimension) == ("m3", 2) else unit, "long_name": text}
    return {"long_name": name}


def read_mesh(dataset: "xarray.Dataset") -> Mesh:
    """Return the rest mesh of a dataset; raises SeriesError if it has none."""
    missing = [name for name in _REQUIRED if name not in dataset]
    if missing:
        raise SeriesError(f"the dataset is not a series of a body: it has no {', '.join(missing)}")
    cells = dataset["connectivity"].values
    try:
        return Mesh(dataset["rest_position"].values[:, : cells.shape[1] - 1], cells, name="rest state")
    except MeshError as error:
        raise SeriesError(str(error)) from error
