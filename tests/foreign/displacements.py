"""Series in which the displacement, the rest state or the moving points must be found from evidence."""

from pathlib import Path

import numpy as np

from tests.foreign.writers import STRETCHES, bar, index, stretch, write_vtu

POINTS, CELLS = bar()
LONG_POINTS, LONG_CELLS = bar((3, 1, 1), (3.0, 1.0, 1.0))
TETRAHEDRA = [(10, CELLS)]


def baseline(folder: Path) -> None:
    """Rest points and displacement."""
    for k, s in enumerate(STRETCHES):
        write_vtu(folder / f"f_{k}.vtu", POINTS, TETRAHEDRA, {"displacement": stretch(POINTS, s) - POINTS})
    index(folder)


def cell_field_displacement(folder: Path) -> None:
    """Point and cell fields are both named displacement; the second index has the cell field alone."""
    for k, s in enumerate(STRETCHES):
        u = stretch(LONG_POINTS, s) - LONG_POINTS
        cells = {"displacement": u[LONG_CELLS].mean(axis=1)}
        write_vtu(folder / f"f_{k}.vtu", LONG_POINTS, [(10, LONG_CELLS)], {"displacement": u}, cells)
        write_vtu(folder / f"g_{k}.vtu", LONG_POINTS, [(10, LONG_CELLS)], {}, cells)
    index(folder)
    index(folder, "cells_only", "g_{}.vtu")


def deformed_from_step_1(folder: Path) -> None:
    """Deformed points and displacement, without a frame at t = 0 (Kratos)."""
    for k, s in enumerate((1.2, 1.5, 1.8), start=1):
        x = stretch(POINTS, s)
        write_vtu(folder / f"Structure_0_{k}.vtu", x, TETRAHEDRA, {"DISPLACEMENT": x - POINTS})
        write_vtu(folder / f"f_{k}.vtu", x, TETRAHEDRA, {"displacement": x - POINTS})
    index(folder, "s", "Structure_0_{}.vtu", (1, 2, 3))
    index(folder, "lower", "f_{}.vtu", (1, 2, 3))


def own_points(folder: Path) -> None:
    """Every cell has points of its own (discontinuous Galerkin)."""
    X, cells = POINTS[CELLS].reshape(-1, 3), np.arange(4 * len(CELLS)).reshape(-1, 4)
    for k, s in enumerate(STRETCHES):
        write_vtu(folder / f"f_{k}.vtu", X, [(10, cells)], {"displacement": stretch(X, s) - X})
    index(folder)


def three_scalars(folder: Path) -> None:
    """The displacement is three scalars, beside a stress."""
    for k, s in enumerate(STRETCHES):
        u = stretch(POINTS, s) - POINTS
        scalars = {f"disp_{axis}": u[:, i].copy() for i, axis in enumerate("xyz")}
        write_vtu(folder / f"f_{k}.vtu", POINTS, TETRAHEDRA, {**scalars, "stress_xx": 2 * u[:, 0]})
    index(folder)


def not_in_first_frame(folder: Path) -> None:
    """The first frame has no displacement field."""
    for k, s in enumerate(STRETCHES):
        fields = {"T": np.zeros(len(POINTS))} | ({"displacement": stretch(POINTS, s) - POINTS} if k else {})
        write_vtu(folder / f"f_{k}.vtu", POINTS, TETRAHEDRA, fields)
    index(folder)


def noise_in_rest_points(folder: Path) -> None:
    """Rest points computed as x - u: they differ by 1e-15 between frames."""
    random = np.random.default_rng(1)
    for k, s in enumerate(STRETCHES):
        u = stretch(POINTS, s) - POINTS
        X = (POINTS + u) - u + (random.uniform(-1, 1, POINTS.shape) * 1e-15 if k else 0)
        write_vtu(folder / f"f_{k}.vtu", X, TETRAHEDRA, {"displacement": u})
    index(folder)


def two_vectors(folder: Path) -> None:
    """D is the displacement, U the velocity, on points that do not move (solids4foam)."""
    for k, s in enumerate(STRETCHES):
        u = stretch(POINTS, s) - POINTS
        write_vtu(folder / f"f_{k}.vtu", POINTS, TETRAHEDRA, {"D": u, "U": 5.0 * u})
    index(folder)


def flow(folder: Path) -> None:
    """A flow through a mesh at rest; U is its velocity (OpenFOAM)."""
    for k in range(3):
        u = POINTS * [0.3 * (1 + k), 0, 0]
        write_vtu(
            folder / f"internal_{k}.vtu", POINTS, TETRAHEDRA, {"U": u, "p": POINTS[:, 0].copy()},
            {"U": np.zeros((len(CELLS), 3)), "p": np.zeros(len(CELLS))},
        )  # fmt: skip
    index(folder, "s", "internal_{}.vtu")


def vectors_named_d_v_p(folder: Path) -> None:
    """Displacement d, velocity v and pressure p on rest points."""
    for k, s in enumerate(STRETCHES):
        u = stretch(POINTS, s) - POINTS
        write_vtu(folder / f"f_{k}.vtu", POINTS, TETRAHEDRA, {"d": u, "v": 3 * u, "p": np.zeros(len(POINTS))})
    index(folder)


def single_precision_far_away(folder: Path) -> None:
    """Single precision at map coordinates: numbers there lie 0.03 to 0.5 m apart."""
    points, cells = bar((4, 2, 2), (4.0, 2.0, 2.0))
    for k, s in enumerate((1.0, 1.001, 1.002)):
        x = (stretch(points, s) + np.array([451234.3, 5712345.7, 0])).astype(np.float32)
        write_vtu(folder / f"f_{k}.vtu", x, [(10, cells)])
    index(folder)


def not_a_number(folder: Path) -> None:
    """The last frame is NaN: the solver diverged."""
    for k, s in enumerate((*STRETCHES, float("nan"))):
        write_vtu(folder / f"f_{k}.vtu", POINTS, TETRAHEDRA, {"displacement": stretch(POINTS, s) - POINTS})
    index(folder, frames=range(4))
