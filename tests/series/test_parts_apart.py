"""Parts that touch at rest: one node while they stay together, nodes of their own if they move apart."""

import numpy as np
import pytest

from pipeline.run.measures import measure
from pipeline.series import read_series
from pipeline.series.body.motion_evidence import choose_sample
from tests.foreign.writers import bar, split, stretch, write_pvd, write_vtu

POINTS, CELLS = bar()


def write_parts(folder, factors):
    """Two halves of a bar, each stretched by its own factor in each frame."""
    rows = []
    for k, pair in enumerate(factors):
        for name, cells, factor in zip("ab", (CELLS[:6], CELLS[6:]), pair, strict=True):
            used, local = split(cells)
            u = (stretch(POINTS, factor) - POINTS)[used]
            write_vtu(folder / f"{name}_{k}.vtu", POINTS[used], [(10, local)], {"displacement": u})
            rows.append({"timestep": float(k), "part": "ab".index(name), "file": f"{name}_{k}.vtu"})
    write_pvd(folder / "s.pvd", rows)
    return folder / "s.pvd"


def test_parts_that_stay_together_share_nodes(tmp_path):
    series = read_series(write_parts(tmp_path, [(1, 1), (1.2, 1.2), (1.5, 1.5)]))
    assert len(series.mesh.points) == 12 and any("count as one node" in note for note in series.notes)


def test_parts_that_move_apart_keep_their_own_nodes(tmp_path):
    series = read_series(write_parts(tmp_path, [(1, 1), (1.2, 1), (1.5, 0.9)]))
    assert len(series.mesh.points) == 16 and any("move apart later" in note for note in series.notes)
    ratio = measure(series.read_frame(2))["volume_ratio"]
    assert np.sort(ratio) == pytest.approx([0.9] * 6 + [1.5] * 6)


def test_parts_that_move_apart_only_between_the_frames_looked_at_have_no_numbers_there(tmp_path):
    factors = [(1 + k / 1000, 1 + k / 1000) for k in range(200)]
    unseen = max(set(range(200)) - set(choose_sample(200, 16)))
    factors[unseen] = (1.3, 1.0)
    series = read_series(write_parts(tmp_path, factors))
    assert len(series.mesh.points) == 12
    frame = series.read_frame(unseen)
    assert "touch at rest move apart by 0.3 m" in frame.fault and np.isnan(frame.x).all()
    assert measure(series.read_frame(100))["volume_ratio"] == pytest.approx(1.1)


def test_parts_that_change_places_are_matched_at_rest(tmp_path):
    """Halves of equal cells, and another partition: right is 2, 2.4, 3 and 3.6."""
    rows = []
    halves = [(CELLS[:6], CELLS[6:]), (CELLS[6:], CELLS[:6]), (CELLS[:3], CELLS[3:]), (CELLS[6:], CELLS[:6])]
    for k, (groups, factor) in enumerate(zip(halves, (1.0, 1.2, 1.5, 1.8), strict=True)):
        for part, cells in enumerate(groups):
            used, local = split(cells)
            u = (stretch(POINTS, factor) - POINTS)[used]
            write_vtu(tmp_path / f"f_{k}_{part}.vtu", POINTS[used], [(10, local)], {"u": u})
            rows.append({"timestep": float(k), "part": part, "file": f"f_{k}_{part}.vtu"})
    write_pvd(tmp_path / "s.pvd", rows)
    series = read_series(tmp_path / "s.pvd")
    measured = [measure(frame) for frame in series]
    assert [float(values["total_volume"]) for values in measured] == pytest.approx([2.0, 2.4, 3.0, 3.6])
    for values, factor in zip(measured, (1.0, 1.2, 1.5, 1.8), strict=True):
        assert values["volume_ratio"] == pytest.approx(factor)
