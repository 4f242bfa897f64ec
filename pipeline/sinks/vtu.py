"""Frames as ParaView files: a .vtu each, and a .pvd index with the true times."""

import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.formats.atomic import write_whole
from pipeline.formats.pvd import complete_pvd, encode_pvd_rows
from pipeline.formats.vtu_write import StaticParts, encode_static_parts, encode_vtu
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.run.frame import Frame, Values
from pipeline.sinks.fields import Precision, make_frame_fields, make_rest_positions

_INDEX_SECONDS = 1.0  # the index grows with the run; writing it with every frame would cost the square of that


class VtuSink:
    """Writes frames/frame_000000.vtu … and series.pvd into a folder, after frames of `earlier` times [s] there.

    With `precision` "float32" the fields of nodes and cells take half the room; statistics cannot be rebuilt from them.
    """

    def __init__(
        self, folder: str | os.PathLike[str], *, earlier: Sequence[float] = (), precision: Precision = "float64"
    ) -> None:
        self.folder = Path(folder)
        self.index = self.folder / "series.pvd"
        self.precision = precision
        self._rows = bytearray(encode_pvd_rows((t, name_frame_file(index)) for index, t in enumerate(earlier)))
        self._indexed_at = -np.inf
        self._mesh: BodyMesh | None = None
        self._static: StaticParts

    def write(self, frame: Frame, measured: Values) -> None:
        """Write one whole frame; the index follows within a second."""
        name = name_frame_file(frame.index)
        write_whole(self.folder / name, self._encode(frame, measured))
        self._rows += encode_pvd_rows([(frame.time, name)])
        if time.monotonic() - self._indexed_at >= _INDEX_SECONDS:
            self._write_index()

    def close(self) -> None:
        """Write the index of all frames."""
        if self._rows:
            self._write_index()

    def _write_index(self) -> None:
        write_whole(self.index, complete_pvd(self._rows))
        self._indexed_at = time.monotonic()

    def _encode(self, frame: Frame, measured: Values) -> bytes:
        """Return the frame's .vtu."""
        mesh = frame.mesh
        if self._mesh is not mesh:
            self._mesh = mesh
            self._static = encode_static_parts(mesh.cell_array, make_rest_positions(mesh, self.precision))
        fields = make_frame_fields(frame, measured, self.precision)
        return encode_vtu(fields.points, fields.nodal, fields.cellular, fields.numbers, self._static)


def name_frame_file(index: int) -> str:
    """Return the name of a frame's file within the folder of the run."""
    return f"frames/frame_{index:06d}.vtu"
