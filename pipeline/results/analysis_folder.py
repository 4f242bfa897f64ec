"""Anybody's series measured, and several of them side by side: datasets, figures and movies.

Frames are read one after the other and written at once, so memory is that of a few frames however long a series is;
figures and movies of long ones show some of their frames, and a note says so.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.analysis.node_distance import NodeDistance, write_node_distances
from pipeline.arrays import Floats
from pipeline.errors import SeriesError
from pipeline.formats.atomic import whole_file
from pipeline.formats.netcdf import NETCDF_LOCK, open_dataset
from pipeline.run.frame import Frame, Values
from pipeline.run.measures import AXES, QUANTILES, VARIABLES, attributes
from pipeline.run.recording import record
from pipeline.series import Series, read_series
from pipeline.sinks.netcdf import NetcdfSink

if TYPE_CHECKING:
    import xarray

OnSeriesFrame = Callable[[str, int, int], None]  # what is read, frames done, frames in all
OnDrawing = Callable[[int, int], None]

_SAME_TIME = 1e-12  # relative: what separates i * dt computed with another dt
_DRAWN_VALUES = 10_000_000  # 80 MB of volume ratios in one figure
_LINES, _DRAWN_POINTS = 2000, 200_000  # up to so many cells a figure has a line for each: 4 s of drawing
_DRAWN_FRAMES = 600  # 20 s of film at 30 a second: a movie holds all surfaces that it shows
_FILM_SECONDS = 20.0
_DIFFERENCES = ("volume_ratio", "rotation_angle")


@dataclass(frozen=True)
class Analysis:
    """What was found of a series, and where it was written."""

    name: str
    folder: Path
    made: tuple[Path, ...]
    notes: tuple[str, ...]
    frames: int
    worst_volume_ratio: float
    worst_cell: int
    worst_time: float


@dataclass(frozen=True)
class Comparison:
    """Series side by side: each one's analysis, and what was written of them together."""

    folder: Path
    made: tuple[Path, ...]
    notes: tuple[str, ...]
    analyses: tuple[Analysis, ...]
    node_distances: tuple[NodeDistance, ...] = ()  # the nodes of each but the first, where differences were asked for


def analyze(
    source: Path | str | Series, out: Path, *, movie: bool = False, on_frame: OnSeriesFrame | None = None,
    on_drawing: OnDrawing | None = None,
) -> Analysis:  # fmt: skip
    """Write statistics.nc, volume.png and, if asked for, movie.mp4 and movie.png of a series into a folder.

    A path is read with the defaults of read_series. Raises SeriesError where a frame cannot be measured, OutputError
    where something cannot be written or drawn.
    """
    series = source if isinstance(source, Series) else read_series(source)
    out, notes, path = Path(out), list(series.notes), Path(out) / "statistics.nc"
    with whole_file(path) as hidden:

        def told(frame: Frame, *_: object) -> None:
            if on_frame is not None:
                on_frame(series.name, frame.index + 1, len(series))

        summary = record(iter(series), [_Steady(NetcdfSink(hidden, title=series.name))], on_frame=told)
    made = [path, _figure(path, out / "volume.png", [series.name], series.name, notes)]
    if movie:
        made += _movie([series], [series.name], out / "movie.mp4", notes, on_drawing)
    return Analysis(
        series.name, out, tuple(made), tuple(notes), summary.frames, summary.worst_volume_ratio, summary.worst_cell,
        summary.worst_time,
    )  # fmt: skip


