"""comparison.nc: the numbers of several statistics.nc side by side along `variant`, read and written in blocks.

`join_variants` joins the variants of one case, which have the same frame times. `join_series` joins any series: it
interpolates their numbers to common times and can add differences from the first series.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.analysis.node_distance import NodeDistance, write_node_distances
from pipeline.analysis.sampling import Sampling, check_units, sample_series
from pipeline.arrays import Floats
from pipeline.errors import OutputError, SeriesError
from pipeline.formats.atomic import replace_file
from pipeline.formats.netcdf import NETCDF_LOCK, NetcdfVariable, create_dataset
from pipeline.run.frame import Values
from pipeline.run.measures import AXES, QUANTILES, VARIABLES
from pipeline.series import Series
from pipeline.series.matching import match_cells
from pipeline.system.times import TIME_RTOL, are_same_times

_BLOCK_BYTES = 1 << 22  # of one field: 4 MB, 2700 frames of 192 cells, or one of half a million
_CHUNK_VALUES = 2048  # of one variant and several frames: 16 kB, as in statistics.nc
_ROUNDING = 1e-12  # of a volume
_OTHER_SIZE = 10.0  # bodies that differ more are hardly meant to be compared as they are
_DIFFERENCES = ("volume_ratio", "rotation_angle")


class StatisticsFile:
    """A statistics.nc whose numbers are read on access; the caller holds the netCDF lock until the stack closes it."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        import netCDF4

        try:
            self._dataset = stack.enter_context(netCDF4.Dataset(path))
            self._dataset.set_auto_mask(False)
            self.times: Floats = self._dataset["time"][:]
            self.rest_volume: Floats = self._dataset["rest_volume"][:]
        except (OSError, RuntimeError, IndexError) as error:
            raise SeriesError(f"{path}: cannot be read ({error})") from error
        self.names = [name for name in VARIABLES if name in self._dataset.variables]
        self.sampling: Sampling | None = None  # if its cells are not those of the comparison
        _limit_caches(self._dataset)

    def read_attributes(self, name: str) -> dict[str, Any]:
        """Return the attributes of a variable."""
        return {key: self._dataset[name].getncattr(key) for key in self._dataset[name].ncattrs()}

    def read_at(self, times: Floats, names: Sequence[str]) -> Values:
        """Return variables (k, ...) at increasing times (k,), NaN after the last frame.

        Between frames they are interpolated linearly; quantiles and counts of inverted cells are those of interpolated
        cells.
        """
        slack = TIME_RTOL * max(abs(self.times[0]), abs(self.times[-1]))
        last = len(self.times) - 1
        recorded = times <= self.times[-1] + slack
        inside = times[recorded]
        frames = np.clip(np.searchsorted(self.times, inside + slack, side="right") - 1, 0, last)
        between = (np.abs(inside - self.times[frames]) > slack) & (frames < last)
        before = frames[between]
        share = (inside[between] - self.times[before]) / (self.times[before + 1] - self.times[before])

        def interpolate(name: str) -> Floats:
            values = self._read_frames(name, frames)
            if before.size:
                weight = share.reshape(-1, *[1] * (values.ndim - 1))
                values[between] = (1 - weight) * values[between] + weight * self._read_frames(name, before + 1)
            return values

        rows = {name: interpolate(name) for name in names}
        if before.size:
            ratio = (rows["volume_ratio"] if "volume_ratio" in rows else interpolate("volume_ratio"))[between]
            rows["volume_ratio_quantile"][between] = np.quantile(ratio, QUANTILES, axis=1).T
            rows["inverted_count"][between] = (ratio <= 0).sum(axis=1)
        if self.sampling is not None:
            chosen = [name for name in rows if "cell" in VARIABLES[name].dims]
            rows |= {name: self.sampling.take_cells(rows[name]) for name in chosen}
        return {name: _pad(values, len(times)) for name, values in rows.items()}

    def _read_frames(self, name: str, frames: Any) -> Floats:
        variable = self._dataset[name]
        if frames.size and (np.diff(frames) == 1).all():
            return np.asarray(variable[frames[0] : frames[-1] + 1])
        out = np.empty((len(frames), *variable.shape[1:]))
        for row, frame in enumerate(frames.tolist()):
            out[row] = variable[frame]
        return out


