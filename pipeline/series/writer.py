"""A dataset of a moving body as ParaView files; xarray reads from them the dataset that was written."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.errors import OutputError, SeriesError
from pipeline.series.accessor import SeriesAccessor, pyvista_grid
from pipeline.series.engine import ATTRIBUTES, STATIC
from pipeline.sinks.atomic import write_whole
from pipeline.sinks.vtu import pvd_text

if TYPE_CHECKING:
    import xarray


def dataset_to_pvd(dataset: "xarray.Dataset", path: Path | str) -> Path:
    """Write a dataset as NAME.pvd with a folder NAME of .vtu files, a frame at a time; return the index.

    Raises SeriesError for a variable that is neither (time, node…), (time, cell…) nor (time…), as files of frames
    cannot hold it; OutputError where it cannot write.
    """
    path = Path(path)
    SeriesAccessor(dataset).mesh()
    strange = [str(name) for name, one in dataset.data_vars.items() if name not in STATIC and not _fits(one)]
    if strange:
        raise SeriesError(f"{path}: frames cannot hold {', '.join(strange)}; drop_vars them, or put time first")
    listed = []
    for index, time in enumerate(dataset["time"].values.tolist()):
        name = f"{path.stem}/frame_{index:06d}.vtu"
        grid = pyvista_grid(dataset.isel(time=index))
        if index == 0:
            said = {str(key): one.attrs for key, one in dataset.variables.items()} | {"": dataset.attrs}
            grid.field_data[ATTRIBUTES] = [json.dumps(said, default=_plain)]
        write_whole(path.parent / name, encoded(grid, path.parent / name))
        listed.append((time, name))
    write_whole(path, pvd_text(listed))
    return path


def _fits(variable: "xarray.DataArray") -> bool:
    """Return whether a variable is one of numbers, with time first."""
    return variable.dims[:1] == ("time",) and variable.dtype.kind in "fiu"


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
