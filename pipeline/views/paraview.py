"""Writes open_in_paraview.py into a result folder: paraview_script.py with the values of that result."""

import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from pipeline.arrays import Floats
from pipeline.formats.atomic import write_whole
from pipeline.views.camera import ASIDE, LONG, RAISED

SCRIPT_NAME = "open_in_paraview.py"
_VALUES = re.compile(r"(?<=^# BEGIN VALUES).*?(?=^# END VALUES)", re.MULTILINE | re.DOTALL)


def write_script(folder: Path, indices: Mapping[str, str], *, radius: float, normal: Floats | None = None) -> Path:
    """Write the script for variants by name, each with the file that lists its frames, and return its path.

    `radius` is r of the common color range [1 - r, 1 + r] of the volume ratio; `normal` is that of planar bodies (3,).
    Raises OutputError.
    """
    variants = "".join(f"    ({name!r}, {index!r}),\n" for name, index in indices.items())
    values = (
        f"\nRADIUS = {radius:g}  # colors from 1 - RADIUS to 1 + RADIUS\n"
        f"VARIANTS = [  # name, file\n{variants}]\n"
        f"FOLDER = {str(folder.resolve())!r}\n"
        f"NORMAL = {None if normal is None else [round(float(n), 9) for n in normal]!r}  # of planar bodies, if known\n"
        f"ASIDE, RAISED, LONG = {ASIDE!r}, {RAISED!r}, {LONG!r}  # the movie's camera\n"
    )
    text = files("pipeline.views").joinpath("paraview_script.py").read_text(encoding="utf-8")
    path = folder / SCRIPT_NAME
    write_whole(path, _VALUES.sub(lambda _: values, text))
    return path
