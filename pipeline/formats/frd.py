"""CalculiX's result files (.frd), in text or binary: nodes, elements and the fields of each step.

The layout is that of the manual of CalculiX GraphiX (result format): records of fixed columns, whose first word tells
what follows: 2C nodes, 3C elements, 100C one field of one step.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Ints
from pipeline.errors import SeriesError, shorten
from pipeline.formats.cell_types import find_cell_fault
from pipeline.formats.grid import Grid

# CalculiX's type: VTK's type, and the order in which VTK has CalculiX's nodes
_TYPES: dict[int, tuple[int, tuple[int, ...]]] = {
    1: (12, tuple(range(8))), 2: (13, tuple(range(6))), 3: (10, tuple(range(4))),
    4: (25, (*range(12), *range(16, 20), *range(12, 16))),  # here upright edges come before those on top
    5: (26, (*range(9), *range(12, 15), *range(9, 12))), 6: (24, tuple(range(10))), 7: (5, tuple(range(3))),
    8: (22, tuple(range(6))), 9: (9, tuple(range(4))), 10: (23, tuple(range(8))), 11: (3, (0, 1)), 12: (21, (0, 1, 2)),
}  # fmt: skip
_MODES = 2  # kind of analysis: vibration modes
_WIDTHS = {0: 5, 1: 10}  # of integers in text, by format


class _Block(NamedTuple):
    """Records of one kind: `size` of them, in which format (0 and 1 text, 2 and 3 binary), and where they are."""

    kind: str
    size: int
    form: int
    start: int
    end: int
    name: str = ""
    components: int = 0
    step: int = 0
    time: float = 0.0
    analysis: int = 0


class _FrdContent(NamedTuple):
    """A file's bytes and blocks; `steps` has the number of each complete step."""

    raw: bytes
    blocks: tuple[_Block, ...]
    steps: tuple[int, ...]
    notes: tuple[str, ...]


def read_frd(file: Path, step: int) -> Grid:
    """Return the mesh and the fields of one step; raises SeriesError."""
    try:
        content = _open(file, file.stat().st_mtime_ns)
        nodes = _find_only(content, "2C")
        ids, points = _read_values(content.raw, nodes, 3, np.dtype("<f8" if nodes.form == 3 else "<f4"))
        order = np.argsort(ids, kind="stable")
        cells, elements = _read_elements(content, ids, order)
        fields = {
            block.name: _place(*_read_values(content.raw, block, block.components, np.dtype("<f4")), ids, order)
            for block in content.blocks
            if block.kind == "100C" and content.steps and block.step == content.steps[step]
        }
    except (ValueError, IndexError, OverflowError, KeyError) as error:
        raise SeriesError(f"{file}: cannot be read: {shorten(' '.join(str(error).split()), 200)}") from error
    types, offsets, connectivity = cells
    if fault := find_cell_fault(types, offsets, len(connectivity)):
        raise SeriesError(f"{file}: {fault}")
    return Grid(
        points, len(points), types, offsets, connectivity, {**fields, "GlobalNodeId": ids},
        {"GlobalElementId": elements}, {}, notes=content.notes,
    )  # fmt: skip


def read_frd_times(file: Path) -> list[float] | None:
    """Return the times [s] of the steps, None if there are only nodes and elements; raises SeriesError."""
    try:
        content = _open(file, file.stat().st_mtime_ns)
    except (ValueError, IndexError) as error:
        raise SeriesError(f"{file}: cannot be read: {shorten(' '.join(str(error).split()), 200)}") from error
    times = {block.step: block.time for block in content.blocks if block.kind == "100C"}
    return [times[number] for number in content.steps] or None


