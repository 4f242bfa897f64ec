"""Whether fields of the files are the quantities that this program means by the same names.

A file of another program may have a `displacement` that is not position minus rest position, or a `volume_ratio` of its
own. Numbers decide, in the frames that are looked at: if they differ, the field gets another name.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats
from pipeline.errors import SeriesError
from pipeline.formats.grid import Grid
from pipeline.run.measures import measure_cells, pad_to_space
from pipeline.series.series import Series

MEASURED = ("volume_ratio", "volume_ratio_min", "volume_ratio_max", "rotation_angle")
_NODAL = ("displacement", "rest_position")
_ROUNDING = 1e-5  # of the largest number: single precision, after a few operations
_PART = 1e-4  # of the largest displacement
_ANGLE = 0.1  # [degree]: the angle of a small rotation loses half of the digits


def find_agreeing(
    series: Series, fields: set[tuple[str, str]], frames: Iterable[tuple[int, Grid]]
) -> set[tuple[str, str]]:
    """Return the fields (kind, name) that are what their names say, of MEASURED, `displacement` and `rest_position`.

    A field has to agree in all frames that have it; a frame that cannot be read on the mesh says nothing.
    """
    agreeing, differing = set[tuple[str, str]](), set[tuple[str, str]]()
    candidates = fields & {*(("point", name) for name in _NODAL), *(("cell", name) for name in MEASURED)}
    for index, grid in frames if candidates else ():
        names = {(kind, name) for kind, name in candidates if name in getattr(grid, f"{kind}_data")}
        if not names - differing:
            continue
        try:
            x = series.read_frame(index, grid).x
            arrangement = series.layout.arrange(grid, str(series.files[index]))
        except SeriesError:
            continue
        expected = _compute_expected(series, x, {name for _, name in names - differing})
        for kind, name in names - differing:
            stored = getattr(grid, f"{kind}_data")[name]
            stored = arrangement.select_nodes(stored) if kind == "point" else arrangement.select_cells(stored)
            (agreeing if _is_same(name, stored, expected[name]) else differing).add((kind, name))
    return agreeing - differing


def _is_same(name: str, stored: NDArray[Any], expected: Floats) -> bool:
    """Return whether a field has the expected values, but for rounding; in the plane it may have two components."""
    if name in _NODAL and stored.ndim == 2 and stored.shape[1] == 2 and not expected[:, 2].any():
        expected = expected[:, :2]
    if stored.shape != expected.shape or stored.dtype.kind not in "fiu":
        return False
    size = np.nanmax(np.abs(expected), initial=0)
    # of displacements themselves: those of small strains would all agree to a part of the body's size
    tolerance = {"rotation_angle": _ANGLE, "displacement": _PART * size, "rest_position": _ROUNDING * size}
    return np.allclose(stored, expected, rtol=_ROUNDING, atol=tolerance.get(name, _ROUNDING), equal_nan=True)


def _compute_expected(series: Series, x: Floats, names: set[str]) -> dict[str, Floats]:
    """Return the values of these names at positions x."""
    mesh = series.mesh
    expected = {"displacement": pad_to_space(x - mesh.points), "rest_position": pad_to_space(mesh.points)}
    if names.intersection(MEASURED):
        cells = measure_cells(mesh, x)
        expected |= {
            "volume_ratio": cells.volumes / mesh.rest_volumes, "volume_ratio_min": cells.ratio_min,
            "volume_ratio_max": cells.ratio_max, "rotation_angle": np.degrees(cells.angles),
        }  # fmt: skip
    return expected
