"""The numbers of an XDMF DataItem: as text, in HDF5, in binary files, and as selections of other items.

https://xdmf.org/index.php/XDMF_Model_and_Format. Sizes are compared with the source before anything is allocated.
"""

import math
import re
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import shorten
from pipeline.formats.xdmf.document import XdmfDocument

Selection = tuple[slice, ...] | None  # None selects everything
_KINDS = {"float": "f", "double": "f", "int": "i", "uint": "u", "char": "i", "uchar": "u", "short": "i", "ushort": "u"}
_WIDTHS = {"double": 8, "char": 1, "uchar": 1, "short": 2, "ushort": 2}
_HDF_NAME = re.compile(r"((?:[A-Za-z]:[\\/])?[^:]*):(.*)", re.DOTALL)  # the name may begin with a drive
_ORDERS = {"native": "=", "little": "<", "big": ">"}


def read_item(document: XdmfDocument, item: Element) -> NDArray[Any]:
    """Return the array of a DataItem in the shape of its Dimensions; raises ValueError or OSError."""
    return _read(document, item, 0)


def parse_numbers(text: str, kind: Any = int) -> tuple[Any, ...]:
    """Return the numbers in a text, separated by spaces or commas."""
    return tuple(kind(word) for word in text.replace(",", " ").split())


def _read(document: XdmfDocument, item: Element, depth: int) -> NDArray[Any]:
    if depth > 10:
        raise ValueError("its DataItems are nested too deeply")
    name = item.get("ItemType", item.get("Type", "Uniform"))
    kind = name.lower()
    if kind == "uniform":
        return _reshape(_read_source(document, item, None), item)
    if kind not in ("hyperslab", "coordinates"):
        raise ValueError(f"a DataItem has the type {shorten(name)}; it may be one of Uniform, HyperSlab, Coordinates")
    inner = document.get_children(item, "DataItem")
    if len(inner) != 2:
        raise ValueError(f"a DataItem of the type {name} has {len(inner)} DataItems in it, not 2")
    choice = _read(document, inner[0], depth + 1)
    select = _select_slab if kind == "hyperslab" else _select_coordinates
    return _reshape(select(document, inner[1], choice, depth), item)


def _select_slab(document: XdmfDocument, source: Element, choice: NDArray[Any], depth: int) -> NDArray[Any]:
    """Return part of a source: `choice` has its start, stride and count in each dimension (3, rank)."""
    rows = choice.reshape(3, -1).astype(np.int64)
    selection = make_slices(*rows.tolist())
    if source.get("ItemType", source.get("Type", "Uniform")).lower() == "uniform":
        return _read_source(document, source, selection)
    values = _read(document, source, depth + 1)
    check_slices(selection, values.shape)
    return values[selection]


def _select_coordinates(document: XdmfDocument, source: Element, choice: NDArray[Any], depth: int) -> NDArray[Any]:
    """Return the values of a source at some of its entries, whose indices `choice` has: (count * rank)."""
    values = _read(document, source, depth + 1)
    places = choice.reshape(-1, values.ndim).astype(np.int64)
    if (places < 0).any() or (places >= np.array(values.shape)).any():
        raise ValueError(f"a DataItem selects entries outside its source of shape {values.shape}")
    return values[tuple(places.T)]


def make_slices(starts: list[int], strides: list[int], counts: list[int]) -> tuple[slice, ...]:
    """Return slices with these starts, strides and counts; raises ValueError if one of them is negative."""
    if min([*starts, *counts, 0]) < 0 or min([*strides, 1]) < 1 or not len(starts) == len(strides) == len(counts):
        raise ValueError(f"a hyperslab starts at {starts}, with strides {strides} and counts {counts}")
    return tuple(
        slice(start, start + stride * (count - 1) + 1 if count else start, stride)
        for start, stride, count in zip(starts, strides, counts, strict=True)
    )


def check_slices(selection: tuple[slice, ...], shape: tuple[int, ...]) -> None:
    """Raise ValueError unless the slices lie within an array of that shape."""
    if len(selection) != len(shape) or any(part.stop > n for part, n in zip(selection, shape, strict=True)):
        ends = [part.stop for part in selection]
        raise ValueError(f"a hyperslab ends at {ends}, beyond its source of shape {list(shape)}")


def read_shape(item: Element) -> tuple[int, ...] | None:
    """Return the Dimensions of an item, None if it has none."""
    text = item.get("Dimensions")
    if text is None:
        return None
    shape = parse_numbers(text)
    if not shape or min(shape) < 0:
        raise ValueError(f'a DataItem has the Dimensions "{shorten(text)}"')
    return shape


def _reshape(values: NDArray[Any], item: Element) -> NDArray[Any]:
    shape = read_shape(item)
    if shape is None:
        return values
    if math.prod(shape) != values.size:
        raise ValueError(f"a DataItem of Dimensions {item.get('Dimensions')} has {values.size} values")
    return values.reshape(shape)


