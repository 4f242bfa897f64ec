"""The frames of any program's series as files for ParaView, with the volume ratio of every cell, and a script."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.errors import OutputError
from pipeline.formats.netcdf import open_dataset
from pipeline.series import Series
from pipeline.sinks.vtu import VtuSink, name_frame_file
from pipeline.views.paraview import write_script
from pipeline.views.track import SAMPLED_CELLS, find_normal, fit_color_radius


def make_frame_sink(folder: Path) -> VtuSink:
    """Return the sink that writes frames into a folder, in which those of an earlier analysis are removed first."""
    sink = VtuSink(folder)
    try:
        for path in (folder / name_frame_file(0)).parent.glob("frame_*.vtu"):
            path.unlink()
        sink.index.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: frames of an earlier analysis cannot be removed ({error.strerror})") from error
    return sink


def write_frame_script(series: Sequence[Series], folders: Sequence[Path], out: Path) -> Path:
    """Write open_in_paraview.py for series whose frames and statistics.nc are in folders below `out`."""
    samples, indices = [], {}
    for s, folder in zip(series, folders, strict=True):
        with open_dataset(folder / "statistics.nc") as dataset:
            every = max(1, dataset.sizes["cell"] // SAMPLED_CELLS)
            samples.append(np.abs(dataset["volume_ratio"].values[:, ::every] - 1).ravel())
        indices[s.name] = (folder.relative_to(out) / "series.pvd").as_posix()
    normals = [find_normal(s.mesh) for s in series]
    return write_script(out, indices, radius=fit_color_radius(np.concatenate(samples)), normal=normals[0])
