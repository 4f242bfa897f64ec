"""What solving, writing and both together take a frame, and how well writing overlaps solving.

    python benchmarks/writing.py 8x26x8 [--frames 300] [--repeats 5] [--format vtu] [--precision float64]

The thesis' bar of so many boxes, six tetrahedra each, one frame a step of one solve (dt .07 s, polar rotations).
Solving alone has the frames thrown away; writing alone has them all in memory. Wall time, milliseconds a frame, the
median of the repeats, which take turns; the process that writes is there before the first frame. Nothing else should
run. "Unrelated" solves in one process and writes what is in memory in another: no overlap is better than that.
"""

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from threadpoolctl import threadpool_limits

from pipeline import build, frames, load_case
from pipeline.run.frame import Frame, Sink
from pipeline.run.measures import measure
from pipeline.run.recording import Recording, Watcher, drive
from pipeline.sinks.frame_formats import FORMATS
from pipeline.sinks.netcdf import NetcdfSink
from pipeline.sinks.writer_process import WriterProcess

CASE = Path(__file__).parent.parent / "cases" / "bar_as_printed.toml"


def main() -> None:
    """Print what the mesh of the command line takes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("boxes", help="along x, y and z: 8x26x8")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--format", choices=FORMATS, default="vtu")
    parser.add_argument("--precision", choices=("float64", "float32"), default="float64")
    options = parser.parse_args()
    keys = {"mesh.cells": [int(n) for n in options.boxes.split("x")], "schedule.frames": options.frames - 1}
    problem = build(load_case(CASE, overrides={**keys, "method.linear_rtol": 1e-6}).variant("polar"))
    folder = Path(tempfile.mkdtemp(prefix="writing_"))

    def sinks() -> list[Sink]:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        first = FORMATS[options.format].make_sink(folder, [], options.precision, options.frames)
        return [first, NetcdfSink(folder / "statistics.nc", title="writing")]

    def seconds(watcher: Watcher, kept: list[Frame] | None = None) -> float:
        source = frames(problem) if kept is None else iter(kept)
        first, began = next(source), time.perf_counter()  # the set-up is behind us
        watcher.take(first)
        drive(source, watcher)
        return time.perf_counter() - began

    def unrelated() -> float:
        """Both at once, by processes that know nothing of each other: what the machine allows."""
        source = frames(problem)
        next(source)
        began = time.perf_counter()
        solver = os.fork()
        if not solver:
            for _ in source:
                pass
            os._exit(0)
        seconds(Recording(sinks()), kept)
        os.waitpid(solver, 0)
        return time.perf_counter() - began

    with threadpool_limits(limits=1, user_api="blas"), WriterProcess() as writer:
        kept = list(frames(problem))
        ways: dict[str, Callable[[], float]] = {
            "solving alone": lambda: seconds(_Nowhere()),
            "writing alone": lambda: seconds(Recording(sinks()), kept),
            "one after the other": lambda: seconds(Recording(sinks())),
            "beside each other": lambda: seconds(writer.start_recording(sinks())),
            "unrelated, at once": unrelated,
        }
        seconds(writer.start_recording(sinks()), kept[:10])  # it has started
        rows = [{name: way() for name, way in ways.items()} for _ in range(options.repeats)]
    took = {name: 1e3 * median(row[name] for row in rows) / options.frames for name in ways}
    print(f"{len(problem.body.mesh.cells)} tetrahedra, {options.frames} frames, ms a frame")
    for name, value in {**took, **parts(kept, sinks())}.items():
        print(f"{name:24}{value:9.2f}")
    larger = max(took["solving alone"], took["writing alone"])
    for name in ("one after the other", "beside each other", "unrelated, at once"):
        print(f"{name} over the larger of the two: {took[name] / larger:.2f}")
    shutil.rmtree(folder)


class _Nowhere:
    """Takes frames and does nothing."""

    def take(self, frame: Frame) -> None:
        pass

    def drain(self) -> None:
        pass

    def close(self) -> None:
        pass


def parts(kept: list[Frame], sinks: list[Sink]) -> dict[str, float]:
    """Return the medians [ms] of measuring a frame and of each sink's writing it."""
    took: dict[str, list[float]] = {}
    for frame in kept:
        began = time.perf_counter()
        measured = measure(frame)
        took.setdefault("  measuring", []).append(time.perf_counter() - began)
        for sink in sinks:
            began = time.perf_counter()
            sink.write(frame, measured)
            took.setdefault(f"  {type(sink).__name__}", []).append(time.perf_counter() - began)
    for sink in sinks:
        sink.close()
    return {name: 1e3 * median(values) for name, values in took.items()}


if __name__ == "__main__":
    main()
