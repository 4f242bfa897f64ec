"""What a total error costs with elements of order 1 and 2: trade-off studies of five scenes, a table and a figure.

    python -m benchmarks.fronts [--only heavy_beam] [--out outputs/fronts]

Each row is one study: the solver seconds at which each order reaches 1 % of the body's size in total (model, time and
mesh together), and their ratio. A cost in parentheses is extrapolated, because the order needs finer meshes than were
run. Points that were run before are not run again.
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
from pipeline.studies.tradeoff.verdict import describe_setting

TOLERANCE = 0.01
HEAD = "| scene | simulated | order 1 | order 2 | ratio | error of the finest mesh | setting of order 2 |"


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
    print(HEAD, "| --- " * 7 + "|", sep="\n", flush=True)
    for scene in SCENES:
        if options.only and scene.name not in options.only:
            continue
        case = load_case(cases / f"{scene.name}.toml")
        plan = make_plan(
            case, tolerance=TOLERANCE, dts=scene.dts, refinements=scene.refinements, orders=(1, 2), steps=scene.steps
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
    first, second = find_order_costs(table, TOLERANCE)
    mesh = table.estimate_reference_errors().mesh
    cells = (
        table.plan.case.name,
        f"{table.plan.interval * table.plan.frames:.3g} s",
        format_cost(first),
        format_cost(second),
        f"{first.seconds / second.seconds:.3g}" if isfinite(first.seconds) else "",
        "" if mesh is None else f"{100 * mesh:.2g} %",
        "" if second.setting is None else describe_setting(second.setting),
    )
    return f"| {' | '.join(cells)} |"


def format_cost(cost: OrderCost) -> str:
    """Return the seconds of an order, in parentheses if they are extrapolated."""
    if not isfinite(cost.seconds):
        return "not reached"
    text = f"{cost.seconds:.3g} s"
    return text if cost.setting is not None else f"({text})"


if __name__ == "__main__":
    sys.exit(main())
