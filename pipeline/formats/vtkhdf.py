"""Temporal .vtkhdf: one file for all frames, its cells and rest positions stored once, readable even after a kill.

All space is laid out when the file is made, and frame arrays are not compressed: a frame is plain bytes at known
places. Unused space takes no room on disk (a sparse file). A frame counts once the link VTKHDF points to the other of
two groups, which lists one more frame and shares the rest: a write of a few bytes, and the only one that readers
notice. (VTK's reader overruns its memory if Steps/Values is longer than NSteps: the two have to change together.)
The reader is VTK's, in vtk_readers; ParaView reads temporal VTKHDF from 5.13 on.
https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
"""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Fields
from pipeline.formats.atomic import replace_file
from pipeline.formats.grid import CellArray

_GROUPS = ("turns/even", "turns/odd")


class VtkhdfFile:
    """A file open for appending frames; its arrays have `names`: Points, PointData/…, CellData/… and FieldData/….

    Frames after those of `times` [s], which a killed run may have left, are dropped.
    """

    def __init__(self, path: Path, names: Iterable[str], times: Sequence[float]) -> None:
        import h5py

        # not locked, so that others can read it meanwhile
        self._file = h5py.File(path, "r+", locking=False)
        self._datasets = {name: self._file["VTKHDF"][name] for name in names}
        self.room = len(self._file["VTKHDF/Steps/PointOffsets"])
        self._times = list(times)
        if self._times:
            self._list_frames()

    def append(self, time: float, arrays: Fields) -> None:
        """Write the arrays of a frame, then list it."""
        for name, values in arrays.items():
            self._datasets[name][_frame_rows(values, len(self._times))] = values
        self._times.append(time)
        self._list_frames()

    def read_rows(self, name: str, rows: slice) -> NDArray[Any]:
        """Return rows of an array of all frames."""
        values: NDArray[Any] = self._datasets[name][rows]
        return values

    def close(self) -> None:
        """Sync and close the file."""
        os.fsync(self._file.id.get_vfd_handle())
        self._file.close()

    def _list_frames(self) -> None:
        """List the frames in the group that readers do not see, and make the link point to it."""
        unseen = self._file[_GROUPS[1] if self._file["VTKHDF"] == self._file[_GROUPS[0]] else _GROUPS[0]]
        steps = unseen["Steps"]
        steps["Values"].resize((len(self._times),))
        steps["Values"][:] = self._times
        steps.attrs.modify("NSteps", np.int64(len(self._times)))
        self._file.flush()
        os.fsync(self._file.id.get_vfd_handle())
        del self._file["VTKHDF"]
        self._file["VTKHDF"] = unseen
        self._file.flush()


def lay_out_file(
    path: Path,
    cells: CellArray,
    rest: NDArray[np.floating],
    arrays: Fields,
    *,
    times: Sequence[float],
    room: int,
    before: VtkhdfFile | None = None,
) -> None:
    """Put a whole file in place for simplices (e, d + 1), rest positions (n, 3) and `room` frames like `arrays`.

    It lists the frames of `times` [s], whose arrays are copied from the file `before`. Without that file `times` is the
    time of one frame with `arrays`.
    """
    import h5py

    # the oldest layout: every reader knows it, and a kill leaves no "open" mark in it
    with replace_file(path) as hidden, h5py.File(hidden, "w", libver="earliest") as file:
        root, other = (file.create_group(group) for group in _GROUPS)
        _lay_out_cells(root, cells, rest)
        _lay_out_frames(root, arrays, room)
        for name, values in arrays.items():
            for index in range(len(times)):
                rows = _frame_rows(values, index)
                root[name][rows] = values if before is None else before.read_rows(name, rows)
        _lay_out_steps(root, times, room)
        _share(root, other)
        file["VTKHDF"] = root


def _frame_rows(values: NDArray[Any], index: int) -> slice:
    """Return the rows of a frame's values among those of all frames."""
    return slice(index * len(values), (index + 1) * len(values))


def _lay_out_cells(root: Any, cells: CellArray, rest: NDArray[np.floating]) -> None:
    """Write everything that never changes."""
    n, e = len(rest), len(cells.types)
    root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
    root.attrs["Type"] = np.bytes_("UnstructuredGrid")
    for name, count in {"Points": n, "Cells": e, "ConnectivityIds": len(cells.connectivity)}.items():
        root[f"NumberOf{name}"] = np.array([count], dtype=np.int64)
    static: dict[str, NDArray[Any]] = {
        "Connectivity": cells.connectivity,
        "Offsets": cells.offsets,
        "Types": cells.types,
        "PointData/rest_position": rest,
    }
    for name, values in static.items():
        _store(root, name, values)


def _lay_out_frames(root: Any, arrays: Fields, room: int) -> None:
    """Reserve every frame's bytes in the file, unwritten."""
    import h5py

    for name, values in arrays.items():
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        if "/" in name:
            root.require_group(name.partition("/")[0])
        space = h5py.h5s.create_simple((room * len(values), *values.shape[1:]))
        h5py.h5d.create(root.id, name.encode(), h5py.h5t.py_create(values.dtype), space, dcpl=layout)


def _lay_out_steps(root: Any, times: Sequence[float], room: int) -> None:
    """Write the list of frames and the place where each begins."""
    index, n, e = np.arange(room, dtype=np.int64), int(root["NumberOfPoints"][0]), int(root["NumberOfCells"][0])
    steps = root.create_group("Steps")
    _lay_out_times(steps, times, room)
    _store(steps, "NumberOfParts", np.ones_like(index))
    _store(steps, "PartOffsets", np.zeros_like(index))
    _store(steps, "CellOffsets", np.zeros((room, 1), dtype=np.int64))
    steps["ConnectivityIdOffsets"] = steps["CellOffsets"]
    for kind, starts in {"PointData": n * index, "CellData": e * index, "FieldData": index}.items():
        fields = [f"{kind}Offsets/{name}" for name in root[kind] if name != "rest_position"]
        _store(steps, fields[0], starts)
        for name in fields[1:]:  # many names for one array
            steps[name] = steps[fields[0]]
    steps["PointOffsets"] = steps["PointDataOffsets/displacement"]
    steps["PointDataOffsets/rest_position"] = steps["PartOffsets"]


def _store(root: Any, name: str, values: NDArray[Any]) -> None:
    """Write an array that never changes, compressed in 64 KiB chunks: the default takes a megabyte for one cell."""
    rows = min(65536 // (values.nbytes // len(values)), len(values))
    chunks = (rows, *values.shape[1:])
    root.create_dataset(name, data=values, compression="gzip", shuffle=True, chunks=chunks)


def _lay_out_times(steps: Any, times: Sequence[float], room: int) -> None:
    steps.attrs["NSteps"] = np.int64(len(times))
    # one chunk for all frames to come, allocated at once: listing a frame moves nothing in the file
    steps.create_dataset("Values", data=np.asarray(times), maxshape=(None,), chunks=(room,))


def _share(root: Any, other: Any) -> None:
    """Link everything of the first group into the other, which gets its own list of frames."""
    for name, value in root.attrs.items():
        other.attrs[name] = value
    for name in root.keys() - {"Steps"}:
        other[name] = root[name]
    steps = other.create_group("Steps")
    for name in root["Steps"].keys() - {"Values"}:
        steps[name] = root["Steps"][name]
    values = root["Steps/Values"]
    _lay_out_times(steps, values[:], values.chunks[0])
