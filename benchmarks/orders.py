"""Error and cost of bodies at rest with cells of order 1 and 2, as a table in markdown.

    python -m benchmarks.orders [--most-cells 50000] [--only heavy]

Each body comes to rest under its own weight, by backward Euler with one corotational solve per step. The error is that
of the mean displacement of its free end, against the finest mesh of order 2 in the table: its own error is unknown, and
estimated by the difference between the two finest ones. `ms` is the fastest step, on one core.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pipeline import build, load_case
from pipeline.arrays import Floats
from pipeline.fem.loads import normal_traction
from pipeline.mesh.element_mesh import ElementMesh
from pipeline.mesh.surface import find_boundary_faces
from pipeline.problem.problem import Problem

CASES = Path(__file__).resolve().parent.parent / "cases"
HEAD = "| body | cells | order | rotations | dilatation | error of the end | ms a step |"
STEP, MOST_STEPS, REST = 1.0, 200, 1e-7  # [s]; of the size: the largest motion in a step of a body at rest
Cells = tuple[int, int, int]


class Body(NamedTuple):
    """A body: its case, keys to change, the axis of its length and the end, and meshes of order 1 and 2."""

    name: str
    case: str
    keys: dict[str, object]
    axis: int
    end: float
    meshes: tuple[tuple[Cells, ...], tuple[Cells, ...]]
    with_mean: bool = False


BAR = (
    ((2, 8, 2), (4, 16, 4), (8, 32, 8), (12, 48, 12)),
    ((2, 4, 2), (2, 8, 2), (4, 12, 4), (6, 18, 6), (8, 24, 8), (12, 36, 12)),
)
AT_REST = {"initial.velocity": [0.0, 0.0, 0.0], "mesh.split": "alternating"}
BODIES = (
    Body(
        "heavy beam", "heavy_beam_quadratic", {}, 0, 10.0,
        (((20, 2, 2), (40, 4, 4), (80, 8, 8)), ((5, 1, 1), (10, 1, 1), (20, 2, 2), (40, 4, 4))),
    ),
    Body("bar, nu .33", "bar_quadratic", AT_REST, 1, 0.0, BAR),
    Body("bar, nu .49", "bar_quadratic", {**AT_REST, "material.poisson_ratio": 0.49}, 1, 0.0, BAR, with_mean=True),
)  # fmt: skip


class Row(NamedTuple):
    """A mesh of a body, the displacement of its end (d,) [m], and the time of a step [ms]."""

    body: str
    cells: int
    order: int
    rotations: str
    dilatation: str
    end: Floats
    ms: float

    def format(self, reference: Floats) -> str:
        """Return the line in markdown, with the error against a displacement."""
        error = np.linalg.norm(self.end - reference) / np.linalg.norm(reference)
        shown = "reference" if error == 0 else f"{100 * error:.2g} %"
        names = (self.body, self.cells, self.order, self.rotations, self.dilatation)
        return "| " + " | ".join(map(str, names)) + f" | {shown} | {self.ms:.3g} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and return 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--most-cells", type=int, default=50_000, help="leave out larger meshes (%(default)s)")
    parser.add_argument("--only", metavar="WORD", default="", help="only bodies whose names have this word")
    options = parser.parse_args(arguments)
    print(HEAD, "| --- " * 7 + "|", sep="\n")
    for body in BODIES:
        if options.only in body.name:
            rows = list(iterate_rows(body, options.most_cells))
            reference = rows[-1].end  # the finest mesh of order 2
            print(*(row.format(reference) for row in rows), sep="\n", flush=True)
    return 0


def iterate_rows(body: Body, most_cells: int) -> Iterator[Row]:
    """Yield the rows of a body: order 1, then order 2; the finest mesh of order 2 comes last."""
    first, second = body.meshes
    parts = [("order_1", first, "full"), ("element", second, "full"), ("points", second, "full")]
    if body.with_mean:
        parts = [parts[0], ("order_1", first, "mean"), *parts[1:], ("points", second, "mean")]
    for variant, meshes, dilatation in parts:
        for cells in meshes:
            if 6 * int(np.prod(cells)) <= most_cells:
                yield measure_mesh(body, variant, cells, dilatation)


def measure_mesh(body: Body, variant: str, cells: Cells, dilatation: str) -> Row:
    """Return the row of a mesh."""
    keys = {"mesh.cells": list(cells), "method.volumetric": dilatation, "method.iterations": 1, "schedule.dt": STEP}
    problem = build(load_case(CASES / f"{body.case}.toml", overrides={**keys, **body.keys}).variant(variant))
    end, ms = come_to_rest(problem, body)
    order = problem.body.mesh.order
    rotations = variant if order == 2 else ""
    return Row(body.name, len(problem.body.mesh.rest_volumes), order, rotations, dilatation, end, ms)


def come_to_rest(problem: Problem, body: Body) -> tuple[Floats, float]:
    """Return the mean displacement of the end at rest [m] and the time of the fastest step [ms]."""
    stepper, state, mesh, fastest = problem.prepare(), problem.start, problem.body.mesh, np.inf
    for count in range(MOST_STEPS):
        start = time.perf_counter()
        after, _ = stepper.step(state)
        fastest = min(fastest, time.perf_counter() - start)
        moved, state = float(np.abs(after.x - state.x).max()), after
        if count > 5 and moved < REST * mesh.size:
            return average_end(mesh, state.x - mesh.points, body), 1e3 * fastest
    raise SystemExit(f"{body.name}: {len(mesh.points)} nodes do not come to rest in {MOST_STEPS} steps")


def average_end(mesh: ElementMesh, u: Floats, body: Body) -> Floats:
    """Return the mean (d,) of displacements u (n, d) over the face at the end."""
    faces, _ = find_boundary_faces(mesh)
    end = faces[(np.abs(mesh.points[faces][:, :, body.axis] - body.end) < 1e-9).all(axis=1)]
    areas = np.abs(normal_traction(mesh, end, 1.0)[:, body.axis])
    return np.asarray(areas @ u / areas.sum())


if __name__ == "__main__":
    sys.exit(main())
