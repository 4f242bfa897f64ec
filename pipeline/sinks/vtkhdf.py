"""One file for all frames: temporal VTKHDF, its cells and rest positions stored once, readable after every kill.

All room is laid out when the file is made, and what moves is not compressed: a frame is plain bytes at places known
before. Room that was not used yet takes none on the disk (a sparse file). A frame counts when the link VTKHDF is
turned to the other one of two groups, which lists a frame more and shares the rest: a write of a few bytes, and the
only one that changes what a reader sees. (VTK's reader overruns its memory where Steps/Values is longer than NSteps
says: the two have to change together.) ParaView 5.11 does not read temporal VTKHDF.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import OutputError
from pipeline.formats.atomic import whole_file
from pipeline.formats.cell_types import CELL_TYPES
from pipeline.mesh.simplex import Mesh
from pipeline.run.frame import Frame, Values
from pipeline.sinks.fields import FrameFields, Precision, frame_fields, rest_positions

_ROOM = 64  # frames, where nobody says how many will come; doubled when they are more
_TURNS = ("turns/even", "turns/odd")


class VtkhdfSink:
    """Appends frames to series.vtkhdf in a folder, after those of `earlier` times [s]; room for `frames` is laid out.

    Raises OutputError at the first frame where h5py is missing.
    """

    def __init__(
        self, folder: Path, *, earlier: Sequence[float] = (), precision: Precision = "float64", frames: int = _ROOM
    ) -> None:
        self.path = Path(folder) / "series.vtkhdf"
        self.precision = precision
        self._times, self._room = list(earlier), max(frames, len(earlier))
        self._file: Any = None
        self._datasets: Mapping[str, Any] = {}

    def write(self, frame: Frame, measured: Values) -> None:
        """Write one frame, then count it; raises OutputError."""
        fields = frame_fields(frame, measured, self.precision)
        with self._told("written"):
            if not self._times:
                self._make(frame, fields, self._room)
            elif self._file is None:
                self._open(fields)
            if self._times and len(self._times) == self._room:
                self._make(frame, fields, 2 * self._room)
            self._append(frame.time, fields)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            file, self._file, self._datasets = self._file, None, {}
            with self._told("closed"):
                os.fsync(file.id.get_vfd_handle())
                file.close()

    def _append(self, time: float, fields: FrameFields) -> None:
        for name, values in _moving(fields).items():
            self._datasets[name][_rows(values, len(self._times))] = values
        self._times.append(time)
        _turn(self._file, self._times)

    def _make(self, frame: Frame, fields: FrameFields, room: int) -> None:
        """Put a file with room and the frames so far in place; without any the first frame is laid out too."""
        before, self._room = self._file, room
        with whole_file(self.path) as hidden, _created(hidden) as file:
            root, other = (file.create_group(turn) for turn in _TURNS)
            _lay_out_cells(root, frame.mesh, self.precision)
            _lay_out_frames(root, fields, room)
            for name, values in _moving(fields).items():
                for place in range(len(self._times)):
                    rows = _rows(values, place)
                    root[name][rows] = before["VTKHDF"][name][rows]
            _lay_out_steps(root, self._times or [frame.time], room)
            _share(root, other)
            file["VTKHDF"] = root
        if before is not None:
            before.close()
        self._open(fields)

    def _open(self, fields: FrameFields) -> None:
        import h5py

        # not locked: others may read meanwhile
        self._file = h5py.File(self.path, "r+", locking=False)
        self._datasets = {name: self._file["VTKHDF"][name] for name in _moving(fields)}
        self._room = len(self._file["VTKHDF/Steps/PointOffsets"])
        if self._times:
            _turn(self._file, self._times)

    @contextmanager
    def _told(self, what: str) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError, KeyError, ValueError, ImportError) as error:
            raise OutputError(f"{self.path}: cannot be {what} ({error})") from error


def _moving(fields: FrameFields) -> Mapping[str, NDArray[Any]]:
    """Return everything that changes from frame to frame, by its name in the file."""
    return {
        "Points": fields.points,
        **{f"PointData/{name}": values for name, values in fields.nodal.items()},
        **{f"CellData/{name}": values for name, values in fields.cellular.items()},
        **{f"FieldData/{name}": values for name, values in fields.numbers.items()},
    }


def _rows(values: NDArray[Any], place: int) -> slice:
    """Return where a frame's values lie among those of all frames."""
    return slice(place * len(values), (place + 1) * len(values))


