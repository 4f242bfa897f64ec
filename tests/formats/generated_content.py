"""Random contents of small files: points, cells of many kinds, and fields of many types, from a number."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

# VTK's cell types with a fixed number of corners
SIZES = {1: 1, 3: 2, 5: 3, 8: 4, 9: 4, 10: 4, 11: 8, 12: 8, 13: 6, 14: 5, 21: 3, 22: 6, 23: 8, 24: 10, 25: 20, 26: 15,
         27: 13, 28: 9, 29: 27, 32: 18}  # fmt: skip
SOLIDS = (10, 12, 13, 14, 24, 25)
TYPES = "f4 f8 i1 i2 i4 i8 u1 u2 u4 u8".split()
NAMES = ("u", "Displacement", "T", "Von Mises [MPa]", "p'", "σ", "a<b&c", "id", "stress")
NO_MARKUP = tuple(name for name in NAMES if not set(name) & set("<&'"))
PLAIN_NAMES = ("u", "Displacement", "T", "von_Mises", "p", "id", "stress")  # of formats that allow few characters


@dataclass
class Content:
    """What a file must give: VTK's layout of cells, and fields by name."""

    points: np.ndarray
    types: np.ndarray
    offsets: np.ndarray
    connectivity: np.ndarray
    point_data: dict[str, np.ndarray] = field(default_factory=dict)
    cell_data: dict[str, np.ndarray] = field(default_factory=dict)
    field_data: dict[str, np.ndarray] = field(default_factory=dict)
    digits: int = 0  # of numbers written as rounded text; VTK writes six of single precision
    wider: bool = False  # numbers may come back with eight bytes: XDMF's text does
    faces: list[list[list[int]]] = field(default_factory=list)  # of each polyhedron

    @property
    def cells(self) -> list[list[int]]:
        """The nodes of each cell."""
        return [self.connectivity[a:b].tolist() for a, b in zip(self.offsets, self.offsets[1:], strict=False)]


def make_values(random: np.random.Generator, count: int, kind: str, components: int) -> np.ndarray:
    """Random numbers of a type, with extremes among them."""
    shape = (count,) if components == 1 else (count, components)
    if kind[0] == "f":
        values = random.normal(size=shape) * 10.0 ** random.integers(-3, 4)
        largest = 1e300 if kind == "f8" else 1e30
        if random.random() < 0.2 and values.size:
            values.flat[random.integers(values.size)] = random.choice([largest, -largest, 0.0, 1.0 / largest])
        return values.astype(kind)
    limits = np.iinfo(kind)
    if random.random() < 0.2:
        return random.integers(limits.min, limits.max, size=shape, dtype=kind, endpoint=True)
    return random.integers(0, 100, size=shape).astype(kind)


def make_fields(
    random: np.random.Generator, count: int, names: tuple[str, ...] = NAMES, types: list[str] = TYPES, most: int = 3
) -> dict[str, np.ndarray]:
    """Random fields of `count` rows."""
    chosen = random.choice(len(names), size=random.integers(0, min(most, len(names)) + 1), replace=False)
    return {
        names[i]: make_values(random, count, str(random.choice(types)), int(random.choice([1, 1, 2, 3, 3, 6, 9])))
        for i in chosen
    }


def make_content(
    random: np.random.Generator, *, kinds: tuple[int, ...] | None = None, names: tuple[str, ...] = NAMES,
    types: list[str] = TYPES, least: int = 1,
) -> Content:  # fmt: skip
    """A random content; half of them have cells of one kind."""
    n = int(random.integers(30, 60)) if random.random() < 0.5 else 27
    points = make_values(random, n, str(random.choice(["f4", "f8", "f8"])), 3).astype(np.float64) * 1.0
    points = np.clip(points, -1e20, 1e20)
    pool = kinds or (tuple(SIZES) if random.random() < 0.5 else (int(random.choice(SOLIDS)),))
    chosen = random.choice(pool, size=int(random.integers(least, 8))).astype(np.uint8)
    cells = [random.choice(n, size=SIZES[int(kind)], replace=False) for kind in chosen]
    offsets = np.cumsum([0, *map(len, cells)]).astype(np.int64)
    return Content(
        points, chosen, offsets, np.concatenate(cells).astype(np.int64),
        make_fields(random, n, names, types), make_fields(random, len(chosen), names, types),
    )  # fmt: skip


def make_tetrahedra(random: np.random.Generator) -> Content:
    """A content with tetrahedra alone and a vector field, for formats of series."""
    content = make_content(random, kinds=(10,), names=PLAIN_NAMES, types=["f8"])
    content.point_data = {"u": random.normal(size=(len(content.points), 3))}
    content.cell_data = {}
    return content


