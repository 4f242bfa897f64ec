"""Series whose fields change type, come late, or have names that a dataset uses for something else."""

from pathlib import Path

import numpy as np

from tests.foreign.displacements import CELLS, LONG_CELLS, LONG_POINTS, POINTS, TETRAHEDRA
from tests.foreign.writers import STRETCHES, index, stretch, write_vtu


def integers_first(folder: Path) -> None:
    """Fields are integer zeros in the first frame, later floating-point."""
    for k, s in enumerate(STRETCHES):
        damage = np.full(len(CELLS), 0.3 * k) if k else np.zeros(len(CELLS), dtype=np.int64)
        temperature = np.full(len(POINTS), 0.5 * k) if k else np.zeros(len(POINTS), dtype=np.int32)
        write_vtu(folder / f"f_{k}.vtu", stretch(POINTS, s), TETRAHEDRA, {"temp": temperature}, {"damage": damage})
    index(folder)


def types_grow(folder: Path) -> None:
    """Fields are UInt8, Float32 and Int32 in the first frame, later Int32, Float64 and Int64."""
    kinds = [(np.uint8, np.float32, np.int32), *2 * [(np.int32, np.float64, np.int64)]]
    for k, s in enumerate(STRETCHES):
        values = {"material": [7, 300, 1000][k], "pressure": 1e8 + 1.5 * k, "id": [5, 2**40, 2**40][k]}
        fields = {n: np.full(len(CELLS), v, kind) for (n, v), kind in zip(values.items(), kinds[k], strict=True)}
        write_vtu(folder / f"f_{k}.vtu", stretch(POINTS, s), TETRAHEDRA, {}, fields)
    index(folder)


def names_of_dimensions(folder: Path) -> None:
    """Fields are named time, node, cell, axis, volume_ratio, rest_position and connectivity."""
    for k, s in enumerate(STRETCHES):
        x, time = stretch(POINTS, s), {"time": [0.1 * k]}
        numbers, cells = np.arange(len(POINTS)), np.arange(len(CELLS))
        ours = {"volume_ratio": np.full(len(CELLS), 7.0), "rest_position": np.zeros((len(CELLS), 3)),
                "connectivity": np.zeros(len(CELLS))}  # fmt: skip
        fields = {"time": np.full(len(POINTS), 0.1), "node": numbers}
        write_vtu(folder / f"f_{k}.vtu", x, TETRAHEDRA, fields, {"cell": cells, "axis": cells}, time)
        write_vtu(folder / f"g_{k}.vtu", x, TETRAHEDRA, {}, {}, time)
        write_vtu(folder / f"h_{k}.vtu", x, TETRAHEDRA, {"node": numbers})
        write_vtu(folder / f"i_{k}.vtu", x, TETRAHEDRA, {}, ours)
    for name in "fghi":
        index(folder, name, name + "_{}.vtu")


def same_name_on_points_and_cells(folder: Path) -> None:
    """T is a field of the points and another one of the cells."""
    for k, s in enumerate(STRETCHES):
        fields = {"T": np.full(len(POINTS), 300.0 + k)}, {"T": np.full(len(CELLS), 500.0 + k)}
        write_vtu(folder / f"f_{k}.vtu", stretch(POINTS, s), TETRAHEDRA, *fields)
    index(folder)


def odd_names(folder: Path) -> None:
    """Names with a slash, a Greek letter, the name of a dimension, and one that points and cells share."""
    for k, s in enumerate(STRETCHES):
        n = len(LONG_POINTS)
        fields = {
            "Von Mises/[MPa]": np.full(n, 1.0 * k), "T": np.full(n, 300.0 + k), "σ": np.zeros((n, 6)),
            "cell": np.arange(n),
        }  # fmt: skip
        cells = {"T": np.full(len(LONG_CELLS), 1.0)}
        write_vtu(folder / f"f_{k}.vtu", stretch(LONG_POINTS, s), [(10, LONG_CELLS)], fields, cells)
    index(folder)
