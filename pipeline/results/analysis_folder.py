"""The result folder of any series, and of several side by side: datasets, figures and movies.

Frames are read and written one at a time, so memory is that of a few frames, however long a series is. Figures
and movies of long series show some of the frames, and a note says so.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pipeline.analysis.compare import join_series, plan_comparison
from pipeline.analysis.node_distance import NodeDistance
from pipeline.analysis.statistics import write_statistics
from pipeline.errors import SeriesError
from pipeline.formats.netcdf import open_dataset
from pipeline.results.folder_kinds import check_output_folder
from pipeline.results.measured_frames import make_frame_sink, write_frame_script
from pipeline.results.stale_files import hash_file, remove_stale
from pipeline.series import Series, read_series

if TYPE_CHECKING:
    import xarray

OnSeriesFrame = Callable[[str, int, int], None]  # name of the series, frames done, frames in all
OnDrawing = Callable[[int, int], None]

_DRAWN_VALUES = 10_000_000  # 80 MB of volume ratios in one figure
_LINES, _DRAWN_POINTS = 2000, 200_000  # figures of up to 2000 cells draw a line for each: 4 s of drawing
_DRAWN_FRAMES = 600  # 20 s of film at 30 frames a second: a movie holds all its surfaces in memory
_FILM_SECONDS = 20.0


@dataclass(frozen=True)
class Analysis:
    """The largest deviation in a series, and the files written about it."""

    name: str
    folder: Path
    files: tuple[Path, ...] = field(repr=False)
    notes: tuple[str, ...] = field(repr=False)
    frames: int
    worst_volume_ratio: float
    worst_cell: int
    worst_time: float


@dataclass(frozen=True)
class Comparison:
    """Series side by side: the analysis of each, and the files written about all of them."""

    folder: Path
    files: tuple[Path, ...] = field(repr=False)
    notes: tuple[str, ...] = field(repr=False)
    analyses: tuple[Analysis, ...] = field(repr=False)
    node_distances: tuple[NodeDistance, ...] = ()  # of all but the first, if differences were requested


def analyze(
    source: str | os.PathLike[str] | Series, out: str | os.PathLike[str], *, movie: bool = False,
    paraview: bool = False, on_frame: OnSeriesFrame | None = None, on_drawing: OnDrawing | None = None,
) -> Analysis:  # fmt: skip
    """Write statistics.nc, volume.png and, with `movie`, movie.mp4 and movie.png of a series into a folder.

    `paraview` adds series.pvd with the frames, whose cells have their volume ratios, and open_in_paraview.py.
    A path is read with the defaults of read_series. Results of another series in that folder are removed. Raises
    SeriesError if a frame cannot be read or no cell can be measured, OutputError if a file cannot be written or drawn.
    """
    series = source if isinstance(source, Series) else read_series(source)
    out = Path(out)
    check_output_folder(out)
    statistics, on_own_frame = out / "statistics.nc", _with_name(on_frame, series.name)
    before = hash_file(statistics)
    frames = make_frame_sink(out) if paraview else None
    summary, gaps = write_statistics(series, statistics, on_own_frame, frames=frames)
    volume, notes = _draw_volume(statistics, out / "volume.png", series.name, series.name)
    files, notes = [statistics, volume], [*series.notes, *gaps, *notes]
    if frames is not None:
        files += [frames.index, write_frame_script([series], [out], out)]
    notes += remove_stale(out, statistics, before, files)
    if movie:
        pictures, movie_notes = _draw_movie([series], series.name, out / "movie.mp4", on_drawing)
        files, notes = files + pictures, notes + movie_notes
    return Analysis(
        series.name, out, tuple(files), tuple(notes), summary.frames, summary.worst_volume_ratio, summary.worst_cell,
        summary.worst_time,
    )  # fmt: skip


def compare(
    sources: Sequence[str | os.PathLike[str] | Series], out: str | os.PathLike[str], *, movie: bool = False,
    difference: bool = False, paraview: bool = False, on_frame: OnSeriesFrame | None = None,
    on_drawing: OnDrawing | None = None,
) -> Comparison:  # fmt: skip
    """Write comparison.nc, volume.png and, with `movie`, movie.mp4 of several series, and the analysis of each in a
    subfolder; `paraview` adds the frames there, and a script that shows all side by side.

    The dataset joins them along `variant`. If their times differ, numbers are interpolated linearly to those of the
    series with the fewest frames, within the time that all cover. Numbers of cells need the same cells in all.
    `difference` adds the differences from the first series in cells and nodes (displacement, velocity, distance) and
    distance.png; series on other meshes are sampled at the rest positions of the first's nodes and cells. Raises
    SeriesError if bodies cannot be compared: other dimensions or units, or no place that both have.
    """
    named = _make_names_distinct([s if isinstance(s, Series) else read_series(s) for s in sources])
    plan, out = plan_comparison(named, difference=difference), Path(out)
    check_output_folder(out)
    series = list(plan.series)
    analyses = tuple(analyze(s, out / s.name, paraview=paraview, on_frame=on_frame) for s in series)
    path = out / "comparison.nc"
    on_time, before = _with_name(on_frame, "difference of nodes"), hash_file(path)
    distances = join_series(plan, [analysis.files[0] for analysis in analyses], path, on_time)
    files, notes = [path], [*(f"{part.name}: {note}" for part in analyses for note in part.notes), *plan.notes]
    if plan.joins_cells:
        picture, figure_notes = _draw_volume(path, out / "volume.png", plan.title)
        files, notes = [*files, picture], notes + figure_notes
    else:
        notes.append(
            "the cells differ: comparison.nc has the numbers of whole bodies only; a difference (--difference) samples "
            f"the others at the rest positions of {series[0].name}"
        )
    if difference:
        files.append(_draw_distances(path, out / "distance.png", plan.title))
        if plan.interpolated:
            notes.append("between two frames of a series, nodes are taken to be on the chord between them")
    if paraview:
        files.append(write_frame_script(series, [analysis.folder for analysis in analyses], out))
    notes += remove_stale(out, path, before, files)
    if movie:
        pictures, movie_notes = _draw_movie(series, plan.title, out / "movie.mp4", on_drawing)
        files, notes = files + pictures, notes + movie_notes
    return Comparison(out, tuple(files), tuple(notes), analyses, distances)


def _with_name(on_frame: OnSeriesFrame | None, name: str) -> Callable[[int, int], None] | None:
    """Return a callback of (done, frames) that also passes a name on."""
    if on_frame is None:
        return None
    return lambda done, frames: on_frame(name, done, frames)


def _make_names_distinct(series: list[Series]) -> list[Series]:
    """Return the series under names that differ; raises SeriesError if there are fewer than two."""
    if len(series) < 2:
        raise SeriesError(f"a comparison needs two series or more, not {len(series)}")
    names: list[str] = []
    for s in series:
        count = 1
        while (name := s.name if count == 1 else f"{s.name}_{count}") in names:
            count += 1
        names.append(name)
    return [replace(s, name=name) for s, name in zip(series, names, strict=True)]


def _draw_volume(path: Path, picture: Path, title: str, name: str | None = None) -> tuple[Path, list[str]]:
    """Draw the volume ratios of a comparison.nc, or of a statistics.nc with a `name`; a note if frames are left out."""
    from pipeline.views.plots import write_volume_figure

    with open_dataset(path) as dataset:
        frames, count = _choose_frames(dataset), dataset.sizes["time"]
        names = [name for name in ("volume_ratio", "volume_ratio_min", "volume_ratio_max") if name in dataset]
        ratios = dataset[[*names, "rest_volume"]].isel(time=frames)
        if name is not None:  # after the choice of frames, as expand_dims reads all values
            ratios = ratios.assign({key: ratios[key].expand_dims(variant=[name]) for key in names})
        write_volume_figure(ratios, picture, title=title)
    note = f"{picture.name} shows {len(frames)} of {count} frames, the worst among them"
    return picture, [note] if len(frames) < count else []


def _draw_distances(path: Path, picture: Path, title: str) -> Path:
    """Draw the distances of the nodes from those of the first series."""
    from pipeline.views.plots import write_distance_figure

    with open_dataset(path) as dataset:
        write_distance_figure(dataset[["node_distance_worst", "node_distance_rms"]], picture, title=title)
    return picture


def _choose_frames(dataset: "xarray.Dataset") -> list[int]:
    """Return the frames that a figure shows."""
    count = dataset.sizes["time"]
    most = _DRAWN_POINTS if dataset.sizes["cell"] <= _LINES else _DRAWN_VALUES
    most = max(2, most // (dataset.sizes["cell"] * dataset.sizes.get("variant", 1)))
    if count <= most:
        return list(range(count))
    extremes = dataset["volume_ratio_quantile"].isel(quantile=[0, -1])
    worst = abs(extremes - 1).max("quantile").fillna(-1).argmax("time").values.ravel()
    return sorted({*np.linspace(0, count - 1, most).round().astype(int).tolist(), *worst.tolist()})


def _draw_movie(
    series: list[Series], title: str, path: Path, on_drawing: OnDrawing | None
) -> tuple[list[Path], list[str]]:
    """Draw series side by side, no longer than 20 s; return the movie, its poster and notes on frames left out."""
    from pipeline.views.movie.movie import write_movie

    drawn, notes = [], []
    for s in series:
        frames = np.unique(np.linspace(0, len(s) - 1, min(len(s), _DRAWN_FRAMES)).round().astype(int)).tolist()
        if len(frames) < len(s):
            notes.append(f"{path.name} shows {len(frames)} of the {len(s)} frames of {s.name}")
        drawn.append(s.select_frames(frames))
    span = max(s.times[-1] for s in drawn) - min(s.times[0] for s in drawn)
    poster, labels = path.with_suffix(".png"), [s.name for s in series]
    write_movie(
        drawn, labels, path, title=title, poster=poster, speed=max(1.0, span / _FILM_SECONDS), on_frame=on_drawing
    )
    return [path, poster], notes
