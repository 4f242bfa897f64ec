"""The fields of an XDMF grid: attributes at nodes, cells or the whole grid, and functions of finite elements."""

import math
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Ints
from pipeline.errors import shorten
from pipeline.formats.grid import CellArray
from pipeline.formats.xdmf.document import XdmfDocument
from pipeline.formats.xdmf.items import read_item

_REMEDY = "interpolate it into continuous linear elements first, or use write() in place of write_checkpoint()"


class XdmfFields(NamedTuple):
    """Fields by name, at points, cells and the whole grid, and notes on those that are left out."""

    nodal: dict[str, NDArray[Any]]
    cellular: dict[str, NDArray[Any]]
    whole: dict[str, NDArray[Any]]
    notes: list[str]


def read_fields(document: XdmfDocument, attributes: tuple[Element, ...], points: int, cells: CellArray) -> XdmfFields:
    """Return the fields of a grid; raises ValueError if one does not fit its points or cells."""
    fields = XdmfFields({}, {}, {}, [])
    for number, attribute in enumerate(attributes):
        name = attribute.get("Name", f"attribute {number}")
        center = attribute.get("Center", "Node").lower()
        if attribute.get("ElementFamily") or attribute.get("ItemType") == "FiniteElementFunction":
            center, values = _read_function(document, attribute, points, cells, name)
            _add(fields.nodal if center == "node" else fields.cellular, name, values)
            continue
        if center not in ("node", "cell", "grid"):
            fields.notes.append(f"the field {shorten(name)} at {shorten(center)}s is not read")
            continue
        item = document.get_child(attribute, "DataItem")
        if item is None:
            raise ValueError(f"its attribute {shorten(name)} has no DataItem")
        values = read_item(document, item)
        if center == "grid":
            _add(fields.whole, name, values.ravel())
            continue
        count, group = (points, fields.nodal) if center == "node" else (len(cells.types), fields.cellular)
        _add(group, name, arrange_values(values, count, f"its attribute {shorten(name)} at {center}s"))
    return fields


def _add(group: dict[str, NDArray[Any]], name: str, values: NDArray[Any]) -> None:
    if name in group:
        raise ValueError(f"a grid has two attributes {shorten(name)}")
    group[name] = values


def arrange_values(values: NDArray[Any], count: int, what: str) -> NDArray[Any]:
    """Return values (count,) or (count, components); raises ValueError if the shape does not begin with the count.

    The count may be spread over several dimensions (nz ny nx), and ones may come before it.
    """
    products = [math.prod(values.shape[:i]) for i in range(1, values.ndim + 1)]
    flat = values.ndim == 1 and count and values.size % count == 0
    if count not in products and not flat:
        raise ValueError(f"{what} has the shape {values.shape}, but {count} values are needed")
    arranged = np.ascontiguousarray(values.reshape(count, -1))
    return arranged[:, 0] if arranged.shape[1] == 1 else arranged


def _read_function(
    document: XdmfDocument, attribute: Element, points: int, cells: CellArray, name: str
) -> tuple[str, NDArray[Any]]:
    """Return "node" or "cell" and the values of a function that is given by degrees of freedom of each cell.

    The items are the numbers of each cell's degrees of freedom (component after component, in the order of its
    nodes), their values, and perhaps where each cell begins among the numbers, and which cell it is.
    """
    family, degree = attribute.get("ElementFamily", "").upper(), attribute.get("ElementDegree", "")
    kind = "node" if (family, degree) in (("CG", "1"), ("P", "1"), ("Q", "1")) else "cell"
    if kind == "cell" and (family, degree) not in (("DG", "0"), ("DQ", "0")):
        raise ValueError(f"its function {shorten(name)} has the elements {shorten(family)}{shorten(degree)}: {_REMEDY}")
    arrays = [read_item(document, item).ravel() for item in document.get_children(attribute, "DataItem")]
    sizes = np.diff(cells.offsets)
    width = int(sizes[0]) if kind == "node" else 1
    count = len(sizes)
    if len(arrays) < 2 or (sizes != sizes[0]).any() or arrays[0].size % (count * width):
        raise ValueError(f"its function {shorten(name)} does not fit its {count} cells")
    numbers = arrays[0].astype(np.int64).reshape(count, -1)
    if len(arrays) > 2 and not np.array_equal(np.unique(np.diff(arrays[2].astype(np.int64)))[:2], [numbers.shape[1]]):
        raise ValueError(f"its function {shorten(name)} has different numbers of values in its cells")
    order = arrays[3].astype(np.int64) if len(arrays) > 3 else np.arange(count, dtype=np.int64)
    if not np.array_equal(np.sort(order), np.arange(count)) or numbers.min() < 0 or numbers.max() >= arrays[1].size:
        raise ValueError(f"its function {shorten(name)} refers to cells or values that do not exist")
    components = arrays[1][numbers.reshape(count, -1, width)]  # (cell, component, node)
    if kind == "cell":
        values = np.empty((count, components.shape[1]), dtype=components.dtype)
        values[order] = components[:, :, 0]
        return kind, arrange_values(values, count, name)
    values = _scatter(components, cells.connectivity.reshape(count, width)[order], points)
    return kind, arrange_values(values, points, name)


def _scatter(components: NDArray[Any], nodes: Ints, points: int) -> NDArray[Any]:
    """Return nodal values (points, components), NaN at points of no cell."""
    values = np.full((points, components.shape[1]), np.nan)
    for k in range(components.shape[1]):
        values[nodes, k] = components[:, k]
    return values