@lru_cache(maxsize=2)
def _open(file: Path, _modified: int) -> _FrdContent:
    raw = file.read_bytes().replace(b"\r\n", b"\n") if _is_text(file) else file.read_bytes()
    if not raw.startswith(b"    1C"):
        raise ValueError("it does not begin with 1C, as CalculiX's results do")
    blocks, complete, cut = list[_Block](), False, 0
    place = 0
    while 0 <= place < len(raw):
        line, after = _read_line(raw, place)
        if line.startswith(" 9999"):
            complete = True
            break
        if line.startswith(("    2C", "    3C", "  100C")):
            try:
                block = _read_block(raw, line, after)
            except ValueError:
                if raw.find(b"\n -3", after - 1) >= 0 or not blocks:
                    raise
                block = None  # the file ends in the lines that begin the block
            if block is None:
                cut = int(line[58:63]) if line.startswith("  100C") and len(line) > 63 else 0
                break
            blocks.append(block)
            after = block.end
        place = after
    steps = list(dict.fromkeys(block.step for block in blocks if block.kind == "100C"))
    notes = list[str]()
    if not complete and (steps or cut):
        last = cut or steps[-1]  # without a cut block, further fields of the last step may be missing
        notes.append(f"the file does not end with 9999: its step {last} may be cut off and is left out")
        steps = [step for step in steps if step != last]
    if any(block.analysis == _MODES for block in blocks):
        notes.append("its steps are vibration modes: the times are frequencies")
    return _FrdContent(raw, tuple(blocks), tuple(steps), tuple(notes))


def _is_text(file: Path) -> bool:
    with file.open("rb") as stream:
        return b"\r\n" in stream.read(200)


def _read_line(raw: bytes, place: int) -> tuple[str, int]:
    end = raw.find(b"\n", place)
    end = len(raw) if end < 0 else end
    return raw[place:end].decode("latin-1"), end + 1


def _read_block(raw: bytes, line: str, after: int) -> _Block | None:
    """Return the block that a line begins, None if the file ends within it."""
    kind, form = line[:6].strip(), int(line[73:75] or 1)
    count = int(line[24:36])
    if form not in (0, 1, 2, 3):
        raise ValueError(f"a block {kind} has the format {form}")
    name, components = "", 3
    step, time, analysis = 0, 0.0, 0
    if kind == "100C":
        kind, step, time, analysis = "100C", int(line[58:63]), float(line[12:24]), int(line[56:58])
        name, components, after = _read_head(raw, after)
    if form < 2:
        last = raw.find(b"\n -3", after - 1)
        end = last + 1
        if last < 0:
            return None
    elif kind == "3C":
        end = _skip_elements(raw, after, count)
    else:
        end = after + count * (4 + components * (8 if form == 3 and kind == "2C" else 4))
    if end > len(raw):
        return None
    return _Block(kind, count, form, after, end, name, components, step, time, analysis)


def _read_head(raw: bytes, place: int) -> tuple[str, int, int]:
    """Return the name of a field, the number of components in the file, and the place of its values."""
    line, place = _read_line(raw, place)
    if not line.startswith(" -4"):
        raise ValueError("a field has no line -4 with its name")
    name, components = line[5:13].strip(), 0
    for _ in range(int(line[13:18])):
        component, place = _read_line(raw, place)
        # components that the reader should compute itself are marked with 1
        components += component[33:38].strip() != "1"
    return name, components, place


def _skip_elements(raw: bytes, place: int, count: int) -> int:
    """Return the place behind binary elements: four numbers and the nodes of each."""
    for _ in range(count):
        kind = int.from_bytes(raw[place + 4 : place + 8], "little")
        if kind not in _TYPES:
            raise ValueError(f"it has an element of the type {kind}")
        place += 16 + 4 * len(_TYPES[kind][1])
    return place


def _find_only(content: _FrdContent, kind: str) -> _Block:
    blocks = [block for block in content.blocks if block.kind == kind]
    if len(blocks) != 1:
        raise ValueError(f"it has {len(blocks)} blocks {kind}, not one")
    return blocks[0]


