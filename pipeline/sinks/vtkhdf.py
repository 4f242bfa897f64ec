"""Frames in one temporal .vtkhdf, which stays readable even after a kill; formats.vtkhdf describes how."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pipeline.arrays import Fields
from pipeline.errors import OutputError
from pipeline.formats.vtkhdf import VtkhdfFile, lay_out_file
from pipeline.run.frame import Frame, Values
from pipeline.sinks.fields import FrameFields, Precision, make_frame_fields, make_rest_positions

_ROOM = 64  # frames, if the caller does not say how many will come; doubled if more come


class VtkhdfSink:
    """Appends frames to series.vtkhdf in a folder, after those of `earlier` times [s]; room for `frames` is laid out.

    Raises OutputError at the first frame if h5py is missing.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        *,
        earlier: Sequence[float] = (),
        precision: Precision = "float64",
        frames: int = _ROOM,
    ) -> None:
        self.path = Path(folder) / "series.vtkhdf"
        self.precision = precision
        self._times, self._room = list(earlier), max(frames, len(earlier))
        self._file: VtkhdfFile | None = None

    def write(self, frame: Frame, measured: Values) -> None:
        """Write one frame, then count it; raises OutputError."""
        arrays = _name_arrays(make_frame_fields(frame, measured, self.precision))
        with self._report_failure("written"):
            if not self._times:
                self._file = self._lay_out(frame, arrays, self._room)
            elif self._file is None:
                self._file = VtkhdfFile(self.path, arrays, self._times)
            assert self._file is not None
            if self._times and len(self._times) == self._file.room:
                self._file = self._lay_out(frame, arrays, 2 * self._file.room)
            self._file.append(frame.time, arrays)
            self._times.append(frame.time)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            file, self._file = self._file, None
            with self._report_failure("closed"):
                file.close()

    def _lay_out(self, frame: Frame, arrays: Fields, room: int) -> VtkhdfFile:
        """Return a file with room for `room` frames that has those so far or, if there are none, lists this one."""
        mesh = frame.mesh
        rest = make_rest_positions(mesh, self.precision)
        times = self._times or [frame.time]
        lay_out_file(self.path, mesh.cell_array, rest, arrays, times=times, room=room, before=self._file)
        if self._file is not None:
            self._file.close()
        return VtkhdfFile(self.path, arrays, self._times)

    @contextmanager
    def _report_failure(self, action: str) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError, KeyError, ValueError, ImportError) as error:
            raise OutputError(f"{self.path}: cannot be {action} ({error})") from error


def _name_arrays(fields: FrameFields) -> Fields:
    """Return everything that changes from frame to frame, by its name in the file."""
    return {
        "Points": fields.points,
        **{f"PointData/{name}": values for name, values in fields.nodal.items()},
        **{f"CellData/{name}": values for name, values in fields.cellular.items()},
        **{f"FieldData/{name}": values for name, values in fields.numbers.items()},
    }