def compare(
    sources: Sequence[Path | str | Series], out: Path, *, movie: bool = False, difference: bool = False,
    on_frame: OnSeriesFrame | None = None, on_drawing: OnDrawing | None = None,
) -> Comparison:  # fmt: skip
    """Write comparison.nc, volume.png, and if asked for movie.mp4, of several series; each one's own in a subfolder.

    The dataset joins them along `variant`. Where their times differ, numbers are interpolated linearly to those of
    the series with the fewest frames, within the time that all cover. Numbers a cell need the same cells in all;
    `difference` adds their difference to the first series, those of the nodes (displacement, velocity, distances) and
    distance.png, and raises SeriesError where the cells differ.
    """
    named = _distinct([one if isinstance(one, Series) else read_series(one) for one in sources])
    same = _same_cells(named, difference=difference)
    out, notes = Path(out), [f"{one.name}: {note}" for one in named for note in one.notes]
    times, said = _common_times(named)
    notes += said
    analyses = tuple(analyze(one, out / one.name, on_frame=on_frame) for one in named)
    path = out / "comparison.nc"
    rows = [analysis.made[0] for analysis in analyses]
    with whole_file(path) as hidden, ExitStack() as opened:
        _write_comparison(hidden, [_Rows(p, opened) for p in rows], named, times, difference=difference, same=same)
        apart = _write_apart(hidden, named, times, on_frame) if difference else ()
    made = [path]
    if same:
        made.append(_figure(path, out / "volume.png", [one.name for one in named], _title(named), notes))
    else:
        notes.append("the cells differ: comparison.nc has the numbers of whole bodies only")
    if difference:
        made.append(_distances(path, out / "distance.png", _title(named)))
        if said:
            notes.append("nodes between two frames of a series are on the chord between them")
    if movie:
        made += _movie(named, [one.name for one in named], out / "movie.mp4", notes, on_drawing)
    return Comparison(out, tuple(made), tuple(notes), analyses, apart)


class _Steady:
    """A sink that gives another one the same names in every frame, NaN for what a frame does not say."""

    def __init__(self, sink: NetcdfSink) -> None:
        self._sink = sink
        self._first: Values = {}

    def write(self, frame: Frame, measured: Values) -> None:
        self._first = self._first or {name: np.full(np.shape(value), np.nan) for name, value in measured.items()}
        self._sink.write(frame, {name: measured.get(name, missing) for name, missing in self._first.items()})

    def close(self) -> None:
        self._sink.close()


