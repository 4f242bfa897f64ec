"""The instants of an XDMF file: temporal and spatial collections, and several of them side by side.

A program may write one collection a function, or one a partition; both are joined by time.
"""

from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from pipeline.errors import shorten
from pipeline.formats.xdmf.document import XdmfDocument
from pipeline.formats.xdmf.items import parse_numbers, read_item

_CLOSE = 1e-9  # relative to the span: times of two collections that are written with different digits
_DEEPEST = 50  # collections in collections


class XdmfPiece(NamedTuple):
    """One uniform grid: the elements of its mesh and of its fields."""

    name: str
    topology: Element | None
    geometry: Element | None
    attributes: tuple[Element, ...]


class XdmfStep(NamedTuple):
    """One instant: its time (None if none is given) and its grids: parts of a body."""

    time: float | None
    pieces: tuple[XdmfPiece, ...]


class XdmfSeries(NamedTuple):
    """The instants of one file in order, as `layers` of the same body: each layer has its own fields.

    `layers[k]` has the steps of one collection; `times` has all their times; `static` has grids without a time.
    """

    times: tuple[float, ...] | None
    layers: tuple[tuple[XdmfStep, ...], ...]
    static: tuple[XdmfPiece, ...]
    notes: tuple[str, ...]

    def select(self, step: int) -> list[tuple[XdmfPiece, ...]]:
        """Return the grids of one instant, one tuple a layer that has this instant."""
        if self.times is None:
            return []
        if have_equal_times(self.layers):  # by number, so that equal times stay apart
            return [layer[step].pieces for layer in self.layers]
        time, tolerance = self.times[step], _CLOSE * (self.times[-1] - self.times[0])
        close = (
            [s.pieces for s in layer if s.time is not None and abs(s.time - time) <= tolerance] for layer in self.layers
        )
        return [pieces[-1] for pieces in close if pieces]


def have_equal_times(layers: tuple[tuple[XdmfStep, ...], ...]) -> bool:
    """Return whether all collections have the same times in the same order."""
    times = [[step.time for step in layer] for layer in layers]
    return all(other == times[0] for other in times)


def list_steps(document: XdmfDocument) -> XdmfSeries:
    """Return the instants of a file; raises ValueError if it has none, or if their times make no sense."""
    domains = [d for d in document.get_children(document.root, "Domain") if document.get_children(d, "Grid")]
    if len(domains) != 1:
        raise ValueError(f"it has {len(domains)} domains with grids, not one; write one domain")
    layers, static, notes = list[tuple[XdmfStep, ...]](), list[XdmfPiece](), list[str]()
    for grid in document.get_children(domains[0], "Grid"):
        steps = _expand(document, grid, notes, 0)
        if len(steps) == 1 and steps[0].time is None:
            static += steps[0].pieces
        else:
            layers.append(tuple(steps))
    if not layers:
        return XdmfSeries(None, (), tuple(static), tuple(notes))
    layers = _join_uniform(layers)
    shared = static[0] if static else None
    filled = tuple(tuple(_fill(step, shared) for step in _inherit(layer)) for layer in layers)
    times = _merge_times(filled, notes)
    return XdmfSeries(times, filled, _drop_meshes(static, filled), tuple(dict.fromkeys(notes)))


def _join_uniform(layers: list[tuple[XdmfStep, ...]]) -> list[tuple[XdmfStep, ...]]:
    """Return the layers; single grids with different times, outside any collection, become one of them."""
    single = [layer for layer in layers if len(layer) == 1]
    if len(single) < 2 or len({layer[0].time for layer in single}) < len(single):
        return layers
    joined = tuple(sorted((layer[0] for layer in single), key=lambda step: step.time or 0.0))
    return [*(layer for layer in layers if len(layer) > 1), joined]


def _inherit(layer: tuple[XdmfStep, ...]) -> list[XdmfStep]:
    """Return the steps; a grid without a mesh of its own takes that of the same grid one step before."""
    steps = list[XdmfStep]()
    for step in layer:
        before = steps[-1].pieces if steps and len(steps[-1].pieces) == len(step.pieces) else None
        if before is not None:
            pieces = (_take_mesh(piece, other) for piece, other in zip(step.pieces, before, strict=True))
            step = step._replace(pieces=tuple(pieces))
        steps.append(step)
    return steps


def _take_mesh(piece: XdmfPiece, other: XdmfPiece) -> XdmfPiece:
    return piece._replace(
        topology=other.topology if piece.topology is None else piece.topology,
        geometry=other.geometry if piece.geometry is None else piece.geometry,
    )


def _fill(step: XdmfStep, mesh: XdmfPiece | None) -> XdmfStep:
    """Return the step with the mesh of a grid beside the collection, if it has none itself."""
    return step if mesh is None else step._replace(pieces=tuple(_take_mesh(piece, mesh) for piece in step.pieces))


def _drop_meshes(static: list[XdmfPiece], layers: tuple[tuple[XdmfStep, ...], ...]) -> tuple[XdmfPiece, ...]:
    """Return the grids without a time that are more than the mesh to which the collections point."""
    used = {id(piece.topology) for layer in layers for step in layer for piece in step.pieces}
    return tuple(piece for piece in static if piece.attributes or id(piece.topology) not in used)


