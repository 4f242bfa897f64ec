"""MED files (.med, .rmed) of Code_Aster and Salome: HDF5 in the layout of MED 3 and 4.

Arrays hold one component after the other. MED numbers the nodes of solids in the mirrored order of VTK.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import SeriesError, join_names, shorten
from pipeline.formats.cell_types import find_cell_fault
from pipeline.formats.grid import Grid

_NO_PROFILE = "MED_NO_PROFILE_INTERNAL"
# MED's name of a type: VTK's type, and the order in which VTK has MED's nodes
_TYPES: dict[str, tuple[int, tuple[int, ...]]] = {
    "PO1": (1, (0,)), "SE2": (3, (0, 1)), "SE3": (21, (0, 1, 2)), "TR3": (5, (0, 1, 2)), "TR6": (22, tuple(range(6))),
    "TR7": (34, tuple(range(7))), "QU4": (9, tuple(range(4))), "QU8": (23, tuple(range(8))),
    "QU9": (28, tuple(range(9))), "TE4": (10, (0, 2, 1, 3)), "T10": (24, (0, 2, 1, 3, 6, 5, 4, 7, 9, 8)),
    "PY5": (14, (0, 3, 2, 1, 4)), "P13": (27, (0, 3, 2, 1, 4, 8, 7, 6, 5, 9, 12, 11, 10)),
    "PE6": (13, (0, 2, 1, 3, 5, 4)), "P15": (26, (0, 2, 1, 3, 5, 4, 8, 7, 6, 11, 10, 9, 12, 14, 13)),
    "HE8": (12, (0, 3, 2, 1, 4, 7, 6, 5)),
    "H20": (25, (0, 3, 2, 1, 4, 7, 6, 5, 11, 10, 9, 8, 15, 14, 13, 12, 16, 19, 18, 17)),
}  # fmt: skip
_LONG_NAMES = {"TE10": "T10", "PY13": "P13", "PE15": "P15", "HE20": "H20"}


def read_med(file: Path, step: int) -> Grid:
    """Return the mesh and the fields of one instant; raises SeriesError."""
    with _open(file) as stored:
        instants = _list_instants(stored)
        keys = instants[step][1] if instants else {}
        mesh, notes = _find_mesh(stored)
        points = _read_points(mesh)
        kinds = _list_kinds(mesh)
        types = np.concatenate([np.full(len(nodes), _TYPES[name][0], dtype=np.uint8) for name, nodes in kinds])
        sizes = np.concatenate([np.full(len(nodes), nodes.shape[1], dtype=np.int64) for _, nodes in kinds])
        offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        connectivity = np.concatenate([nodes.ravel() for _, nodes in kinds])
        if fault := find_cell_fault(types, offsets, len(connectivity)):
            raise ValueError(fault)
        if connectivity.min() < 0 or connectivity.max() >= len(points):
            raise ValueError(f"a cell refers to point {connectivity.max() + 1} of {len(points)}")
        nodal, cellular = dict[str, NDArray[Any]](), dict[str, NDArray[Any]]()
        for name, key in keys.items():
            field = stored["CHA"][name]
            _read_field(stored, field, field[key], name, len(points), kinds, nodal, cellular, notes)
        return Grid(points, len(points), types, offsets, connectivity, nodal, cellular, {}, notes=tuple(notes))


def read_med_times(file: Path) -> list[float] | None:
    """Return the times [s] of the instants, None if there are no fields; raises SeriesError."""
    with _open(file) as stored:
        return [time for time, _ in _list_instants(stored)] or None


@contextmanager
def _open(file: Path) -> Iterator[Any]:
    try:
        import h5py
    except ModuleNotFoundError as error:
        raise SeriesError(f"{file}: MED files are HDF5 files; pip install {error.name}") from error
    try:
        with h5py.File(file, "r", locking=False) as stored:
            if "ENS_MAA" not in stored:
                raise ValueError("it has no meshes (ENS_MAA), as MED files do")
            yield stored
    except (ValueError, KeyError, IndexError, OSError, AttributeError, TypeError) as error:
        raise SeriesError(f"{file}: cannot be read: {shorten(' '.join(str(error).split()), 300)}") from error


def _list_instants(stored: Any) -> list[tuple[float, dict[str, str]]]:
    """Return the time of each instant in order, and the group of each field that has it."""
    found: dict[tuple[int, int], tuple[float, dict[str, str]]] = {}
    for name in stored.get("CHA", {}):
        for key, group in stored["CHA"][name].items():
            number = int(group.attrs["NDT"]), int(group.attrs["NOR"])
            time, keys = found.setdefault(number, (float(group.attrs["PDT"]), {}))
            if time != float(group.attrs["PDT"]):
                raise ValueError(f"its fields have different times of step {number[0]}: {time:g} and another one")
            keys[name] = key
    return [found[number] for number in sorted(found)]


def _find_mesh(stored: Any) -> tuple[Any, list[str]]:
    """Return the group of the mesh (of its only instant), and notes."""
    meshes = stored["ENS_MAA"]
    if len(meshes) != 1:
        raise ValueError(f"it has {len(meshes)} meshes ({join_names(meshes)}); keep one in a file")
    mesh = next(iter(meshes.values()))
    if "NOE" in mesh:  # MED 2
        return mesh, []
    if len(mesh) != 1:
        raise ValueError(f"its mesh has {len(mesh)} instants of its own, which is not read")
    inner = next(iter(mesh.values()))
    return inner, []


def _read_points(mesh: Any) -> NDArray[np.float64]:
    dataset = mesh["NOE"]["COO"]
    count = int(dataset.attrs["NBR"])
    if not count or dataset.size % count or dataset.size // count > 3:
        raise ValueError(f"it declares {count} nodes and has {dataset.size} coordinates")
    points = dataset[()].astype(np.float64).reshape(-1, count).T
    return np.ascontiguousarray(np.pad(points, [(0, 0), (0, 3 - points.shape[1])]))


def _list_kinds(mesh: Any) -> list[tuple[str, NDArray[np.int64]]]:
    """Return the kinds of cells and their nodes (e, k) in VTK's order, counted from 0."""
    kinds = []
    for name, group in mesh.get("MAI", {}).items():
        short = _LONG_NAMES.get(name, name)
        if short not in _TYPES:
            raise ValueError(f"it has cells of the type {shorten(name)}, which are not read")
        dataset, order = group["NOD"], _TYPES[short][1]
        if dataset.size % len(order):
            raise ValueError(f"it has {dataset.size} nodes of {name} cells, {len(order)} of them a cell")
        nodes = dataset[()].astype(np.int64).reshape(len(order), -1).T[:, list(order)] - 1
        kinds.append((short, nodes))
    if not kinds:
        raise ValueError("it has no cells")
    return kinds


