"""The rest mesh as variables of a dataset: cells of any kind, described as a topology of UGRID 1.0; and back.

`connectivity` (cell, corner) has the nodes of each cell in VTK's order, -1 beyond its last, and `cell_type` (cell) the
number of its kind in VTK. Polyhedra have their faces in `face_connectivity` and `face_cell` too. `mesh` tells other
programs how these belong together (https://ugrid-conventions.github.io/ugrid-conventions/).
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.errors import MeshError, SeriesError
from pipeline.formats.cell_kinds import TYPES
from pipeline.formats.cell_types import CELL_TYPES
from pipeline.formats.grid import CellArray, PolyhedronFaces
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.mesh.cell_mesh import CellMesh
from pipeline.mesh.shape_functions import find_kind
from pipeline.mesh.simplex import Mesh
from pipeline.run.measures import AXES, pad_to_space

if TYPE_CHECKING:
    import xarray

MESH_VARIABLES = (
    "rest_position", "connectivity", "cell_type", "mesh", "plane", "face_nodes", "face_connectivity", "face_cell",
)  # fmt: skip
NODE_COORDINATES = tuple(f"node_{axis}" for axis in AXES)
# dimensions of all datasets and variables of most of them: a field of a file cannot have such a name
RESERVED = frozenset(
    {"time", "node", "cell", "axis", "corner", "quantile", "step_of_frame", "displacement", "rest_position",
     "connectivity", "cell_type", "mesh", *NODE_COORDINATES}
)  # fmt: skip
_MISSING = -1
_ROUNDING = 1e-9  # of natural coordinates
MeshVariable = tuple[tuple[str, ...], Any, dict[str, Any], dict[str, Any]]  # dimensions, values, attributes, encoding


class MeshDescription(NamedTuple):
    """The variables and coordinates of a dataset that describe its mesh, by name."""

    variables: dict[str, MeshVariable]
    coordinates: dict[str, MeshVariable]


def describe_mesh(mesh: BodyMesh) -> MeshDescription:
    """Return the variables and coordinates from which `read_mesh` makes the mesh again."""
    cells, rest = mesh.cell_array, pad_to_space(mesh.points)
    corners = _pad_rows(cells.offsets, cells.connectivity)
    names = NODE_COORDINATES[: mesh.points.shape[1]]
    topology: dict[str, Any] = {
        "cf_role": "mesh_topology", "long_name": "topology of the body at rest", "topology_dimension": mesh.dimension,
        "node_coordinates": " ".join(names), "node_dimension": "node",
    }  # fmt: skip
    variables: dict[str, MeshVariable] = {
        "rest_position": (("node", "axis"), rest, _attribute_field("position at rest", "m", "node"), {})
    }
    if mesh.dimension == 2:
        topology["face_dimension"] = "cell"
        rings = _order_rings(cells, corners)
        role, other = ("face_node_connectivity", "") if rings is corners else ("", "face_node_connectivity")
        if rings is not corners:
            topology[other] = "face_nodes"
            variables["face_nodes"] = _index_nodes(("cell", "corner"), rings, "nodes around the cell, in order", other)
    else:
        role = "volume_node_connectivity"
        topology |= {"volume_dimension": "cell", "volume_shape_type": "cell_type"}
        if cells.faces is not None:
            topology["face_node_connectivity"] = "face_connectivity"
            variables |= _describe_faces(cells.faces)
    topology |= {role: "connectivity"} if role else {}
    variables["connectivity"] = _index_nodes(("cell", "corner"), corners, "nodes of the cell, in VTK's order", role)
    if isinstance(mesh, CellMesh) and mesh.plane is not None:
        text = {"long_name": "unit vectors along and across the plane of the body", "units": "1"}
        variables["plane"] = (("plane_axis", "axis"), mesh.plane, text, {})
    variables["mesh"] = ((), np.int32(0), topology, {})
    coordinates = {name: _describe_coordinate(i, rest) for i, name in enumerate(names)}
    return MeshDescription(variables, coordinates | {"cell_type": _describe_kinds(cells.types)})


def _describe_coordinate(i: int, rest: Floats) -> MeshVariable:
    """Return a coordinate of the nodes at rest."""
    attributes = {"units": "m", "long_name": f"{AXES[i]} at rest", "axis": AXES[i].upper()}
    if AXES[i] == "z":  # CF has no standard name for a third coordinate without an earth
        attributes["positive"] = "up"
    else:
        attributes["standard_name"] = f"projection_{AXES[i]}_coordinate"
    return ("node",), rest[:, i], attributes, {"_FillValue": None}


def _attribute_field(text: str, units: str, location: str) -> dict[str, Any]:
    return {"units": units, "long_name": text, "mesh": "mesh", "location": location}


def _index_nodes(dims: tuple[str, ...], nodes: Ints, text: str, role: str) -> MeshVariable:
    """Return a variable of node numbers, integers with their fill value as an attribute, as if read without masks."""
    attributes: dict[str, Any] = {"long_name": text, "start_index": 0}
    attributes |= {"_FillValue": _MISSING} if (nodes < 0).any() else {}
    return dims, nodes, attributes | ({"cf_role": role} if role else {}), {}


def _describe_kinds(types: NDArray[np.uint8]) -> MeshVariable:
    kinds = np.unique(types)
    attributes = {
        "long_name": "kind of the cell, by VTK's number",
        "flag_values": kinds if len(kinds) > 1 else kinds[0],  # as netCDF gives it back
        "flag_meanings": " ".join(TYPES[kind].name.lower().replace(" ", "_") for kind in kinds.tolist()),
    }
    return ("cell",), types, attributes, {}


def _describe_faces(faces: PolyhedronFaces) -> dict[str, MeshVariable]:
    """Return the nodes of each face of the polyhedra, and the cell that it belongs to."""
    cells = np.repeat(np.arange(len(faces.cell_offsets) - 1), np.diff(faces.cell_offsets))
    nodes = _pad_rows(faces.offsets, faces.connectivity)
    role = "face_node_connectivity"
    text = {"long_name": "polyhedron that the face belongs to", "start_index": 0}
    return {
        "face_connectivity": _index_nodes(("face", "face_corner"), nodes, "nodes of the faces of polyhedra", role),
        "face_cell": (("face",), cells, text, {}),
    }


def _pad_rows(offsets: Ints, values: Ints) -> Ints:
    """Return rows of different lengths as one array, -1 beyond their ends."""
    lengths = np.diff(offsets)
    width = int(lengths.max(initial=0))
    if len(lengths) and (lengths == width).all():
        return np.array(values, dtype=np.int64).reshape(-1, width)
    rows = np.full((len(lengths), width), _MISSING, dtype=np.int64)
    rows[np.arange(width) < lengths[:, None]] = values
    return rows


def _unpad_rows(rows: NDArray[Any]) -> tuple[Ints, Ints]:
    """Return offsets and values of padded rows; a dataset that was in a file has NaN instead of -1."""
    rows = np.where(np.isnan(rows), _MISSING, rows) if rows.dtype.kind == "f" else rows
    present = rows >= 0
    offsets = np.concatenate([[0], np.cumsum(present.sum(axis=1))]).astype(np.int64)
    return offsets, rows[present].astype(np.int64)


def _order_rings(cells: CellArray, corners: Ints) -> Ints:
    """Return the nodes around each planar cell in order; the corners themselves if they are in order."""
    groups = np.unique(np.column_stack([cells.types, np.diff(cells.offsets)]), axis=0).tolist()
    places = {(kind, count): _find_ring(kind, count) for kind, count in groups}
    if all(ring.tolist() == list(range(count)) for (_, count), ring in places.items()):
        return corners
    rings, lengths = np.full_like(corners, _MISSING), np.diff(cells.offsets)
    for (kind, count), ring in places.items():
        chosen = np.flatnonzero((cells.types == kind) & (lengths == count))
        rings[chosen[:, None], np.arange(len(ring))] = corners[chosen[:, None], ring]
    return rings


def _find_ring(cell_type: int, count: int) -> Ints:
    """Return the places of the nodes around a planar cell in its list of nodes, in order, from its first corner on."""
    if TYPES[cell_type].faceted:
        return np.arange(count)
    kind = find_kind(cell_type, count)
    edges = (
        [*kind.nodes.T, 1 - kind.nodes.sum(axis=1)] if kind.shape == "triangle" else [*kind.nodes.T, *1 - kind.nodes.T]
    )
    around = np.flatnonzero(np.min(np.abs(edges), axis=0) < _ROUNDING)
    x, y = (kind.nodes[around] - kind.nodes[kind.corners].mean(axis=0)).T
    ring = around[np.argsort(np.arctan2(y, x))]
    return np.roll(ring, -int(np.flatnonzero(ring == kind.corners[0])[0])).astype(np.int64)


def read_mesh(dataset: "xarray.Dataset") -> BodyMesh:
    """Return the rest mesh of a dataset; raises SeriesError if it has none."""
    missing = [name for name in ("rest_position", "connectivity", "displacement") if name not in dataset]
    if missing:
        raise SeriesError(f"the dataset is not a series of a body: it has no {', '.join(missing)}")
    wrong = [name for name in MESH_VARIABLES if name in dataset and len(dataset[name].dims) != _count_dims(name)]
    if wrong:
        raise SeriesError(
            f"{wrong[0]} has the dimensions {', '.join(map(str, dataset[wrong[0]].dims))}: the mesh must be the same "
            "everywhere; select one of them first (isel)"
        )
    rows, rest = dataset["connectivity"].values, dataset["rest_position"].values
    offsets, nodes = _unpad_rows(rows)
    if "cell_type" in dataset:
        types = dataset["cell_type"].values.astype(np.uint8)
    else:
        types = np.full(len(rows), CELL_TYPES.get(rows.shape[1] - 1, 0), dtype=np.uint8)
    unknown = [kind for kind in np.unique(types).tolist() if kind not in TYPES]
    if unknown:
        raise SeriesError(f"cell_type {unknown[0]} is not one of VTK's")
    dimension = max((TYPES[kind].dimension for kind in np.unique(types).tolist()), default=0)
    if dimension < 2:
        raise SeriesError("the dataset has no cells that are bodies or surfaces")
    cells = CellArray(types, offsets, nodes, _read_faces(dataset, offsets, nodes))
    in_space = dimension == 3 or "plane" in dataset or "node_z" in dataset.coords
    points = rest if in_space else rest[:, :2]
    plane = dataset["plane"].values if "plane" in dataset else None
    return _make_mesh(points, cells, dimension, plane)


def _count_dims(name: str) -> int:
    return {"cell_type": 1, "face_cell": 1, "mesh": 0}.get(name, 2)


def _read_faces(dataset: "xarray.Dataset", cell_offsets: Ints, cell_nodes: Ints) -> PolyhedronFaces | None:
    """Return the faces of the polyhedra; raises SeriesError if they are not those of these cells."""
    if "face_connectivity" not in dataset or "face_cell" not in dataset:
        return None
    offsets, nodes = _unpad_rows(dataset["face_connectivity"].values)
    owners, count = dataset["face_cell"].values.astype(np.int64), len(cell_offsets) - 1
    # (cell, node) of each corner of a face must be a node of that cell
    corners = np.column_stack([np.repeat(owners, np.diff(offsets)), nodes])
    known = np.column_stack([np.repeat(np.arange(count), np.diff(cell_offsets)), cell_nodes])
    width = 1 + max(int(nodes.max(initial=0)), int(cell_nodes.max(initial=0)))
    if (np.diff(owners) < 0).any() or not np.isin(corners @ [width, 1], known @ [width, 1]).all():
        raise SeriesError("the faces are not those of the cells: choose cells with ds.deformation.extract(cells)")
    per_cell = np.bincount(owners, minlength=count)
    return PolyhedronFaces(nodes, offsets, np.concatenate([[0], np.cumsum(per_cell)]).astype(np.int64))


def select_cells(mesh: BodyMesh, chosen: Ints) -> tuple[BodyMesh, Ints]:
    """Return the mesh of some cells, in that order, with their nodes counted anew, and the nodes' old numbers.

    Raises SeriesError if there are no cells.
    """
    cells = mesh.cell_array
    offsets, connectivity = _take_rows(cells.offsets, cells.connectivity, chosen)
    nodes, connectivity = np.unique(connectivity, return_inverse=True)
    faces = None
    if cells.faces is not None:
        renumbered = np.zeros(len(mesh.points), dtype=np.int64)
        renumbered[nodes] = np.arange(len(nodes))
        cell_offsets, used = _take_rows(
            cells.faces.cell_offsets, np.arange(len(cells.faces.offsets) - 1, dtype=np.int64), chosen
        )
        face_offsets, corners = _take_rows(cells.faces.offsets, cells.faces.connectivity, used)
        faces = PolyhedronFaces(renumbered[corners], face_offsets, cell_offsets)
    part = CellArray(cells.types[chosen], offsets, connectivity.astype(np.int64, copy=False).reshape(-1), faces)
    plane = mesh.plane if isinstance(mesh, CellMesh) else None
    return _make_mesh(mesh.points[nodes], part, mesh.dimension, plane), nodes


def _take_rows(offsets: Ints, values: Ints, chosen: Ints) -> tuple[Ints, Ints]:
    """Return offsets and values of some of the rows, in that order."""
    lengths = np.diff(offsets)[chosen]
    ends = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    places = np.arange(ends[-1]) + np.repeat(offsets[:-1][chosen] - ends[:-1], lengths)
    return ends, values[places]


def _make_mesh(points: Floats, cells: CellArray, dimension: int, plane: Floats | None) -> BodyMesh:
    """Return a Mesh if all cells are linear simplices with as many coordinates as dimensions, else a CellMesh."""
    try:
        if points.shape[1] == dimension and (cells.types == CELL_TYPES[dimension]).all():
            return Mesh(points, cells.connectivity.reshape(len(cells.types), dimension + 1), name="rest state")
        return CellMesh(np.ascontiguousarray(points), cells, dimension, plane, name="rest state")
    except MeshError as error:
        raise SeriesError(str(error)) from error
