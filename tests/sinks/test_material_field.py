"""The numbers of materials in frames: a field of cells if a body has several materials, nothing otherwise."""

import numpy as np
import pytest

from pipeline.case import load_case
from pipeline.results.case_run import run_case
from tests.bodies import write_case

STIFF = {"youngs_modulus": 9e8, "poisson_ratio": 0.2, "density": 3000.0, "cells": [0, 3]}


@pytest.mark.parametrize("output", ["vtu", "vtkhdf"])
@pytest.mark.parametrize("materials", [[STIFF], []])
def test_frames_have_the_numbers_of_materials(tmp_path, output, materials):
    import pyvista
    import xarray

    case = load_case(write_case(tmp_path, materials=materials, output={"format": output}))
    result = run_case(case, tmp_path / "out", movie=False)
    index = next((tmp_path / "out").rglob("series.pvd" if output == "vtu" else "series.vtkhdf"))
    grid = pyvista.read(index)
    grid = grid[0] if isinstance(grid, pyvista.MultiBlock) else grid
    assert ("material" in grid.cell_data) == bool(materials) and result is not None
    if materials:
        values = np.asarray(grid.cell_data["material"])
        assert values.dtype.kind == "i" and np.flatnonzero(values).tolist() == [0, 3] and values.max() == 1
        with xarray.open_dataset(index, engine="corotational-pipeline") as dataset:
            assert np.flatnonzero(dataset["material"].values.reshape(-1, len(values))[-1]).tolist() == [0, 3]
