"""How many antialiased pictures a second a movie of two bodies gets, the encoding included.

    python benchmarks/movies.py 2x8x2 [--frames 100] [--repeats 3]

The bar of the thesis, linear beside polar, 1280x720, every picture another one. The frames are on disk, as a run
leaves them. "Pictures" are from the first one to the closed file; "whole" has the reading and OpenGL's start too.
Wall time; nothing else should run.
"""

import argparse
import tempfile
import time
from pathlib import Path
from statistics import median

from pipeline import load_case
from pipeline.results.case_run import run_case
from pipeline.series import read_series
from pipeline.views.movie.movie import write_movie

CASE = Path(__file__).parent.parent / "cases" / "bar_as_printed.toml"
VARIANTS = ("linear", "polar")
FPS = 30.0


def main() -> None:
    """Print what the mesh of the command line takes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("boxes", help="along x, y and z: 2x8x2")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    keys = {"mesh.cells": [int(n) for n in options.boxes.split("x")], "schedule.frames": options.frames - 1}
    case = load_case(CASE, overrides=keys)
    with tempfile.TemporaryDirectory(prefix="movies_") as name:
        solved = run_case(case, Path(name), variants=VARIANTS, movie=False).variants
        rows = [
            _rates([variant.folder for variant in solved], Path(name) / "movie.mp4") for _ in range(options.repeats)
        ]
    for i, what in enumerate(("pictures", "whole")):
        print(f"{what:10}{median(row[i] for row in rows):7.1f} a second")


def _rates(folders: list[Path], movie: Path) -> tuple[float, float]:
    """Return pictures a second, from the first one on and with all that comes before."""
    began, drawn = time.perf_counter(), list[float]()
    series = [read_series(folder) for folder in folders]
    span = float(series[0].times[-1] - series[0].times[0])
    speed = span / (len(series[0].times) - 1) * FPS  # a frame of film each frame of the series
    made = write_movie(
        series,
        VARIANTS,
        movie,
        title="movies",
        speed=speed,
        fps=FPS,
        on_frame=lambda *_: drawn.append(time.perf_counter()),
    )
    ended = time.perf_counter()
    return (made.scenes - 1) / (ended - drawn[0]), made.scenes / (ended - began)


if __name__ == "__main__":
    main()
