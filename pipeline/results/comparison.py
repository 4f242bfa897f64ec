"""All finished variants of a case side by side: comparison.nc, plots and the movie."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.analysis.compare import join_variants
from pipeline.case import Case, load_case
from pipeline.errors import OutputError, join_names
from pipeline.formats.netcdf import open_dataset
from pipeline.problem.problem import resolve_mass
from pipeline.results.variant_run import UNFINISHED, read_run, result_settings
from pipeline.series import read_series
from pipeline.sinks.frame_formats import FORMATS
from pipeline.views.paraview import SCRIPT_NAME as SCRIPT
from pipeline.views.paraview import write_script

if TYPE_CHECKING:
    import xarray

MOVIE_FILES = ("comparison.mp4", "comparison.png")
_EFFORT = "effort.png"  # if a variant has model = "auto"


def compare_variants(
    case: Case,
    folder: Path,
    *,
    movie: bool,
    fresh: bool = True,
    on_drawing: Callable[[int, int], None] | None = None,
) -> tuple[list[Path], list[str]]:
    """Join and draw every variant in the folder that is a result of this case; return the new files and notes."""
    runs = {name: run for name, run in find_runs(case, folder).items() if run["status"] not in UNFINISHED}
    usable = list(runs)
    if not usable:
        return [], ["no variant has a frame: nothing to compare"]
    paths = {
        n: folder / n for n in ("comparison.nc", "volume.png", "energy.png", "comparison.mp4", "comparison.png", SCRIPT)
    }
    if not fresh and all(path.exists() for name, path in paths.items() if movie or name not in MOVIE_FILES):
        return [], []
    for stale in (*MOVIE_FILES, _EFFORT):
        (folder / stale).unlink(missing_ok=True)
    title = case.movie.title or case.name.replace("_", " ")
    statistics = {name: folder / name / "statistics.nc" for name in usable}
    notes = list(join_variants(statistics, paths["comparison.nc"], title=title))
    from pipeline.views.plots import write_effort_figure, write_energy_figure, write_volume_figure

    made = [paths["comparison.nc"], paths["volume.png"], paths["energy.png"]]
    if numbers := {name: steps for name in usable if (steps := _read_steps(statistics[name])).sizes.get("step")}:
        write_effort_figure(numbers, folder / _EFFORT, title="The model that each step needed")
        made.append(folder / _EFFORT)
    with open_dataset(paths["comparison.nc"]) as dataset:
        write_volume_figure(dataset, paths["volume.png"], title=title)
        write_energy_figure(dataset, paths["energy.png"], title=title)
        made.append(
            _write_paraview_script(
                folder, dataset, {n: str(run["case"]["output"]["format"]) for n, run in runs.items()}
            )
        )
    shown = [name for name in case.movie.variants if name in usable]
    if movie and shown:
        try:
            draw_movie(case, folder, shown, on_drawing=on_drawing)
            made += [paths["comparison.mp4"], paths["comparison.png"]]
        except OutputError as error:
            notes.append(str(error))
    return made, notes


def _read_steps(path: Path) -> "xarray.Dataset":
    """Return the numbers of each step in a statistics.nc; none unless a variant has model = "auto"."""
    with open_dataset(path) as dataset:
        return dataset.drop_dims("time").load()


def _write_paraview_script(folder: Path, dataset: "xarray.Dataset", formats: Mapping[str, str]) -> Path:
    """Write the script that shows the variants in ParaView, all in one color range."""
    from pipeline.views.track import SAMPLED_CELLS, fit_color_radius

    ratio = dataset["volume_ratio"].values[..., :: max(1, dataset.sizes["cell"] // SAMPLED_CELLS)]
    indices = {name: f"{name}/{FORMATS[formats[name]].index}" for name in formats}
    return write_script(folder, indices, radius=fit_color_radius(abs(ratio - 1)))


def draw_movie(
    case: Case, folder: Path, shown: Sequence[str], *, on_drawing: Callable[[int, int], None] | None = None
) -> Path:
    """Draw comparison.mp4 and comparison.png of the variants' recorded frames; raises OutputError without OpenGL."""
    from pipeline.views.movie.movie import write_movie

    path = folder / "comparison.mp4"
    write_movie(
        [read_series(folder / name, name) for name in shown],
        [name.replace("_", " ") for name in shown],
        path,
        title=case.movie.title or case.name.replace("_", " "),
        poster=folder / "comparison.png",
        speed=case.movie.speed,
        fps=case.movie.fps,
        size=(case.movie.size[0], case.movie.size[1]),
        on_frame=on_drawing,
    )
    return path


def find_runs(case: Case, folder: Path) -> dict[str, dict[str, Any]]:
    """Return the run.json of every variant that has frames of exactly this case, by name."""
    runs = {name: read_run(folder / name) for name in case.variant_names}
    return {
        name: run
        for name, run in runs.items()
        if _has_frames(run, folder / name) and _belongs_to(run, case, folder / name)
    }


def _has_frames(run: dict[str, Any], folder: Path) -> bool:
    """Return whether there is a frame; the run.json of a killed run has no count."""
    return bool(run) and (bool(run.get("frames")) or any((folder / one.index).is_file() for one in FORMATS.values()))


def _belongs_to(run: dict[str, Any], case: Case, folder: Path) -> bool:
    """Return whether a run belongs to a variant of this case, or of its copy in the result folder.

    The path of a mesh file is relative to the case file and so may differ; the variant's own case.toml has it as well.
    """
    wanted = result_settings(resolve_mass(case.variant(folder.name)))
    if run["case"] == wanted:
        return True
    own = folder / "case.toml"
    if case.mesh_path is None or not own.is_file():
        return False
    same = load_case(own).mesh_path
    return (
        same is not None
        and same.resolve() == case.mesh_path.resolve()
        and run["case"] | {"mesh": run["case"]["mesh"] | {"file": wanted["mesh"]["file"]}} == wanted
    )


def redraw_movie(folder: str | os.PathLike[str], *, on_drawing: Callable[[int, int], None] | None = None) -> Path:
    """Draw the movie of a result folder again from its frames; raises PipelineError if it is not a result folder."""
    folder = Path(folder)
    case = load_case(folder / "case.toml")
    runs = find_runs(case, folder)
    shown = [name for name in case.movie.variants if name in runs]
    if not shown:
        raise OutputError(f"{folder}: none of {join_names(case.movie.variants)} has a frame of this case")
    return draw_movie(case, folder, shown, on_drawing=on_drawing)
