"""A dataset of a moving body as ParaView files; xarray reads from them the dataset that was written."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.arrays import Floats
from pipeline.errors import OutputError, SeriesError
from pipeline.formats.atomic import write_whole
from pipeline.series.accessor import DeformationAccessor
from pipeline.series.xarray_plugin import ATTRIBUTES, STATIC
from pipeline.sinks.fields import FrameFields
from pipeline.sinks.vtu import pvd_text, static_parts, vtu_text

if TYPE_CHECKING:
    import xarray

_WHOLE = (("node",), ("cell",))
_BLOCK_BYTES = 1 << 22  # 4 MB: a hundred frames of a few hundred cells, one of a large mesh


def write_pvd_series(dataset: "xarray.Dataset", path: Path | str) -> Path:
    """Write a dataset as NAME.pvd with a folder NAME of .vtu files, a frame at a time; return the index.

    The frames are not synced: after a loss of power soon afterwards some may be empty or partial; write them anew.
    Raises SeriesError for a variable that is neither (time, node…), (time, cell…) nor (time…), as files of frames
    cannot hold it; OutputError where it cannot write.
    """
    path = Path(path)
    mesh = DeformationAccessor(dataset).mesh()
    strange = [str(name) for name, one in dataset.data_vars.items() if name not in STATIC and not _fits(one)]
    if strange:
        raise SeriesError(f"{path}: frames cannot hold {', '.join(strange)}; drop_vars them, or put time first")
    rest, moving = dataset["rest_position"].values, dataset.drop_vars(STATIC)
    static, listed = static_parts(mesh.cells, rest), []
    said = {str(key): one.attrs for key, one in dataset.variables.items()} | {"": dataset.attrs}
    first = {ATTRIBUTES: np.array([json.dumps(said, default=_plain).encode()])}
    for index, (time, fields) in enumerate(_frames(moving, rest)):
        name = f"{path.stem}/frame_{index:06d}.vtu"
        numbers = first | dict(fields.numbers) if index == 0 else fields.numbers
        write_whole(path.parent / name, vtu_text(replace(fields, numbers=numbers), static), synced=False)
        listed.append((time, name))
    write_whole(path, pvd_text(listed))
    return path


def _frames(moving: "xarray.Dataset", rest: Floats) -> Iterator[tuple[float, FrameFields]]:
    """Yield time [s] and fields of each frame; a block of frames is read at once, which costs less than one by one."""
    count = moving.sizes["time"]
    block = max(1, _BLOCK_BYTES * count // max(1, moving.nbytes))
    kinds = {str(name): one.dims[1:2] for name, one in moving.data_vars.items()}
    for start in range(0, count, block):
        part = moving.isel(time=slice(start, start + block))
        values = {name: part[name].values for name in kinds}
        for i, time in enumerate(part["time"].values.tolist()):
            row = {name: value[i] for name, value in values.items()}
            numbers = {"TimeValue": np.array([[time]])} | {
                name: np.atleast_2d(row[name]) for name, kind in kinds.items() if kind not in _WHOLE
            }
            nodal, cellular = ({name: row[name] for name, kind in kinds.items() if kind == one} for one in _WHOLE)
            yield time, FrameFields(rest + row["displacement"], nodal, cellular, numbers)


def _fits(variable: "xarray.DataArray") -> bool:
    """Return whether a variable is one of numbers, with time first, then nodes or cells, then components."""
    whole = variable.dims[1:2] in _WHOLE
    alone = not {"node", "cell"}.intersection(variable.dims[2 if whole else 1 :])
    return variable.dims[:1] == ("time",) and alone and variable.ndim <= 2 + whole and variable.dtype.kind in "fiu"


def _plain(value: Any) -> Any:
    """Return a numpy number or array as JSON has it; anything else in words."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def encoded(grid: Any, file: Path) -> str:
    """Return the text of a .vtu: inline base64, zlib, which every ParaView reads; raises OutputError."""
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    writer = vtkXMLUnstructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetDataModeToBinary()
    writer.SetCompressorTypeToZLib()
    writer.SetCompressionLevel(1)
    writer.SetWriteToOutputString(True)
    if not writer.Write():
        raise OutputError(f"{file}: VTK could not encode it")
    return str(writer.GetOutputString())
