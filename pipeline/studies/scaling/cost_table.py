"""The costs of a scaling study as lines of text: our methods, then other programs."""

from collections.abc import Sequence

from pipeline.studies.scaling.rival import Rival
from pipeline.studies.scaling.step_cost import METHODS, CostRow

_HEAD = "method         tets   ms a step   ns a tet   iterations   set-up s   peak MB   bound ms"
_RIVAL_HEAD = "other programs     tets         ms   ns a tet   set-up s   ours ms"


def format_costs(rows: Sequence[CostRow], rivals: Sequence[Rival]) -> list[str]:
    """Return the table, with a line for each point, then the cost of Newton's iterations, then the other programs."""
    beside = [rival.name for rival in rivals if rival.beside]
    lines = ["   ".join([_HEAD, *beside])]
    lines += [_format_row(row) for row in rows if row["method"] in METHODS]
    return [*lines, *_list_newton_lines(rows), *_list_order_lines(rows), *_list_rival_lines(rows, rivals)]


def _format_row(row: CostRow) -> str:
    if row["error"]:
        return _format_failure(row)
    peak = f"{row['peak_MB']:9.0f}" if row["peak_MB"] else f"{'':9}"
    baseline = row["baseline_ms"]
    ratio = f"{baseline:10.2f} ({baseline / row['ms']:.1f} x)" if baseline else ""
    line = (
        f"{row['method']:<10} {row['tets']:8d} {row['ms']:11.3f} {row['ns_per_tet']:10.0f} "
        f"{row['linear_iterations']:12g} {row['setup_s']:10.3f} {peak} {row['bound_ms']:10.3f}   {ratio}"
    )
    return line.rstrip()


def _format_failure(row: CostRow) -> str:
    return f"{row['method']:<10} {row['cells']}: {row['error']}"


def _list_newton_lines(rows: Sequence[CostRow]) -> list[str]:
    """Return the cost of an iteration of the converged method over that of one_solve on the same mesh."""
    good = [row for row in rows if not row["error"]]
    one_solve = {(row["case"], row["tets"]): row["ms"] for row in good if row["method"] == "one_solve"}
    lines = []
    for row in good:
        place = row["case"], row["tets"]
        if row["method"] == "converged" and row["iterations"] and place in one_solve:
            ratio = row["ms"] / row["iterations"] / one_solve[place]
            lines.append(f"converged, {row['tets']} tets: an iteration costs {ratio:.1f} x one solve")
    return lines


def _list_order_lines(rows: Sequence[CostRow]) -> list[str]:
    """Return the cost of order_two over that of one_solve on a mesh of the same case with as many nodes."""
    good = [row for row in rows if not row["error"]]
    one_solve = {(row["case"], row["nodes"]): row for row in good if row["method"] == "one_solve"}
    lines = []
    for row in good:
        other = one_solve.get((row["case"], row["nodes"])) if row["method"] == "order_two" else None
        if other and other["tets"] > row["tets"]:
            ratio, cells = row["ms"] / other["ms"], f"{row['tets']} and {other['tets']} tets"
            lines.append(f"order_two, {row['nodes']} nodes: {ratio:.2f} x one_solve with as many ({cells})")
    return lines


def _list_rival_lines(rows: Sequence[CostRow], rivals: Sequence[Rival]) -> list[str]:
    """Return the table of other programs, and the difference of each from ours."""
    measured = {rival.name: rival for rival in rivals if any(row["method"] == rival.name for row in rows)}
    if not measured:
        return []
    lines = [_RIVAL_HEAD, *(_format_rival_row(row) for row in rows if row["method"] in measured)]
    return lines + [f"{name}: {rival.differs}" for name, rival in measured.items()]


def _format_rival_row(row: CostRow) -> str:
    if row["error"]:
        return _format_failure(row)
    return (
        f"{row['method'] + ' ' + row['version']:<14} {row['tets']:8d} {row['ms']:10.3f} {row['ns_per_tet']:10.0f} "
        f"{row['setup_s']:10.3f} {row['ours_ms']:9.3f} ({row['ms'] / row['ours_ms']:.1f} x)"
    )