def _merge_times(layers: tuple[tuple[XdmfStep, ...], ...], notes: list[str]) -> tuple[float, ...]:
    """Return the times of the instants; raises ValueError if only some steps have one."""
    times = [step.time for layer in layers for step in layer]
    known = [time for time in times if time is not None]
    if len(known) < len(times):
        raise ValueError(f"{len(times) - len(known)} of its {len(times)} grids in time have no time")
    if not np.isfinite(known).all():
        raise ValueError("a time is not a number")
    if have_equal_times(layers):
        return tuple(known[: len(layers[0])])
    known.sort()
    tolerance = _CLOSE * (known[-1] - known[0])
    merged = [known[0]]
    for time in known[1:]:
        if time - merged[-1] > tolerance:
            merged.append(time)
    counts = ", ".join(str(len(layer)) for layer in layers)
    notes.append(f"its {len(layers)} collections have {counts} times; they are joined to {len(merged)} instants")
    if len({step.time for step in layers[0]}) < len(layers[0]):
        notes.append("a collection has several grids at one time; the last of them is taken")
    return tuple(merged)


def _expand(document: XdmfDocument, grid: Element, notes: list[str], depth: int) -> list[XdmfStep]:
    """Return the instants of a grid: one without a time if it knows none."""
    if depth > _DEEPEST:
        raise ValueError("its collections are nested too deeply")
    kind = grid.get("GridType", grid.get("Type", "Uniform")).lower()
    if kind == "uniform":
        return [XdmfStep(_read_time(document, grid), (_make_piece(document, grid),))]
    if kind not in ("collection", "tree"):
        raise ValueError(f"a grid has the type {shorten(kind)}; it may be one of Uniform, Collection, Tree")
    children = [_expand(document, child, notes, depth + 1) for child in document.get_children(grid, "Grid")]
    if not children:
        raise ValueError(f"its collection {shorten(grid.get('Name', ''))} is empty")
    if kind == "collection" and grid.get("CollectionType", "Spatial").lower() == "temporal":
        return _line_up(document, grid, children, notes)
    steps = _put_together(children, grid.get("Name", ""))
    time = _read_time(document, grid)
    return [step._replace(time=time) if step.time is None else step for step in steps]


def _make_piece(document: XdmfDocument, grid: Element) -> XdmfPiece:
    return XdmfPiece(
        grid.get("Name", ""),
        document.get_child(grid, "Topology"),
        document.get_child(grid, "Geometry"),
        tuple(document.get_children(grid, "Attribute")),
    )


def _line_up(document: XdmfDocument, grid: Element, children: list[list[XdmfStep]], notes: list[str]) -> list[XdmfStep]:
    """Return the steps of a temporal collection: with the times of its grids, or with those in its own Time."""
    name = shorten(grid.get("Name", ""))
    steps = [step for child in children for step in child]
    listed = _list_times(document, grid, len(children), notes)
    if listed is not None:
        if len(listed) != len(children) or len(steps) != len(children):
            raise ValueError(f"its collection {name} has {len(listed)} times for {len(children)} grids")
        return [step._replace(time=time) for step, time in zip(steps, listed, strict=True)]
    missing = sum(step.time is None for step in steps)
    if missing == len(steps):
        notes.append(f"the grids of the collection {name} have no times; they are counted from 0")
        return [step._replace(time=float(i)) for i, step in enumerate(steps)]
    if missing:
        raise ValueError(f"{missing} of the {len(steps)} grids of its collection {name} have no time")
    return steps


def _put_together(children: list[list[XdmfStep]], name: str) -> list[XdmfStep]:
    """Return the steps of a spatial collection: at each time the grids of all its members."""
    moving = [child for child in children if len(child) > 1 or child[0].time is not None]
    if not moving:
        return [XdmfStep(None, tuple(piece for child in children for piece in child[0].pieces))]
    times = [step.time for step in moving[0]]
    for child in moving:
        if [step.time for step in child] != times:
            raise ValueError(f"the parts of its collection {shorten(name)} have different times")
    return [
        XdmfStep(time, tuple(p for child in children for p in child[min(i, len(child) - 1)].pieces))
        for i, time in enumerate(times)
    ]


def _read_time(document: XdmfDocument, grid: Element) -> float | None:
    """Return the time of one grid, None if it has none."""
    element = document.get_child(grid, "Time")
    if element is None:
        return None
    if (text := element.get("Value")) is not None:
        return float(text)
    item = document.get_child(element, "DataItem")
    values = [] if item is None else read_item(document, item).ravel().tolist()
    if len(values) != 1:
        raise ValueError(f"the Time of its grid {shorten(grid.get('Name', ''))} has {len(values)} values, not one")
    return float(values[0])


def _list_times(document: XdmfDocument, grid: Element, count: int, notes: list[str]) -> list[float] | None:
    """Return the times in a collection's own Time, None if it has none: a list, a start and a step, or a range."""
    element = document.get_child(grid, "Time")
    if element is None:
        return None
    kind = element.get("TimeType", element.get("Type", "Single")).lower()
    item = document.get_child(element, "DataItem")
    text = element.get("Value", "")
    values = (
        [float(v) for v in read_item(document, item).ravel()] if item is not None else [*parse_numbers(text, float)]
    )
    if kind == "hyperslab":
        if len(values) != 3:
            raise ValueError(f"a Time of the type HyperSlab has {len(values)} values, not start, stride and count")
        start, stride, length = values
        if length != count:
            raise ValueError(f"a Time of the type HyperSlab has {length:g} times for {count} grids")
        return [start + i * stride for i in range(count)]
    if kind == "range":
        if len(values) != 2:
            raise ValueError(f"a Time of the type Range has {len(values)} values, not first and last")
        notes.append(f"its times are a range of {count} equal steps from {values[0]:g} to {values[1]:g} s")
        return [float(time) for time in np.linspace(values[0], values[1], count)]
    if kind == "list" or (kind == "single" and len(values) == count):
        return values
    raise ValueError(f"the Time of a collection has the type {shorten(kind)}; it may be one of List, HyperSlab, Range")
