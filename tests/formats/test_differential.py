"""Two readers, no disagreement: generated files in every layout give the arrays that were written.

`make fuzz` tries 10 000 (PIPELINE_FUZZ); a failure names the kind of file and the number of the example.
"""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import SeriesError
from pipeline.series.frame_files import read_grid
from tests.formats import generated_vtk as V
from tests.formats.generated_content import Content, find_difference

TOTAL = max(2000, int(os.environ.get("PIPELINE_FUZZ", "0")))
Write = Callable[[np.random.Generator, Path], Content]
# suffix, writer, share of the examples
KINDS: dict[str, tuple[str, Write, float]] = {
    "vtu_by_hand": (".vtu", V.write_vtu_by_hand, 0.25),
    "vtu_inline": (".vtu", V.write_inline_vtu, 0.1),
    "vtu_by_vtk": (".vtu", V.write_vtu_by_vtk, 0.2),
    "vtp": (".vtp", V.write_vtp, 0.07),
    "legacy": (".vtk", V.write_legacy, 0.13),
    "pvtu": (".pvtu", V.write_pvtu, 0.08),
}
BATCH = 50


def batches() -> list[tuple[str, range]]:
    rows = []
    for kind, (_, _, share) in KINDS.items():
        count = round(TOTAL * share)
        rows += [(kind, range(k, min(k + BATCH, count))) for k in range(0, count, BATCH)]
    return rows


@pytest.mark.parametrize(("kind", "numbers"), batches(), ids=lambda v: v if isinstance(v, str) else f"{v.start}")
def test_a_file_gives_the_arrays_that_were_written(tmp_path, kind, numbers):
    suffix, write, _ = KINDS[kind]
    faults = []
    for number in numbers:
        folder = tmp_path / str(number)
        folder.mkdir()
        path = folder / f"it{suffix}"
        expected = write(np.random.default_rng([number, *kind.encode()]), path)
        try:
            difference = find_difference(read_grid(path), expected)
        except SeriesError as error:
            difference = str(error)
        if difference:
            faults.append(f"{kind} {number}: {difference}")
        else:
            shutil.rmtree(folder)
    assert not faults, "\n".join(faults)