def _read_values(raw: bytes, block: _Block, components: int, binary: np.dtype[Any]) -> tuple[Ints, Floats]:
    """Return the numbers of the nodes (n,) and their values (n, components)."""
    if block.form >= 2:
        record = np.dtype([("id", "<i4"), ("values", binary, (components,))])
        rows = np.frombuffer(raw, dtype=record, count=block.size, offset=block.start)
        return rows["id"].astype(np.int64), rows["values"].astype(np.float64).reshape(block.size, components)
    width = 3 + _WIDTHS[block.form]
    lines = raw[block.start : block.end - 1].split(b"\n") if block.end > block.start else []
    first = [line for line in lines if line.startswith(b" -1")]
    more = [line for line in lines if line.startswith(b" -2")]
    if len(first) != block.size or len(more) not in (0, len(first) * ((components - 1) // 6)):
        raise ValueError(f"a block declares {block.size} nodes and has {len(first)}")
    ids = np.array([line[3:width] for line in first]).astype(np.int64)
    values = _read_columns(first, width, min(components, 6))
    if components > 6:
        per_node = (components - 1) // 6
        chunks = [_read_columns(more[i::per_node], width, min(6, components - 6 * (i + 1))) for i in range(per_node)]
        values = np.concatenate([values, *chunks], axis=1)
    return ids, values


def _read_columns(lines: list[bytes], start: int, count: int) -> Floats:
    """Return numbers of twelve characters each (lines, count)."""
    if not lines:
        return np.zeros((0, count))
    columns = [np.array([line[start + 12 * i : start + 12 * (i + 1)] for line in lines]) for i in range(count)]
    return np.stack([column.astype(np.float64) for column in columns], axis=1)


def _place(numbers: Ints, values: Floats, ids: Ints, order: Ints) -> NDArray[np.float64]:
    """Return values at all nodes of the mesh, NaN at those that have none."""
    places = _find_nodes(numbers, ids, order)
    placed = np.full((len(ids), values.shape[1]), np.nan)
    placed[places] = values
    return placed[:, 0] if values.shape[1] == 1 else placed


def _find_nodes(numbers: Ints, ids: Ints, order: Ints) -> Ints:
    """Return the places of nodes in the list of all; raises ValueError if one is not there."""
    found = np.searchsorted(ids, numbers, sorter=order)
    places = order[np.minimum(found, len(ids) - 1)]
    if (ids[places] != numbers).any():
        raise ValueError(
            f"it has values or elements at node {numbers[ids[places] != numbers][0]}, which it does not list"
        )
    return places


def _read_elements(content: _FrdContent, ids: Ints, order: Ints) -> tuple[tuple[NDArray[np.uint8], Ints, Ints], Ints]:
    """Return the cells in VTK's layout, and the number of each element."""
    block = _find_only(content, "3C")
    rows = _list_binary(content.raw, block) if block.form >= 2 else _list_text(content.raw, block)
    if len(rows) != block.size:
        raise ValueError(f"it declares {block.size} elements and has {len(rows)}")
    kinds = [_TYPES[kind] for _, kind, _ in rows]
    nodes = [[numbers[i] for i in place] for (_, _, numbers), (_, place) in zip(rows, kinds, strict=True)]
    sizes = np.array([len(place) for _, place in kinds], dtype=np.int64)
    connectivity = np.array([number for row in nodes for number in row], dtype=np.int64)
    types = np.array([kind for kind, _ in kinds], dtype=np.uint8)
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    cells = types, offsets, _find_nodes(connectivity, ids, order)
    return cells, np.array([number for number, _, _ in rows], dtype=np.int64)


def _list_text(raw: bytes, block: _Block) -> list[tuple[int, int, list[int]]]:
    """Return the number, the type and the nodes of each element."""
    width = _WIDTHS[block.form]
    rows = list[tuple[int, int, list[int]]]()
    for line in raw[block.start : block.end].split(b"\n"):
        if line.startswith(b" -1"):
            rows.append((int(line[3 : 3 + width]), int(line[3 + width : 8 + width]), []))
        elif line.startswith(b" -2") and rows:
            rows[-1][2].extend(int(line[i : i + width]) for i in range(3, len(line.rstrip()), width))
    if any(kind not in _TYPES for _, kind, _ in rows):
        raise ValueError(f"it has an element of the type {next(kind for _, kind, _ in rows if kind not in _TYPES)}")
    return rows


def _list_binary(raw: bytes, block: _Block) -> list[tuple[int, int, list[int]]]:
    numbers = np.frombuffer(raw, dtype="<i4", count=(block.end - block.start) // 4, offset=block.start).tolist()
    rows, place = list[tuple[int, int, list[int]]](), 0
    for _ in range(block.size):
        count = len(_TYPES[numbers[place + 1]][1])
        rows.append((numbers[place], numbers[place + 1], numbers[place + 4 : place + 4 + count]))
        place += 4 + count
    return rows
