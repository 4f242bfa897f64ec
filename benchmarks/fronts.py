"""What a total error costs with elements of order 1 and 2: trade-off studies of five scenes, a table and a figure.

    python -m benchmarks.fronts [--only heavy_beam] [--out outputs/fronts]

Each row is one study: the solver seconds at which each order reaches a total error (model, time and mesh together) of
5 % and of 1 % of the body's size, and their ratio. A cost in parentheses is extrapolated, because the order needs finer
meshes than were run. Points that were run before are not run again.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

from pipeline import load_case
from pipeline.studies.tradeoff.order_figure import write_order_figure
from pipeline.studies.tradeoff.orders import OrderCost, find_order_costs
from pipeline.studies.tradeoff.settings import CONVERGED, REFERENCE_STEPPER, Plan, Setting, make_plan
from pipeline.studies.tradeoff.study import study_tradeoff
from pipeline.studies.tradeoff.table import ErrorTable

GOALS = (0.05, 0.01)
HEAD = (
    "| scene | simulated | error of the finest mesh | 5 %: order 1 | order 2 | ratio | 1 %: order 1 | order 2 | ratio |"
)


class Scene(NamedTuple):
    """A case, the steps of its schedule that are run, the step sizes [s], and the refinements."""

    name: str
    steps: int
    dts: Sequence[float]
    refinements: Sequence[float]


SCENES = (
    Scene("heavy_beam", 8, (0.0625, 0.03125, 0.015625), (0.5, 1, 2)),
    Scene("bar_as_printed", 7, (0.007, 0.0035, 0.00175), (0.5, 1, 2)),
    Scene("twisted_bar", 100, (0.02, 0.01), (0.25, 0.5, 1)),
    Scene("beam2d", 3000, (1 / 60, 1 / 120, 1 / 240), (0.25, 0.5, 1, 2)),
    Scene("mushroom", 7, (0.0175, 0.00875), (1, 2)),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the studies, print the table, write the figure and return 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", metavar="NAME", nargs="+", default=[], help="only these scenes")
    parser.add_argument("--out", type=Path, default=Path("outputs/fronts"), help="folder of the studies (%(default)s)")
    options = parser.parse_args(arguments)
    cases, tables = Path(__file__).parents[1] / "cases", []
    print(HEAD, "| --- " * 9 + "|", sep="\n", flush=True)
    for scene in SCENES:
        if options.only and scene.name not in options.only:
            continue
        case = load_case(cases / f"{scene.name}.toml")
        plan = make_plan(
            case, tolerance=GOALS[-1], dts=scene.dts, refinements=scene.refinements, orders=(1, 2), steps=scene.steps
        )
        plan = replace(plan, settings=tuple(s for s in plan.settings if is_main(plan, s)))
        tables.append(study_tradeoff(plan, options.out / scene.name, repeats=3).table)
        print(format_row(tables[-1]), flush=True)
    write_order_figure(tables, options.out / "orders.png")
    return 0


def is_main(plan: Plan, setting: Setting) -> bool:
    """Return whether a setting belongs to the fronts: BDF2 with one solve or converged, and what a study needs."""
    model = (setting.law, setting.rotation, setting.iterations)
    is_own = setting.level == plan.own and setting.stepper != REFERENCE_STEPPER and model == CONVERGED
    return is_own or (
        setting.stepper == REFERENCE_STEPPER
        and setting.mass == plan.case.method.mass
        and (model == CONVERGED or model == ("corotational", "polar", "1"))
    )


def format_row(table: ErrorTable) -> str:
    """Return the line of a study in markdown."""
    mesh = table.estimate_reference_errors().mesh
    cells = [
        table.plan.case.name,
        f"{table.plan.interval * table.plan.frames:.3g} s",
        "unknown" if mesh is None else f"{100 * mesh:.2g} %",
    ]
    for goal in GOALS:
        first, second = find_order_costs(table, goal)
        is_known = isfinite(first.seconds) and second.setting is not None
        cells += [format_cost(first), format_cost(second), f"{first.seconds / second.seconds:.2g}" if is_known else ""]
    return f"| {' | '.join(cells)} |"


def format_cost(cost: OrderCost) -> str:
    """Return the seconds of an order, in parentheses if they are extrapolated."""
    if not isfinite(cost.seconds):
        return "not reached"
    text = f"{cost.seconds:.3g} s"
    return text if cost.setting is not None else f"({text})"


if __name__ == "__main__":
    sys.exit(main())