def _pad(values: Floats, count: int) -> Floats:
    """Return `count` rows, NaN after those of `values`."""
    if len(values) == count:
        return values
    out = np.full((count, *values.shape[1:]), np.nan)
    out[: len(values)] = values
    return out


class ComparisonPlan(NamedTuple):
    """The common ground of several series: times [s], whether they have the same cells, and notes on both.

    The series have the order of the first's nodes and cells if their meshes are the same; `samplings` are None for
    these, and for all if there is no difference to compute.
    """

    series: tuple[Series, ...]
    times: Floats
    same_cells: bool
    difference: bool  # from the first series
    interpolated: bool  # between frames of some series
    notes: tuple[str, ...]
    samplings: tuple[Sampling | None, ...]

    @property
    def title(self) -> str:
        """Return the names of the series as a phrase."""
        names = [s.name for s in self.series]
        return " and ".join([", ".join(names[:-1]), names[-1]])

    @property
    def joins_cells(self) -> bool:
        """Return whether numbers of cells can be joined: all series have the first's cells, or are sampled on them."""
        return self.same_cells or self.difference


def plan_comparison(series: Sequence[Series], *, difference: bool) -> ComparisonPlan:
    """Return how two or more series can be compared; raises SeriesError if they cannot."""
    matched, samplings, match_notes = _match_series(series, difference=difference)
    times, notes = _choose_times(series)
    same_cells = all(s is not None for s in matched)
    chosen = tuple(s if m is None else m for s, m in zip(series, matched, strict=True))
    return ComparisonPlan(chosen, times, same_cells, difference, bool(notes), (*match_notes, *notes), samplings)


def join_variants(
    statistics: Mapping[str, Path], path: Path, *, title: str, cells: Mapping[str, object] | None = None
) -> tuple[str, ...]:
    """Write comparison.nc of the variants of one case; return a note for each that must be left out.

    Variants have the same cells if their rest volumes agree and so do their `cells`, any description of them: cells of
    orders 1 and 2 may be the same, and those of two splits of a box are not, although they have the same volumes. The
    times are those of the variant with the most frames; a variant that stopped early is NaN after its last frame. A
    number that some variants lack is NaN for them. Raises SeriesError, OutputError.
    """
    with _open_statistics(statistics) as files, _write_to(path) as hidden:
        longest = max(files, key=lambda name: len(files[name].times))
        reference, joined, notes = files[longest], {}, []
        for name, file in files.items():
            same = cells is None or cells[name] == cells[longest]
            if not (same and _are_same_volumes(file.rest_volume, reference.rest_volume)):
                notes.append(f"{name} is left out of the comparison: its mesh is not that of {longest}")
            elif not are_same_times(file.times, reference.times[: len(file.times)]):
                notes.append(f"{name} is left out of the comparison: its frame times are not those of {longest}")
            else:
                joined[name] = file
        names = [name for name in VARIABLES if any(name in file.names for file in joined.values())]
        with _create(hidden, joined, reference.times, names, title=title, meaning="variant of the case") as out:
            _write_numbers(out, joined, reference.times, names)
    return tuple(notes)


def _are_same_volumes(a: Floats, b: Floats) -> bool:
    """Return whether rest volumes are the same, apart from the rounding of the two orders' formulas."""
    return a.shape == b.shape and bool((np.abs(a - b) <= _ROUNDING * b).all())


def join_series(
    plan: ComparisonPlan, statistics: Sequence[Path], path: Path, on_time: Callable[[int, int], None] | None = None
) -> tuple[NodeDistance, ...]:
    """Write comparison.nc of several series, given a statistics.nc of each; return the distances of nodes if planned.

    Only numbers that all series have are joined; those of cells, only if the cells are the same. `on_time(done, times)`
    is called while nodes are compared. Raises SeriesError, OutputError.
    """
    labels = [s.name for s in plan.series]
    with _open_statistics(dict(zip(labels, statistics, strict=True))) as files, _write_to(path) as hidden:
        names = [
            name
            for name, variable in VARIABLES.items()
            if all(name in file.names for file in files.values()) and (plan.joins_cells or "cell" not in variable.dims)
        ]
        for file, sampling in zip(files.values(), plan.samplings, strict=True):
            file.sampling = sampling
        with _create(hidden, files, plan.times, names, title=plan.title, meaning="series") as out:
            if plan.difference:
                _create_differences(out, labels[0])
            _write_numbers(out, files, plan.times, names, difference=plan.difference)
            if not plan.difference:
                return ()
            return write_node_distances(out, plan.series, plan.samplings, plan.times, on_time)


