"""The contents of a frame in ParaView files of every format: points, and fields of nodes, cells and the body, by name.

Points are the DEFORMED positions; `displacement` and `rest_position` lead back.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Fields
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.run.frame import Frame, Values
from pipeline.run.measures import VARIABLES, pad_to_space

Precision = Literal["float64", "float32"]


@dataclass(frozen=True, eq=False)
class FrameFields:
    """One frame: points (n, 3), nodal (n, 3), cellular (e,), and numbers of the body: rows of components (1, k)."""

    points: NDArray[np.floating]
    nodal: Fields
    cellular: Fields
    numbers: Fields


def make_frame_fields(frame: Frame, measured: Values, precision: Precision = "float64") -> FrameFields:
    """Return everything that changes from frame to frame; numbers of the body are float64 in every precision."""
    mesh = frame.mesh
    nodal = {"displacement": frame.x - mesh.points}
    if frame.v is not None:
        nodal["velocity"] = frame.v
    cellular = {
        name: measured[name] for name, variable in VARIABLES.items() if variable.dims == ("cell",) and name in measured
    }
    cellular = {"volume": cellular["volume_ratio"] * mesh.rest_volumes, **cellular}
    fixed: Fields = {} if frame.materials is None else {"material": frame.materials}
    numbers = {"TimeValue": np.array([[frame.time]])}
    if frame.step is not None:
        numbers["step"] = np.array([[frame.step]], dtype=np.int64)
    numbers |= {name: np.atleast_2d(value) for name, value in measured.items() if name not in cellular}
    return FrameFields(
        pad_to_space(frame.x).astype(precision, copy=False),
        {name: pad_to_space(value).astype(precision, copy=False) for name, value in nodal.items()},
        {**{name: value.astype(precision, copy=False) for name, value in cellular.items()}, **fixed},
        numbers,
    )


def make_rest_positions(mesh: BodyMesh, precision: Precision = "float64") -> NDArray[np.floating]:
    """Return the rest points (n, 3), the one nodal field that never changes."""
    return pad_to_space(mesh.points).astype(precision, copy=False)