def _created(path: Path) -> Any:
    """Return a new file of the oldest layout: every reader knows it, and a kill leaves no mark "open" in it."""
    import h5py

    return h5py.File(path, "w", libver="earliest")


def _turn(file: Any, times: Sequence[float]) -> None:
    """List frames of these times in the group that nobody sees, and turn the link to it."""
    unseen = file[_TURNS[1] if file["VTKHDF"] == file[_TURNS[0]] else _TURNS[0]]
    steps = unseen["Steps"]
    steps["Values"].resize((len(times),))
    steps["Values"][:] = times
    steps.attrs.modify("NSteps", np.int64(len(times)))
    file.flush()
    os.fsync(file.id.get_vfd_handle())
    del file["VTKHDF"]
    file["VTKHDF"] = unseen
    file.flush()


def _lay_out_cells(root: Any, mesh: Mesh, precision: Precision) -> None:
    """Write what never changes."""
    n, (e, corners) = len(mesh.points), mesh.cells.shape
    root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
    root.attrs["Type"] = np.bytes_("UnstructuredGrid")
    for name, count in {"Points": n, "Cells": e, "ConnectivityIds": e * corners}.items():
        root[f"NumberOf{name}"] = np.array([count], dtype=np.int64)
    for name, values in {
        "Connectivity": mesh.cells.ravel(),
        "Offsets": np.arange(0, e * corners + 1, corners, dtype=np.int64),
        "Types": np.full(e, CELL_TYPES[mesh.dimension], dtype=np.uint8),
        "PointData/rest_position": rest_positions(mesh, precision),
    }.items():
        _store(root, name, values)


def _lay_out_frames(root: Any, fields: FrameFields, room: int) -> None:
    """Give every frame its bytes in the file, unwritten."""
    import h5py

    for name, values in _moving(fields).items():
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        if "/" in name:
            root.require_group(name.partition("/")[0])
        space = h5py.h5s.create_simple((room * len(values), *values.shape[1:]))
        h5py.h5d.create(root.id, name.encode(), h5py.h5t.py_create(values.dtype), space, dcpl=layout)


def _lay_out_steps(root: Any, times: Sequence[float], room: int) -> None:
    """Write which frames there are, and where each begins."""
    place, n, e = np.arange(room, dtype=np.int64), int(root["NumberOfPoints"][0]), int(root["NumberOfCells"][0])
    steps = root.create_group("Steps")
    _lay_out_times(steps, times, room)
    _store(steps, "NumberOfParts", np.ones_like(place))
    _store(steps, "PartOffsets", np.zeros_like(place))
    _store(steps, "CellOffsets", np.zeros((room, 1), dtype=np.int64))
    steps["ConnectivityIdOffsets"] = steps["CellOffsets"]
    for kind, first in {"PointData": n * place, "CellData": e * place, "FieldData": place}.items():
        fields = [f"{kind}Offsets/{name}" for name in root[kind] if name != "rest_position"]
        _store(steps, fields[0], first)
        for name in fields[1:]:  # many names of one array
            steps[name] = steps[fields[0]]
    steps["PointOffsets"] = steps["PointDataOffsets/displacement"]
    steps["PointDataOffsets/rest_position"] = steps["PartOffsets"]


def _store(root: Any, name: str, values: NDArray[Any]) -> None:
    """Write an array that stays, compressed; 64 KiB a chunk, as the default makes a file of one cell a megabyte."""
    rows = min(65536 // (values.nbytes // len(values)), len(values))
    chunks = (rows, *values.shape[1:])
    root.create_dataset(name, data=values, compression="gzip", shuffle=True, chunks=chunks)


def _lay_out_times(steps: Any, times: Sequence[float], room: int) -> None:
    steps.attrs["NSteps"] = np.int64(len(times))
    # one chunk for all that will come, there from the start: listing a frame moves nothing in the file
    steps.create_dataset("Values", data=np.asarray(times), maxshape=(None,), chunks=(room,))


def _share(root: Any, other: Any) -> None:
    """Give the other group all that the first one has, but a list of frames of its own."""
    for name, value in root.attrs.items():
        other.attrs[name] = value
    for name in root.keys() - {"Steps"}:
        other[name] = root[name]
    steps = other.create_group("Steps")
    for name in root["Steps"].keys() - {"Values"}:
        steps[name] = root["Steps"][name]
    values = root["Steps/Values"]
    _lay_out_times(steps, values[:], values.chunks[0])
