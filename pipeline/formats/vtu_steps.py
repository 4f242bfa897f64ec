"""A .vtu with several time steps: VTK's writer makes one if its NumberOfTimeSteps is set.

VTK's own reader leaves the arrays of such a file unset, so one step is cut out as a file of one step. The writer
repeats either the pieces, once a step (ASCII, inline), or the arrays within a piece, numbered by TimeStep (appended).
"""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from pipeline.errors import SeriesError, shorten
from pipeline.formats.preflight import find_unsafe_xml

_HEAD = 1 << 16
_TIMES = re.compile(rb"<(?:UnstructuredGrid|PolyData)\b[^>]*?\bTimeValues\s*=\s*[\"']([^\"'<]*)[\"']")
_APPENDED = re.compile(rb"<AppendedData\b[^>]*>")


def find_step_times(file: Path) -> list[float] | None:
    """Return the times of the steps in a .vtu or .vtp, None if it is a file of one step; raises SeriesError."""
    with file.open("rb") as stream:
        match = _TIMES.search(stream.read(_HEAD))
    if match is None:
        return None
    try:
        return [float(word) for word in match[1].split()] or None
    except ValueError as error:
        raise SeriesError(f"{file}: its TimeValues are not numbers ({shorten(str(error))})") from error


def cut_out_step(file: Path, step: int) -> bytes:
    """Return the file of one step; raises SeriesError if it cannot be found in the file of several steps."""
    count = len(find_step_times(file) or [])
    if not 0 <= step < count:
        raise SeriesError(f"{file}: there is no step {step}; it has {count}")
    if reason := find_unsafe_xml(file):
        raise SeriesError(f"{file}: {reason}")
    content = file.read_bytes()
    mark = _APPENDED.search(content)
    if mark is not None and b"base64" not in mark[0]:
        raise SeriesError(f"{file}: it has {count} steps as raw appended data; write one file a step, or base64")
    try:
        root = ET.fromstring(content)
        _keep_step(root, step, count)
    except (ET.ParseError, ValueError) as error:
        raise SeriesError(f"{file}: cannot be read ({shorten(str(error), 200)})") from error
    return ET.tostring(root)


def _keep_step(root: ET.Element, step: int, count: int) -> None:
    """Remove the pieces and arrays of other steps; raises ValueError if there are not as many as steps."""
    (grid,) = (child for child in root if child.tag in ("UnstructuredGrid", "PolyData"))
    del grid.attrib["TimeValues"]
    pieces = grid.findall("Piece")
    numbered = {array.get("TimeStep") for piece in pieces for array in piece.iter("DataArray")} - {None, "0"}
    if not numbered:  # each step has pieces of its own
        if len(pieces) % count:
            raise ValueError(f"its {len(pieces)} pieces are not those of {count} steps")
        own = len(pieces) // count
        for i, piece in enumerate(pieces):
            if i // own != step:
                grid.remove(piece)
        pieces = pieces[own * step : own * (step + 1)]
    for section in (section for piece in pieces for section in piece):
        for array in list(section):
            number = array.attrib.pop("TimeStep", None)
            if numbered and number is not None and int(number) != step:
                section.remove(array)
