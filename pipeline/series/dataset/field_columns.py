"""The columns of a dataset: a field of the files each, with its name, dimensions and attributes there."""

from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.errors import SeriesError
from pipeline.formats.grid import Grid
from pipeline.run.measures import STEPS, VARIABLES
from pipeline.series.dataset.agreement import MEASURED, find_agreeing
from pipeline.series.dataset.attributes import ATTRIBUTES, describe_field
from pipeline.series.dataset.field_names import KINDS, choose_names
from pipeline.series.dataset.field_table import FieldForm, choose_frames, describe_missing, list_forms
from pipeline.series.dataset.frame_store import FieldColumn, FrameStore

_HIDDEN = {("field", "TimeValue"), ("field", ATTRIBUTES)}  # they are the coordinate time, and the attributes
_GHOSTS = "vtkGhostType"  # what it marks is left out of the mesh; in a file that we write, it would be again
_PLACES = {"point": ("node",), "cell": ("cell",), "field": ()}


def list_columns(
    store: FrameStore, taken: Collection[str], *, scan_all: bool = False
) -> tuple[list[FieldColumn], tuple[str, ...]]:
    """Return the columns of a dataset in which some names are taken, and notes on the decisions; raises SeriesError.

    Frames of our own all have the same fields: the first and the last are looked at.
    """
    series, first = store.series, store.read_grid(0)
    own = series.ours or series.layout.trusted
    count = len(series)
    sample = [0, count - 1] if own else choose_frames(count, first, store.capacity)
    chosen = list(range(count)) if scan_all else sorted(set(sample))
    changed = list[int]()
    forms, notes = list_forms((series.files[i].name, grid) for i, grid in _iterate_frames(store, chosen, changed))
    sources = {(form.kind, form.source) for form in forms}
    known = _list_known(first) if own else find_agreeing(series, sources, _iterate_frames(store, sample))
    forms = [form for form in forms if not _is_hidden(form, known, series.layout.displacement)]
    forms.sort(key=lambda form: (form.kind, form.source) not in known)  # these keep their names
    blocked = {name for name in MEASURED if ("cell", name) not in known}
    names, name_notes = choose_names([(form.kind, form.source) for form in forms], {*taken, *blocked})
    columns = [_make_displacement(store, own=own and ("point", "displacement") in known)]
    used = {*taken, *names.values()}
    columns += [_make_column(form, names[form.kind, form.source], store, used) for form in _sort_forms(forms)]
    if not own:
        notes += [*name_notes, *describe_missing(forms), *_describe_changed(changed), *_describe_sample(chosen, count)]
    return columns, tuple(notes)


def _iterate_frames(
    store: FrameStore, chosen: list[int], changed: list[int] | None = None
) -> Iterator[tuple[int, Grid]]:
    """Yield the frames that can be read; the others are errors when their values are needed.

    Those with other cells than the mesh come without fields of points and cells, and are added to `changed`.
    """
    for index in chosen:
        with suppress(SeriesError):
            grid = store.read_grid(index)
            if store.find_arrangement(index, grid) is None:
                grid = replace(grid, point_data={}, cell_data={})
                if changed is not None:
                    changed.append(index)
            yield index, grid


def _describe_changed(changed: list[int]) -> list[str]:
    """Return a note on frames whose cells are not those of the mesh."""
    if not changed:
        return []
    return [f"{len(changed)} frames have other cells, first {changed[0]}: their fields of points and cells are NaN"]


def _list_known(first: Grid) -> set[tuple[str, str]]:
    """Return the fields of our own files that are what their names say: all of them."""
    exact = "displacement" in first.point_data and "rest_position" in first.point_data
    nodal = {("point", "displacement"), ("point", "rest_position")} if exact else set()
    return nodal | {("cell", name) for name in MEASURED}


def _is_hidden(form: FieldForm, known: set[tuple[str, str]], displacement: str | None) -> bool:
    """Return whether a field is in the dataset anyway: as displacement, rest_position, time or attributes."""
    key = form.kind, form.source
    if key in _HIDDEN or form.source == _GHOSTS:
        return True
    return key == ("point", displacement) or (key in known and form.kind == "point")


def _sort_forms(forms: list[FieldForm]) -> list[FieldForm]:
    return sorted(forms, key=lambda form: list(KINDS).index(form.kind))


def _describe_sample(chosen: list[int], count: int) -> list[str]:
    if len(chosen) == count:
        return []
    numbers = ", ".join(map(str, chosen))
    return [f"fields and their types are those of the frames {numbers} of {count}; scan_all = True looks at all"]


def _make_displacement(store: FrameStore, *, own: bool) -> FieldColumn:
    series = store.series
    dims, shape = ("node", "axis"), (len(series.mesh.points), 3)
    attributes = describe_field("displacement", dims, series.mesh.dimension)
    if not own:
        attributes["comment"] = f"the files have {series.layout.decisions.points}"
    return FieldColumn("displacement", None, dims, shape, np.dtype(np.float64), attributes, own)


def _make_column(form: FieldForm, name: str, store: FrameStore, used: set[str]) -> FieldColumn:
    mesh = store.series.mesh
    counts = {"node": len(mesh.points), "cell": len(mesh.cell_array.types)}
    places = _PLACES[form.kind]
    inner = tuple(
        _name_dimension(form, name, size, used, place) for place, size in enumerate(form.shape)
    )  # one, for a vector or a tensor
    dims = (*places, *inner)
    attributes: dict[str, Any] = describe_field(name, dims, mesh.dimension)
    if name != form.source:
        attributes["comment"] = f"the {KINDS[form.kind]} {form.source} of the files"
    return FieldColumn(name, form, dims, (*(counts[place] for place in places), *form.shape), form.dtype, attributes)


def _name_dimension(form: FieldForm, name: str, size: int, used: set[str], place: int) -> str:
    """Return the name of the dimension of a field's components."""
    if name in STEPS and form.kind == "field":
        return "step_of_frame"
    if name in VARIABLES and VARIABLES[name].dims == ("quantile",) and size == 9 and form.kind == "field":
        return "quantile"
    if size == 3 and len(form.shape) == 1:
        return "axis"
    dim = f"{name}_component" if place == 0 else f"{name}_component_{place + 1}"
    while dim in used:
        dim += "_"
    return dim
