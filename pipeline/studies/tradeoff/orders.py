"""Elements of order 1 and 2 compared: the cost at which each reaches a total error, measured or extrapolated."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, isfinite, log

from pipeline.studies.tradeoff.levels import ORDERS
from pipeline.studies.tradeoff.settings import Setting
from pipeline.studies.tradeoff.table import ErrorTable, SettingRow
from pipeline.studies.tradeoff.verdict import describe_setting, find_cheapest, format_percent, list_choosable

GOALS = (0.05, 0.01)  # total errors of which every report tells the cost
_LEAST_RATE = 0.1  # of log error over log cost: slower convergence says nothing about finer meshes
_FARTHEST = 1e3  # times the cost of the finest mesh that was run: no line holds that far


@dataclass(frozen=True)
class OrderCost:
    """The solver seconds at which an order reaches the tolerance; infinite if that cannot be told.

    `setting` was measured; it is None if finer meshes are needed than were run: then the seconds are extrapolated.
    """

    order: int
    seconds: float
    setting: Setting | None


def find_order_costs(table: ErrorTable, tolerance: float) -> list[OrderCost]:
    """Return the cost of every order that the study has; none if it has only one."""
    orders = [order for order in ORDERS if any(level.order == order for level in table.plan.levels)]
    return [_find_cost(table, order, tolerance) for order in orders] if len(orders) > 1 else []


def _find_cost(table: ErrorTable, order: int, tolerance: float) -> OrderCost:
    levels = [level for level in table.plan.levels if level.order == order]
    rows = list_choosable(table, levels)
    # on other meshes an error of time that makes up for that of the mesh is luck
    best = find_cheapest([r for r in rows if table.find_mesh_error(r.setting.level) <= tolerance], tolerance, "total")
    if best is not None:
        return OrderCost(order, best.costs["seconds"], best.setting)
    points = []
    for level in levels:
        row = find_cheapest([row for row in rows if row.setting.level == level], tolerance)
        if row is not None:
            points.append((table.find_mesh_error(level), row.costs["seconds"]))
    return OrderCost(order, _extrapolate(points[-2:], tolerance), None)


def _extrapolate(points: Sequence[tuple[float, float]], tolerance: float) -> float:
    """Return the seconds at which the mesh's error falls to the tolerance along the line through two meshes."""
    if len(points) < 2:
        return float("inf")
    (coarse, cheap), (fine, dear) = points
    if not (isfinite(coarse) and fine > 0 and dear > cheap):
        return float("inf")
    rate = log(coarse / fine) / log(dear / cheap)
    if rate <= _LEAST_RATE:
        return float("inf")
    stretch = log(fine / tolerance) / rate
    return dear * exp(stretch) if stretch <= log(_FARTHEST) else float("inf")


def list_goals(tolerance: float) -> list[float]:
    """Return the total errors whose costs are told: those of GOALS and the study's tolerance, largest first."""
    return sorted({*GOALS, tolerance}, reverse=True)


def describe_orders(table: ErrorTable, tolerance: float) -> str:
    """Return one sentence on the cheapest setting of each order and their ratio; "" if there is only one order."""
    costs, goal = find_order_costs(table, tolerance), format_percent(tolerance)
    if not costs:
        return ""
    text = f"{goal} in total: {'; '.join(map(_describe_cost, costs))}"
    first, second = costs
    if second.setting is not None and isfinite(first.seconds):
        text += f": order 1 costs {first.seconds / second.seconds:.3g} times as much"
    finest = table.estimate_reference_errors().finest
    if finest is not None and (finest.error is None or finest.error > tolerance):
        text += "; but the finest mesh itself is not known to be that accurate"
    return text


def _describe_cost(cost: OrderCost) -> str:
    if cost.setting is not None:
        return f"order {cost.order} {1e3 * cost.seconds:.3g} ms ({describe_setting(cost.setting)})"
    if isfinite(cost.seconds):
        return f"order {cost.order} {1e3 * cost.seconds:.3g} ms (extrapolated: it needs finer meshes than were run)"
    return f"order {cost.order} not reached, and not to be extrapolated"


def list_order_front(table: ErrorTable, order: int) -> list[SettingRow]:
    """Return the rows of an order from which a front of total error is drawn."""
    return list_choosable(table, [level for level in table.plan.levels if level.order == order])
