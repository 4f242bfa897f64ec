"""The kind of a folder of results, for messages that say what to do with it."""

from pathlib import Path

from pipeline.case import Case, load_case
from pipeline.errors import CaseError, OutputError, SeriesError, join_names

_INDICES = ("series.pvd", "series.vtkhdf")


def list_variant_folders(folder: Path) -> list[str]:
    """Return the names of the variants that a result folder has; none if it is not one."""
    if not (folder / "case.toml").is_file() or not folder.is_dir():
        return []
    return sorted(path.name for path in folder.iterdir() if any((path / index).is_file() for index in _INDICES))


def load_result_case(folder: Path) -> Case:
    """Return the case of a result folder; raises CaseError that says which folder to give instead."""
    is_variant = any((folder / index).is_file() for index in _INDICES)  # which has a case.toml of its own
    if (is_variant or not (folder / "case.toml").is_file()) and (advice := suggest_folder(folder)):
        raise CaseError(f"{folder}: not the result folder of a case: {advice}")
    return load_case(folder / "case.toml")


def check_series_folder(path: Path) -> None:
    """Raise SeriesError for a result folder with several series, with the paths to choose from."""
    variants = list_variant_folders(path)
    if variants:
        choices = join_names(str(path / name) for name in variants)
        raise SeriesError(f"{path}: the result folder of a case with {len(variants)} variants: give one, {choices}")


def check_output_folder(folder: Path) -> None:
    """Raise OutputError if a folder holds the results of a run, which an analysis must not overwrite."""
    if (folder / "run.json").is_file() or (folder / "case.toml").is_file():
        raise OutputError(f"{folder}: it holds the results of a run, which would be overwritten; choose another --out")


def suggest_folder(folder: Path) -> str:
    """Return what to do instead with a folder that is not the result folder of a case; empty if nothing is known."""
    if any((folder / index).is_file() for index in _INDICES) and (folder.parent / "case.toml").is_file():
        return f"it holds one variant: give {folder.parent}"
    for name, verb in (("comparison.nc", "compare"), ("statistics.nc", "analyze")):
        if (folder / name).is_file():
            return f"it holds an analysis: repeat pipeline {verb} with --movie and --report --out {folder}"
    if folder.is_dir():
        names = ("case.toml", "statistics.nc", "comparison.nc")
        inside = sorted(path for path in folder.iterdir() if any((path / name).is_file() for name in names))
        if inside:
            return f"it holds other results: {join_names(str(path) for path in inside)}"
    return ""
