"""The point fields of a grid that may be a displacement: vectors, the first components of wider ones, three scalars.

A name alone decides nothing, but it says which fields may be asked about: `clear` names speak of a displacement in
one of the languages of solvers, `short` ones (u, U, D, …) are a displacement in one program and a velocity in another.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.arrays import Floats
from pipeline.formats.grid import Grid, describe_arrays

Role = Literal["clear", "short", "vague", "derived", "other"]

_WIDTHS = (2, 3, 4, 6)  # plane, space, homogeneous, and shells: three translations, then three rotations
_CLEAR = ("displ", "depla", "depl", "deform", "verschieb", "desplaz", "deslocament", "spostament", "verplaats")
_SHORT = re.compile(r"(u|d)(|h|_h|n|_n|_new|vec|_vec|sol|_sol|_?\d+)|uvw|u_?h?_?(vector|solid)")
# numbers derived from a displacement, or of another one than the body's
_DERIVED = (
    "rate", "incr", "delta", "magn", "grad", "error", "resid", "prescr", "impos", "target", "test", "veloc", "accel",
    "old", "prev", "dot", "virtual", "dual", "adjoint", "constr", "rotation", "slip", "jump", "mean", "averag",
)  # fmt: skip
# vector fields that are no displacements
_OTHERS = (
    "veloc", "accel", "force", "normal", "reaction", "load", "moment", "traction", "rest_", "flux", "flow", "stress",
    "strain", "grad", "fiber", "fibre", "orient", "direction", "axis", "color", "colour", "texture", "coord", "posit",
    "magnet", "electric", "current", "vorticity", "curl", "resid", "rotation", "angle", "spin", "tangent", "contact",
    "torque", "eigen", "heat", "rgb", "body_f", "gravity", "weight", "pressure", "energy", "sigma", "ids",
)  # fmt: skip
_OTHER_SHORT = {"v", "a", "f_ext", "fext", "fint", "rf", "n", "nu", "t", "p", "vel", "acc", "du", "vx", "q", "b", "e"}
_FLOW = re.compile(
    r"p|p_?h|p_rgh|pressure.*|pression|druck|nut|nutilda|wallshearstress|mach|alpha\..*|y_?plus|vorticity|q_?criterion"
)
_AXES = (("x", "y", "z"), ("0", "1", "2"), ("1", "2", "3"))


@dataclass(frozen=True)
class VectorField:
    """A vector of the points: `columns` are the array and component that hold each of its two or three components."""

    name: str
    columns: tuple[tuple[str, int], ...]
    role: Role

    def is_in(self, grid: Grid) -> bool:
        """Return whether a grid has the field."""
        return all(source in grid.point_data for source, _ in self.columns)

    def read(self, grid: Grid) -> Floats | None:
        """Return the vectors (n, 3) of a grid, or None if it lacks a component."""
        vectors, loaded = np.zeros((grid.count, 3)), dict[str, np.ndarray]()
        for i, (source, component) in enumerate(self.columns):
            if source not in grid.point_data:
                return None
            if source not in loaded:
                loaded[source] = np.asarray(grid.point_data[source], dtype=np.float64).reshape(grid.count, -1)
            if component >= loaded[source].shape[1]:
                return None
            vectors[:, i] = loaded[source][:, component]
        return vectors


def find_vector_fields(grid: Grid) -> dict[str, VectorField]:
    """Return the fields by name that may be vectors of the points, whatever they mean."""
    shapes = {
        name: shape
        for name, (dtype, shape) in describe_arrays(grid.point_data).items()
        if dtype.kind in "fiu" and shape and shape[0] == grid.count
    }
    fields = dict[str, VectorField]()
    for name, shape in shapes.items():
        width = int(np.prod(shape[1:], dtype=np.int64))
        if (
            len(shape) == 2
            and width in _WIDTHS
            and not (width in (4, 6) and find_role(name) in ("other", "vague", "derived"))
        ):
            columns = tuple((name, i) for i in range(min(width, 3)))
            fields[name] = VectorField(name, columns, find_role(name))
    scalars = [name for name, shape in shapes.items() if len(shape) == 1 or shape[1:] == (1,)]
    for field in _join_scalars(scalars):
        fields.setdefault(field.name, field)
    return fields


def select_named_field(grid: Grid, text: str) -> VectorField | None:
    """Return the field that a user named: an array, or two or three arrays separated by commas; None if there is none.

    The array may have any number of components from two on; the first three count.
    """
    shapes = {name: shape for name, (_, shape) in describe_arrays(grid.point_data).items()}
    if text in shapes:
        shape = shapes[text]
        if len(shape) < 2 or shape[1] < 2:
            return None
        return VectorField(text, tuple((text, i) for i in range(min(shape[1], 3))), "clear")
    if (known := find_vector_fields(grid).get(text)) is not None:
        return VectorField(known.name, known.columns, "clear")
    names = [name.strip() for name in text.split(",")]
    if len(names) in (2, 3) and all(name in shapes and int(np.prod(shapes[name][1:])) == 1 for name in names):
        return VectorField(text, tuple((name, 0) for name in names), "clear")
    return None


def find_role(name: str) -> Role:
    """Return how a name speaks of a displacement."""
    lower = name.lower()
    words = set(re.split(r"[^a-z]+", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()))
    if any(word in lower for word in _CLEAR) or "disp" in words or re.fullmatch(r"(u_)?disp(_?\w)?", lower):
        derived = any(word in lower for word in _DERIVED) or bool(words & {"real", "imag", "phase", "mode"})
        return "derived" if derived else "clear"
    if any(word in lower for word in _OTHERS) or lower in _OTHER_SHORT:
        return "other"
    return "short" if _SHORT.fullmatch(lower) else "vague"


def find_unusable_fields(grid: Grid) -> list[str]:
    """Return the names of point fields that speak of a displacement, are no vectors and are not zero."""
    used = {source for vector in find_vector_fields(grid).values() for source, _ in vector.columns}
    names = []
    for name, (dtype, shape) in describe_arrays(grid.point_data).items():
        stem = re.sub(r"[ _:.-]*[xyz]$", "", name, flags=re.IGNORECASE)
        speaks = find_role(name) in ("clear", "derived") or (stem != name and find_role(stem) in ("clear", "short"))
        if name not in used and speaks and dtype.kind in "fiu" and shape and np.nan_to_num(grid.point_data[name]).any():
            names.append(name)
    return names


def find_cell_displacements(grid: Grid) -> list[str]:
    """Return the names of vectors at cells that may be a displacement, though cells do not say where nodes are."""
    shapes = {name: shape for name, (_, shape) in describe_arrays(grid.cell_data).items()}
    return [name for name, shape in shapes.items()
            if len(shape) == 2 and shape[1] in (2, 3) and find_role(name) in ("clear", "short")]  # fmt: skip


def find_flow_fields(names: Iterable[str]) -> list[str]:
    """Return the names that belong to a flow: beside them, U is a velocity."""
    return [name for name in names if _FLOW.fullmatch(name.lower())]


def _join_scalars(names: Sequence[str]) -> list[VectorField]:
    """Return vectors whose components are scalars of their own: disp_x, disp_y, disp_z; u1, u2, u3; U:0, U:1, U:2."""
    groups = dict[tuple[str, str, int], dict[str, str]]()
    for name in names:
        for pattern in (
            r"(?P<stem>.*?)(?P<sep>[ _:.\-\[(]*)(?P<axis>[xyz0-3])(?P<end>[\])]?)",
            r"(?P<sep>)(?P<axis>[xyz])[_\-. ]?(?P<stem>.+)(?P<end>)",
        ):
            match = re.fullmatch(pattern, name, flags=re.IGNORECASE)
            if match and match["stem"]:
                key = (match["stem"].lower(), match["sep"] + match["end"], len(pattern))
                groups.setdefault(key, {})[match["axis"].lower()] = name
    vectors = list[VectorField]()
    for (stem, _, _), members in groups.items():
        for axes in _AXES:
            chosen = [members[axis] for axis in axes if axis in members]
            if len(chosen) == len(axes) or (
                len(chosen) == 2 and axes[2] not in members and axes[0] in members and axes[1] in members
            ):
                role = find_role(stem)
                if role in ("clear", "short"):
                    text = ",".join(chosen)
                    vectors.append(VectorField(text, tuple((name, 0) for name in chosen), role))
                break
    names_uvw = {name.lower(): name for name in names}
    for triple in (("ux", "uy", "uz"), ("u", "v", "w")):
        if all(axis in names_uvw for axis in triple):
            text = ",".join(names_uvw[axis] for axis in triple)
            if all(text != vector.name for vector in vectors):
                vectors.append(VectorField(text, tuple((names_uvw[axis], 0) for axis in triple), "short"))
    return vectors
