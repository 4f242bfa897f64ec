"""A long run has no more memory and open files at its end than at its beginning."""

import os
import resource
from pathlib import Path

import numpy as np
import pytest

from pipeline.case import load_case
from pipeline.results.case_run import run_case
from tests.bodies import skip_figures, write_case


def read_resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@pytest.mark.slow
def test_memory_and_open_files_do_not_grow(tmp_path, monkeypatch):
    """20 000 steps in 200 frames with a checkpoint each; docs/reliability.md has 100 000."""
    skip_figures(monkeypatch)
    case = load_case(
        write_case(
            tmp_path,
            schedule={"dt": 0.002, "steps_per_frame": 100, "frames": 200},
            output={"checkpoint_frames": 1},
            variants={"only": {"method.stepper": "bdf2"}},
        )
    )
    memory, files = [], []

    def measure(name, problem, frame, summary):
        memory.append(read_resident_bytes())
        files.append(len(os.listdir("/proc/self/fd")))

    result = run_case(case, tmp_path / "out", movie=False, on_frame=measure)
    assert result.variants[0].run["work"]["steps"] == 20_000
    # the first frames load libraries and fill caches
    late = np.array(memory[50:], dtype=float)
    slope = np.polyfit(np.arange(len(late)), late, 1)[0] * len(late)
    assert slope < 2e6, f"{slope / 1e6:.2g} MB more in {len(late)} frames"
    assert max(files[10:]) <= min(files[:10]) + 3  # those that are being written at the moment