def _read_field(
    stored: Any, field: Any, instant: Any, name: str, points: int, kinds: list[tuple[str, NDArray[np.int64]]],
    nodal: dict[str, NDArray[Any]], cellular: dict[str, NDArray[Any]], notes: list[str],
) -> None:  # fmt: skip
    """Add the values of a field at nodes or cells; other places get a note."""
    components = int(field.attrs["NCO"])
    starts = np.cumsum([0, *(len(nodes) for _, nodes in kinds)])
    places = {_LONG_NAMES.get(kind, kind): i for i, (kind, _) in enumerate(kinds)}
    at_cells = np.full((int(starts[-1]), components), np.nan)
    found = False
    for place, group in instant.items():
        center, _, kind = place.partition(".")
        kind = _LONG_NAMES.get(kind, kind)
        if center == "NOE" and not kind:
            nodal[name] = _squeeze(_read_profiles(stored, group, points, components, name))
        elif center == "MAI" and kind in places and all(int(p.attrs.get("NGA", 1)) == 1 for p in group.values()):
            i = places[kind]
            rows = _read_profiles(stored, group, len(kinds[i][1]), components, name)
            at_cells[starts[i] : starts[i + 1]], found = rows, True
        else:
            notes.append(f"the field {shorten(name)} at {shorten(place)} (points in cells) is not read")
    if found:
        cellular[name] = _squeeze(at_cells)


def _read_profiles(stored: Any, group: Any, count: int, components: int, name: str) -> NDArray[np.float64]:
    """Return values (count, components), NaN where the field has none."""
    values = np.full((count, components), np.nan)
    for profile, part in group.items():
        dataset = part["CO"]
        size = int(part.attrs["NBR"])
        if dataset.size != size * components or size > count:
            raise ValueError(f"the field {shorten(name)} has {dataset.size} values for {size} of {count} places")
        numbers = np.arange(size) if profile == _NO_PROFILE else stored["PROFILS"][profile]["PFL"][()].ravel() - 1
        if len(numbers) != size or (size and (numbers.min() < 0 or numbers.max() >= count)):
            raise ValueError(f"the profile {shorten(profile)} of the field {shorten(name)} does not fit")
        values[numbers] = dataset[()].reshape(components, size).T
    return values


def _squeeze(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[:, 0] if values.shape[1] == 1 else values
