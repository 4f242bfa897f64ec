"""The cells of meshes in words, such as "192 tetrahedra and 4 quadratic hexahedra"."""

from collections.abc import Sequence

import numpy as np

from pipeline.formats.cell_kinds import TYPES
from pipeline.mesh.body_mesh import BodyMesh


def describe_cells(meshes: Sequence[BodyMesh]) -> str:
    """Return the numbers of cells by kind; meshes that differ are named one after the other."""
    counts = [_count_kinds(mesh) for mesh in meshes]
    kinds = list(dict.fromkeys(kind for count in counts for kind in count))
    if len(kinds) == 1:
        numbers = sorted({count[kinds[0]] for count in counts})
        return f"{_join([_format_count(n) for n in numbers])} {kinds[0] if numbers == [1] else _make_plural(kinds[0])}"
    texts = [
        _join([f"{_format_count(n)} {kind if n == 1 else _make_plural(kind)}" for kind, n in count.items()])
        for count in counts
    ]
    return "; ".join(dict.fromkeys(texts))


def _count_kinds(mesh: BodyMesh) -> dict[str, int]:
    """Return the number of cells of every kind, the most frequent first."""
    cells = mesh.cell_array
    pairs = np.column_stack([cells.types.astype(np.int64), np.diff(cells.offsets)])
    counts: dict[str, int] = {}
    for (number, nodes), count in zip(*np.unique(pairs, axis=0, return_counts=True), strict=True):
        name = _name_kind(int(number), int(nodes))
        counts[name] = counts.get(name, 0) + int(count)
    return dict(sorted(counts.items(), key=lambda item: -item[1]))


def _name_kind(number: int, nodes: int) -> str:
    """Return the name of cells of a VTK type with that many nodes; Lagrange cells of order 1 are linear cells."""
    row = TYPES.get(number)
    if row is None:
        return f"cell of type {number}"
    shape, _, rest = row.kinds.get(nodes, "").partition(" ")
    return shape if rest == "1" else row.name


def _make_plural(name: str) -> str:
    if name.startswith("cell of"):
        return name.replace("cell", "cells", 1)
    return name[:-2] + "a" if name.endswith("hedron") else name + "es" if name.endswith("x") else name + "s"


def _format_count(count: int) -> str:
    return f"{count:,}".replace(",", " ")


def _join(texts: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(texts[:-1]), texts[-1]]))
