"""A recorded series of frames, replayed as Frames: what views and statistics read."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pipeline.arrays import Floats
from pipeline.mesh.simplex import Mesh
from pipeline.run.frame import Frame
from pipeline.run.measures import AXES, QUANTILES, STEPS, VARIABLES
from pipeline.series.frame_files import Grid, read_grid
from pipeline.series.layout import Options, SeriesLayout, infer_layout
from pipeline.series.listing import list_frames

_AS_FOUND = Options()
_LENGTHS = {(): 1, ("axis",): len(AXES), ("quantile",): len(QUANTILES)}


@dataclass(frozen=True, eq=False)
class Series:
    """The frames of a series: a name, the files in order (with the step in each) and their times [s]."""

    name: str
    folder: Path
    files: tuple[Path, ...]
    times: tuple[float, ...]
    steps: tuple[int, ...] = ()
    options: Options = _AS_FOUND
    listing_notes: tuple[str, ...] = ()
    ours: bool = False  # recorded by this program: read without the care that files of others need

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[Frame]:
        return (self.read_frame(i) for i in range(len(self)))

    def select_frames(self, kept: Sequence[int]) -> "Series":
        """Return the series of some of its frames, by their indices in increasing order."""
        return replace(
            self,
            files=tuple(self.files[i] for i in kept),
            times=tuple(self.times[i] for i in kept),
            steps=tuple(self.steps[i] for i in kept) if self.steps else (),
        )

    def read_grid(self, index: int) -> Grid:
        """Return what the files say of one frame, read now; raises SeriesError where it cannot be read."""
        return read_grid(self.files[index], self.steps[index] if self.steps else 0, ours=self.ours)

    def read_frame(self, index: int, grid: Grid | None = None) -> Frame:
        """Return one frame, read from its file now; raises SeriesError where the file is not one of this series."""
        grid = self.read_grid(index) if grid is None else grid
        x = self.read_positions(index, grid)
        stepwise = [name for name in STEPS if name in grid.field_data] if self.ours else []
        known = {name: np.asarray(grid.field_data[name], dtype=np.float64).ravel() for name in stepwise}
        for name in grid.field_data.keys() & VARIABLES.keys():
            dims = VARIABLES[name].dims
            value = np.asarray(grid.field_data[name], dtype=np.float64)
            # a field of that name may be something else elsewhere
            if value.size == _LENGTHS.get(dims):
                known[name] = value.reshape([-1] if dims else [])
        step = int(grid.field_data["step"].ravel()[0]) if "step" in grid.field_data else None
        return Frame(index, self.times[index], self.mesh, x, step=step, v=self._velocity(grid), known=known)

    def read_positions(self, index: int, grid: Grid | None = None) -> Floats:
        """Return the positions (n, d) of one frame, read from its file now; raises SeriesError as `read_frame`."""
        where = f"{self.files[index]}, t = {self.times[index]:g} s"
        return self.layout.positions(self.read_grid(index) if grid is None else grid, where)

    def _velocity(self, grid: Grid) -> np.ndarray | None:
        v, d = grid.point_data.get("velocity"), self.mesh.dimension
        if v is None or v.ndim != 2 or v.shape[1] < d:
            return None
        v = v if self.layout.nodes is None else v[self.layout.nodes]
        return np.ascontiguousarray(v[:, :d], dtype=np.float64)

    @cached_property
    def layout(self) -> SeriesLayout:
        """Return how the files are understood; reads the first frame, and two more where it is not clear from that."""
        return infer_layout(self.read_grid, len(self), self.options, str(self.files[0]))

    @property
    def mesh(self) -> Mesh:
        """Return the rest mesh."""
        return self.layout.mesh

    @property
    def notes(self) -> tuple[str, ...]:
        """Return what a reader should know: frames left out, cells not measured, what was taken for what."""
        return *self.listing_notes, *self.layout.notes


def read_series(
    path: Path | str, name: str | None = None, *, displacement: str | None = None, rest: str | Path | None = None,
    strict: bool = False,
) -> Series:  # fmt: skip
    """Return the series of an index (.pvd, .series), a folder, a pattern, or a file with steps (.vtkhdf, .xdmf).

    Numbered files lie in a folder or match a pattern ("out/beam_*.vtu"). Frames that are missing or cut off are left
    out with a note; `strict` refuses them. `displacement` and `rest` are those of Options. Raises SeriesError.
    """
    found = list_frames(Path(path), strict=strict)
    times, files, steps = zip(*found.members, strict=True)
    options = Options(displacement, rest)
    series = Series(name or found.name, found.folder, files, times, steps, options, found.notes, found.ours)
    _ = series.layout  # what cannot be understood is refused here, not at the first frame
    return series