def _read_source(document: XdmfDocument, item: Element, selection: Selection) -> NDArray[Any]:
    """Return the values of a Uniform item, or part of them, in the shape of the Dimensions or the HDF5 dataset."""
    source = item.get("Format", "XML").lower()
    readers: dict[str, Callable[..., NDArray[Any]]] = {"xml": _read_text, "hdf": _read_hdf, "binary": _read_binary}
    if source not in readers:
        raise ValueError(f"a DataItem has the format {shorten(source)}; it may be one of XML, HDF, Binary")
    if source == "hdf":
        return _read_hdf(document, item, selection)
    values = _reshape(readers[source](document, item), item)
    if selection is None:
        return values
    check_slices(selection, values.shape)
    return values[selection]


def _read_type(item: Element) -> np.dtype[Any]:
    """Return the type of an item's numbers, by NumberType (DataType) and Precision, in its byte order."""
    name = item.get("NumberType", item.get("DataType", "Float"))
    kind = _KINDS.get(name.lower())
    width = int(item.get("Precision", _WIDTHS.get(name.lower(), 4)))
    order = _ORDERS.get(item.get("Endian", "Native").lower())
    if kind is None or order is None or width not in ((4, 8) if kind == "f" else (1, 2, 4, 8)):
        raise ValueError(
            f"a DataItem has numbers of the type {shorten(name)} with precision {width} "
            f"({shorten(item.get('Endian', 'Native'))} endian), which are not read"
        )
    return np.dtype(f"{order}{kind}{width}")


def _read_text(document: XdmfDocument, item: Element) -> NDArray[Any]:
    text = document.get_text(item).strip()
    kind = _read_type(item).kind
    parsed: Any = {"f": np.float64, "i": np.int64, "u": np.uint64}[kind]
    if not text:
        return np.empty(0, dtype=parsed)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy stops at a word that is no number, and only warns
        try:
            return np.fromstring(text, dtype=parsed, sep=" ")
        except (DeprecationWarning, ValueError):
            pass
    try:
        return np.array(text.replace(",", " ").split(), dtype=parsed)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"a DataItem has a word that is no number ({shorten(str(error))})") from error


def _read_binary(document: XdmfDocument, item: Element) -> NDArray[Any]:
    kind, shape = _read_type(item), read_shape(item)
    if shape is None:
        raise ValueError("a DataItem in a binary file has no Dimensions")
    name = document.get_text(item).strip()
    file = document.find_file(item, name)
    start, size = int(item.get("Seek", "0")), math.prod(shape) * kind.itemsize
    compression = item.get("Compression", "Raw").lower()
    if start < 0 or compression not in ("raw", "zlib"):
        raise ValueError(f"a DataItem has Seek {start} and the compression {shorten(compression)}, not Raw or Zlib")
    with file.open("rb") as stream:
        stream.seek(start)
        if compression == "raw":
            if start + size > file.stat().st_size:
                raise ValueError(f"{shorten(name, 200)} is too short: {size} bytes were declared at {start}")
            content = stream.read(size)
        else:
            content = zlib.decompressobj().decompress(stream.read(), size)
            if len(content) != size:
                raise ValueError(f"{shorten(name, 200)} decompresses to {len(content)} bytes; {size} were declared")
    values = np.frombuffer(content, dtype=kind)
    return values.astype(kind.newbyteorder("="))


def _read_hdf(document: XdmfDocument, item: Element, selection: Selection) -> NDArray[Any]:
    """Return a dataset, or part of it: file.h5:/path, or file.h5:/path|starts:strides:counts:shape of the dataset."""
    import h5py  # noqa: F401  (its absence matters more than that of the file)

    reference, _, region = document.get_text(item).strip().partition("|")
    match = _HDF_NAME.match(reference.strip())
    if match is None:
        raise ValueError(f"a DataItem in HDF5 names no dataset: {shorten(reference, 200)} (file.h5:/path)")
    name, path = match.groups()
    if "|" in region:
        raise ValueError(f"a DataItem joins several datasets ({shorten(region, 200)}), which is not read")
    file = document.find_file(item, name.strip())
    if region:
        rows = [list(parse_numbers(part)) for part in region.split(":")]
        if len(rows) not in (3, 4) or selection is not None:
            raise ValueError(f"a DataItem selects {shorten(region, 200)}, not starts:strides:counts:shape")
        selection = make_slices(*rows[:3])
    return _read_dataset(file, path.strip(), item, selection)


def _read_dataset(file: Path, path: str, item: Element, selection: Selection) -> NDArray[Any]:
    import h5py

    shape = read_shape(item)
    with h5py.File(file, "r", locking=False) as stored:
        dataset = stored.get(path)
        if not isinstance(dataset, h5py.Dataset):
            raise ValueError(f"{file.name} has no dataset {shorten(path, 200)}")
        if dataset.dtype.kind not in "fiu" or dataset.external:
            raise ValueError(f"the dataset {shorten(path, 200)} of {file.name} does not hold numbers of its own")
        if selection is not None:
            check_slices(selection, dataset.shape)
            values = dataset[selection]
        elif shape is not None and dataset.size != math.prod(shape):
            raise ValueError(
                f"the dataset {shorten(path, 200)} of {file.name} has {dataset.size} values; "
                f"the Dimensions are {item.get('Dimensions')}"
            )
        else:
            values = dataset[()]
    values = np.asarray(values)
    return values.astype(values.dtype.newbyteorder("="), copy=False)
