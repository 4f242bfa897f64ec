"""The antialiased pictures per second of a movie of two bodies, encoding included.

    python benchmarks/movies.py 2x8x2 [--frames 100] [--repeats 3]

The bar of the thesis, linear and polar side by side, 1280x720, all pictures different. The frames are on disk, as after
a run. "Pictures" counts from the first one to the closed file; "whole" includes reading and the start of OpenGL. Wall
time; nothing else should run.
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
    """Print the rates for the mesh on the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("boxes", help="along x, y and z: 2x8x2")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    keys = {"mesh.cells": [int(n) for n in options.boxes.split("x")], "schedule.frames": options.frames - 1}
    case = load_case(CASE, overrides=keys)
    with tempfile.TemporaryDirectory(prefix="movies_") as name:
        results = run_case(case, Path(name), variants=VARIANTS, movie=False).variants
        movie = Path(name) / "movie.mp4"
        rows = [_measure_rates([variant.folder for variant in results], movie) for _ in range(options.repeats)]
    for i, name in enumerate(("pictures", "whole")):
        print(f"{name:10}{median(row[i] for row in rows):7.1f} a second")


def _measure_rates(folders: list[Path], movie: Path) -> tuple[float, float]:
    """Return the pictures per second, from the first one on and from the start of reading."""
    began, picture_times = time.perf_counter(), list[float]()
    series = [read_series(folder) for folder in folders]
    span = float(series[0].times[-1] - series[0].times[0])
    speed = span / (len(series[0].times) - 1) * FPS  # one frame of film for each frame of the series
    movie_report = write_movie(
        series,
        VARIANTS,
        movie,
        title="movies",
        speed=speed,
        fps=FPS,
        on_frame=lambda *_: picture_times.append(time.perf_counter()),
    )
    ended = time.perf_counter()
    return (movie_report.scenes - 1) / (ended - picture_times[0]), movie_report.scenes / (ended - began)


if __name__ == "__main__":
    main()