class _Rows:
    """The numbers of a statistics.nc at any time, read when asked for."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        import netCDF4

        stack.enter_context(NETCDF_LOCK)
        self._dataset = stack.enter_context(netCDF4.Dataset(path))
        self._dataset.set_auto_mask(False)
        self.times = self._dataset["time"][:]
        self.names = [name for name in VARIABLES if name in self._dataset.variables]
        self.rest_volume = self._dataset["rest_volume"][:]

    def at(self, time: float) -> Values:
        """Return every number at a time within the series, interpolated linearly between its frames."""
        slack = _SAME_TIME * max(abs(self.times[0]), abs(self.times[-1]))
        i = int(np.clip(np.searchsorted(self.times, time + slack, side="right") - 1, 0, len(self.times) - 1))
        row = {name: np.asarray(self._dataset[name][i]) for name in self.names}
        if abs(time - self.times[i]) <= slack or i + 1 == len(self.times):
            return row
        share = (time - self.times[i]) / (self.times[i + 1] - self.times[i])
        row = {name: (1 - share) * row[name] + share * self._dataset[name][i + 1] for name in self.names}
        ratio = row["volume_ratio"]  # what does not follow linearly from the cells is counted again
        counted = {
            "volume_ratio_quantile": np.quantile(ratio, QUANTILES),
            "inverted_count": np.asarray((ratio <= 0).sum()),
        }
        return row | counted


def _distinct(series: list[Series]) -> list[Series]:
    """Return two or more series under names that differ."""
    if len(series) < 2:
        raise SeriesError(f"a comparison needs two series or more, not {len(series)}")
    names: list[str] = []
    for one in series:
        count = 1
        while (name := one.name if count == 1 else f"{one.name}_{count}") in names:
            count += 1
        names.append(name)
    return [one if one.name == name else replace(one, name=name) for one, name in zip(series, names, strict=True)]


def _same_cells(series: Sequence[Series], *, difference: bool) -> bool:
    """Return whether all series have the cells of the first; raises SeriesError where they must have and do not."""
    first = series[0].mesh
    for one in series[1:]:
        if one.mesh.dimension != first.dimension:
            raise SeriesError(f"{one.name} has {one.mesh.dimension} dimensions, {series[0].name} {first.dimension}")
        if np.array_equal(one.mesh.cells, first.cells):
            continue
        if difference:
            raise SeriesError(
                f"a difference needs the same cells: {series[0].name} has {len(first.cells)} cells of "
                f"{len(first.points)} nodes, {one.name} {len(one.mesh.cells)} of {len(one.mesh.points)}, "
                "or the same in another order"
            )
        return False
    return True


def _common_times(series: Sequence[Series]) -> tuple[Floats, list[str]]:
    """Return the times of a comparison [s], and a note where they are not those of every series."""
    times = [np.asarray(one.times, dtype=np.float64) for one in series]
    scale = float(np.abs(times[0]).max())
    if all(len(t) == len(times[0]) and np.allclose(t, times[0], rtol=0, atol=_SAME_TIME * scale) for t in times):
        return times[0], []
    start, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    inside = [t[(t >= start) & (t <= end)] for t in times]
    fewest = min(range(len(series)), key=lambda i: (len(inside[i]) or np.inf, i))
    if not len(inside[fewest]):
        spans = ", ".join(f"{one.name} {t[0]:g} to {t[-1]:g} s" for one, t in zip(series, times, strict=True))
        raise SeriesError(f"no frame lies in the time that all series cover: {spans}")
    return inside[fewest], [
        f"the times differ: the comparison has the {len(inside[fewest])} of {series[fewest].name} from {start:g} to "
        f"{end:g} s; numbers of the others are interpolated linearly between their frames"
    ]


def _write_comparison(
    path: Path, rows: list[_Rows], series: list[Series], times: Floats, *, difference: bool, same: bool
) -> None:
    """Write the dataset, a time after the other."""
    import netCDF4

    names = [n for n in VARIABLES if all(n in one.names for one in rows) and (same or "cell" not in VARIABLES[n].dims)]
    with NETCDF_LOCK, netCDF4.Dataset(path, "w", format="NETCDF4") as out:
        _create(out, names, rows if same else [], series, times, difference=difference)
        for k, time in enumerate(times.tolist()):
            first: Values = {}
            for m, one in enumerate(rows):
                row = one.at(time)
                first = first or row
                for name in names:
                    out[name][m, k] = row[name]
                for name in _DIFFERENCES if difference else ():
                    out[f"{name}_difference"][m, k] = row[name] - first[name]


def _write_apart(
    path: Path, series: list[Series], times: Floats, on_frame: OnSeriesFrame | None
) -> tuple[NodeDistance, ...]:
    """Add how far the nodes are apart to the dataset."""
    import netCDF4

    def told(done: int, count: int) -> None:
        if on_frame is not None:
            on_frame("difference of nodes", done, count)

    with NETCDF_LOCK, netCDF4.Dataset(path, "a") as out:
        return write_node_distances(out, series, times, told)


def _create(
    out: Any, names: list[str], rows: list[_Rows], series: list[Series], times: Floats, *, difference: bool
) -> None:
    """Create all dimensions, coordinates and variables; `rows` where the cells are the same in all series."""
    d = series[0].mesh.dimension
    sizes = {"variant": len(series), "time": len(times), "axis": 3, "quantile": len(QUANTILES)}
    if rows:
        sizes["cell"] = len(series[0].mesh.cells)
    out.setncatts({"Conventions": "CF-1.11", "title": _title(series)})
    for dim, size in sizes.items():
        out.createDimension(dim, size)
    labels = np.array([one.name for one in series], dtype=object)
    given = {"time": times, "quantile": np.array(QUANTILES), "axis": np.array(AXES, dtype=object)}
    out.createVariable("variant", str, ("variant",)).setncatts({"long_name": "series"})
    out["variant"][:] = labels
    for name, values in given.items():
        out.createVariable(name, str if values.dtype == object else "f8", (name,)).setncatts(attributes(name, d))
        out[name][:] = values
    if rows:
        rest = np.stack([one.rest_volume for one in rows])
        one_rest = bool((rest == rest[0]).all())
        variable = out.createVariable("rest_volume", "f8", ("cell",) if one_rest else ("variant", "cell"))
        variable.setncatts(attributes("rest_volume", d))
        out["rest_volume"][:] = rest[0] if one_rest else rest
    for name in names:
        dims = ("variant", "time", *VARIABLES[name].dims)
        chunks = [1, 1, sizes["cell"]] if "cell" in dims else None
        out.createVariable(name, "f8", dims, chunksizes=chunks).setncatts(attributes(name, d))
    for name in _DIFFERENCES if difference else ():
        variable = out.createVariable(f"{name}_difference", "f8", ("variant", "time", "cell"),
                                      chunksizes=[1, 1, sizes["cell"]])  # fmt: skip
        text = attributes(name, d)
        variable.setncatts({"units": text["units"], "long_name": f"{name}, less that of {labels[0]}"})


def _title(series: Sequence[Series]) -> str:
    return " and ".join([", ".join(one.name for one in series[:-1]), series[-1].name])


def _figure(path: Path, picture: Path, methods: list[str], title: str, notes: list[str]) -> Path:
    """Draw the volume ratios of a dataset on disk; of long ones some frames, the worst among them."""
    from pipeline.views.plots import write_volume_figure

    with open_dataset(path) as dataset:
        kept = _drawn(dataset)
        if len(kept) < dataset.sizes["time"]:
            notes.append(f"{picture.name} shows {len(kept)} of {dataset.sizes['time']} frames, the worst among them")
        shown = dataset[["volume_ratio", "rest_volume"]].isel(time=kept)
        if "variant" not in dataset.dims:  # after the choice: this reads all that it is given
            shown = shown.assign(volume_ratio=shown["volume_ratio"].expand_dims(variant=methods))
        write_volume_figure(shown, picture, title=title)
    return picture


def _distances(path: Path, picture: Path, title: str) -> Path:
    """Draw how far the nodes are from those of the first series."""
    from pipeline.views.plots import write_distance_figure

    with open_dataset(path) as dataset:
        write_distance_figure(dataset[["node_distance_worst", "node_distance_rms"]], picture, title=title)
    return picture


def _drawn(dataset: "xarray.Dataset") -> list[int]:
    """Return the frames that a figure shows."""
    count = dataset.sizes["time"]
    most = _DRAWN_POINTS if dataset.sizes["cell"] <= _LINES else _DRAWN_VALUES
    most = max(2, most // (dataset.sizes["cell"] * dataset.sizes.get("variant", 1)))
    if count <= most:
        return list(range(count))
    extremes = dataset["volume_ratio_quantile"].isel(quantile=[0, -1])
    worst = abs(extremes - 1).max("quantile").argmax("time").values.ravel()
    return sorted({*np.linspace(0, count - 1, most).round().astype(int).tolist(), *worst.tolist()})


def _movie(
    series: list[Series], labels: list[str], path: Path, notes: list[str], on_drawing: OnDrawing | None
) -> Iterator[Path]:
    """Draw series side by side, no longer than 20 s; yield what was written."""
    from pipeline.views.movie.movie import write_movie

    shown = []
    for one in series:
        kept = np.unique(np.linspace(0, len(one) - 1, min(len(one), _DRAWN_FRAMES)).round().astype(int)).tolist()
        if len(kept) < len(one):
            notes.append(f"{path.name} shows {len(kept)} of the {len(one)} frames of {one.name}")
        shown.append(one.select_frames(kept))
    span = max(one.times[-1] for one in shown) - min(one.times[0] for one in shown)
    poster = path.with_suffix(".png")
    write_movie(
        shown, labels, path, title=_title(series) if len(series) > 1 else labels[0], poster=poster,
        speed=max(1.0, span / _FILM_SECONDS), on_frame=on_drawing,
    )  # fmt: skip
    yield from (path, poster)