@contextmanager
def _open_statistics(paths: Mapping[str, Path]) -> Iterator[dict[str, StatisticsFile]]:
    """Yield the files by name, holding the netCDF lock until they are closed."""
    with NETCDF_LOCK, ExitStack() as stack:
        yield {name: StatisticsFile(path, stack) for name, path in paths.items()}


@contextmanager
def _write_to(path: Path) -> Iterator[Path]:
    """Yield a hidden path that replaces `path` at the end; raises OutputError if netCDF cannot write."""
    try:
        with replace_file(path) as hidden:
            yield hidden
    except RuntimeError as error:  # netCDF's own error, such as for a full disk
        raise OutputError(f"{path}: cannot be written ({error})") from error


def _create(
    path: Path, files: Mapping[str, StatisticsFile], times: Floats, names: Sequence[str], *, title: str, meaning: str
) -> Any:
    """Return a new netCDF4 dataset with all coordinates, rest volumes, and variables that are still NaN."""
    first = next(iter(files.values()))
    sizes = {"variant": len(files), "time": None, "axis": len(AXES), "quantile": len(QUANTILES)}
    labels, axes = (np.array(list(texts), dtype=object) for texts in (files, AXES))
    variables = {
        "variant": NetcdfVariable(("variant",), {"long_name": meaning}, labels, dtype=str),
        "time": NetcdfVariable(("time",), first.read_attributes("time"), times, chunks=(len(times),)),
        "quantile": NetcdfVariable(("quantile",), first.read_attributes("quantile"), QUANTILES),
        "axis": NetcdfVariable(("axis",), first.read_attributes("axis"), axes, dtype=str),
    }
    if any("cell" in VARIABLES[name].dims for name in names):
        sizes["cell"] = len(first.rest_volume)
        rest = np.stack([first.rest_volume if file.sampling else file.rest_volume for file in files.values()])
        shared = all(_are_same_volumes(row, rest[0]) for row in rest)
        variables["rest_volume"] = NetcdfVariable(
            ("cell",) if shared else ("variant", "cell"), first.read_attributes("rest_volume"),
            rest[0] if shared else rest,
        )  # fmt: skip
    for name in names:
        source = next(file for file in files.values() if name in file.names)
        dims = VARIABLES[name].dims
        lengths = [int(sizes[dim] or 1) for dim in dims]
        chunks = (1, max(1, min(len(times), _CHUNK_VALUES // prod(lengths))), *lengths)
        attributes = source.read_attributes(name)
        variables[name] = NetcdfVariable(("variant", "time", *dims), attributes, chunks=chunks, fill_value=np.nan)
    out = create_dataset(path, title=title, sizes=sizes, variables=variables)
    out.set_auto_maskandscale(False)
    _limit_caches(out)
    return out


def _limit_caches(dataset: Any) -> None:
    """Let each field of cells cache one block, not the library's 16 MB or more: every value passes only once."""
    for variable in dataset.variables.values():
        if {"time", "cell"} <= set(variable.dimensions):
            variable.set_var_chunk_cache(size=_BLOCK_BYTES)


def _create_differences(out: Any, first: str) -> None:
    """Create the variables of differences from the first series."""
    for name in _DIFFERENCES:
        source = out[name]
        variable = out.createVariable(
            f"{name}_difference", "f8", source.dimensions, chunksizes=source.chunking(), fill_value=np.nan
        )
        variable.setncatts({"units": source.units, "long_name": f"{name}, minus that of {first}"})
        variable.set_auto_maskandscale(False)


def _write_numbers(
    out: Any, files: Mapping[str, StatisticsFile], times: Floats, names: Sequence[str], *, difference: bool = False
) -> None:
    """Write the variables block by block."""
    cells = max(len(file.rest_volume) for file in files.values())  # before sampling
    block = max(1, _BLOCK_BYTES // (8 * cells))
    for start in range(0, len(times), block):
        place = slice(start, min(start + block, len(times)))
        first: Values = {}
        for m, file in enumerate(files.values()):
            rows = file.read_at(times[place], [name for name in names if name in file.names])
            first = first or rows
            for name, values in rows.items():
                out[name][m, place] = values
            for name in _DIFFERENCES if difference else ():
                out[f"{name}_difference"][m, place] = rows[name] - first[name]


Matches = tuple[list[Series | None], tuple[Sampling | None, ...], tuple[str, ...]]


def _match_series(series: Sequence[Series], *, difference: bool) -> Matches:
    """Return each series in the first's order, None if its mesh is another one; samplings of those; notes.

    Raises SeriesError if bodies have different dimensions or units, or cannot be sampled for a difference.
    """
    first, notes = series[0], list[str]()
    matched, samplings = list[Series | None]([first]), list[Sampling | None]([None])
    for other in series[1:]:
        if other.mesh.dimension != first.mesh.dimension:
            raise SeriesError(
                f"{other.name} has cells of dimension {other.mesh.dimension}, {first.name} of {first.mesh.dimension}: "
                "they cannot be compared"
            )
        match = match_cells(first, other)
        matched.append(match)
        samplings.append(None)
        if match is not None and match is not other:
            notes.append(
                f"{other.name} has the mesh of {first.name} in another order: nodes and cells are matched by rest "
                f"positions, and numbered as in {first.name}"
            )
        if match is None:
            check_units(first, other)
            notes += _compare_sizes(first, other)
            if difference:
                samplings[-1] = sampling = sample_series(first, other)
                notes.append(_describe_sampling(first, other, sampling))
    return matched, tuple(samplings), tuple(notes)


def _describe_sampling(first: Series, other: Series, sampling: Sampling) -> str:
    """Return a note on a series that is sampled."""
    lost = int(np.isnan(sampling.take_nodes(other.mesh.points)).any(axis=1).sum())
    cells, nodes = len(sampling.cells), len(first.mesh.points)
    missing = (
        f"{100 * sampling.without_partner:.3g} % of the volume ({int((sampling.cells < 0).sum())} of {cells} cells) "
        f"and {lost} of {nodes} nodes have no partner and are NaN"
        if lost or sampling.without_partner
        else f"all {cells} cells and {nodes} nodes have a partner"
    )
    return (
        f"{other.name} has another mesh than {first.name}: its numbers are sampled at rest positions of nodes and "
        f"centers of cells of {first.name}; {missing}"
    )


def _compare_sizes(first: Series, other: Series) -> list[str]:
    """Return a note if bodies on different meshes differ so much in size that their units may differ."""
    ratio = other.mesh.size / first.mesh.size
    if 1 / _OTHER_SIZE < ratio < _OTHER_SIZE:
        return []
    return [f"{other.name} is {ratio:.3g} times as large as {first.name}: check that both have the same unit of length"]


def _choose_times(series: Sequence[Series]) -> tuple[Floats, tuple[str, ...]]:
    """Return the times of a comparison [s], and a note if they are not those of every series."""
    times = [np.asarray(s.times, dtype=np.float64) for s in series]
    if all(are_same_times(t, times[0]) for t in times):
        return times[0], ()
    start, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    slack = TIME_RTOL * max(abs(start), abs(end))
    inside = [t[(t >= start - slack) & (t <= end + slack)] for t in times]
    fewest = min(range(len(series)), key=lambda i: (len(inside[i]) or np.inf, i))
    if not len(inside[fewest]):
        spans = ", ".join(f"{s.name} {t[0]:g} to {t[-1]:g} s" for s, t in zip(series, times, strict=True))
        raise SeriesError(f"no frame lies in the time span that all series cover: {spans}")
    return inside[fewest], (
        f"the times differ: the comparison uses the {len(inside[fewest])} times of {series[fewest].name} from "
        f"{start:g} to {end:g} s; numbers of the others are interpolated linearly between their frames",
    )
