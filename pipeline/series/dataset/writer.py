"""Writes a dataset of a moving body as ParaView files, from which xarray reads the same dataset back."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import SeriesError
from pipeline.formats.atomic import write_whole
from pipeline.formats.pvd import encode_pvd
from pipeline.formats.vtu_write import encode_static_parts, encode_vtu
from pipeline.series.dataset.attributes import ATTRIBUTES
from pipeline.series.dataset.mesh_variables import MESH_VARIABLES, read_mesh
from pipeline.sinks.fields import FrameFields

if TYPE_CHECKING:
    import xarray

_WHOLE = (("node",), ("cell",))
_BLOCK_BYTES = 1 << 22  # 4 MB: a hundred frames of a few hundred cells, or one of a large mesh


def write_pvd_series(dataset: "xarray.Dataset", path: str | os.PathLike[str]) -> Path:
    """Write a dataset as NAME.pvd with a folder NAME of .vtu files, frame by frame; return the index.

    The frames are not synced: a power loss soon afterwards may leave some of them empty or incomplete. Raises
    SeriesError for a variable that is neither (time, node, ...), (time, cell, ...) nor (time, ...), because files of
    frames cannot hold it; OutputError if a file cannot be written.
    """
    path, mesh = Path(path), read_mesh(dataset)
    moving = dataset.drop_vars(MESH_VARIABLES, errors="ignore")
    strange = [str(name) for name, field in moving.data_vars.items() if not _fits_frames(field)]
    if strange:
        raise SeriesError(f"{path}: frames cannot hold {', '.join(strange)}; drop_vars them, or put time first")
    times = dataset["time"].values
    if len(np.unique(times)) < len(times):
        raise SeriesError(f"{path}: some times occur twice, and a reader would drop frames: drop_duplicates('time')")
    rest = dataset["rest_position"].values
    static, entries = encode_static_parts(mesh.cell_array, rest), []
    names = [name for name in dataset.variables if name != "cell_type"]  # its attributes are arrays, and made anew
    attributes = {str(name): dataset[name].attrs for name in names} | {"": dataset.attrs}
    first = {ATTRIBUTES: np.array([json.dumps(attributes, default=_to_json).encode()])}
    others = {ATTRIBUTES: np.array([b"in the first frame"])}
    for index, (time, fields) in enumerate(_iterate_frames(moving, rest)):
        name = f"{path.stem}/frame_{index:06d}.vtu"
        numbers = (others if index else first) | dict(fields.numbers)
        content = encode_vtu(fields.points, fields.nodal, fields.cellular, numbers, static)
        write_whole(path.parent / name, content, synced=False)
        entries.append((time, name))
    write_whole(path, encode_pvd(entries))
    return path


def _iterate_frames(moving: "xarray.Dataset", rest: Floats) -> Iterator[tuple[float, FrameFields]]:
    """Yield time [s] and fields of each frame; they are read in blocks, which is faster than one by one."""
    count = moving.sizes["time"]
    block = max(1, _BLOCK_BYTES * count // max(1, moving.nbytes))
    kinds = {str(name): field.dims[1:2] for name, field in moving.data_vars.items()}
    for start in range(0, count, block):
        part = moving.isel(time=slice(start, start + block))
        values = {name: part[name].values for name in kinds}
        for i, time in enumerate(part["time"].values.tolist()):
            row = {name: value[i] for name, value in values.items()}
            numbers = {"TimeValue": np.array([[time]])} | {
                name: np.atleast_2d(row[name]) for name, kind in kinds.items() if kind not in _WHOLE
            }
            nodal, cellular = ({name: row[name] for name, kind in kinds.items() if kind == dim} for dim in _WHOLE)
            yield time, FrameFields(rest + row["displacement"], nodal, cellular, numbers)


def _fits_frames(variable: "xarray.DataArray") -> bool:
    """Return whether a variable holds numbers, with time first, then nodes or cells if any, then components."""
    whole = variable.dims[1:2] in _WHOLE
    alone = not {"node", "cell"}.intersection(variable.dims[2 if whole else 1 :])
    return variable.dims[:1] == ("time",) and alone and variable.ndim <= 2 + whole and variable.dtype.kind in "fiu"


def _to_json(value: Any) -> Any:
    """Return a numpy number or array as plain Python; anything else as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)
