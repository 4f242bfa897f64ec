"""A long run takes no more memory than a short one."""

import os
from pathlib import Path

import pytest

from pipeline import build, frames, load_case
from pipeline.run.recording import Recording, drive
from pipeline.sinks.frame_formats import FORMATS
from pipeline.sinks.netcdf import NetcdfSink
from tests.bodies import write_case

FRAMES = {"vtu": 10_000, "vtkhdf": 2_000}  # a frame of the second takes five times as long
# a frame takes some 20 kB with what was measured on it; its time and the name of its file stay in the index
A_FRAME = 1_000  # bytes


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_memory_is_flat_over_thousands_of_frames(tmp_path, monkeypatch, name):
    count, settled = FRAMES[name], FRAMES[name] // 5
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)  # what the disk takes is not the question here
    mesh = {"shape": "box", "size": [4.0, 12.0, 4.0], "cells": [2, 8, 2]}  # of the thesis
    path = write_case(tmp_path, mesh=mesh, supports=[{"plane": "y", "at": 12.0}],
                      schedule={"dt": 0.01, "frames": count}, output={"format": name})  # fmt: skip
    problem = build(load_case(path).variant("polar"))
    sinks = [FORMATS[name].make_sink(tmp_path, [], "float64", count + 1), NetcdfSink(tmp_path / "s.nc", title="long")]
    seen = {}

    def look(frame, summary):
        if frame.index in (settled, count):
            seen[frame.index] = resident()

    drive(frames(problem), Recording(sinks, on_frame=look))
    assert (seen[count] - seen[settled]) / (count - settled) < A_FRAME, seen
    assert sum(1 for _ in tmp_path.rglob(FORMATS[name].index)) == 1
