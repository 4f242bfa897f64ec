"""A recorded series of frames, read back as Frames: the input of views and statistics."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from pathlib import Path

import numpy as np

from pipeline.arrays import Floats
from pipeline.formats.grid import Grid
from pipeline.mesh.body_mesh import BodyMesh
from pipeline.run.frame import Frame
from pipeline.run.measures import AXES, MATERIAL, QUANTILES, STEPS, VARIABLES
from pipeline.series.body.decisions import Decisions
from pipeline.series.body.inference import infer_layout
from pipeline.series.body.layout import Options, SeriesLayout
from pipeline.series.dataset.attributes import is_exported
from pipeline.series.files.frame_files import read_grid
from pipeline.series.files.instants import Member
from pipeline.series.files.listing import FrameListing, list_frames

_LENGTHS = {(): 1, ("axis",): len(AXES), ("quantile",): len(QUANTILES)}


@dataclass(frozen=True, eq=False, repr=False)
class Series:
    """The frames of a series: the place of each, in order of time, and the way in which the files are read."""

    name: str
    folder: Path
    members: tuple[Member, ...]
    layout: SeriesLayout
    listing_notes: tuple[str, ...] = ()
    ours: bool = False  # recorded by this program: read without the precautions that other files need

    def __len__(self) -> int:
        return len(self.members)

    def __iter__(self) -> Iterator[Frame]:
        return (self.read_frame(i) for i in range(len(self)))

    def __repr__(self) -> str:
        return f"<Series {self.name}: {self._describe()}>"

    def _repr_html_(self) -> str:
        notes = "".join(f"<br>{escape(note)}" for note in self.notes)
        return f"<b>{escape(self.name)}</b>: {self._describe()}{notes}"

    def _describe(self) -> str:
        """Return the numbers of frames and cells and the time span."""
        span = f"t = {self.times[0]:g} to {self.times[-1]:g} s" if len(self) else "no time"
        return f"{len(self)} frames, {span}, {len(self.mesh.rest_volumes)} cells in {self.mesh.dimension}D"

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """Return the file of each frame."""
        return tuple(member.file for member in self.members)

    @cached_property
    def times(self) -> tuple[float, ...]:
        """Return the time of each frame [s]."""
        return tuple(member.time for member in self.members)

    @property
    def mesh(self) -> BodyMesh:
        """Return the rest mesh."""
        return self.layout.mesh

    @property
    def notes(self) -> tuple[str, ...]:
        """Return notes on frames left out, cells not measured, and guesses about the files."""
        return *self.listing_notes, *self.layout.notes

    def describe_decisions(self) -> Decisions:
        """Return the decisions about points, displacement, rest state, cells and times as short texts."""
        if not len(self):
            return self.layout.decisions
        counted = ", counted: the files have none" if any("counted from 0" in note for note in self.notes) else ""
        frames = "1 frame" if len(self) == 1 else f"{len(self)} frames"
        times = f"{frames} from {self.times[0]:g} to {self.times[-1]:g} s{counted}"
        return replace(self.layout.decisions, times=times)

    def select_frames(self, indices: Sequence[int]) -> "Series":
        """Return the series of some of its frames, by their indices in increasing order."""
        return replace(self, members=tuple(self.members[i] for i in indices))

    def read_grid(self, index: int) -> Grid:
        """Return the content of a frame's file, read now; raises SeriesError if it cannot be read."""
        return _read_member(self.members[index], ours=self.ours)

    def read_frame(self, index: int, grid: Grid | None = None) -> Frame:
        """Return one frame, read from its file now; raises SeriesError if the file does not fit the series.

        If its cells are not those of the mesh, its positions are NaN, and it has numbers of the whole body.
        """
        grid = self.read_grid(index) if grid is None else grid
        member = self.members[index]
        where = f"{member.file}, t = {member.time:g} s"
        x, fault = self.layout.compute_positions(grid, where)
        changed = bool(self.layout.find_arrangement(grid).fault)
        stepwise = [name for name in STEPS if name in grid.field_data] if self.ours else []
        known = {name: np.asarray(grid.field_data[name], dtype=np.float64).ravel() for name in stepwise}
        for name in grid.field_data.keys() & VARIABLES.keys():
            dims = VARIABLES[name].dims
            value = np.asarray(grid.field_data[name], dtype=np.float64)
            # in another program's files, a field of that name may be something else
            if value.size == _LENGTHS.get(dims):
                known[name] = value.reshape([-1] if dims else [])
        if not (self.ours and MATERIAL in grid.cell_data):  # one density: the center follows from the points
            known.pop("center_of_mass", None)
        step = int(grid.field_data["step"].ravel()[0]) if "step" in grid.field_data else None
        return Frame(
            index, member.time, self.mesh, x, step=step, v=None if changed else self._read_velocity(grid), known=known,
            whole=self.layout.measure_whole(grid) if changed else {}, fault=fault,
        )  # fmt: skip

    def read_positions(self, index: int, grid: Grid | None = None) -> Floats:
        """Return the positions (n, d) of one frame, read from its file now; raises SeriesError as `read_frame` does.

        Nodes that the frame does not have are NaN.
        """
        member = self.members[index]
        where = f"{member.file}, t = {member.time:g} s"
        return self.layout.compute_positions(self.read_grid(index) if grid is None else grid, where)[0]

    def _read_velocity(self, grid: Grid) -> Floats | None:
        v, d = grid.point_data.get("velocity"), self.mesh.points.shape[1]
        if v is None or v.ndim != 2 or v.shape[1] < d:
            return None
        v = self.layout.arrange(grid, "").select_nodes(v)
        return np.ascontiguousarray(v[:, :d], dtype=np.float64)


def read_series(
    path: str | os.PathLike[str], name: str | None = None, *, displacement: str | None = None,
    rest: str | os.PathLike[str] | None = None, strict: bool = False,
) -> Series:  # fmt: skip
    """Return the series of an index (.pvd, .series), a folder, a pattern, or a file with steps (.vtkhdf, .xdmf).

    A folder or a pattern ("out/beam_*.vtu") is read as numbered files. Frames that are missing or cut off are left out
    with a note; with `strict` they are errors. `displacement` and `rest` are those of Options. Raises SeriesError.
    """
    return open_series(path, name, displacement=displacement, rest=rest, strict=strict)[0]


def open_series(
    path: str | os.PathLike[str], name: str | None = None, *, displacement: str | None = None,
    rest: str | os.PathLike[str] | None = None, strict: bool = False,
) -> tuple[Series, Grid]:  # fmt: skip
    """Return the series, as `read_series` does, and its first frame, which has to be read for that."""
    listing = list_frames(Path(path), strict=strict)
    listing = listing if name is None else listing._replace(name=name)
    return make_series(listing, Options(displacement, rest))


def make_series(listing: FrameListing, options: Options = Options()) -> tuple[Series, Grid]:  # noqa: B008  (frozen)
    """Return the series of listed frames, and its first frame; raises SeriesError if the layout is ambiguous."""
    members, ours = listing.members, listing.ours
    first = _read_member(members[0], ours=ours)

    def read(index: int) -> Grid:
        return _read_member(members[index], ours=ours)

    trusted = ours or (is_exported(first) and is_exported(read(len(members) - 1)))
    layout = infer_layout(first, read, len(members), options, str(members[0].file), ours=trusted)
    return Series(listing.name, listing.folder, members, layout, (*listing.notes, *first.notes), ours), first


def _read_member(member: Member, *, ours: bool) -> Grid:
    return read_grid(member.file, member.step, others=member.others, ours=ours)