def add_polyhedra(random: np.random.Generator, content: Content) -> None:
    """Append one or two polyhedra, the tetrahedra or wedges of some points given by their faces."""
    shapes = (
        ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
        ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (0, 2, 5, 3)),
    )
    for _ in range(int(random.integers(1, 3))):
        shape = shapes[int(random.integers(2))]
        nodes = random.choice(len(content.points), size=1 + max(max(f) for f in shape), replace=False)
        content.faces.append([[int(nodes[i]) for i in face] for face in shape])
        content.types = np.append(content.types, np.uint8(42))
        content.connectivity = np.concatenate([content.connectivity, nodes])
        content.offsets = np.append(content.offsets, len(content.connectivity))
        content.cell_data = {name: np.concatenate([values, values[:1]]) for name, values in content.cell_data.items()}


def join_contents(contents: list[Content]) -> Content:
    """The contents one after another, with the fields that all have."""
    starts = np.cumsum([0, *(len(c.points) for c in contents)])
    ends = np.cumsum([0, *(c.offsets[-1] for c in contents)])
    out = Content(
        np.concatenate([c.points for c in contents]),
        np.concatenate([c.types for c in contents]),
        np.concatenate([[0], *(c.offsets[1:] + end for c, end in zip(contents, ends, strict=False))]),
        np.concatenate([c.connectivity + start for c, start in zip(contents, starts, strict=False)]),
    )
    for kind in ("point_data", "cell_data"):
        first = getattr(contents[0], kind)
        common = [name for name in first if all(name in getattr(c, kind) for c in contents)]
        getattr(out, kind).update({name: np.concatenate([getattr(c, kind)[name] for c in contents]) for name in common})
    out.field_data = contents[0].field_data
    return out


def find_difference(found: Any, expected: Content) -> str:
    """The first difference between a Grid and the content that it must have; empty if there is none."""
    pairs = [
        ("points", found.points, expected.points),
        ("types", found.types, expected.types),
        ("offsets", found.offsets, expected.offsets),
        ("connectivity", *(_sort_polyhedra(one) for one in (found, expected))),
    ]
    for kind in ("point_data", "cell_data", "field_data"):
        ours, theirs = getattr(found, kind), getattr(expected, kind)
        if ours.keys() != theirs.keys():
            return f"{kind}: {sorted(ours)} instead of {sorted(theirs)}"
        pairs += [(f"{kind} {name}", ours[name], theirs[name]) for name in theirs]
    for name, ours, theirs in pairs:
        ours, theirs = np.asarray(ours), np.asarray(theirs)
        if theirs.ndim == 2 and theirs.shape[1] == 1:
            theirs = theirs[:, 0]
        if ours.shape != theirs.shape:
            return f"{name}: shape {ours.shape} instead of {theirs.shape}"
        if expected.digits and ours.dtype.kind == "f" and _are_close(ours, theirs, expected.digits):
            continue
        if ours.dtype.kind in "fiu" and not np.array_equal(ours, theirs, equal_nan=ours.dtype.kind == "f"):
            return f"{name}: {ours.ravel()[:4]} instead of {theirs.ravel()[:4]}"
        if name.split()[0] in ("point_data", "cell_data") and not _fits(ours, theirs, expected):
            return f"{name}: {ours.dtype} instead of {theirs.dtype}"
    return _find_face_difference(found, expected)


def _are_close(ours: np.ndarray, theirs: np.ndarray, digits: int) -> bool:
    """Whether numbers agree that were rounded to some digits, to six in single precision."""
    rtol = 6e-6 if ours.dtype.itemsize == 4 else 10.0 ** (1 - digits)
    return bool(np.allclose(ours, theirs, rtol=rtol, atol=1e-300, equal_nan=True))  # tiny ones may underflow


def _fits(ours: np.ndarray, theirs: np.ndarray, expected: Content) -> bool:
    """Whether the type of an array is that of the file."""
    return ours.dtype.kind == theirs.dtype.kind if expected.wider else ours.dtype == theirs.dtype


def _sort_polyhedra(content: Any) -> np.ndarray:
    """The connectivity, with the points of each polyhedron sorted: their order has no meaning."""
    out = np.array(content.connectivity)
    for cell in np.flatnonzero(np.asarray(content.types) == 42):
        out[content.offsets[cell] : content.offsets[cell + 1]].sort()
    return out


def _find_face_difference(found: Any, expected: Content) -> str:
    if found.faces is None:
        return "faces are missing" if expected.faces else ""
    c, o, k = found.faces
    ours = [[c[o[f] : o[f + 1]].tolist() for f in range(a, b)] for a, b in pairwise(k.tolist()) if b > a]
    return "" if ours == expected.faces else f"faces: {ours} instead of {expected.faces}"
