"""The cost of the same questions about the same series in this package and in MeshSeries of ogstools.

    python benchmarks/series.py SERIES.pvd --theirs VENV/bin/python [--repeats 5]

ogstools is in an environment of its own (python -m venv VENV; VENV/bin/pip install ogstools). Each figure is from one
process that imports, opens, asks once (processor seconds, and the peak memory of the whole process) and asks again with
its caches. Medians over the repeats; a sum over each answer shows that both are the same. Processor seconds, as other
programs may be running; nothing here runs in parallel.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

POINTS = 100  # to probe
RESAMPLED = 500  # times, between those of the frames
CELLS = 40  # to extract


def ask_ours(path: Path, folder: Path) -> tuple[float, dict[str, Callable[[], Any]]]:
    """Return the time after the imports, and the questions in xarray."""
    import numpy as np
    import xarray

    done, ds = time.process_time(), xarray.open_dataset(path)
    t = ds.time.values
    between, probes = _choose_times(t), _choose_points(ds.rest_position.values, ds.connectivity.values)
    return done, {
        "open": lambda: xarray.open_dataset(path).sizes["time"],
        "read one field": lambda: ds.displacement.values.sum(),
        "read everything": lambda: xarray.open_dataset(path).load().velocity.values.sum(),
        "probe at 100 points": lambda: ds.deformation.probe("displacement", probes).values.sum(),
        "resample to 500 times": lambda: ds.interp(time=between).displacement.values.sum(),
        "maximum in time": lambda: ds.displacement.max("time").values.sum(),
        "mean in time": lambda: ds.volume_ratio.mean("time").values.sum(),
        "mean in space": lambda: ds.volume_ratio.mean("cell").values.sum(),
        "difference of two times": lambda: (ds.volume_ratio[-1] - ds.volume_ratio[0]).values.sum(),
        "difference of two series": lambda: (xarray.open_dataset(path).displacement - ds.displacement).values.sum(),
        "time of the extreme": lambda: ds.volume_ratio.idxmax("time").values.sum(),
        "extract 40 cells": lambda: ds.deformation.extract(np.arange(CELLS)).load().volume_ratio.values.sum(),
        "extract a fifth of the times": lambda: ds.isel(time=slice(None, len(t) // 5)).load().velocity.values.sum(),
        "save": lambda: _is_written(ds.deformation.to_pvd(folder / f"{time.monotonic_ns()}.pvd")),
    }  # fmt: skip


def ask_theirs(path: Path, folder: Path) -> tuple[float, dict[str, Callable[[], Any]]]:
    """Return the time after the imports, and the questions in ogstools."""
    import numpy as np
    import ogstools
    from ogstools.mesh.differences import difference

    done, ms = time.process_time(), ogstools.MeshSeries(path)
    t, first = ms.timevalues, ms[0]
    between, probes = _choose_times(t), _choose_points(first["rest_position"], first.cells_dict[10])
    whole = ogstools.MeshSeries.difference
    return done, {
        "open": lambda: len(ogstools.MeshSeries(path)),
        "read one field": lambda: ms.values("displacement").sum(),
        "read everything": lambda: sum(mesh["velocity"].sum() for mesh in ogstools.MeshSeries(path)),
        "probe at 100 points": lambda: ms.probe_values(probes, "displacement").sum(),
        "resample to 500 times": lambda: ms.resample_temporal(between).values("displacement").sum(),
        "maximum in time": lambda: ms.aggregate_temporal("displacement", np.max)["displacement_max"].sum(),
        "mean in time": lambda: ms.aggregate_temporal("volume_ratio", np.mean)["volume_ratio_mean"].sum(),
        "mean in space": lambda: ms.aggregate_spatial("volume_ratio", np.mean).sum(),
        "difference of two times": lambda: difference(ms[-1], ms[0], "volume_ratio")["volume_ratio_difference"].sum(),
        "difference of two series": lambda: whole(ogstools.MeshSeries(path), ms, "displacement").values(
            "displacement_difference").sum(),
        "time of the extreme": lambda: ms.time_of_max("volume_ratio")["max_volume_ratio_time"].sum(),
        "extract 40 cells": lambda: ms.extract(np.arange(CELLS), "cells").values("volume_ratio").sum(),
        "extract a fifth of the times": lambda: ms[: len(t) // 5].values("velocity").sum(),
        "save": lambda: _is_written(ms.save(folder / f"{time.monotonic_ns()}.pvd")[0]),
    }  # fmt: skip


LIBRARIES = {"ours": ask_ours, "theirs": ask_theirs}


def _choose_times(times: Any) -> Any:
    """Return times between those of the frames."""
    import numpy as np

    return np.linspace(times[0], times[-1], RESAMPLED + 2)[1:-1]


def _choose_points(rest: Any, cells: Any) -> Any:
    """Return centers of cells at rest, where a linear field is the mean of its corners."""
    import numpy as np

    return rest[cells[np.linspace(0, len(cells) - 1, POINTS).astype(int)]].mean(axis=1)


def _is_written(index: Path) -> bool:
    return index.stat().st_size > 0


def run_child(library: str, task: str, path: Path) -> None:
    """Print the cost of one task in this process, as JSON."""
    import resource

    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        imported, tasks = LIBRARIES[library](path, Path(folder))
        opened = time.process_time()
        seconds, answer = [], 0.0
        for _ in range(2):
            began = time.process_time()
            answer = float(tasks[task]())
            seconds.append(time.process_time() - began)
            if len(seconds) == 1:
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        peak += resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    costs = {"imported": imported - start, "opened": opened - imported, "first": seconds[0], "again": seconds[1]}
    print(json.dumps(costs | {"peak": peak, "answer": answer}))


def measure_task(python: str, library: str, task: str, path: Path, repeats: int) -> dict[str, float]:
    """Return the medians of a task over several processes."""
    command = [python, __file__, str(path), "--child", library, task]
    one_thread = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    rows = []
    for _ in range(repeats):
        run = subprocess.run(command, capture_output=True, text=True, check=False, env=one_thread)
        if run.returncode:
            raise SystemExit(f"{library}, {task}: {run.stderr[-2000:]}")
        rows.append(json.loads(run.stdout.splitlines()[-1]))
    return {name: median(row[name] for row in rows) for name in rows[0]}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("series", type=Path)
    parser.add_argument("--theirs", help="the python of an environment with ogstools")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--task", action="append", help="only this; may be repeated")
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    path = options.series.resolve()
    if options.child:
        run_child(*options.child, path)
        return
    pythons = {"ours": sys.executable} | ({"theirs": options.theirs} if options.theirs else {})
    names = options.task or list(TASKS)
    heads = [f"{which}, {number}" for number in ("s", "again [s]", "peak [MB]") for which in pythons]
    print(f"| {' | '.join(['task', *heads])} | same answer |\n|{' --- |' * (len(heads) + 2)}")
    for name in names:
        costs = {which: measure_task(python, which, name, path, options.repeats) for which, python in pythons.items()}
        if name == names[0]:
            start = {which: f"{row['imported']:.2f} + {row['opened']:.3f}" for which, row in costs.items()}
        cells = [f"{row['first']:.3g}" for row in costs.values()]
        cells += [f"{row['again']:.3g}" for row in costs.values()]
        cells += [f"{row['peak']:.0f}" for row in costs.values()]
        answers = [row["answer"] for row in costs.values()]
        same = abs(answers[-1] - answers[0]) <= 1e-6 * max(1.0, abs(answers[0]))
        print(f"| {name} | {' | '.join(cells)} | {'yes' if same else answers} |", flush=True)
    print(f"\nimports + the first opening [s]: {start}")


TASKS = (
    "open", "read one field", "read everything", "probe at 100 points", "resample to 500 times", "maximum in time",
    "mean in time", "mean in space", "difference of two times", "difference of two series", "time of the extreme",
    "extract 40 cells", "extract a fifth of the times", "save",
)  # fmt: skip

if __name__ == "__main__":
    main()
