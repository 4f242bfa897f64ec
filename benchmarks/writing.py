"""The time per frame of solving, of writing and of both together, and the overlap of the two.

    python benchmarks/writing.py 8x26x8 [--frames 300] [--repeats 5] [--format vtu] [--precision float64]

The thesis' bar, cut into that many boxes, six tetrahedra each, one solve per step and one step per frame (dt .07 s,
polar rotation). "Solving alone" discards the frames; "writing alone" has them all in memory. Wall time, milliseconds a
frame, the median of the repeats, which take turns; the writer process is started beforehand. Nothing else should run.
"Unrelated" solves in one process and writes frames from memory in another: no overlap can be better.
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
    """Print the times for the mesh on the command line."""
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

    def make_sinks() -> list[Sink]:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        first = FORMATS[options.format].make_sink(folder, [], options.precision, options.frames)
        return [first, NetcdfSink(folder / "statistics.nc", title="writing")]

    def time_frames(watcher: Watcher, recorded: list[Frame] | None = None) -> float:
        source = frames(problem) if recorded is None else iter(recorded)
        first, began = next(source), time.perf_counter()  # after the set-up
        watcher.take(first)
        drive(source, watcher)
        return time.perf_counter() - began

    def time_unrelated() -> float:
        """Run both at once, in two unconnected processes: the best that the machine allows."""
        source = frames(problem)
        next(source)
        began = time.perf_counter()
        solver = os.fork()
        if not solver:
            for _ in source:
                pass
            os._exit(0)
        time_frames(Recording(make_sinks()), recorded)
        os.waitpid(solver, 0)
        return time.perf_counter() - began

    with threadpool_limits(limits=1, user_api="blas"), WriterProcess() as writer:
        recorded = list(frames(problem))
        ways: dict[str, Callable[[], float]] = {
            "solving alone": lambda: time_frames(_NoWatcher()),
            "writing alone": lambda: time_frames(Recording(make_sinks()), recorded),
            "one after the other": lambda: time_frames(Recording(make_sinks())),
            "beside each other": lambda: time_frames(writer.start_recording(make_sinks())),
            "unrelated, at once": time_unrelated,
        }
        time_frames(writer.start_recording(make_sinks()), recorded[:10])  # the writer has started by then
        rows = [{name: way() for name, way in ways.items()} for _ in range(options.repeats)]
    times = {name: 1e3 * median(row[name] for row in rows) / options.frames for name in ways}
    print(f"{len(problem.body.mesh.cells)} tetrahedra, {options.frames} frames, ms a frame")
    for name, value in {**times, **measure_parts(recorded, make_sinks())}.items():
        print(f"{name:24}{value:9.2f}")
    larger = max(times["solving alone"], times["writing alone"])
    for name in ("one after the other", "beside each other", "unrelated, at once"):
        print(f"{name} over the larger of the two: {times[name] / larger:.2f}")
    shutil.rmtree(folder)


class _NoWatcher:
    """Takes frames and does nothing."""

    def take(self, frame: Frame) -> None:
        pass

    def drain(self) -> None:
        pass

    def close(self) -> None:
        pass


def measure_parts(recorded: list[Frame], sinks: list[Sink]) -> dict[str, float]:
    """Return the medians [ms] of measuring a frame and of writing it to each sink."""
    times: dict[str, list[float]] = {}
    for frame in recorded:
        began = time.perf_counter()
        measured = measure(frame)
        times.setdefault("  measuring", []).append(time.perf_counter() - began)
        for sink in sinks:
            began = time.perf_counter()
            sink.write(frame, measured)
            times.setdefault(f"  {type(sink).__name__}", []).append(time.perf_counter() - began)
    for sink in sinks:
        sink.close()
    return {name: 1e3 * median(values) for name, values in times.items()}


if __name__ == "__main__":
    main()
