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
from pipeline.results.folder_kinds import load_result_case
from pipeline.results.variant_run import UNFINISHED, read_run, result_settings
from pipeline.series import read_series
from pipeline.sinks.frame_formats import FORMATS
from pipeline.views.paraview import SCRIPT_NAME as SCRIPT
from pipeline.views.paraview import write_script

if TYPE_CHECKING:
    import xarray

MOVIE_FILES = ("comparison.mp4", "comparison.png")
_DATASET, _FIGURES = "comparison.nc", ("volume.png", "energy.png")
_EFFORT = "effort.png"


def compare_variants(
    case: Case,
    folder: Path,
    *,
    movie: bool,
    rewrite: bool = True,
    on_drawing: Callable[[int, int], None] | None = None,
) -> tuple[list[Path], list[str]]:
    """Join and draw every variant in the folder that is a result of this case; return the new files and notes.

    Without `rewrite`, nothing is written if all files exist.
    """
    runs = {name: run for name, run in find_runs(case, folder).items() if run["status"] not in UNFINISHED}
    if not runs:
        return [], ["no variant has a frame: nothing to compare"]
    wanted = (_DATASET, *_FIGURES, SCRIPT, *(MOVIE_FILES if movie else ()))
    if not rewrite and all((folder / name).exists() for name in wanted):
        return [], []
    for outdated in (*MOVIE_FILES, _EFFORT):
        (folder / outdated).unlink(missing_ok=True)
    statistics = {name: folder / name / "statistics.nc" for name in runs}
    cells = {name: _describe_cells(run["case"]["mesh"]) for name, run in runs.items()}
    notes = list(join_variants(statistics, folder / _DATASET, title=make_title(case), cells=cells))
    formats = {name: str(run["case"]["output"]["format"]) for name, run in runs.items()}
    with open_dataset(folder / _DATASET) as dataset:
        figures = _draw_figures(dataset, statistics, folder, title=make_title(case))
        files = [folder / _DATASET, *figures, _write_paraview_script(dataset, folder, formats)]
    shown = [name for name in case.movie.variants if name in runs]
    if movie and shown:
        try:
            draw_movie(case, folder, shown, on_drawing=on_drawing)
            files += [folder / name for name in MOVIE_FILES]
        except OutputError as error:
            notes.append(str(error))
    return files, notes


def _describe_cells(mesh: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a mesh that its cells depend on."""
    return {key: value for key, value in mesh.items() if key != "order"}


def make_title(case: Case) -> str:
    """Return the title of a case's pictures and page."""
    return case.movie.title or case.name.replace("_", " ")


def _draw_figures(dataset: "xarray.Dataset", statistics: Mapping[str, Path], folder: Path, *, title: str) -> list[Path]:
    """Draw volumes and energies, and effort.png if a variant has model = "auto"; return the files."""
    from pipeline.views.plots import write_effort_figure, write_energy_figure, write_volume_figure

    volume, energy, effort = (folder / name for name in (*_FIGURES, _EFFORT))
    efforts = {name: steps for name, path in statistics.items() if (steps := _read_steps(path)).sizes.get("step")}
    if efforts:
        write_effort_figure(efforts, effort, title="The model that each step needed")
    write_volume_figure(dataset, volume, title=title)
    write_energy_figure(dataset, energy, title=title)
    return [volume, energy, *([effort] if efforts else [])]


def _read_steps(path: Path) -> "xarray.Dataset":
    """Return the numbers of each step in a statistics.nc; none unless a variant has model = "auto"."""
    with open_dataset(path) as dataset:
        return dataset.drop_dims("time").load()


def _write_paraview_script(dataset: "xarray.Dataset", folder: Path, formats: Mapping[str, str]) -> Path:
    """Write the script that shows the variants in ParaView, all with one color range."""
    from pipeline.views.track import SAMPLED_CELLS, fit_color_radius

    ratio = dataset["volume_ratio"].values[..., :: max(1, dataset.sizes["cell"] // SAMPLED_CELLS)]
    indices = {name: f"{name}/{FORMATS[formats[name]].index}" for name in formats}
    return write_script(folder, indices, radius=fit_color_radius(abs(ratio - 1)))


def draw_movie(
    case: Case, folder: Path, shown: Sequence[str], *, on_drawing: Callable[[int, int], None] | None = None
) -> Path:
    """Draw comparison.mp4 and comparison.png of the variants' recorded frames; raises OutputError without OpenGL."""
    from pipeline.views.movie.movie import write_movie

    path, poster = (folder / name for name in MOVIE_FILES)
    write_movie(
        [read_series(folder / name, name) for name in shown],
        [name.replace("_", " ") for name in shown],
        path,
        title=make_title(case),
        poster=poster,
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
    return bool(run) and (bool(run.get("frames")) or any((folder / row.index).is_file() for row in FORMATS.values()))


def _belongs_to(run: dict[str, Any], case: Case, folder: Path) -> bool:
    """Return whether a run belongs to a variant of this case, or of its copy in the result folder.

    The path of a mesh file is relative to the case file and so may differ; the variant's own case.toml has it too.
    """
    wanted = result_settings(resolve_mass(case.variant(folder.name)))
    if run["case"] == wanted:
        return True
    copy = folder / "case.toml"
    if case.mesh_path is None or not copy.is_file():
        return False
    mesh_path = load_case(copy).mesh_path
    return (
        mesh_path is not None
        and mesh_path.resolve() == case.mesh_path.resolve()
        and run["case"] | {"mesh": run["case"]["mesh"] | {"file": wanted["mesh"]["file"]}} == wanted
    )


def redraw_movie(folder: str | os.PathLike[str], *, on_drawing: Callable[[int, int], None] | None = None) -> Path:
    """Redraw the movie of a result folder from its frames; raises PipelineError if it is not a result folder."""
    folder = Path(folder)
    case = load_result_case(folder)
    runs = find_runs(case, folder)
    shown = [name for name in case.movie.variants if name in runs]
    if not shown:
        raise OutputError(
            f"{folder}: none of {join_names(case.movie.variants)} has a frame of this case; pipeline run solves them"
        )
    return draw_movie(case, folder, shown, on_drawing=on_drawing)
